"""What every simulation of a replay is given at a moment: its inputs, and where the robot was measured to be."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from mujoco import batch as mjbatch
from numpy.typing import NDArray

from simgap.data.plant import Plant
from simgap.simulation.state import MeasuredState
from simgap.simulation.variant import Variant

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

_ROUNDING = 1e-9
"""Rows: a time step that begins with a stair, to the last bit, sees that stair."""


class Drive:
    """Controls and applied joint forces of every simulation at a position (in grid rows) after its origin.

    Simulation i belongs to ``variants[i]`` and reads the inputs ``shared[paths[i]]`` (n, ni) from row ``origin[i]`` on.
    """

    def __init__(
        self,
        plant: Plant,
        variants: Sequence[Variant],
        paths: Ints,
        shared: Array,
        origin: Ints,
        dt: float,
        period: float,
    ) -> None:
        self._shared, self.origin = shared, origin
        self._path = paths[:, None]
        self._lag = np.array([v.inputs.delay for v in variants]) / period
        # A held command is a staircase. What acts in a time step is its mean over the step, so that the work of a delay
        # changes smoothly with it.
        self._held = np.array([not c.linear for c in plant.inputs])
        self._step = dt / period
        self._channels = np.arange(len(plant.inputs))[None, :]
        self._to_control = np.zeros((len(plant.inputs), plant.model.nu))
        self._to_force = np.zeros((len(plant.inputs), plant.model.nv))
        for i, channel in enumerate(plant.inputs):
            if channel.actuator >= 0:
                self._to_control[i, channel.actuator] = 1.0
            else:
                self._to_force[i, channel.dof] = 1.0
        self._low = self._high = np.zeros((len(paths), 1), np.int64)

    def limits(self, low: Ints, high: Ints) -> None:
        """Rows [low, high) of the run that each simulation belongs to."""
        self._low, self._high = low[:, None], high[:, None] - 2

    def at(self, position: float | Array) -> tuple[Array, Array]:
        """(ctrl (n, nu), joint forces (n, nv)) at a position; (n, k, ...) at k positions."""
        several = np.ndim(position) > 0
        moment = np.asarray(position)[None, :, None] if several else position
        extend = (lambda a: a[:, None, :]) if several else (lambda a: a)
        row = extend(self.origin[:, None] - self._lag) + moment
        row = np.clip(row, extend(self._low), extend(self._high + 1))
        floor = np.minimum((row + _ROUNDING).astype(np.int64), extend(self._high))
        share = np.maximum(row - floor, 0.0)
        # Of the coming time step, what lies behind the next stair.
        late = np.clip((share + self._step - 1.0) / self._step, 0.0, 1.0)
        share = np.where(self._held, late, share)
        path = extend(self._path)
        before = self._shared[path, floor, self._channels]
        after = self._shared[path, floor + 1, self._channels]
        values = before + share * (after - before)
        return values @ self._to_control, values @ self._to_force


class Follow:
    """Puts the measured coordinates of every simulation where the robot was, late ones from ``late_from`` [rows] on."""

    def __init__(
        self,
        states: Sequence[MeasuredState],
        index: Ints,
        origin: Ints,
        batch: mjbatch.Batch,
        stops: Ints | None = None,
        late_from: float = np.inf,
        starts: Ints | None = None,
    ) -> None:
        self._index, self._origin, self._stops, self._starts = index, origin, stops, starts
        # Views: looked up once, since this runs at every step.
        self._all_qpos, self._all_qvel = batch.bind("qpos"), batch.bind("qvel")
        first = states[0]
        self._position = np.stack([s.position for s in states])
        self._velocity = np.stack([s.velocity for s in states])
        self._qpos, self._dof, self._base, self._late_from = first.qpos, first.dof, first.base, late_from
        # Which coordinates are placed, and which are given a rate, before ``late_from`` and after it.
        known, rows = first.qpos >= 0, np.arange(len(first.dof))
        self._early = rows[known & ~first.late], rows[~first.late]
        self._all = rows[known], rows
        self._pose = np.stack([s.pose for s in states])
        self._twist = np.stack([s.twist for s in states])

    def apply(self, position: float, shift: Array | None, rate_shift: Array | None) -> None:
        """Overwrite coordinates and rates with the measurement ``position`` rows after (or before) the origin.

        Before a simulation's ``starts`` the robot was where it was then.
        """
        row = self._origin + int(np.floor(position))
        last = self._position.shape[1] - 2 if self._stops is None else self._stops - 2
        row, share = np.minimum(row, last), (position - int(np.floor(position)))
        if position < 0:
            row = np.maximum(row, 0 if self._starts is None else self._starts)
        qpos, qvel = self._all_qpos, self._all_qvel
        if len(self._dof):
            nm = len(self._dof)
            value = _between(self._position, self._index, row, share) + (0.0 if shift is None else shift[:, :nm])
            rate = _between(self._velocity, self._index, row, share)
            rate = rate + (0.0 if rate_shift is None else rate_shift[:, :nm])
            placed, moved = self._all if position >= self._late_from else self._early
            qpos[:, self._qpos[placed]] = value[:, placed]
            qvel[:, self._dof[moved]] = rate[:, moved]
        if self._base is not None:
            pose = _between(self._pose, self._index, row, share)
            twist = _between(self._twist, self._index, row, share)
            if shift is not None:
                pose[:, :3] += shift[:, -6:-3]
                pose[:, 3:] = _turned(pose[:, 3:], shift[:, -3:])
            if rate_shift is not None:
                twist = twist + rate_shift[:, -6:]
            pose[:, 3:] /= np.linalg.norm(pose[:, 3:], axis=1, keepdims=True)
            qpos[:, self._base[0] : self._base[0] + 7] = pose
            qvel[:, self._base[1] : self._base[1] + 6] = twist


def _turned(quaternion: Array, angle: Array) -> Array:
    """Quaternions (n, 4), w first, turned by small angles (n, 3) [rad] about their own axes."""
    w, v = quaternion[:, :1], quaternion[:, 1:]
    return np.concatenate(
        [w - 0.5 * (v * angle).sum(1, keepdims=True), v + 0.5 * (w * angle + np.cross(v, angle))], axis=1
    )


def _between(series: Array, index: Ints, row: Ints, share: float) -> Array:
    before: Array = series[index, row]
    return before + share * (series[index, row + 1] - before)
