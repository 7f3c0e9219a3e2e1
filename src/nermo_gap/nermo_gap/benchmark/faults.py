"""What can be wrong with a truth: each fault at a weak, medium and strong size, and faults that no library has."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from nermo_gap.benchmark.truth import Truth

Array = NDArray[np.float64]
Inject = Callable[[Truth, str, float], float]

WEAK, MEDIUM, STRONG = 0, 1, 2


@dataclass(frozen=True)
class Fault:
    """A fault: the name that a diagnosis should give it, the kind of its site, and its sizes for each robot's sites."""

    name: str
    kind: str
    sizes: tuple[float, float, float]
    inject: Inject
    known: bool = True


def _dof(truth: Truth, joint: str) -> int:
    return int(truth.model.jnt_dofadr[truth.model.joint(joint).id])


def _torque_scale(truth: Truth, joint: str) -> float:
    """[N m] what gravity and motion ask of a joint, roughly: a tenth of the limit of its servo, or by its inertia."""
    for a in range(truth.model.nu):
        if truth.model.actuator_trnid[a, 0] == truth.model.joint(joint).id and np.isfinite(truth.limit[a]):
            return 0.1 * float(truth.limit[a])
    return 10.0 * float(truth.model.dof_M0[_dof(truth, joint)])


def _coulomb(truth: Truth, joint: str, size: float) -> float:
    level = size * _torque_scale(truth, joint)
    # A presliding spring is stiffer than the time step can carry; the slope stays below that.
    slope = min(0.5 * float(truth.model.dof_M0[_dof(truth, joint)]) / truth.model.opt.timestep, 400.0 * level)
    truth.friction[_dof(truth, joint)] = lambda v, _: float(level * np.tanh(slope * v / level))
    return level


def _stribeck(truth: Truth, joint: str, size: float) -> float:
    level = size * _torque_scale(truth, joint)
    slope = min(0.5 * float(truth.model.dof_M0[_dof(truth, joint)]) / truth.model.opt.timestep, 400.0 * level)
    truth.friction[_dof(truth, joint)] = lambda v, _: float(
        level * (0.5 + np.exp(-abs(v) / 0.3)) * np.tanh(slope * v / level)
    )
    return level


def _viscous(truth: Truth, joint: str, size: float) -> float:
    level = size * _torque_scale(truth, joint) / 2.0
    truth.model.dof_damping[_dof(truth, joint)] += level
    return level


def _load(truth: Truth, joint: str, size: float) -> float:
    inertia = float(truth.model.dof_M0[_dof(truth, joint)])
    slope = 0.5 * inertia / truth.model.opt.timestep

    def law(v: float, force: float) -> float:
        level = size * abs(force) + 1e-9
        return float(level * np.tanh(slope * v / level))

    truth.friction[_dof(truth, joint)] = law
    return size


def _armature(truth: Truth, joint: str, size: float) -> float:
    extra = size * float(truth.model.dof_M0[_dof(truth, joint)])
    truth.model.dof_armature[_dof(truth, joint)] += extra
    return extra


def _spring(truth: Truth, joint: str, size: float) -> float:
    stiffness = size * _torque_scale(truth, joint)
    index, dof = truth.model.joint(joint).id, _dof(truth, joint)
    address = int(truth.model.jnt_qposadr[index])

    def force(data: mujoco.MjData) -> None:
        data.qfrc_applied[dof] -= stiffness * data.qpos[address]

    truth.forces.append(force)
    return stiffness


def _stop(truth: Truth, joint: str, size: float) -> float:
    index, dof = truth.model.joint(joint).id, _dof(truth, joint)
    address = int(truth.model.jnt_qposadr[index])
    stiffness = 0.05 * float(truth.model.dof_M0[dof]) / truth.model.opt.timestep**2

    def force(data: mujoco.MjData) -> None:
        depth = data.qpos[address] - size
        if depth > 0:
            data.qfrc_applied[dof] -= stiffness * depth + 0.2 * np.sqrt(stiffness) * max(data.qvel[dof], 0.0)

    truth.forces.append(force)
    return size


def _mass(truth: Truth, body: str, size: float) -> float:
    index = truth.model.body(body).id
    extra = size * float(truth.model.body_mass[index])
    truth.model.body_mass[index] *= 1.0 + size
    truth.model.body_inertia[index] *= 1.0 + size
    return extra


def _actuator(field: str) -> Inject:
    def inject(truth: Truth, actuator: str, size: float) -> float:
        values = getattr(truth, field)
        values[truth.model.actuator(actuator).id if actuator != "all" else slice(None)] = size
        return size

    return inject


