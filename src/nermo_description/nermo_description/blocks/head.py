"""The head: pan and, on Nermo, tilt, with two cameras."""

from __future__ import annotations

import mujoco

from nermo_description.blocks.common import box_inertia, load, write_inertia, write_servo
from nermo_description.parameters import RobotParameters


def build_head(robot: RobotParameters) -> mujoco.MjSpec:
    """The head at its pan axis; without its servo the tilt joint is fused."""
    spec = load("head")
    write_servo(spec, "pan", "pan_joint", robot.servos["head_pan"], robot.contact)
    if "head_tilt" in robot.servos:
        write_servo(spec, "tilt", "tilt_joint", robot.servos["head_tilt"], robot.contact)
    else:
        for quantity in ("position", "velocity", "torque"):
            spec.delete(spec.sensor(f"tilt_{quantity}"))
        spec.delete(spec.actuator("tilt"))
        spec.delete(spec.joint("tilt_joint"))
    mass = robot.head.mass - spec.body("neck").mass
    write_inertia(spec.body("skull"), mass, robot.head.com, box_inertia(mass, robot.head.size))
    return spec
