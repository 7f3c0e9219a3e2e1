"""The leg without mass between hip and foot (C 2.7): length L and foot angle theta of a planar joint.

Two kinds. `LookUpLegs` is C's: the force of the springs in equilibrium (2.21), (2.22), interpolated from a table.
`FollowingLegs` has what C left open: the fold of the knee is a state of its own, which follows its equilibrium as fast
as the friction in the struts lets it, and the cable bounds it from below: it pulls and never pushes. Coulomb friction
of the foot is MuJoCo's, because the foot has a mass.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq, minimize_scalar

from nermo_control.pantograph_controller import aslp_leg
from nermo_description.blocks.common import write_inertia
from nermo_description.pantograph import PantographLeg, PantographParameters
from nermo_description.parameters import LEGS

Array = NDArray[np.float64]
LINK_MASS = 1e-4
"""Of the body between hip and foot [kg], because MuJoCo wants one: a five-hundredth of the leg's."""
ACTIVE = 1e-6
"""A bound that is nearer than this to the knee [rad] holds it."""
SHORTEST, ANGLES = 0.62, (-0.4, 1.5)
"""Range of the table: least length over the stretched leg's [1], and foot angles [rad]."""


def make_massless(spec: mujoco.MjSpec, robot: PantographParameters, prefix: str = "") -> None:
    """Puts a planar joint in the place of a leg, all of its mass in the foot (C figure 2.8)."""
    leg, stretched = robot.leg, aslp_leg(robot.leg).longest
    for element in ("diagonal_loop", "parallel_loop"):
        spec.delete(spec.equality(prefix + element))
    upper = spec.body(f"{prefix}upper")
    parent, friction, solref = upper.parent, spec.geom(f"{prefix}foot").friction, spec.geom(f"{prefix}foot").solref
    hip = robot.hip_positions[LEGS.index(prefix.removesuffix("_"))] if prefix else (0.0, 0.0, 0.0)
    friction, solref = friction.copy(), solref.copy()
    for sensor in [one for one in spec.sensors if one.name.startswith(prefix) and "imu" not in one.name]:
        spec.delete(sensor)
    for actuator in [one for one in spec.actuators if one.name.startswith(prefix)]:
        spec.delete(actuator)
    for tendon in [one for one in spec.tendons if one.name.startswith(prefix)]:
        spec.delete(tendon)
    for body in (upper, spec.body(f"{prefix}knee_pulley")):
        if body is not None:
            spec.delete(body)
    link = (parent if prefix else spec.worldbody).add_body(name=f"{prefix}line", pos=hip)
    _point(link, LINK_MASS, 1e-6)
    link.add_joint(name=f"{prefix}hip_joint", axis=(0.0, -1.0, 0.0))
    foot = link.add_body(name=f"{prefix}end", pos=(0.0, 0.0, -stretched))
    _point(foot, leg.mass, 0.4 * leg.mass * leg.foot_radius**2)
    foot.add_joint(
        name=f"{prefix}length",
        type=mujoco.mjtJoint.mjJNT_SLIDE,
        axis=(0.0, 0.0, -1.0),
        ref=stretched,
        limited=mujoco.mjtLimited.mjLIMITED_TRUE,
        range=(SHORTEST * stretched, stretched),
        solref_limit=(robot.contact.solref_limit, 1.0),
    )
    foot.add_joint(name=f"{prefix}foot_joint", axis=(0.0, -1.0, 0.0))
    foot.add_geom(
        name=f"{prefix}foot",
        type=mujoco.mjtGeom.mjGEOM_SPHERE,
        size=(leg.foot_radius, 0.0, 0.0),
        pos=(0.0, 0.0, -leg.toe_length),
        contype=0,
        conaffinity=1,
        friction=friction,
        solref=solref,
        priority=1,
    )


def _point(body: mujoco.MjsBody, mass: float, inertia: float) -> None:
    write_inertia(body, mass, (0.0, 0.0, 0.0), (inertia, inertia, inertia))


