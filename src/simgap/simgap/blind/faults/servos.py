"""What can be wrong with motors and their supply."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from simgap.blind.faults.base import Scale, Values, actuator_index, varied
from simgap.blind.truth import Truth

Array = NDArray[np.float64]


def delay(truth: Truth, scale: Scale, actuator: str, size: float) -> Values:
    """A servo that acts some seconds late."""
    truth.delay[actuator_index(truth, actuator)] = size
    return {"delay": size}


def band(truth: Truth, scale: Scale, actuator: str, size: float) -> Values:
    """A servo that leaves small errors alone, relative to what its command swings."""
    a = actuator_index(truth, actuator)
    truth.band[a] = size * scale.swing[a]
    return {"half_width": float(truth.band[a])}


def offset(truth: Truth, scale: Scale, actuator: str, size: float) -> Values:
    """A servo whose horn sits elsewhere, relative to what its command swings."""
    a = actuator_index(truth, actuator)
    truth.offset[a] = size * scale.swing[a]
    return {"offset": float(truth.offset[a])}


def rate(truth: Truth, scale: Scale, actuator: str, size: float) -> Values:
    """A servo that is slower than its command, a share of its usual speed."""
    a = actuator_index(truth, actuator)
    truth.rate[a] = size * scale.rate[a]
    return {"limit": float(truth.rate[a])}


def gain(truth: Truth, scale: Scale, actuator: str, size: float) -> Values:
    """A servo with a share of its stiffness and damping, or a motor with a share of its torque."""
    a = actuator_index(truth, actuator)
    if truth.servo[a]:
        truth.kp[a] *= size
        truth.kv[a] *= size
    else:
        truth.model.actuator_gainprm[a, 0] *= size
    return {"factor": size}


def torque_limit(truth: Truth, scale: Scale, actuator: str, size: float) -> Values:
    """A servo that ends at a share of the torque that it needs at times."""
    a = actuator_index(truth, actuator)
    truth.limit[a] = size * float(scale.force[a])
    return {"limit": float(truth.limit[a])}


def sag(truth: Truth, scale: Scale, _: str, size: float) -> Values:
    """A supply whose voltage falls with what all motors draw."""
    truth.sag, truth.sag_at = size, scale.total_force
    return {}


def hot(truth: Truth, scale: Scale, actuator: str, size: float) -> Values:
    """A motor that heats with the square of its torque within seconds and loses torque as it does."""
    a = actuator_index(truth, actuator)
    heat, time = 0.0, 2.5 + 3.5 * varied(size)

    def change(data: mujoco.MjData, torque: Array, dt: float) -> Array:
        nonlocal heat
        heat += dt / time * (float((torque[a] / max(scale.force[a], 1e-9)) ** 2) - heat)
        torque = torque.copy()
        torque[a] *= 1.0 / (1.0 + 4.0 * size * heat)
        return torque

    truth.torques.append(change)
    # How much it loses is relative to a torque that nobody who diagnoses knows.
    return {"time": time}


def backlash(truth: Truth, scale: Scale, actuator: str, size: float) -> Values:
    """Play between motor and link; it is put in when the truth is built."""
    return {"width": size * float(scale.swing[actuator_index(truth, actuator)])}
