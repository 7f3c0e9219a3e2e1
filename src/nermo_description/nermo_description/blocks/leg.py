"""A leg: upper leg, lower leg, paw, knee tendon, pulley and two servos (N 5.1.2-5.1.4)."""

from __future__ import annotations

import math
from typing import Literal

import mujoco

from nermo_description.blocks.common import (
    ANCHOR_RADIUS,
    load,
    rod_inertia,
    wrap_at_zero,
    write_inertia,
    write_joint,
    write_servo,
    write_tendon,
)
from nermo_description.parameters import LegParameters, RobotParameters

Pair = Literal["front", "rear"]
LEG_RADIUS = 0.003
"""Thickness of a leg's segments for their inertia and collision [m]."""


def build_leg(robot: RobotParameters, pair: Pair) -> mujoco.MjSpec:
    """One leg of a pair, left and right alike, at its hip or shoulder axis. ValueError for tendon types but 3."""
    leg, dynamics = (
        (robot.front_leg, robot.front_leg_dynamics) if pair == "front" else (robot.rear_leg, robot.rear_leg_dynamics)
    )
    if leg.tendon_type != "type_3":
        raise ValueError(f"{pair}_leg.tendon_type: the model builds type_3 only, not {leg.tendon_type}")
    spec = load(f"{pair}_leg")

    spec.body("lower").pos = (0.0, 0.0, -leg.upper_length)
    spec.body("paw").pos = (0.0, 0.0, -leg.lower_length)
    spec.site("attachment").pos = (0.0, 0.0, -leg.tendon_attachment)
    for name, length, mass in (
        ("upper", leg.upper_length, dynamics.upper_mass),
        ("lower", leg.lower_length, dynamics.lower_mass),
        ("paw", leg.foot_length, dynamics.foot_mass),
    ):
        across, along = rod_inertia(mass, length, LEG_RADIUS)
        write_inertia(spec.body(name), mass, (0.0, 0.0, -length / 2.0), (across, across, along))
        capsule = spec.geom(name)
        radius = min(LEG_RADIUS, 0.8 * dynamics.foot_radius) if name == "paw" else LEG_RADIUS
        # The paw's stops short of the sole, so that a foot has one contact.
        capsule.fromto = (0.0, 0.0, 0.0, 0.0, 0.0, -0.6 * length if name == "paw" else -length)
        capsule.size = (radius, 0.0, 0.0)
    for element, radius in ((spec.geom("foot"), 1.0), (spec.site("foot"), 2.0)):
        element.pos = (0.0, 0.0, -leg.foot_length)
        element.size = (radius * dynamics.foot_radius, 0.0, 0.0)

    write_joint(spec.joint("knee_joint"), dynamics.knee, robot.stiffness_scale, robot.contact)
    write_joint(spec.joint("ankle_joint"), dynamics.ankle, robot.stiffness_scale, robot.contact)
    spec.joint("ankle_joint").springref = leg.ankle_angle
    servos = robot.servos[f"{pair}_left_hip"], robot.servos[f"{pair}_left_knee"]
    write_servo(spec, "hip", "hip_joint", servos[0], robot.contact)
    write_servo(spec, "knee", "knee_pulley_joint", servos[1], robot.contact)
    write_tendon(spec.tendon("knee_tendon"), robot.contact)
    to_pulley = math.pi - dynamics.caddy_tilt if pair == "front" else dynamics.caddy_tilt
    write_pulley(spec, leg.pulley_radius, leg.pulley_distance, to_pulley, wrap_at_zero(servos[1]))
    return spec


def knee_angle(leg: LegParameters, q2: float) -> float:
    """theta1 [rad] of a type 3 leg at pulley angle q2 (5.18)."""
    l1, l2, free = leg.upper_length, leg.tendon_attachment, leg.tendon_length + q2 * leg.pulley_radius
    return math.pi - math.acos((l1 * l1 - free * free + l2 * l2) / (2.0 * l1 * l2))


def write_pulley(spec: mujoco.MjSpec, r: float, d1: float, axis_to_pulley: float, wrap: float) -> None:
    """The pulley E of radius r at distance d1 [m] from O in a direction [rad]; the tendon wraps it by `wrap` [rad].

    The tendon runs from O to the side of the pulley from which turning it about +y pays out, as q2 > 0 does in N.
    Angles are in the plane x, z, from x towards z; turning about +y lowers them.
    """
    tangent = axis_to_pulley + math.pi + math.acos(r / d1)
    anchor = tangent + wrap

    def around(angle: float, radius: float) -> tuple[float, float, float]:
        return radius * math.cos(angle), 0.0, radius * math.sin(angle)

    x, _, z = around(axis_to_pulley, d1)
    side_x, _, side_z = around(axis_to_pulley + 1.5 * math.pi, 3.0 * r)
    spec.body("knee_pulley").pos = (x, 0.0, z)
    spec.geom("knee_pulley").size = (r, 0.0015, 0.0)
    spec.site("knee_anchor").pos = around(anchor, ANCHOR_RADIUS * r)
    spec.site("wrap_side").pos = (x + side_x, 0.0, z + side_z)