@dataclass(frozen=True, slots=True)
class Effort:
    """What a leg does at its ends."""

    force: float
    """Along L, positive stretches [N]."""
    torque: float
    """On theta [N m]."""
    cable: float
    """Tension of the cable [N]."""


class Equilibrium:
    """The mass-less leg at rest in itself: the knee that minimises (2.21) under (2.22), and the stops."""

    def __init__(self, leg: PantographLeg) -> None:
        self.leg, self.kinematics = leg, aslp_leg(leg)
        from nermo_control.legs.aslp_symbolic import massless_functions, minimal_functions  # sympy is slow to load

        self.functions, self._minimal = massless_functions(leg), minimal_functions(leg)
        self._arm = leg.upper_length + leg.lower_length - leg.spacing
        self._longest = self.kinematics.longest
        self.reference = leg.knee_reference

    def closed_knee(self, length: float) -> float:
        """Fold of the closed leg of a length [rad]: the largest that the length allows."""
        l2, arm = self.leg.middle_length, self._arm
        cosine = (length**2 - l2**2 - arm**2) / (2.0 * l2 * arm)
        return math.acos(min(max(cosine, -1.0), 1.0))

    def open_knee(self, length: float) -> float:
        """Fold of the leg as far open as its slider goes [rad]: the least that the length allows."""
        closed = self.closed_knee(length)
        most = self.leg.middle_length + self.leg.parallel_travel

        def beyond(knee: float) -> float:
            return float(self._minimal.lengths(knee, self.functions.opening(knee, length))[1]) - most

        low = max(self.reference, 0.3)
        if low >= closed:
            return closed
        try:
            if beyond(low) <= 0.0:
                return low
            return float(brentq(beyond, low, closed, xtol=1e-9))
        except ValueError:  # no opening makes the leg so short with this knee
            low = self._least_knee(length)
            return float(brentq(beyond, low, closed, xtol=1e-9)) if beyond(low) > 0.0 else low

    def _least_knee(self, length: float) -> float:
        """Fold with which l3 is folded back onto the cable, a hair inside [rad]."""
        b = self.leg.lower_length - self.leg.spacing
        return self.leg.knee_of_cable(length + b) + 1e-6

    def knee(self, length: float, theta: float, cable_knee: float = 0.0) -> float:
        """Fold in equilibrium [rad]; `cable_knee` is the least that the cable allows."""
        upper = self.closed_knee(length)
        lower = min(max(self.open_knee(length), self.reference, cable_knee), upper)
        if upper - lower < 1e-9:
            return upper
        found = minimize_scalar(
            lambda knee: self.functions.forces(knee, length, theta)[0],
            bounds=(lower, upper),
            method="bounded",
            options={"xatol": 1e-7},
        )
        slope = self.functions.forces(upper, length, theta)[1]
        if slope < 0.0 and self.functions.forces(upper, length, theta)[0] <= found.fun:
            return upper
        return lower if self.functions.forces(lower, length, theta)[0] <= found.fun else float(found.x)

    def effort(self, length: float, theta: float, knee: float, cable_knee: float = 0.0) -> Effort:
        """Forces with a given fold: minus the slopes of the least energy, by the envelope theorem."""
        _, by_knee, by_length, by_theta, *_ = self.functions.forces(knee, length, theta)
        force = -by_length
        cable = 0.0
        closed = self.closed_knee(length)
        if knee > closed - ACTIVE and by_knee < 0.0:  # the closed pantograph carries what its spring would not
            l2, arm = self.leg.middle_length, self._arm
            force += by_knee * length / (l2 * arm * math.sin(knee))
        elif knee < max(self.reference, cable_knee) + ACTIVE and by_knee > 0.0 and cable_knee > self.reference:
            l_c = self.kinematics.cable_of_knee(knee)
            cable = by_knee * l_c / (self.leg.upper_length * self.leg.middle_length * math.sin(knee))
        return Effort(force, -by_theta, cable)


