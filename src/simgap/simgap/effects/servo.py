"""Effects inside a servo: between the command and the torque at the joint."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial

import mujoco
import numpy as np

from simgap.data.channels import is_servo
from simgap.data.plant import Plant
from simgap.effects.base import ByPart, Context, Effect, Parameter, Site, amount, by_part, named_sites, ratio
from simgap.effects.friction import damping_of
from simgap.simulation.heat import heated
from simgap.simulation.variant import HEAT_TIME, Variant

Obj = mujoco.mjtObj


STATED = 0.2
"""Standard deviation of the logarithm of a gain that the map states: a robot's controller computes with it, and what
stands between is a motor's torque constant, which is off by a tenth or two, not by decades."""
_FAR = (0.012, 0.05, 0.2, 5.0)
"""Gains in published models are mostly too high: a hobby servo's 998 N m/rad, where it has 11 to 36."""


def commanded(plant: Plant, kinds: Sequence[str]) -> list[int]:
    """Actuators that a recorded command of one of these kinds drives."""
    return sorted({c.actuator for c in plant.inputs if c.actuator >= 0 and c.kind in kinds and not c.measured})


def channels_of(plant: Plant, actuators: Sequence[int]) -> list[int]:
    """Input channels of actuators."""
    return [i for i, c in enumerate(plant.inputs) if c.actuator in actuators]


def servo_unit(plant: Plant, actuator: int) -> str:
    """Unit of a position servo's command."""
    model = plant.model
    if model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_JOINT:
        hinge = model.jnt_type[model.actuator_trnid[actuator, 0]] == mujoco.mjtJoint.mjJNT_HINGE
        return "rad" if hinge else "m"
    return "m"


def servo_sites(context: Context, actuators: Sequence[int]) -> list[Site]:
    """Sites whose actuators are told in the same unit: an angle and the length of a cable have no value in common."""
    sites = named_sites(context, Obj.mjOBJ_ACTUATOR, actuators)
    return [s for s in sites if len({servo_unit(context.plant, a) for a in s.targets}) == 1]


def pulls_cable(model: mujoco.MjModel, actuator: int) -> bool:
    """Whether an actuator only pulls, at a tendon."""
    at_tendon = model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_TENDON
    return bool(at_tendon and model.actuator_forcelimited[actuator] and model.actuator_forcerange[actuator, 1] <= 0)


def swing(context: Context, actuators: Sequence[int]) -> float:
    """How far actuators are told to move, root mean square in the unit of their commands."""
    return float(np.mean(context.scales.input_rms[channels_of(context.plant, actuators)])) or 1.0


def _gain(context: Context, actuators: Sequence[int]) -> Parameter:
    """The factor of some actuators' gain."""
    stated = context.plant.map.gains
    known = all(context.model.actuator(a).name in stated for a in actuators)
    return ratio(tries=(0.5, 0.75, 1.3, 1.7), far=_FAR, spread=STATED if known else math.inf)


class ServoDelay(Effect):
    """The servo acts on its command late (processing, bus, filter), by a constant time."""

    name = "servo_delay"

    @classmethod
    def candidates(cls, context: Context) -> Iterable[Effect]:
        for site in named_sites(
            context, Obj.mjOBJ_ACTUATOR, commanded(context.plant, ("position", "velocity", "torque"))
        ):
            # A delay of everything is the link's.
            if site.name != "all":
                yield cls(site, [Parameter("delay", "s", 0.0, 0.0, 0.15, (0.006, 0.02, 0.05), 0.01)])

    def apply(self, variant: Variant, values: Sequence[float]) -> None:
        variant.inputs.delay[channels_of(variant.plant, self.site.targets)] += values[0]


