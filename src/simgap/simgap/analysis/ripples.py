"""Ripples that a recording suggests: periods of a torque that goes to and fro with a joint's angle, without a replay.

A fit of such a torque has a valley of its own for every period, so it must begin at the right one. What the nominal
model leaves of a joint's measured position in each window is set against how the joint would answer to sin and cos of
its measured angle, for many periods: as its inertia on the spring and the damper of its servo does, others held. Beside
them stand terms of which any other cause makes something (a constant, the angle and its square, speed, friction,
inertia, the input), and the start of each window is forgiven. It is rough, so it judges nothing: it says where fits
begin.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from simgap.data.channels import is_servo
from simgap.data.plant import Plant
from simgap.effects.base import Wave
from simgap.effects.joint import LEAST_OF_SWING, MOST_OF_SWING, driven_joints, moved_joint
from simgap.simulation.replay import Replayer
from simgap.simulation.scales import Scales

Array = NDArray[np.float64]

_FINENESS = 0.25
"""Distance of the wave numbers that are looked at, in waves over the joint's swing."""
_APART = 1.0
"""The same of two that are told."""
_MOST, _WORTH = 3, 0.3
"""So many are told of a joint, if they explain this share of what the best of them does."""
_SAMPLES = 4.0
"""A wave lasts so many samples at the joint's usual speed, or it is not seen."""
_ROUNDS = 2
"""Of weighing windows by what is left in them."""


def waves(replayer: Replayer, outputs: Array, scales: Scales) -> dict[int, tuple[Wave, ...]]:
    """Ripples to begin with, by joint, of those that an input moves and a position measures.

    ``outputs`` (nw, ns, no) are those of the nominal model.
    """
    plant, found = replayer.plant, {}
    for joint in driven_joints(plant):
        dof, address = int(plant.model.jnt_dofadr[joint]), int(plant.model.jnt_qposadr[joint])
        swing = float(scales.high[dof] - scales.low[dof])
        channels = [i for i, c in enumerate(plant.outputs) if c.qpos == address and replayer.aligned.live[i]]
        if channels and address in replayer.state.qpos and swing > 1e-9 and scales.speed[dof] > 0.0:
            told = _Joint(replayer, joint, channels[0], outputs).waves(scales)
            if told:
                found[joint] = told
    return found