@dataclass(frozen=True, slots=True)
class Table:
    """Force and torque over length and foot angle (C figure 2.9)."""

    lengths: Array
    """(n,) [m]"""
    angles: Array
    """(m,) [rad]"""
    force: Array
    """(n, m) along L [N], positive stretches."""
    torque: Array
    """(n, m) on theta [N m]"""

    @property
    def stiffness(self) -> Array:
        """(n - 1, m): minus the slope of the force along L [N/m]."""
        slope: Array = -np.diff(self.force, axis=0) / np.diff(self.lengths)[:, None]
        return slope

    @property
    def free_toe(self) -> Array:
        """(n,) force [N] with the foot at the angle at which it bears no torque."""
        found = []
        for torque, force in zip(self.torque, self.force, strict=True):
            angle = np.interp(0.0, torque[::-1], self.angles[::-1])  # the torque falls as the angle grows
            found.append(float(np.interp(angle, self.angles, force)))
        return np.array(found)


@functools.lru_cache(maxsize=8)
def look_up_table(leg: PantographLeg, count: int = 41) -> Table:
    """Equilibria on a grid; a second or two."""
    equilibrium = Equilibrium(leg)
    longest = equilibrium.kinematics.longest
    lengths, angles = np.linspace(SHORTEST * longest, longest * (1.0 - 1e-9), count), np.linspace(*ANGLES, count)
    force, torque = np.zeros((count, count)), np.zeros((count, count))
    for row, length in enumerate(lengths.tolist()):
        for column, theta in enumerate(angles.tolist()):
            effort = equilibrium.effort(length, theta, equilibrium.knee(length, theta))
            force[row, column], torque[row, column] = effort.force, effort.torque
    return Table(lengths, angles, force, torque)


class _PlanarLegs:
    """Where length and foot angle of some legs stand in a model."""

    def __init__(self, model: mujoco.MjModel, prefixes: Sequence[str]) -> None:
        joints = [[model.joint(f"{prefix}{name}") for name in ("length", "foot_joint")] for prefix in prefixes]
        self.positions = [[int(joint.qposadr[0]) for joint in group] for group in joints]
        self.velocities = [[int(joint.dofadr[0]) for joint in group] for group in joints]


class LookUpLegs:
    """C's model: linear interpolation in the table, no friction, no cable."""

    def __init__(self, model: mujoco.MjModel, leg: PantographLeg, prefixes: Sequence[str]) -> None:
        self._planar, table = _PlanarLegs(model, prefixes), look_up_table(leg)
        self._values = np.stack([table.force, table.torque], axis=2).tolist()
        self._start = float(table.lengths[0]), float(table.angles[0])
        self._spacing = float(table.lengths[1] - table.lengths[0]), float(table.angles[1] - table.angles[0])
        self._last = len(table.lengths) - 2

    def apply(self, data: mujoco.MjData, step: float) -> None:
        """Writes the forces of the present state."""
        for (at_length, at_foot), (along, about) in zip(self._planar.positions, self._planar.velocities, strict=True):
            u = (float(data.qpos[at_length]) - self._start[0]) / self._spacing[0]
            v = (float(data.qpos[at_foot]) - self._start[1]) / self._spacing[1]
            i, j = min(max(math.floor(u), 0), self._last), min(max(math.floor(v), 0), self._last)
            u, v = u - i, v - j
            rows = self._values[i], self._values[i + 1]
            for target, value in ((along, 0), (about, 1)):
                low = rows[0][j][value] + v * (rows[0][j + 1][value] - rows[0][j][value])
                high = rows[1][j][value] + v * (rows[1][j + 1][value] - rows[1][j][value])
                data.qfrc_applied[target] = low + u * (high - low)


