"""What no library has a word for."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from simgap.blind.faults.base import Scale, Values, actuator_index, by_chance, steepness, varied
from simgap.blind.truth import Truth

Array = NDArray[np.float64]


def tight_spot(truth: Truth, scale: Scale, joint: str, size: float) -> Values:
    """A bent shaft, a damaged tooth: dry friction that is six times as large in a part of the joint's range."""
    most, dof, places = size * scale.torque[joint], truth.dof(joint), truth.addresses(joint)
    swing = scale.high[joint] - scale.low[joint]
    spot = scale.low[joint] + float(by_chance(scale, joint).uniform(0.3, 0.7)) * swing
    slope = steepness(truth, dof, most, scale.speed[joint])

    def force(data: mujoco.MjData) -> None:
        away = (sum(data.qpos[p] for p in places) - spot) / (0.12 * swing)
        level = most * (1.0 + 5.0 * float(np.exp(-(away**4)))) / 6.0
        data.qfrc_applied[dof] -= level * np.tanh(slope * data.qvel[dof] / level)

    truth.forces.append(force)
    return {}


def push(truth: Truth, scale: Scale, joint: str, size: float) -> Values:
    """Somebody who pushes a joint again and again."""
    level, dof = size * scale.torque[joint], truth.dof(joint)

    def force(data: mujoco.MjData) -> None:
        data.qfrc_applied[dof] += level * (np.sin(2 * np.pi * 0.83 * data.time) > 0.3)

    truth.forces.append(force)
    return {}


def drag(truth: Truth, scale: Scale, joint: str, size: float) -> Values:
    """Drag that grows with the cube of speed."""
    level = size * scale.torque[joint] / scale.speed[joint] ** 3
    truth.friction[truth.dof(joint)] = lambda v, _: level * v**3
    return {}


def odd_spring(truth: Truth, scale: Scale, joint: str, size: float) -> Values:
    """A spring that is cubic one way and a root the other."""
    swing, dof, places = scale.high[joint] - scale.low[joint], truth.dof(joint), truth.addresses(joint)
    level, middle = size * scale.torque[joint], 0.5 * (scale.low[joint] + scale.high[joint])

    def force(data: mujoco.MjData) -> None:
        q = 2.0 * (sum(data.qpos[p] for p in places) - middle) / swing
        data.qfrc_applied[dof] -= level * (3.0 * q**3 if q > 0 else -np.sqrt(-q))

    truth.forces.append(force)
    return {}


def slipped(truth: Truth, scale: Scale, actuator: str, size: float) -> Values:
    """A horn slips a tooth, or its screw loosens: the servo's zero jumps once, at 30 to 70 % of the recording."""
    a, jump = actuator_index(truth, actuator), size * float(scale.swing[actuator_index(truth, actuator)])
    before, moment = float(truth.offset[a]), scale.seconds * (0.3 + 0.4 * varied(size))

    def slip(data: mujoco.MjData, torque: Array, dt: float) -> Array:
        truth.offset[a] = before + (jump if data.time >= moment else 0.0)
        return torque

    truth.torques.append(slip)
    return {}


def hysteresis(truth: Truth, scale: Scale, joint: str, size: float) -> Values:
    """A Bouc-Wen element: a spring that yields and remembers."""
    dof, places = truth.dof(joint), truth.addresses(joint)
    swing, memory, last = scale.high[joint] - scale.low[joint], 0.0, float("nan")
    level = 1.5 * size * scale.torque[joint]

    def force(data: mujoco.MjData) -> None:
        nonlocal memory, last
        q = float(sum(data.qpos[p] for p in places))
        move = 0.0 if np.isnan(last) else (q - last) / (0.15 * swing)
        last = q
        memory += move - abs(move) * memory * abs(memory) ** 0.5
        memory = float(np.clip(memory, -1.5, 1.5))
        data.qfrc_applied[dof] -= level * memory * (1.0 + 0.8 * np.sin(2.2 * data.time))

    truth.forces.append(force)
    return {}


def crosstalk(truth: Truth, scale: Scale, actuator: str, size: float) -> Values:
    """Part of another motor's force arrives here, squared."""
    a = actuator_index(truth, actuator)
    others = [i for i in np.flatnonzero(truth.servo) if i != a]

    def change(data: mujoco.MjData, torque: Array, dt: float) -> Array:
        torque = torque.copy()
        for other in others[:1]:
            share = torque[other] / max(scale.force[other], 1e-9)
            torque[a] += size * scale.force[a] * share * abs(share)
        return torque

    truth.torques.append(change)
    return {}


def hanging(truth: Truth, scale: Scale, column: str, size: float) -> Values:
    """A sensor that now and then hangs for a while."""

    def hang(t: Array, y: Array) -> Array:
        rng, out = np.random.default_rng(round(1e6 * abs(float(y[len(y) // 2])))), y.copy()
        position = 0
        while position < len(y):
            position += int(rng.exponential(0.5) / (t[1] - t[0])) + 1
            length = int(rng.uniform(0.5, 1.5) * size * 0.4 / (t[1] - t[0])) + 2
            out[position : position + length] = y[min(position, len(y) - 1)]
            position += length
        return out

    truth.sensors[column] = hang
    return {}


def built_in(truth: Truth, scale: Scale, member: str, size: float) -> Values:
    """A link that flexes: it is put in when the truth is built."""
    return {}