class _Joint:
    """What is left of one joint's position, and how it answers to torques."""

    def __init__(self, replayer: Replayer, joint: int, channel: int, outputs: Array) -> None:
        plant, aligned, windows = replayer.plant, replayer.aligned, replayer.windows
        self._dof, self._period = int(plant.model.jnt_dofadr[joint]), aligned.period
        rows = windows.rows()
        gear = plant.outputs[channel].gear
        self._left = (aligned.outputs[rows, channel] - outputs[..., channel]) / gear
        seen = aligned.valid[rows, channel] & np.isfinite(self._left)
        column = int(np.flatnonzero(replayer.state.qpos == plant.outputs[channel].qpos)[0])
        every = windows.start[:, None] + np.arange(int(windows.sample[-1]) + 1)
        self._angle, speed = (s[every, column] for s in (replayer.state.position, replayer.state.velocity))
        answer, free = _answers(plant, joint, self._period, every.shape[1])
        self._answer, free = answer[windows.sample], free[windows.sample]
        orthogonal = np.linalg.qr(free)[0]
        self._forgiven = np.eye(len(free)) - orthogonal @ orthogonal.T
        usual = max(float(np.sqrt((speed**2).mean())), 1e-12)
        middle, half = float(self._angle.mean()), max(0.5 * float(np.ptp(self._angle)), 1e-12)
        turned = (self._angle - middle) / half
        inputs = [i for i, c in enumerate(plant.inputs) if moved_joint(plant, c) == joint]
        told = [aligned.inputs[every, i] for i in inputs]
        told += [np.gradient(u, axis=1) for u in told]
        others = [np.ones_like(turned), turned, turned**2, speed, np.tanh(speed / (0.05 * usual))]
        others += [np.gradient(speed, axis=1), *told]
        # Windows that were not seen to their end say nothing here.
        self._whole = seen.all(axis=1)
        self._others = np.stack([self._seen(s) for s in others], axis=-1)
        self._others /= np.maximum(np.sqrt((self._others**2).mean(axis=(0, 1))), 1e-300)

    def _seen(self, torque: Array) -> Array:
        """What a torque (nw, n) moves (nw, ns), the start of each window forgiven."""
        found: Array = torque @ self._answer.T @ self._forgiven
        return found

    def waves(self, scales: Scales) -> tuple[Wave, ...]:
        """The likeliest ripples, the best first."""
        low, high = float(scales.low[self._dof]), float(scales.high[self._dof])
        swing, middle = high - low, 0.5 * (low + high)
        shortest = max(LEAST_OF_SWING, _SAMPLES * self._period * float(scales.speed[self._dof]) / swing)
        numbers = np.arange(1.0 / MOST_OF_SWING, 1.0 / shortest + 1e-9, _FINENESS)
        whole = self._whole
        if whole.sum() < 3 or len(numbers) < 3:
            return ()
        left = (self._left @ self._forgiven)[whole]
        others = self._others[whole].reshape(left.size, -1)
        weight = np.ones(len(left))
        for _ in range(_ROUNDS):
            root = np.repeat(np.sqrt(weight), left.shape[1])
            basis = np.linalg.qr(root[:, None] * others)[0]
            rest = root * left.reshape(-1)
            rest = rest - basis @ (basis.T @ rest)
            size = np.sqrt((rest.reshape(left.shape) ** 2).mean(axis=1) / weight)
            weight = 1.0 / (1.0 + (size / max(float(np.median(size)), 1e-300)) ** 2)
        gains, sizes = np.zeros(len(numbers)), np.zeros((len(numbers), 2))
        for k, number in enumerate(numbers):
            phase = 2.0 * np.pi * number / swing * (self._angle - middle)
            pair = np.stack([self._seen(wave(phase))[whole].reshape(-1) for wave in (np.sin, np.cos)], axis=-1)
            pair = root[:, None] * pair
            pair = pair - basis @ (basis.T @ pair)
            if not np.isfinite(pair).all() or np.linalg.norm(pair) <= 0.0:
                continue
            sizes[k] = np.linalg.lstsq(pair, rest, rcond=1e-6)[0]
            gains[k] = float(rest @ (pair @ sizes[k]))
        found: list[int] = []
        for k in np.argsort(-gains):
            peak = gains[k] >= gains[max(k - 1, 0) : k + 2].max() and gains[k] > _WORTH * gains.max()
            if peak and all(abs(numbers[k] - numbers[o]) >= _APART for o in found) and len(found) < _MOST:
                found.append(int(k))
        made = []
        for k in found:
            period, amplitude = swing / numbers[k], float(np.hypot(*sizes[k]))
            origin = middle - period * float(np.arctan2(sizes[k, 1], sizes[k, 0])) / (2.0 * np.pi)
            made.append(Wave(amplitude, float(period), origin))
        return tuple(wave for wave in made if wave.amplitude > 0.0)


def _answers(plant: Plant, joint: int, period: float, count: int) -> tuple[Array, Array]:
    """How a joint answers, others held: (n, n) to torques that are held for a row each, (n, 2) to where it begins."""
    model, dof = plant.model, int(plant.model.jnt_dofadr[joint])
    stiffness, damping = float(model.jnt_stiffness[joint]), float(model.dof_damping[dof])
    for channel in plant.inputs:
        if channel.actuator >= 0 and moved_joint(plant, channel) == joint and is_servo(model, channel.actuator, 1):
            gear = float(model.actuator_gear[channel.actuator, 0])
            stiffness -= gear**2 * float(model.actuator_biasprm[channel.actuator, 1])
            damping -= gear**2 * float(model.actuator_biasprm[channel.actuator, 2])
    inertia = float(model.dof_M0[dof])
    system = np.array([[0.0, 1.0, 0.0], [-stiffness / inertia, -damping / inertia, 1.0 / inertia], [0.0, 0.0, 0.0]])
    step = expm(system * period)
    free = np.zeros((count, 2))
    pulse = np.zeros(count)
    state, kicked = np.eye(2), step[:2, 2].copy()
    for k in range(count):
        free[k] = state[0]
        state = step[:2, :2] @ state
        if k + 1 < count:
            pulse[k + 1] = kicked[0]
            kicked = step[:2, :2] @ kicked
    lag = np.arange(count)[:, None] - np.arange(count)
    answer = np.where(lag >= 0, pulse[np.maximum(lag, 0)], 0.0)
    return answer, free * np.array([1.0, 1.0 / period])
