"""What all blocks do alike: reading MJCF, writing joints, servos, pulleys and inertias into it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path

import mujoco
import numpy as np

from nermo_description.parameters import ContactParameters, JointParameters, ServoParameters

MJCF = Path(str(files("nermo_description"))) / "mjcf"
ANCHOR_RADIUS = 1.005
"""A tendon's anchor on its pulley, in pulley radii: on the surface itself MuJoCo's wrapping counts it as inside."""
LARGEST_WRAP = 3.6
"""[rad] MuJoCo's wrapping changes side beyond about 3.7 rad."""
WRAP_RESERVE = 0.15
"""Wrap left on the pulley when it is paid out fully [rad]."""


def load(block: str) -> mujoco.MjSpec:
    """The MJCF of a block, without numbers."""
    return mujoco.MjSpec.from_file(str(MJCF / block / "block.xml"))


def write_joint(
    joint: mujoco.MjsJoint, parameters: JointParameters, stiffness_scale: float, contact: ContactParameters
) -> None:
    """A compliant joint."""
    joint.stiffness = (parameters.stiffness * stiffness_scale, 0.0, 0.0)
    joint.damping = (parameters.damping, 0.0, 0.0)
    joint.armature = parameters.armature
    joint.springref = parameters.rest
    _limit(joint, parameters.lower, parameters.upper, contact)


def write_servo(spec: mujoco.MjSpec, name: str, joint: str, servo: ServoParameters, contact: ContactParameters) -> None:
    """A position servo with torque, speed and control range on its joint.

    The torque-speed line is the controller's output, limited to the stall torque, less `servo.damping` times the speed.
    """
    actuator, shaft = spec.actuator(name), spec.joint(joint)
    if servo.integral_gain > 0.0:
        # The integral may hold at most the stall torque.
        actuator.set_to_pid(
            kp=servo.proportional_gain,
            kv=servo.derivative_gain,
            ki=servo.integral_gain,
            imax=servo.max_torque / servo.integral_gain,
            ctrlspec=mujoco.mjtCtrlInput.mjINPUT_POS,
        )
    else:
        actuator.set_to_position(kp=servo.proportional_gain, kv=servo.derivative_gain)
    actuator.ctrllimited = mujoco.mjtLimited.mjLIMITED_TRUE
    actuator.ctrlrange = (servo.lower, servo.upper)
    actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
    actuator.forcerange = (-servo.max_torque, servo.max_torque)
    shaft.damping = (servo.damping, 0.0, 0.0)
    shaft.armature = servo.armature
    _limit(shaft, servo.lower, servo.upper, contact)


def write_tendon(tendon: mujoco.MjsTendon, contact: ContactParameters) -> None:
    """A tendon that pulls and never pushes: a stiff one-sided limit; its length is set when the robot is strung."""
    tendon.range = (0.0, 1.0)
    tendon.solref_limit = (contact.solref_limit, 1.0)


def wrap_at_zero(servo: ServoParameters) -> float:
    """Tendon wrapped at 0 on a pulley that pays out with positive angles [rad]. ValueError for too wide a range."""
    wrap = servo.upper + WRAP_RESERVE
    if wrap - servo.lower > LARGEST_WRAP:
        raise ValueError(f"a pulley's range of {servo.upper - servo.lower:.2f} rad is too wide for its tendon to wrap")
    return wrap


def box_inertia(mass: float, size: Sequence[float]) -> tuple[float, float, float]:
    """Diagonal inertia [kg m^2] of a uniform box with edges `size` [m]."""
    x, y, z = (edge * edge for edge in size)
    return mass / 12.0 * (y + z), mass / 12.0 * (x + z), mass / 12.0 * (x + y)


def rod_inertia(mass: float, length: float, radius: float) -> tuple[float, float]:
    """Inertia [kg m^2] of a uniform round rod across and along its axis."""
    return mass * (length**2 / 12.0 + radius**2 / 4.0), mass * radius**2 / 2.0


def write_inertia(body: mujoco.MjsBody, mass: float, com: Sequence[float], inertia: Sequence[float]) -> None:
    """Mass [kg], centre of mass [m] and diagonal inertia about it [kg m^2] in the body's frame."""
    body.explicitinertial = True
    body.mass = mass
    body.ipos = tuple(com)
    body.inertia = tuple(inertia)


def pitch_quaternion(angle: float) -> np.ndarray:
    """Rotation about y [rad] as (w, x, y, z)."""
    return np.array([math.cos(angle / 2.0), 0.0, math.sin(angle / 2.0), 0.0])


def _limit(joint: mujoco.MjsJoint, lower: float, upper: float, contact: ContactParameters) -> None:
    joint.limited = mujoco.mjtLimited.mjLIMITED_TRUE
    joint.range = (lower, upper)
    joint.solref_limit = (contact.solref_limit, 1.0)