class ServoDeadBand(Effect):
    """The servo does nothing while its error is smaller than the band; outside it answers in full or in part."""

    name = "servo_dead_band"

    @classmethod
    def candidates(cls, context: Context) -> Iterable[Effect]:
        plain = [a for a in commanded(context.plant, ("position",)) if context.model.actuator_dyntype[a] == 0]
        for site in servo_sites(context, plain):
            unit, size = servo_unit(context.plant, site.targets[0]), swing(context, site.targets)
            for form in ("full", "part"):
                yield cls(site, [amount("half_width", unit, 0.1 * size, (0.1, 0.4, 1.2), high=8.0)], form)

    def apply(self, variant: Variant, values: Sequence[float]) -> None:
        targets = list(self.site.targets)
        variant.servos.dead_band[targets] += values[0]
        variant.servos.hard[targets] = self.form == "full"


class ServoBacklash(Effect):
    """Play between motor and joint: a motor of its own that turns freely over the width, or late reversal."""

    name = "servo_backlash"

    @classmethod
    def candidates(cls, context: Context) -> Iterable[Effect]:
        model = context.model
        plain = [a for a in commanded(context.plant, ("position",)) if model.actuator_dyntype[a] == 0]
        at_joint = [a for a in plain if model.actuator_trntype[a] == mujoco.mjtTrn.mjTRN_JOINT]
        for form, actuators in (("motor", at_joint), ("command", plain)):
            for site in servo_sites(context, actuators):
                unit, size = servo_unit(context.plant, site.targets[0]), swing(context, site.targets)
                yield cls(site, [amount("width", unit, 0.1 * size, (0.15, 0.5, 1.5), high=8.0)], form)

    def apply(self, variant: Variant, values: Sequence[float]) -> None:
        if self.form == "motor":
            variant.servos.backlash[list(self.site.targets)] += values[0]
        else:
            variant.inputs.play[channels_of(variant.plant, self.site.targets)] += values[0]


class ServoGain(ByPart):
    """The servo is stiffer or softer than modelled, its damping with it (strength) or not (stiffness); for a motor, its
    torque constant is another.
    """

    name = "servo_gain"

    @classmethod
    def candidates(cls, context: Context) -> Iterable[Effect]:
        for site in named_sites(
            context, Obj.mjOBJ_ACTUATOR, commanded(context.plant, ("position", "velocity", "torque"))
        ):
            damped = any(
                is_servo(context.model, a, 1) and context.model.actuator_biasprm[a, 2] != 0 for a in site.targets
            )
            for form in ("strength", "stiffness") if damped else ("",):
                yield cls(site, by_part(context, site, Obj.mjOBJ_ACTUATOR, partial(_gain, context)), form)
        measured = [i for i, c in enumerate(context.plant.inputs) if c.measured or c.actuator < 0]
        for i in measured:
            yield cls(Site(_input_name(context.plant, i), (-1 - i,)), [ratio(tries=(0.7, 0.85, 1.15, 1.4))])

    def apply(self, variant: Variant, values: Sequence[float]) -> None:
        model = variant.model
        for target, value in zip(self.site.targets, np.broadcast_to(values, len(self.site.targets)), strict=True):
            if target < 0:
                variant.inputs.scale[-1 - target] *= value
                continue
            model.actuator_gainprm[target, 0] *= value
            if is_servo(model, target, 1):
                model.actuator_biasprm[target, 1] *= value
                if self.form == "strength":
                    model.actuator_biasprm[target, 2] *= value
            elif is_servo(model, target, 2):
                model.actuator_biasprm[target, 2] *= value


class ServoDamping(ByPart):
    """The servo brakes in proportion to its speed while it has power, as a motor does against its own voltage.

    Without power it does not, which tells it from viscous friction: it is looked for where servos were switched off.
    """

    name = "servo_damping"

    @classmethod
    def candidates(cls, context: Context) -> Iterable[Effect]:
        model = context.model
        turning = [
            a
            for a in commanded(context.plant, ("position", "velocity"))
            if model.actuator_trntype[a] == mujoco.mjtTrn.mjTRN_JOINT and model.actuator_gear[a, 0] != 0.0
        ]
        if not context.switched:
            return
        for site in named_sites(context, Obj.mjOBJ_ACTUATOR, turning):
            make = partial(_braking, context)
            yield cls(site, by_part(context, site, Obj.mjOBJ_ACTUATOR, make))

    def apply(self, variant: Variant, values: Sequence[float]) -> None:
        model = variant.model
        targets = list(self.site.targets)
        model.actuator_biastype[targets] = mujoco.mjtBias.mjBIAS_AFFINE
        model.actuator_biasprm[targets, 2] -= np.asarray(values) / model.actuator_gear[targets, 0] ** 2