class FollowingLegs:
    """With viscous friction and cable: the knee's fold follows its equilibrium."""

    def __init__(self, model: mujoco.MjModel, leg: PantographLeg, prefixes: Sequence[str]) -> None:
        self._planar, self._leg = _PlanarLegs(model, prefixes), leg
        self._equilibrium = Equilibrium(leg)
        self._joints = [model.joint(f"{prefix}length").id for prefix in prefixes]
        self._model = model
        self.knees = [leg.knee_reference] * len(prefixes)
        """The folds [rad], which are states."""
        self.cable_knees = [0.0] * len(prefixes)
        """The least fold that each cable allows [rad]."""
        self.tensions = [0.0] * len(prefixes)
        """Of the cables [N]."""
        self.dissipated = 0.0
        """By the friction in struts and toes [J]."""

    def stop_forces(self, data: mujoco.MjData) -> list[float]:
        """With what the stop of each length, which is the closed leg's on a cable, pulls the foot in [N]."""
        found = dict.fromkeys(self._joints, 0.0)
        for row in np.flatnonzero(data.efc_type[: data.nefc] == mujoco.mjtConstraint.mjCNSTR_LIMIT_JOINT).tolist():
            joint = int(data.efc_id[row])
            if joint in found and self.cable_knees[self._joints.index(joint)] > self._leg.knee_reference + ACTIVE:
                found[joint] += float(data.efc_force[row])
        return list(found.values())

    def length_by_cable(self, number: int) -> float:
        """DL / dl_c of the closed leg on its cable [1]."""
        knee = max(self.cable_knees[number], self._leg.knee_reference)
        equilibrium = self._equilibrium
        length, cable = equilibrium.functions.closed(knee), equilibrium.kinematics.cable_of_knee(knee)
        return float(equilibrium._arm / self._leg.upper_length * cable / length)

    def apply(self, data: mujoco.MjData, step: float) -> None:
        """Advances the folds by `step` [s] and writes the forces."""
        leg, equilibrium = self._leg, self._equilibrium
        functions = equilibrium.functions
        damped = leg.diagonal_damping, leg.parallel_damping, leg.toe_damping
        for number, ((at_length, at_foot), (along, about)) in enumerate(
            zip(self._planar.positions, self._planar.velocities, strict=True)
        ):
            least = max(equilibrium.reference, self.cable_knees[number])
            # The cable also bounds the length: no closed leg is longer than it allows.
            longest = functions.closed(least)
            self._model.jnt_range[self._joints[number], 1] = longest
            length = min(max(float(data.qpos[at_length]), SHORTEST * equilibrium._longest), longest)
            theta = float(data.qpos[at_foot])
            speed, turn = float(data.qvel[along]), float(data.qvel[about])
            closed = equilibrium.closed_knee(length)
            before = self.knees[number]
            knee = min(max(before, least, equilibrium._least_knee(length)), closed)
            _, by_knee, _, _, d_k, p_k, p_l, t_k, t_l = functions.forces(knee, length, theta)
            friction = damped[0] * d_k**2 + damped[1] * p_k**2 + damped[2] * t_k**2
            stiffness = leg.diagonal_stiffness * d_k**2 + leg.parallel_stiffness * p_k**2 + leg.toe_stiffness * t_k**2
            carried = damped[1] * p_k * p_l * speed + damped[2] * t_k * (t_l * speed + turn)
            rate = -(by_knee + carried) / (friction + step * stiffness)
            after = min(max(knee + step * rate, least, equilibrium.open_knee(length)), closed)
            rate = min(max((after - knee) / step, -100.0), 100.0)
            self.knees[number] = after
            effort = equilibrium.effort(length, theta, after, self.cable_knees[number])
            rates = d_k * rate, p_k * rate + p_l * speed, t_k * rate + t_l * speed + turn
            lost = [one * value for one, value in zip(damped, rates, strict=True)]
            self.dissipated += step * sum(force * value for force, value in zip(lost, rates, strict=True))
            self.tensions[number] = effort.cable
            data.qfrc_applied[along] = effort.force - lost[1] * p_l - lost[2] * t_l
            data.qfrc_applied[about] = effort.torque - lost[2]
