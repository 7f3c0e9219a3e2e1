"""Effects of friction and inertia at joints."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from simgap.effects.base import (
    ByPart,
    Context,
    Effect,
    Parameter,
    amount,
    by_joint,
    dof_of,
    joint_units,
    named_sites,
    scalar_joints,
)
from simgap.effects.body import turns_alone
from simgap.simulation.variant import Variant

Obj = mujoco.mjtObj
_ARM = 1e-6
"""[m] A shorter arm is none."""
_AT_JOINT, _AT_TENDON = mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_TENDON
Values = NDArray[np.float64]


def _dofs(variant: Variant, joints: Sequence[int]) -> list[int]:
    return [dof_of(variant.plant.model, j) for j in joints]


class DryFriction(Effect):
    """Friction that sticks, as MuJoCo has it, or firm.

    MuJoCo's own is a soft constraint: a joint creeps under a load that it should hold, by 1 mm/s or more (3 N against
    4 N of friction on 1 kg), and a robot arm at rest sinks by 40 mrad in ten seconds. Firm, it holds. Real gears do;
    what is made with a smooth law of friction does not.
    """

    _HOLD = (0.006, 1.0)
    _GRIP = 0.9999
    _USUAL = (0.02, 1.0), (0.9, 0.95)
    """MuJoCo's solref, and the first two of solimp, of a model that says nothing."""

    def alternatives(self) -> Sequence[Effect]:
        """The other of the two."""
        return (type(self)(self.site, self.parameters, "" if self.form else "firm"),)

    def grip(self, solref: Values, solimp: Values, rows: Sequence[int]) -> None:
        """Make the friction at ``rows`` firm, the model's own with it; not where the model has a law of its own."""
        if not self.form:
            return
        usual = (solref[rows] == self._USUAL[0]).all(axis=1) & (solimp[rows, :2] == self._USUAL[1]).all(axis=1)
        plain = np.asarray(rows)[usual]
        solref[plain] = self._HOLD
        solimp[plain, :2] = self._GRIP

    def grip_joints(self, variant: Variant) -> None:
        """The same at the joints of the site."""
        model = variant.model
        self.grip(model.dof_solref, model.dof_solimp, _dofs(variant, self.site.targets))


def _torque(context: Context, joints: Sequence[int]) -> float:
    return float(max(context.scales.torque[[dof_of(context.model, j) for j in joints]].mean(), 1e-9))


class CoulombFriction(DryFriction, ByPart):
    """Dry friction that does not depend on speed or load, beyond what the model has."""

    name = "coulomb_friction"

    @property
    def aliases(self) -> tuple[str, ...]:
        """Friction in the routing of the cable that turns the joint is the same, while the cable is taut."""
        return self._cable

    _cable: tuple[str, ...] = ()

    @classmethod
    def candidates(cls, context: Context) -> Iterable[Effect]:
        turning = _cables(context.model)
        for site in named_sites(context, Obj.mjOBJ_JOINT, scalar_joints(context.model)):
            effect = cls(site, by_joint(context, site, lambda joints: _friction(context, joints)))
            if len(site.targets) == 1 and site.targets[0] in turning:
                effect._cable = (f"tendon_friction@{turning[site.targets[0]]}",)
            yield effect

    def apply(self, variant: Variant, values: Sequence[float]) -> None:
        dofs = _dofs(variant, self.site.targets)
        self.grip_joints(variant)
        variant.model.dof_frictionloss[dofs] += np.asarray(values)


