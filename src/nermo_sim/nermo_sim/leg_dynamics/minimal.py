"""The leg in minimal coordinates (C 2.2, 2.3): hip, knee, ankle and toe, its loops closed by analysis.

MuJoCo integrates and holds the limits; the forces of springs and friction come from sympy. The state-dependent limits
of the opening (2.12), (2.13) are limits of the distance of P and Q, which MuJoCo's spatial tendons have; the direction
of their constraint is that of the corrected (2.16), as a test shows.
"""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from nermo_description.blocks.common import write_inertia
from nermo_description.blocks.pantograph import MAX_KNEE, STOP_IMPEDANCE, STRUT_SIDE
from nermo_description.pantograph import PantographLeg, PantographParameters


def make_minimal(spec: mujoco.MjSpec, robot: PantographParameters, prefix: str = "") -> None:
    """Takes both struts, and with them both loops, out of a leg, and leaves their masses and their stops.

    A strut's mass goes to its ends, half and half, which keeps its centre of mass.
    """
    leg, contact = robot.leg, robot.contact
    for loop in ("diagonal_loop", "parallel_loop"):
        spec.delete(spec.equality(prefix + loop))
    for tube in ("diagonal_tube", "parallel_tube"):
        spec.delete(spec.body(prefix + tube))
    pivot = (0.0, 0.0, leg.spacing - leg.upper_length)
    for body, place, mass in (
        ("upper", pivot, 2.0 * leg.strut_mass),
        ("middle", (0.0, 0.0, -leg.middle_length), leg.strut_mass),
        ("lower", (0.0, 0.0, leg.spacing), leg.strut_mass),
    ):
        end = spec.body(prefix + body).add_body(name=f"{prefix}{body}_strut_end", pos=place)
        write_inertia(end, mass, (0.0, 0.0, 0.0), (1e-8, 1e-8, 1e-8))
    knee = spec.joint(f"{prefix}knee_joint")
    knee.limited, knee.range = mujoco.mjtLimited.mjLIMITED_TRUE, (leg.knee_reference, MAX_KNEE)
    toe = spec.joint(f"{prefix}toe_joint")
    toe.stiffness, toe.damping = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    spec.body(f"{prefix}upper").add_site(name=f"{prefix}pivot", pos=(0.0, -STRUT_SIDE, pivot[2]))
    stop = spec.add_tendon(
        name=f"{prefix}parallel_stop",
        limited=mujoco.mjtLimited.mjLIMITED_TRUE,
        range=(leg.middle_length, leg.middle_length + leg.parallel_travel),
    )
    stop.wrap_site(f"{prefix}pivot")
    stop.wrap_site(f"{prefix}parallel_end")
    for limit in (knee, stop):
        limit.solref_limit = (contact.solref_limit, 1.0)
        limit.solimp_limit[:2] = (STOP_IMPEDANCE, STOP_IMPEDANCE)


class MinimalLegs:
    """Springs and friction of some legs of a model, as generalised forces."""

    def __init__(self, model: mujoco.MjModel, leg: PantographLeg, prefixes: Sequence[str]) -> None:
        # Here, because sympy takes two seconds to load, and `nermo experiment` loads every experiment.
        from nermo_control.legs.aslp_symbolic import minimal_functions

        self._functions = minimal_functions(leg)
        names = [[f"{prefix}{name}_joint" for name in ("knee", "ankle", "toe")] for prefix in prefixes]
        joints = [[model.joint(name) for name in leg_names] for leg_names in names]
        self._positions = [[int(joint.qposadr[0]) for joint in group] for group in joints]
        self._velocities = [[int(joint.dofadr[0]) for joint in group] for group in joints]
        _weigh_stops(model, self._positions, [model.tendon(f"{prefix}parallel_stop").id for prefix in prefixes])

    def apply(self, data: mujoco.MjData, step: float) -> None:
        """Writes the forces of the present state; `step` [s] is not needed."""
        positions, velocities = data.qpos.tolist(), data.qvel.tolist()
        for (knee, ankle, toe), (at_knee, at_ankle, at_toe) in zip(self._positions, self._velocities, strict=True):
            k, dk = positions[knee], velocities[at_knee]
            by_knee, by_opening, by_toe = self._functions.torques(
                k, positions[ankle] - k, positions[toe], dk, velocities[at_ankle] - dk, velocities[at_toe]
            )
            # The joint of the ankle turns by fold and opening together.
            data.qfrc_applied[at_knee] = by_knee - by_opening
            data.qfrc_applied[at_ankle] = by_opening
            data.qfrc_applied[at_toe] = by_toe

    def dissipation(self, data: mujoco.MjData) -> float:
        """Power that the friction of struts and toes takes [W]."""
        total = 0.0
        for (knee, ankle, toe), (at_knee, at_ankle, at_toe) in zip(self._positions, self._velocities, strict=True):
            k, dk = float(data.qpos[knee]), float(data.qvel[at_knee])
            place = k, float(data.qpos[ankle]) - k, float(data.qpos[toe])
            rates = dk, float(data.qvel[at_ankle]) - dk, float(data.qvel[at_toe])
            moving, resting = self._functions.torques(*place, *rates), self._functions.torques(*place, 0.0, 0.0, 0.0)
            total -= sum((one - other) * rate for one, other, rate in zip(moving, resting, rates, strict=True))
        return total


def _weigh_stops(model: mujoco.MjModel, knees: Sequence[Sequence[int]], stops: Sequence[int]) -> None:
    """Tells MuJoCo the inverse inertia that the stops see: in the straight leg, where it looks, there is none."""
    data = mujoco.MjData(model)
    for knee, ankle, _ in knees:
        data.qpos[[knee, ankle]] = 1.0
    mujoco.mj_forward(model, data)
    slopes, columns = np.zeros((len(stops), model.nv)), np.eye(model.nv)
    start, lengths, small = data.qpos.copy(), data.ten_length.copy(), 1e-6
    for column in range(model.nv):
        mujoco.mj_integratePos(model, data.qpos, columns[column], small)
        mujoco.mj_fwdPosition(model, data)
        slopes[:, column] = (data.ten_length[list(stops)] - lengths[list(stops)]) / small
        data.qpos[:] = start
    mujoco.mj_forward(model, data)
    solved = np.zeros_like(slopes)
    mujoco.mj_solveM(model, data, solved, slopes)
    model.tendon_invweight0[list(stops)] = np.sum(slopes * solved, axis=1)


def set_minimal_leg(data: mujoco.MjData, prefix: str, hip: float, knee: float, opening: float, toe: float) -> None:
    """Puts a leg into a configuration [rad]."""
    for joint, value in (("hip", hip), ("knee", knee), ("ankle", knee + opening), ("toe", toe)):
        data.joint(f"{prefix}{joint}_joint").qpos = np.float64(value)
