"""Effects of compliant joints and drives, and of their range."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial

import mujoco
import numpy as np
from numpy.typing import NDArray

from simgap.data.channels import InputChannel
from simgap.data.plant import Plant
from simgap.effects.base import (
    ByPart,
    Context,
    Effect,
    Parameter,
    Wave,
    amount,
    by_joint,
    dof_of,
    joint_units,
    named_sites,
    ratio,
    scalar_joints,
)
from simgap.effects.servo import commanded, swing
from simgap.simulation.variant import SPRING_DAMPING, Variant

Obj = mujoco.mjtObj
_HARD = 250.0, 1.0
"""A stop is hard (how fast it rings [rad/s]; MuJoCo's default of 50 lets a small range pass), and does not bounce (its
damping ratio)."""
LEAST_OF_SWING, MOST_OF_SWING = 0.02, 0.5
"""Periods of a ripple, as shares of the joint's motion in the recording."""


def _sprung(model: mujoco.MjModel) -> list[int]:
    return [j for j in scalar_joints(model) if model.jnt_stiffness[j] > 0]


class JointStiffness(ByPart):
    """The spring of a joint is softer (fatigue, another material) or stiffer; or cables, a skin or dirt add one.

    What is added pulls to the joint's zero, wherever a spring that was there rests.
    """

    name = "joint_stiffness"

    @classmethod
    def candidates(cls, context: Context) -> Iterable[Effect]:
        model = context.model
        for site in named_sites(context, Obj.mjOBJ_JOINT, _sprung(model)):
            yield cls(site, by_joint(context, site, lambda _: ratio(tries=(0.4, 0.7, 1.4, 2.0))), "factor")
        for site in named_sites(context, Obj.mjOBJ_JOINT, scalar_joints(model)):
            yield cls(site, by_joint(context, site, lambda joints: _added(context, joints)), "added")

    def apply(self, variant: Variant, values: Sequence[float]) -> None:
        targets = list(self.site.targets)
        if self.form == "factor":
            variant.model.jnt_stiffness[targets] *= np.asarray(values)
            return
        model, addresses = variant.model, variant.plant.model.jnt_qposadr[targets]
        before = model.jnt_stiffness[targets]
        after = before + np.asarray(values)
        # Two springs are one that rests between them.
        share = np.divide(before, after, out=np.ones_like(after), where=after > 0)
        zero = variant.plant.model.qpos0[addresses]
        model.jnt_stiffness[targets] = after
        model.qpos_spring[addresses] = zero + share * (model.qpos_spring[addresses] - zero)


def _added(context: Context, joints: Sequence[int]) -> Parameter:
    """Of a spring where there is none."""
    dofs = [dof_of(context.model, j) for j in joints]
    swing = float(np.mean(context.scales.high[dofs] - context.scales.low[dofs])) or 1.0
    angle, force = joint_units(context.model, joints[0])
    size = 0.4 * float(max(context.scales.torque[dofs].mean(), 1e-9)) / swing
    return amount("stiffness", f"{force}/{angle}", size)


class JointRestAngle(Effect):
    """The spring of a joint rests elsewhere (lost pretension, creep)."""

    name = "joint_rest_angle"

    @classmethod
    def candidates(cls, context: Context) -> Iterable[Effect]:
        for site in named_sites(context, Obj.mjOBJ_JOINT, _sprung(context.model)):
            unit = joint_units(context.model, site.targets[0])[0]
            size = 0.1 if unit == "rad" else 0.005
            yield cls(site, [amount("shift", unit, size, (-2.0, -0.5, 0.5, 2.0), low=-15.0, high=15.0)])

    def apply(self, variant: Variant, values: Sequence[float]) -> None:
        addresses = variant.plant.model.jnt_qposadr[list(self.site.targets)]
        variant.model.qpos_spring[addresses] += values[0]