def _cables(model: mujoco.MjModel) -> dict[int, str]:
    """Names of cables that do not stretch, by the joint that each turns for another that a motor turns.

    Taut, such a cable has one length, so that MuJoCo's friction of tendons, which brakes a changing length, is none.
    """
    data = mujoco.MjData(model)
    if model.nkey:  # in the pose of qpos0 a cable may go through a joint's axis
        mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    arms = np.zeros((model.ntendon, model.nv))
    if model.ntendon:
        mujoco.mju_sparse2dense(arms, data.ten_J, model.ten_J_rownnz, model.ten_J_rowadr, model.ten_J_colind)
    at = {int(kind): model.actuator_trnid[model.actuator_trntype == kind, 0] for kind in (_AT_JOINT, _AT_TENDON)}
    driven = set(at[_AT_JOINT].tolist())
    found = {}
    for t in np.flatnonzero(np.asarray(model.tendon_limited) & (model.tendon_stiffness == 0.0)):
        joints = {int(model.dof_jntid[v]) for v in np.flatnonzero(np.abs(arms[t]) > _ARM)}
        (*passive,) = joints - driven
        if t not in at[_AT_TENDON] and len(passive) == 1 and joints & driven:
            found[passive[0]] = str(model.tendon(int(t)).name)
    return found


def _friction(context: Context, joints: Sequence[int]) -> Parameter:
    unit = joint_units(context.model, joints[0])[1]
    return amount("friction", unit, 0.2 * _torque(context, joints))


class ViscousFriction(ByPart):
    """Friction in proportion to speed, beyond (or, negative, below) what the model has."""

    name = "viscous_friction"

    @property
    def aliases(self) -> tuple[str, ...]:
        """Damping of the joint is the same number of the model."""
        return (f"joint_damping@{self.site.name}",)

    @classmethod
    def candidates(cls, context: Context) -> Iterable[Effect]:
        model = context.model
        joints = [j for j in scalar_joints(model) if model.jnt_stiffness[j] == 0]
        for site in named_sites(context, Obj.mjOBJ_JOINT, joints):
            yield cls(site, by_joint(context, site, lambda joints: damping_of(context, joints)))

    def apply(self, variant: Variant, values: Sequence[float]) -> None:
        dofs = _dofs(variant, self.site.targets)
        damping = variant.model.dof_damping
        damping[dofs] = (damping[dofs] + np.asarray(values)).clip(min=0.0)


class JointDamping(ViscousFriction):
    """Damping of a compliant joint, beyond (or, negative, below) what the model has."""

    name = "joint_damping"

    @property
    def aliases(self) -> tuple[str, ...]:
        """Viscous friction is the same number of the model."""
        return (f"viscous_friction@{self.site.name}",)

    @classmethod
    def candidates(cls, context: Context) -> Iterable[Effect]:
        model = context.model
        joints = [j for j in scalar_joints(model) if model.jnt_stiffness[j] > 0]
        for site in named_sites(context, Obj.mjOBJ_JOINT, joints):
            yield cls(site, by_joint(context, site, lambda joints: damping_of(context, joints)))


def damping_of(context: Context, joints: Sequence[int]) -> Parameter:
    """What is added to the damping of joints."""
    model = context.model
    dofs = [dof_of(model, j) for j in joints]
    speed = float(max(context.scales.speed[dofs].mean(), 1e-9))
    scale = 0.2 * _torque(context, joints) / speed
    nominal = float(model.dof_damping[dofs].min())
    angle, force = joint_units(model, joints[0])
    tries = [0.1, 0.4, 1.5] + ([-0.6 * nominal / scale] if nominal > 0.02 * scale else [])
    return amount("damping", f"{force} s/{angle}", scale, tries, low=-0.95 * nominal / scale, high=30.0)


