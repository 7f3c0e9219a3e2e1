"""What the recording says about the model's state: measured coordinates, their rates, and how well they are known."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_coeffs

from simgap.data.align import Aligned
from simgap.data.plant import Plant

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

_SMOOTHING = 0.025
"""[s] span of the local quadratic that gives positions and rates."""


@dataclass(frozen=True)
class MeasuredState:
    """Coordinates of the model that the recording measures, on its grid; without joints that are left free.

    Attributes:
        qpos, dof: (nm,) addresses of the measured scalar coordinates; qpos is -1 where only the rate is measured.
        position, velocity: (n, nm), smoothed, SI.
        position_sd, velocity_sd: (nm,) standard errors of the two.
        late: (nm,) whether a coordinate is put in place only just before a window starts.
        base: address of the free joint's qpos and dof whose pose is measured, or None.
        pose: (n, 7) position and quaternion of that base.
        twist: (n, 6) its linear velocity (world axes) and angular velocity (body axes).
        pose_sd, twist_sd: (6,) standard errors of position [m] and rotation [rad], and of the twist; (0,) without base.
    """

    qpos: Ints
    dof: Ints
    position: Array
    velocity: Array
    position_sd: Array
    velocity_sd: Array
    late: NDArray[np.bool_]
    base: tuple[int, int] | None
    pose: Array
    twist: Array
    pose_sd: Array
    twist_sd: Array

    @property
    def size(self) -> int:
        """Number of coordinates that a window's start takes from the recording; a base counts six."""
        return len(self.dof) + len(self.pose_sd)

    @property
    def start_sd(self) -> tuple[Array, Array]:
        """Standard errors (size,) of all of them and of their rates, the base last."""
        return np.concatenate([self.position_sd, self.pose_sd]), np.concatenate([self.velocity_sd, self.twist_sd])

    def complete(self, model: mujoco.MjModel) -> bool:
        """Whether every coordinate of the model is measured."""
        measured = int((self.qpos >= 0).sum()) + (6 if self.base else 0)
        return measured == model.nv


def smoothing_length(period: float) -> int:
    """Odd number of samples of the smoother."""
    return max(5, 2 * round(0.5 * _SMOOTHING / period) + 1)


def measured_state(plant: Plant, aligned: Aligned, floor: Array, outputs: Array | None = None) -> MeasuredState:
    """Smooth the outputs that measure coordinates; ``outputs`` (n, no) replaces the recorded ones where given."""
    y = aligned.outputs if outputs is None else outputs
    length, period = smoothing_length(aligned.period), aligned.period
    smooth, slope = (savgol_coeffs(length, 2, deriv=d, delta=period) for d in (0, 1))
    by_dof: dict[int, tuple[int, int, int]] = {}
    for i, channel in enumerate(plant.outputs):
        if not aligned.live[i]:
            continue
        if channel.qpos >= 0:
            dof = _dof_of_qpos(plant.model, channel.qpos)
            by_dof[dof] = (channel.qpos, i, by_dof.get(dof, (0, -1, -1))[2])
        elif channel.dof >= 0:
            old = by_dof.get(channel.dof, (-1, -1, -1))
            by_dof[channel.dof] = (old[0], old[1], i)
    columns = [(dof, *by_dof[dof]) for dof in sorted(by_dof) if _joint_of(plant.model, dof) not in plant.free]
    n, nm = len(aligned.time), len(columns)
    position, velocity = np.zeros((n, nm)), np.zeros((n, nm))
    position_sd, velocity_sd = np.zeros(nm), np.zeros(nm)
    for j, (_, qpos, p, v) in enumerate(columns):
        rates: list[tuple[Array, float]] = []
        if qpos >= 0:
            gear = plant.outputs[p].gear
            values, sd = plant.outputs[p].coordinate(y[:, p]), floor[p] / abs(gear)
            position[:, j] = _filter(values, smooth, aligned)
            position_sd[j] = sd * float(np.linalg.norm(smooth))
            rates.append((_filter(values, slope, aligned), sd * float(np.linalg.norm(slope))))
        if v >= 0:
            gear = plant.outputs[v].gear
            rates.append(
                (_filter(y[:, v] / gear, smooth, aligned), floor[v] / abs(gear) * float(np.linalg.norm(smooth)))
            )
        weights = np.array([1.0 / r[1] ** 2 for r in rates])
        velocity[:, j] = sum(w * r[0] for w, r in zip(weights, rates, strict=True)) / weights.sum()
        velocity_sd[j] = float(weights.sum() ** -0.5)
    base, pose, twist, pose_sd, twist_sd = _base(plant, aligned, y, floor, smooth, slope)
    return MeasuredState(
        np.array([c[1] for c in columns], np.int64),
        np.array([c[0] for c in columns], np.int64),
        position,
        velocity,
        position_sd,
        velocity_sd,
        np.array([_joint_of(plant.model, c[0]) in plant.late for c in columns], bool),
        base,
        pose,
        twist,
        pose_sd,
        twist_sd,
    )


def _joint_of(model: mujoco.MjModel, dof: int) -> str:
    return str(model.joint(int(model.dof_jntid[dof])).name)