class JointRange(Effect):
    """A stop that the model does not have ends the joint's motion above or below."""

    name = "joint_range"

    @classmethod
    def candidates(cls, context: Context) -> Iterable[Effect]:
        model = context.model
        for site in named_sites(context, Obj.mjOBJ_JOINT, scalar_joints(model)):
            dofs = [dof_of(model, j) for j in site.targets]
            low, high = float(context.scales.low[dofs].min()), float(context.scales.high[dofs].max())
            swing, unit = high - low, joint_units(model, site.targets[0])[0]
            if swing <= 0:
                continue
            # A real stop shows as the end of what was measured, so that is where to start.
            upper = Parameter(
                "upper", unit, high + swing, high - 0.6 * swing, high + swing, (high, high - 0.1 * swing), 0.1 * swing
            )
            lower = Parameter(
                "lower", unit, low - swing, low - swing, low + 0.6 * swing, (low, low + 0.1 * swing), 0.1 * swing
            )
            yield cls(site, [upper], "upper")
            yield cls(site, [lower], "lower")

    def alternatives(self) -> Sequence[Effect]:
        """A stop that gives way, and gives back some of the speed."""
        if len(self.parameters) > 1:
            return ()
        ringing = Parameter("frequency", "rad/s", _HARD[0], 40.0, _HARD[0], (100.0, 200.0), 40.0)
        damping = Parameter("damping_ratio", "1", _HARD[1], 0.1, _HARD[1], (0.2, 0.6), 0.15)
        return (type(self)(self.site, [*self.parameters, ringing, damping], f"{self.form}, soft"),)

    def apply(self, variant: Variant, values: Sequence[float]) -> None:
        model = variant.model
        frequency, damping = values[1:] or _HARD
        for j in self.site.targets:
            low, high = model.jnt_range[j] if model.jnt_limited[j] else (-1e3, 1e3)
            upper = self.parameters[0].name == "upper"
            model.jnt_range[j] = [low, min(high, values[0])] if upper else [max(low, values[0]), high]
            model.jnt_limited[j] = 1
            model.jnt_solref[j] = 1.0 / (frequency * damping), damping


class JointElasticity(ByPart):
    """The drive between motor and joint gives like a spring and rings: a harmonic drive, a belt, a printed gear.

    The servo holds its motor, whose inertia is the joint's armature; what is recorded is the joint.
    """

    name = "joint_elasticity"

    @classmethod
    def candidates(cls, context: Context) -> Iterable[Effect]:
        model = context.model
        drives: dict[int, list[int]] = {}
        for a in commanded(context.plant, ("position",)):
            if model.actuator_trntype[a] == mujoco.mjtTrn.mjTRN_JOINT:
                drives.setdefault(int(model.actuator_trnid[a, 0]), []).append(a)
        alone = [j for j, (a, *more) in drives.items() if not more and model.actuator_dyntype[a] == 0]
        for site in named_sites(context, Obj.mjOBJ_JOINT, [j for j in alone if j in scalar_joints(model)]):
            if len({joint_units(model, j) for j in site.targets}) > 1:
                continue
            effect = cls(site, by_joint(context, site, partial(_give, context, drives)))
            effect._drives = tuple(drives[j][0] for j in site.targets)
            yield effect

    _drives: tuple[int, ...] = ()
    """The actuator of each joint of the site."""

    def alternatives(self) -> Sequence[Effect]:
        """One of which it is sought how long it rings."""
        if self.form:
            return ()
        ratio = Parameter("damping_ratio", "1", SPRING_DAMPING, 0.005, 1.0, (0.02, 0.05, 0.15, 0.4), SPRING_DAMPING)
        other = JointElasticity(self.site, (*self.parameters, ratio), "damped")
        other._drives = self._drives
        return (other,)

    @property
    def one_size(self) -> bool:
        """Not where how long it rings is a number too."""
        return not self.form

    def apply(self, variant: Variant, values: Sequence[float]) -> None:
        drives, several = list(self._drives), np.asarray(values)
        if self.form:
            variant.servos.ringing[drives], several = several[-1], several[:-1]
        variant.servos.compliance[drives] += several


