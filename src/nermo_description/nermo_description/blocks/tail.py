"""The tail: 18 equal compliant joints with an antagonistic pair of tendons."""

from __future__ import annotations

import mujoco

from nermo_description.blocks.common import (
    ANCHOR_RADIUS,
    load,
    rod_inertia,
    write_inertia,
    write_joint,
    write_servo,
    write_tendon,
)
from nermo_description.parameters import RobotParameters

JOINTS = 18
"""N 4.2"""
ROOT_RADIUS, TIP_RADIUS = 0.0043, 0.0013
"""For the eye [m]."""
EYELET_SPACING = 3
"""Every third segment guides the tendons: as good as every one, at half the time for a step."""


def build_tail(robot: RobotParameters) -> mujoco.MjSpec:
    """The tail at its first joint."""
    tail = robot.tail
    spec = load("tail")
    length = tail.segment_length
    for number in range(1, JOINTS + 1):
        body = spec.body(str(number))
        body.pos = (0.0 if number == 1 else -length, 0.0, 0.0)
        mass = tail.mass * 2.0 * (JOINTS + 0.5 - number) / JOINTS**2
        across, along = rod_inertia(mass, length, 0.5 * length)
        write_inertia(body, mass, (-length / 2.0, 0.0, 0.0), (along, across, across))
        segment = spec.geom(str(number))
        segment.fromto = (0.0, 0.0, 0.0, -length, 0.0, 0.0)
        segment.size = (ROOT_RADIUS + (TIP_RADIUS - ROOT_RADIUS) * (number - 1) / (JOINTS - 1), 0.0, 0.0)
        write_joint(spec.joint(f"{number}_joint"), tail.joint, robot.stiffness_scale, robot.contact)
    for number in range(0, JOINTS + 1, EYELET_SPACING):
        offset = tail.tendon_offset * (1.0 - 2.0 / 3.0 * number / JOINTS)
        x = length / 2.0 if number == 0 else -length / 2.0
        spec.site(f"left_{number}").pos = (x, offset, 0.0)
        spec.site(f"right_{number}").pos = (x, -offset, 0.0)
    write_servo(spec, "servo", "pulley_joint", robot.servos["tail"], robot.contact)
    spec.geom("pulley").size = (tail.pulley_radius, 0.0015, 0.0)
    spec.site("anchor").pos = (ANCHOR_RADIUS * tail.pulley_radius, 0.0, 0.0)
    for side in ("left", "right"):
        write_tendon(spec.tendon(side), robot.contact)
    return spec