def _gain(truth: Truth, actuator: str, size: float) -> float:
    index = truth.model.actuator(actuator).id
    if truth.servo[index]:
        truth.kp[index] *= size
    else:
        truth.model.actuator_gainprm[index, 0] *= size
    return size


def _torque_limit(truth: Truth, actuator: str, size: float) -> float:
    index = truth.model.actuator(actuator).id
    truth.limit[index] *= size
    return float(truth.limit[index])


def _loss(truth: Truth, _: str, size: float) -> float:
    truth.lose = size
    return size


def _sensor(make: Callable[[float], Callable[[Array, Array], Array]]) -> Inject:
    def inject(truth: Truth, sensor: str, size: float) -> float:
        truth.sensors[int(sensor)] = make(size)
        return size

    return inject


FAULTS: tuple[Fault, ...] = (
    Fault("coulomb_friction", "joint", (0.05, 0.15, 0.4), _coulomb),
    Fault("viscous_friction", "joint", (0.1, 0.3, 0.8), _viscous),
    Fault("stribeck_friction", "joint", (0.05, 0.15, 0.4), _stribeck),
    Fault("load_friction", "joint", (0.06, 0.15, 0.35), _load),
    Fault("armature", "joint", (0.2, 0.5, 1.5), _armature),
    Fault("joint_stiffness", "joint", (0.1, 0.3, 0.8), _spring),
    Fault("joint_range", "joint", (0.9, 0.7, 0.45), _stop),
    Fault("mass", "body", (0.25, 0.5, 1.0), _mass),
    Fault("servo_delay", "actuator", (0.006, 0.015, 0.04), _actuator("delay")),
    Fault("servo_dead_band", "servo", (0.008, 0.02, 0.05), _actuator("band")),
    Fault("servo_backlash", "play", (0.01, 0.03, 0.08), _actuator("offset")),
    Fault("servo_gain", "actuator", (0.75, 0.6, 0.4), _gain),
    Fault("servo_offset", "servo", (0.02, 0.05, 0.12), _actuator("offset")),
    Fault("servo_rate_limit", "servo", (2.6, 1.8, 1.1), _actuator("rate")),
    Fault("servo_torque_limit", "servo", (0.3, 0.2, 0.12), _torque_limit),
    Fault("link_latency", "link", (0.006, 0.015, 0.04), _actuator("delay")),
    Fault("link_loss", "link", (0.3, 0.55, 0.8), _loss),
    Fault("sensor_bias", "sensor", (0.02, 0.05, 0.12), _sensor(lambda s: lambda t, y: y + s)),
    Fault("sensor_scale", "sensor", (1.05, 1.12, 1.3), _sensor(lambda s: lambda t, y: s * y)),
    Fault("sensor_delay", "sensor", (0.006, 0.015, 0.04), _sensor(lambda s: lambda t, y: np.interp(t - s, t, y))),
)


def _cogging(truth: Truth, joint: str, size: float) -> float:
    level, dof = size * _torque_scale(truth, joint), _dof(truth, joint)
    address = int(truth.model.jnt_qposadr[truth.model.joint(joint).id])

    def force(data: mujoco.MjData) -> None:
        data.qfrc_applied[dof] += level * np.sin(14.0 * data.qpos[address])

    truth.forces.append(force)
    return level


def _push(truth: Truth, joint: str, size: float) -> float:
    level, dof = size * _torque_scale(truth, joint), _dof(truth, joint)

    def force(data: mujoco.MjData) -> None:
        data.qfrc_applied[dof] += level * (np.sin(2 * np.pi * 0.83 * data.time) > 0.3)

    truth.forces.append(force)
    return level


def _drag(truth: Truth, joint: str, size: float) -> float:
    level = 0.3 * size * _torque_scale(truth, joint)
    truth.friction[_dof(truth, joint)] = lambda v, _: level * v * abs(v)
    return level


def _one_sided(truth: Truth, joint: str, size: float) -> float:
    level, dof = size * _torque_scale(truth, joint), _dof(truth, joint)
    address = int(truth.model.jnt_qposadr[truth.model.joint(joint).id])

    def force(data: mujoco.MjData) -> None:
        q = data.qpos[address]
        data.qfrc_applied[dof] -= 6.0 * level * q**3 if q > 0 else -level * np.sqrt(-q)

    truth.forces.append(force)
    return level


UNKNOWN: tuple[Fault, ...] = (
    Fault("cogging", "joint", (0.1, 0.3, 0.8), _cogging, known=False),
    Fault("periodic_push", "joint", (0.1, 0.3, 0.8), _push, known=False),
    Fault("quadratic_drag", "joint", (0.1, 0.3, 0.8), _drag, known=False),
    Fault("odd_spring", "joint", (0.1, 0.3, 0.8), _one_sided, known=False),
)