def _give(context: Context, drives: dict[int, list[int]], joints: Sequence[int]) -> Parameter:
    """How far the drives of some joints give; the scale is a tenth of their commands' swing under usual torques."""
    model = context.model
    torque = float(max(context.scales.torque[[dof_of(model, j) for j in joints]].mean(), 1e-9))
    angle, force = joint_units(model, joints[0])
    told = swing(context, [drives[j][0] for j in joints])
    return amount("compliance", f"{angle}/({force})", 0.1 * told / torque, (0.15, 0.5, 1.5, 5.0))


class TorqueRipple(Effect):
    """The motor's torque ripples with the joint's angle: cogging of magnets, teeth of a gear.

    Added torque = amplitude * sin(2 pi (q - origin) / period), whether the motor has power or not. Periods of which the
    motion holds fewer than `MOST_OF_SWING` says are a spring's or gravity's affair. A joint whose ripple is
    known already (of a corrected model) has no other.
    """

    name = "torque_ripple"

    @classmethod
    def candidates(cls, context: Context) -> Iterable[Effect]:
        scales, model = context.scales, context.model
        known = Variant.nominal(context.plant).friction.ripple
        for site in named_sites(context, Obj.mjOBJ_JOINT, driven_joints(context.plant), together=False):
            (j,) = site.targets
            dof = dof_of(model, j)
            if known[dof]:
                continue
            low, high = float(scales.low[dof]), float(scales.high[dof])
            if high - low < 1e-9:
                continue
            usual = tuple(Wave(0.0, k * (high - low), 0.5 * (low + high)) for k in (0.2, 0.1, 0.3))
            found = usual if context.waves is None else context.waves.get(j, ())
            if not found:
                continue
            angle, force = joint_units(model, j)
            size = amount("amplitude", force, 0.2 * max(float(scales.torque[dof]), 1e-9))
            shortest, longest = LEAST_OF_SWING * (high - low), MOST_OF_SWING * (high - low)
            period, origin = found[0].period, found[0].origin
            effect = cls(
                site,
                (
                    size,
                    Parameter("period", angle, period, shortest, longest, (shortest, longest), 0.03, True),
                    Parameter("origin", angle, origin, low, high, (low, high), 0.02 * (high - low)),
                ),
            )
            effect._waves = tuple(wave._replace(amplitude=min(wave.amplitude, 0.9 * size.high)) for wave in found)
            yield effect

    _waves: tuple[Wave, ...] = ()

    def starts(self) -> list[tuple[float, ...]]:
        """What the recording suggests; amplitudes of a usual size where it suggests none."""
        size = self.parameters[0]
        return [(wave.amplitude or size.tries[1], wave.period, wave.origin) for wave in self._waves]

    def moved(self, share: float, values: Sequence[float] | NDArray[np.float64]) -> tuple[float, ...]:
        """Period and origin say of which kind it is, not how strong."""
        amplitude, period, origin = map(float, values)
        return share * amplitude, period, origin

    def apply(self, variant: Variant, values: Sequence[float]) -> None:
        dof = dof_of(variant.plant.model, self.site.targets[0])
        path = variant.friction
        path.ripple[dof], path.ripple_period[dof], path.ripple_origin[dof] = values


def moved_joint(plant: Plant, channel: InputChannel) -> int:
    """The joint that an input moves by itself; -1 of one that pulls a cable or drives something else."""
    model = plant.model
    if channel.actuator < 0:
        return int(model.dof_jntid[channel.dof])
    at_joint = model.actuator_trntype[channel.actuator] == mujoco.mjtTrn.mjTRN_JOINT
    return int(model.actuator_trnid[channel.actuator, 0]) if at_joint else -1


def driven_joints(plant: Plant) -> list[int]:
    """Hinges and slides that an input moves by itself."""
    return sorted({moved_joint(plant, channel) for channel in plant.inputs} & set(scalar_joints(plant.model)))