class StribeckFriction(DryFriction):
    """Dry friction that is larger near standstill and falls off over a small speed."""

    name = "stribeck_friction"
    special_case = "coulomb_friction"

    def starts_from(self, special: Sequence[float]) -> list[tuple[float, ...]]:
        """About as much friction in the mean, more or less of it near standstill, over a small or a larger speed."""
        if len(special) != 1:
            return []
        (friction,), speed = special, self.parameters[2].tries[0]
        return [(share * friction, (1.0 - 0.4 * share) * friction, k * speed) for share in (0.5, 1.2) for k in (1, 3)]

    @classmethod
    def candidates(cls, context: Context) -> Iterable[Effect]:
        for site in named_sites(context, Obj.mjOBJ_JOINT, scalar_joints(context.model)):
            angle, force = joint_units(context.model, site.targets[0])
            torque = _torque(context, site.targets)
            speed = float(max(context.scales.speed[[dof_of(context.model, j) for j in site.targets]].mean(), 1e-9))
            yield cls(
                site,
                [
                    amount("static_excess", force, 0.2 * torque, (0.15, 0.5, 1.5)),
                    amount("coulomb", force, 0.2 * torque, (0.3,)),
                    Parameter(
                        "speed", f"{angle}/s", 0.2 * speed, 0.01 * speed, 2.0 * speed, (0.15 * speed,), 0.1 * speed
                    ),
                ],
            )

    def apply(self, variant: Variant, values: Sequence[float]) -> None:
        dofs = _dofs(variant, self.site.targets)
        self.grip_joints(variant)
        variant.friction.stribeck[dofs] += values[0]
        variant.model.dof_frictionloss[dofs] += values[1]
        variant.friction.stribeck_velocity[dofs] = values[2]


class LoadFriction(DryFriction):
    """Dry friction in proportion to the torque that the joint's drive transmits, as in gears.

    Friction that is another where the load moves the drive is this and a servo of another gain: c (1 + a) |tau| against
    the motion where the drive moves, c (1 - a) |tau| where the load does, is c |tau| against the motion and -a c tau.
    """

    name = "load_friction"

    @classmethod
    def candidates(cls, context: Context) -> Iterable[Effect]:
        driven = [j for j in scalar_joints(context.model) if context.scales.torque[dof_of(context.model, j)] > 1e-9]
        for site in named_sites(context, Obj.mjOBJ_JOINT, driven):
            yield cls(site, [Parameter("coefficient", "1", 0.0, 0.0, 0.9, (0.04, 0.12, 0.35), 0.1)])

    def apply(self, variant: Variant, values: Sequence[float]) -> None:
        dofs = _dofs(variant, self.site.targets)
        self.grip_joints(variant)
        variant.friction.load[dofs] += values[0]


class Armature(ByPart):
    """Inertia of motor and gear as felt at the joint, beyond (or below) what the model has."""

    name = "armature"

    @property
    def aliases(self) -> tuple[str, ...]:
        """The inertia of a body that turns about this joint only is the same."""
        return self._body

    _body: tuple[str, ...] = ()

    @classmethod
    def candidates(cls, context: Context) -> Iterable[Effect]:
        model = context.model
        alone = {turns_alone(model, b): str(model.body(b).name) for b in range(1, model.nbody)}
        for site in named_sites(context, Obj.mjOBJ_JOINT, scalar_joints(model)):
            effect = cls(site, by_joint(context, site, lambda joints: _inertia(context, joints)))
            if len(site.targets) == 1 and site.targets[0] in alone:
                effect._body = (f"inertia@{alone[site.targets[0]]}",)
            yield effect

    def apply(self, variant: Variant, values: Sequence[float]) -> None:
        variant.model.dof_armature[_dofs(variant, self.site.targets)] += np.asarray(values)


def _inertia(context: Context, joints: Sequence[int]) -> Parameter:
    model = context.model
    dofs = [dof_of(model, j) for j in joints]
    scale = 0.3 * float(context.scales.inertia[dofs].mean())
    nominal = float(model.dof_armature[dofs].min())
    unit = "kg m^2" if joint_units(model, joints[0])[0] == "rad" else "kg"
    tries = [0.2, 0.7, 2.5] + ([-0.6 * nominal / scale] if nominal > 0.05 * scale else [])
    return amount("inertia", unit, scale, tries, low=-0.9 * nominal / scale, high=30.0)