def _dof_of_qpos(model: mujoco.MjModel, qpos: int) -> int:
    joint = int(np.flatnonzero(model.jnt_qposadr == qpos)[0])
    return int(model.jnt_dofadr[joint])


def _filter(values: Array, kernel: Array, aligned: Aligned) -> Array:
    """Apply a Savitzky-Golay kernel within each run, the ends continued in a straight line."""
    half = len(kernel) // 2
    out = np.empty_like(values)
    for run in aligned.runs:
        y = values[run.start : run.stop]
        head = 2 * y[0] - y[half:0:-1]
        tail = 2 * y[-1] - y[-2 : -half - 2 : -1]
        out[run.start : run.stop] = np.convolve(np.concatenate([head, y, tail]), kernel, mode="valid")
    return out


def _base(
    plant: Plant, aligned: Aligned, y: Array, floor: Array, smooth: Array, slope: Array
) -> tuple[tuple[int, int] | None, Array, Array, Array, Array]:
    """Pose and twist of a free body whose frame position and orientation are both measured, and their errors."""
    model, none = plant.model, (None, np.zeros((0, 7)), np.zeros((0, 6)), np.zeros(0), np.zeros(0))
    free = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE)
    for joint in free:
        body = int(model.jnt_bodyid[joint])
        place = _frame_channels(plant, aligned, mujoco.mjtSensor.mjSENS_FRAMEPOS, body, 3)
        turn = _frame_channels(plant, aligned, mujoco.mjtSensor.mjSENS_FRAMEQUAT, body, 4)
        if place is None or turn is None or place[1] != turn[1]:
            continue
        site = place[1]
        quaternion = np.stack([y[:, c] for c in turn[0]], 1)
        for k in range(1, len(quaternion)):
            if quaternion[k] @ quaternion[k - 1] < 0:
                quaternion[k] = -quaternion[k]
        position = np.stack([y[:, c] for c in place[0]], 1)
        quaternion = np.stack([_filter(quaternion[:, i], smooth, aligned) for i in range(4)], 1)
        length = np.linalg.norm(quaternion, axis=1, keepdims=True)
        # Where nothing was seen there is no turn.
        quaternion = np.divide(quaternion, length, out=np.full_like(quaternion, np.nan), where=length > 0.0)
        position = np.stack([_filter(position[:, i], smooth, aligned) for i in range(3)], 1)
        if site >= 0:
            position, quaternion = _site_to_body(position, quaternion, model.site_pos[site], model.site_quat[site])
        linear = np.stack([_filter(position[:, i], slope, aligned) for i in range(3)], 1)
        rate = np.stack([_filter(quaternion[:, i], slope, aligned) for i in range(4)], 1)
        angular = 2.0 * _multiply(_conjugate(quaternion), rate)[:, 1:]
        pose, twist = np.concatenate([position, quaternion], 1), np.concatenate([linear, angular], 1)
        # A small rotation moves a unit quaternion by half its angle.
        sd = np.concatenate([floor[place[0]], np.full(3, 2.0 * float(np.sqrt(np.mean(floor[turn[0]] ** 2))))])
        pose_sd, twist_sd = sd * float(np.linalg.norm(smooth)), sd * float(np.linalg.norm(slope))
        return (int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])), pose, twist, pose_sd, twist_sd
    return none


def _frame_channels(plant: Plant, aligned: Aligned, kind: int, body: int, count: int) -> tuple[list[int], int] | None:
    """Channels of a complete frame sensor on ``body`` (site -1) or on a site of it."""
    model = plant.model
    found: dict[int, dict[int, int]] = {}
    for i, channel in enumerate(plant.outputs):
        if channel.sensor_type != kind or channel.euler >= 0 or not aligned.live[i]:
            continue
        sensor = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SENSOR, channel.sensor)
        target, type_ = int(model.sensor_objid[sensor]), int(model.sensor_objtype[sensor])
        if type_ == mujoco.mjtObj.mjOBJ_SITE and model.site_bodyid[target] == body:
            found.setdefault(target, {})[channel.component] = i
        elif type_ == mujoco.mjtObj.mjOBJ_XBODY and target == body:
            found.setdefault(-1, {})[channel.component] = i
    for site, channels in found.items():
        if len(channels) == count:
            return [channels[c] for c in range(count)], site
    return None


def _conjugate(q: Array) -> Array:
    return q * np.array([1.0, -1.0, -1.0, -1.0])


def _multiply(a: Array, b: Array) -> Array:
    """Hamilton product of quaternions (..., 4)."""
    w = a[..., 0] * b[..., 0] - (a[..., 1:] * b[..., 1:]).sum(-1)
    v = a[..., :1] * b[..., 1:] + b[..., :1] * a[..., 1:] + np.cross(a[..., 1:], b[..., 1:])
    return np.concatenate([w[..., None], v], -1)


def _site_to_body(position: Array, quaternion: Array, offset: Array, turn: Array) -> tuple[Array, Array]:
    """Pose of a body from that of a site fixed to it."""
    body = _multiply(quaternion, _conjugate(np.broadcast_to(turn, quaternion.shape)))
    lever = np.concatenate([np.zeros((len(position), 1)), np.broadcast_to(offset, position.shape)], 1)
    return position - _multiply(_multiply(body, lever), _conjugate(body))[:, 1:], body
