"""The tail: 18 equal compliant joints with an antagonistic pair of tendons, or the same mass as one rigid body."""

from __future__ import annotations

from collections.abc import Iterator

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
    """The tail at its first joint, as a chain or rigid, with its servo."""
    chain = robot.tail.model == "chain"
    spec = load("tail" if chain else "rigid_tail")
    write_servo(spec, "servo", "pulley_joint", robot.servos["tail"], robot.contact)
    spec.geom("pulley").size = (robot.tail.pulley_radius, 0.0015, 0.0)
    (_write_chain if chain else _write_rigid)(spec, robot)
    return spec


def _write_chain(spec: mujoco.MjSpec, robot: RobotParameters) -> None:
    tail, length = robot.tail, robot.tail.segment_length
    for number, mass in _segments(robot):
        body = spec.body(str(number))
        body.pos = (0.0 if number == 1 else -length, 0.0, 0.0)
        across, along = _inertia(mass, length)
        write_inertia(body, mass, (-length / 2.0, 0.0, 0.0), (along, across, across))
        _write_segment(spec, number, 0.0, length)
        write_joint(spec.joint(f"{number}_joint"), tail.joint, robot.stiffness_scale, robot.contact)
    for number in range(0, JOINTS + 1, EYELET_SPACING):
        offset = tail.tendon_offset * (1.0 - 2.0 / 3.0 * number / JOINTS)
        x = length / 2.0 if number == 0 else -length / 2.0
        spec.site(f"left_{number}").pos = (x, offset, 0.0)
        spec.site(f"right_{number}").pos = (x, -offset, 0.0)
    spec.site("anchor").pos = (ANCHOR_RADIUS * tail.pulley_radius, 0.0, 0.0)
    for side in ("left", "right"):
        write_tendon(spec.tendon(side), robot.contact)


def _write_rigid(spec: mujoco.MjSpec, robot: RobotParameters) -> None:
    """Mass, centre of mass and inertia are those of the straight chain."""
    length = robot.tail.segment_length
    middles = [(mass, -(number - 0.5) * length) for number, mass in _segments(robot)]
    total = sum(mass for mass, _ in middles)
    com = sum(mass * middle for mass, middle in middles) / total
    along = sum(_inertia(mass, length)[1] for mass, _ in middles)
    across = sum(_inertia(mass, length)[0] + mass * (middle - com) ** 2 for mass, middle in middles)
    write_inertia(spec.body("1"), total, (com, 0.0, 0.0), (along, across, across))
    for number in range(1, JOINTS + 1):
        _write_segment(spec, number, (1 - number) * length, length)


def _segments(robot: RobotParameters) -> Iterator[tuple[int, float]]:
    """Number and mass [kg] of each segment, from the root."""
    for number in range(1, JOINTS + 1):
        yield number, robot.tail.mass * 2.0 * (JOINTS + 0.5 - number) / JOINTS**2


def _inertia(mass: float, length: float) -> tuple[float, float]:
    """Of one segment across and along [kg m^2]."""
    return rod_inertia(mass, length, 0.5 * length)


def _write_segment(spec: mujoco.MjSpec, number: int, begin: float, length: float) -> None:
    """How a segment looks that begins at x [m]."""
    segment = spec.geom(str(number))
    segment.fromto = (begin, 0.0, 0.0, begin - length, 0.0, 0.0)
    segment.size = (ROOT_RADIUS + (TIP_RADIUS - ROOT_RADIUS) * (number - 1) / (JOINTS - 1), 0.0, 0.0)
