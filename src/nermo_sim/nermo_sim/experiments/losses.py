"""Theory against twin (N 7.2.1): where the stride goes that the no-slip speed promises.

While a foot is planned to stand, the body moves by what the foot moves backwards seen from the body, less what the foot
itself slides backwards on the ground. Taken apart, over each whole planned stance and along the line that is walked,

    reached = theory - steering + spine - legs - pitch - yaw - slip - contact,

- steering: strides that are shortened to hold the line;
- spine: what the spine's bending adds to the commanded travel, seen from the body;
- legs: travel that was commanded but not made, seen from the body: servo lag, and knees and ankles giving way;
- pitch: travel lost because the body pitches between touch-down and lift-off; yaw: because it yaws and rolls;
- slip: the foot slides backwards while it is loaded; contact: it moves backwards unloaded, because it touched down late
  or lifted off early.

The identity is exact for each stance; averaged over the legs it gives the speed.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from nermo_control.legs.kinematics import LegKinematics
from nermo_control.spine.kinematics import SpineKinematics
from nermo_control.spine.tendon import SpineTendon
from nermo_control.types import Phase
from nermo_description.parameters import LEGS, RobotParameters
from nermo_sim.divergence import STATE
from nermo_sim.run_table import Recording

Array = NDArray[np.float64]

TOUCHING = 0.02
"""Force from which a foot counts as loaded [N], about 1 % of the weight."""
TERMS = ("steering", "spine", "legs", "pitch", "yaw", "slip", "contact")


@dataclass(frozen=True, slots=True)
class StrideLosses:
    """Means over all whole stances of all legs [m]; `reached` is the sum of the others with their signs."""

    theory: float
    steering: float
    spine: float
    legs: float
    pitch: float
    yaw: float
    slip: float
    contact: float
    reached: float
    early_touch_down: float
    """Share of the planned swing in which the foot touches the ground (N: premature touch-down)."""

    def as_speeds(self, strides_per_second: float) -> dict[str, float]:
        """The terms as speeds [m/s]: times f_g g_f (5.21)."""
        names = ("theory", *TERMS, "reached")
        return {f"{name}_m_s": getattr(self, name) * strides_per_second for name in names}


def stride_losses(
    recording: Recording, model: mujoco.MjModel, robot: RobotParameters, stride: float, start: float
) -> StrideLosses:
    """Takes a straight walk apart, from `start` [s] on; `stride` is the planned stride length l_s [m].

    Raises ValueError where the recording has no whole stance.
    """
    recording = recording.part(start, float(recording.time[-1]))
    feet, base, axes = foot_motion(recording, model)
    angles = recording.roll_pitch_yaw
    way = base[-1, :2] - base[0, :2]
    along = np.array([*(way / np.linalg.norm(way)), 0.0])
    seen = np.einsum("nji,nlj->nli", axes, feet - base[:, None])  # feet in base_link
    pitched = np.cos(angles[:, 1, None]) * seen[..., 0] + np.sin(angles[:, 1, None]) * seen[..., 2]
    aligned = (feet - base[:, None]) @ along
    stepped, commanded = _commanded(recording, robot)
    moved = np.diff(feet @ along, axis=0)
    loaded = recording.foot_forces > TOUCHING

    rows = []
    for leg in range(len(LEGS)):
        for begin, end in _stances(recording.phases[:, leg]):
            travel = [
                series[begin, leg] - series[end, leg] for series in (stepped, commanded, seen[..., 0], pitched, aligned)
            ]
            steps, contact = moved[begin:end, leg], loaded[begin + 1 : end + 1, leg]
            rows.append(
                (
                    stride - travel[0],
                    travel[1] - travel[0],
                    travel[1] - travel[2],
                    travel[2] - travel[3],
                    travel[3] - travel[4],
                    -float(steps[contact].sum()),
                    -float(steps[~contact].sum()),
                    float((base[end] - base[begin]) @ along),
                )
            )
    if not rows:
        raise ValueError("the recording has no whole stance")
    *terms, reached = np.mean(rows, axis=0).tolist()
    swinging = recording.phases == int(Phase.SWING)
    return StrideLosses(
        theory=stride,
        **dict(zip(TERMS, terms, strict=True)),
        reached=reached,
        early_touch_down=float(loaded[swinging].mean()),
    )


def foot_motion(recording: Recording, model: mujoco.MjModel) -> tuple[Array, Array, Array]:
    """Feet (n, 4, 3) and base_link (n, 3) in the world [m], and base_link's axes (n, 3, 3)."""
    data = mujoco.MjData(model)
    sites = [model.site(f"{leg}_foot").id for leg in LEGS]
    base = model.site("base_link").id
    count = len(recording.stamps)
    feet, place, axes = np.zeros((count, 4, 3)), np.zeros((count, 3)), np.zeros((count, 3, 3))
    for row, state in enumerate(recording.states):
        mujoco.mj_setState(model, data, state, STATE)
        mujoco.mj_kinematics(model, data)
        feet[row], place[row] = data.site_xpos[sites], data.site_xpos[base]
        axes[row] = data.site_xmat[base].reshape(3, 3)
    return feet, place, axes


def _commanded(recording: Recording, robot: RobotParameters) -> tuple[Array, Array]:
    """Commanded x of the feet [m], (n, 4): in their leg planes, and in base_link with the spine's bending."""
    kinematics = (LegKinematics(robot.front_leg, "front"), LegKinematics(robot.rear_leg, "rear"))
    index = {name: number for number, name in enumerate(recording.servos)}
    spine, tendon = SpineKinematics(robot.spine), SpineTendon(robot.spine, robot.servos["spine_lateral"].neutral)
    flexion = np.array([tendon.flexion(position) for position in recording.commands[:, index["spine_lateral"]]])
    feet, stepped = np.zeros((len(flexion), 4, 3)), np.zeros((len(flexion), 4))
    for number, leg in enumerate(LEGS):
        hips, knees = recording.commands[:, index[f"{leg}_hip"]], recording.commands[:, index[f"{leg}_knee"]]
        for row, (hip, knee) in enumerate(zip(hips.tolist(), knees.tolist(), strict=True)):
            x, z = kinematics[number // 2].forward(hip, knee)
            feet[row, number] = (x, 0.0, z)
        stepped[:, number] = feet[:, number, 0]
        feet[:, number] += robot.hip_positions[number]
        if number >= 2:
            feet[:, number] = spine.point(spine.in_hip_frame(feet[:, number]), flexion)
    return stepped, feet[..., 0]


def _stances(phases: NDArray[np.int8]) -> list[tuple[int, int]]:
    """First and last tick of each whole planned stance; the foot is where it was told to be one tick later."""
    standing = phases == int(Phase.STANCE)
    (begins,) = np.nonzero(standing[1:] & ~standing[:-1])
    (ends,) = np.nonzero(~standing[1:] & standing[:-1])
    pairs = []
    for begin in begins:
        later = ends[ends > begin]
        if later.size:
            pairs.append((int(begin), int(later[0])))
    return pairs