def _braking(context: Context, actuators: Sequence[int]) -> Parameter:
    made = damping_of(context, [int(context.model.actuator_trnid[a, 0]) for a in actuators])
    return replace(made, low=0.0, tries=tuple(t for t in made.tries if t > 0.0))


class ServoOffset(ByPart):
    """The servo's zero is elsewhere: it adds a constant to its command (or the measured torque has a bias).

    Of a servo that pulls a cable this is `tendon_slack`.
    """

    name = "servo_offset"

    @classmethod
    def candidates(cls, context: Context) -> Iterable[Effect]:
        plant = context.plant
        told = commanded(plant, ("position", "velocity", "torque"))
        for site in servo_sites(context, [a for a in told if not pulls_cable(plant.model, a)]):
            kind = plant.inputs[channels_of(plant, site.targets)[0]].kind
            unit = servo_unit(plant, site.targets[0]) if kind == "position" else "1"
            make = partial(_zero, context, unit=unit)
            yield cls(site, by_part(context, site, Obj.mjOBJ_ACTUATOR, make))
        for i, channel in enumerate(plant.inputs):
            if channel.measured or channel.actuator < 0:
                size = 0.1 * float(context.scales.input_rms[i]) or 1e-3
                site = Site(_input_name(plant, i), (-1 - i,))
                yield cls(site, [amount("offset", "N m", size, (-1.5, -0.4, 0.4, 1.5), low=-20.0)])

    def apply(self, variant: Variant, values: Sequence[float]) -> None:
        for target, value in zip(self.site.targets, np.broadcast_to(values, len(self.site.targets)), strict=True):
            channels = [-1 - target] if target < 0 else channels_of(variant.plant, [target])
            variant.inputs.offset[channels] += value


def _zero(context: Context, actuators: Sequence[int], unit: str) -> Parameter:
    return amount("offset", unit, 0.1 * swing(context, actuators), (-1.5, -0.4, 0.4, 1.5), low=-20.0)


class ServoRateLimit(Effect):
    """The servo turns no faster than this, however fast its command moves."""

    name = "servo_rate_limit"

    @classmethod
    def candidates(cls, context: Context) -> Iterable[Effect]:
        plant = context.plant
        for site in servo_sites(context, commanded(plant, ("position",))):
            rates = context.scales.input_rate[channels_of(plant, site.targets)].max(axis=0)
            if rates[-1] <= 0:
                continue
            unit = servo_unit(plant, site.targets[0]) + "/s"
            tries = tuple(float(r) for r in rates[::-1] if r > 0.02 * rates[-1])
            yield cls(
                site,
                [Parameter("limit", unit, 3.0 * rates[-1], 0.02 * rates[-1], 3.0 * rates[-1], tries, 0.2 * rates[-1])],
            )

    def apply(self, variant: Variant, values: Sequence[float]) -> None:
        if values[0] < self.parameters[0].neutral:
            channels = channels_of(variant.plant, self.site.targets)
            variant.inputs.rate_limit[channels] = np.minimum(variant.inputs.rate_limit[channels], values[0])


class ServoTorqueLimit(Effect):
    """The servo saturates: its torque is cut at a limit below the modelled one."""

    name = "servo_torque_limit"

    @classmethod
    def candidates(cls, context: Context) -> Iterable[Effect]:
        for site in servo_sites(context, commanded(context.plant, ("position", "velocity", "torque"))):
            levels = context.scales.force[list(site.targets)].max(axis=0)
            if levels[-1] > 0:
                # A servo that saturates lags, and the nominal one, held to its motion, then pulls far harder.
                usual, top = float(levels[0]), 2.0 * float(levels[-1])
                tries = (float(levels[-1]), usual, 0.5 * usual, 0.2 * usual)
                yield cls(site, [Parameter("limit", "N m", top, 0.02 * usual, top, tries, 0.2 * levels[-1])])

    def apply(self, variant: Variant, values: Sequence[float]) -> None:
        model = variant.model
        for a in self.site.targets:
            low, high = model.actuator_forcerange[a] if model.actuator_forcelimited[a] else (-np.inf, np.inf)
            model.actuator_forcerange[a] = [max(low, -values[0]), min(high, values[0])]
            model.actuator_forcelimited[a] = 1


class ThermalDrift(Effect):
    """The servo loses torque as it heats up: its copper's resistance grows, its driver throttles.

    Torque goes with 1 / (1 + loss * heat); heat is 0 at first and follows (torque / usual)^2 within some seconds.
    Measured, torque goes with 1 / (1 + loss * warming / 10 K) of the motor's recorded temperature.
    """

    name = "thermal_drift"

    @classmethod
    def candidates(cls, context: Context) -> Iterable[Effect]:
        # Held to the motion of a servo that lags, the nominal one pulls far harder at times: not the largest forces.
        usual = context.scales.force[:, 0]
        told = set(commanded(context.plant, ("position", "velocity", "torque"))) & set(heated(context.plant))
        for site in servo_sites(context, [a for a in told if usual[a] > 0]):
            # A thermometer knows better than what the torque was.
            if set(site.targets) <= context.warming:
                yield cls(site, [Parameter("loss", "1", 0.0, 0.0, 5.0, (0.05, 0.2, 0.8), 0.1)], "measured")
            else:
                effect = cls(site, [Parameter("loss", "1", 0.0, 0.0, 100.0, (0.4, 1.5, 5.0), 0.5)])
                effect._usual = tuple(float(usual[a]) for a in site.targets)
                yield effect

    _usual: tuple[float, ...] = ()
    """Force of each servo of the site that heats it to 1 at last."""

    def alternatives(self) -> Sequence[Effect]:
        """One of which it is sought how fast it warms."""
        if self.form:
            return ()
        time = Parameter("time", "s", HEAT_TIME, 0.5, 60.0, (1.5, 4.0, 12.0), 0.4, log=True)
        other = ThermalDrift(self.site, (*self.parameters, time), "own time")
        other._usual = self._usual
        return (other,)

    def apply(self, variant: Variant, values: Sequence[float]) -> None:
        servos, targets = variant.servos, list(self.site.targets)
        if self.form == "measured":
            servos.temperature_loss[targets] += values[0]
            return
        servos.heat_loss[targets] += values[0]
        servos.heat_reference[targets] = self._usual
        if len(values) > 1:
            servos.heat_time[targets] = values[1]


class SupplySag(Effect):
    """The supply gives way: all servos lose torque by 1 / (1 + sag * load), where load is their sum over the usual.

    Measured, their torque goes with the recorded voltage.
    """

    name = "supply_sag"

    @classmethod
    def candidates(cls, context: Context) -> Iterable[Effect]:
        actuators = [a for a in commanded(context.plant, ("position",)) if context.model.actuator_dyntype[a] == 0]
        if actuators:
            effect = cls(
                Site("all", tuple(actuators)), [Parameter("sag", "1", 0.0, 0.0, 5.0, (0.1, 0.3, 0.8, 2.0), 0.1)]
            )
            effect._reference = float(context.scales.force[actuators, -1].sum()) or 1.0
            yield effect
            if context.swaying:
                follows = Parameter("follows", "1", 0.0, -1.0, 4.0, (0.5, 1.0, 2.0), 0.3)
                yield cls(effect.site, [follows], "measured")

    _reference = 1.0
    """Force of all servos together that counts as a load of 1."""

    def apply(self, variant: Variant, values: Sequence[float]) -> None:
        if self.form == "measured":
            variant.servos.follows += values[0]
            return
        variant.servos.sag += values[0]
        variant.servos.sag_reference = self._reference


def _input_name(plant: Plant, i: int) -> str:
    channel = plant.inputs[i]
    if channel.actuator >= 0:
        return str(plant.model.actuator(channel.actuator).name)
    return str(plant.model.joint(int(plant.model.dof_jntid[channel.dof])).name)
