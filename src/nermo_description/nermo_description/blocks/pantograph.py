"""A pantograph leg with both of its closed loops: segments, toe, sprung struts, cable and two servos (C 2.1)."""

from __future__ import annotations

import math

import mujoco

from nermo_description.blocks.common import load, rod_inertia, wrap_at_zero, write_inertia, write_servo, write_tendon
from nermo_description.blocks.leg import write_pulley
from nermo_description.pantograph import PantographLeg, PantographParameters
from nermo_description.parameters import ContactParameters

SEGMENT_RADIUS, STRUT_RADIUS = 0.004, 0.0025
"""Thickness for inertia, collision and looks [m]."""
STRUT_SIDE = 0.007
"""The struts lie beside the segments [m], the diagonal one left and the parallel one right of them."""
STOP_IMPEDANCE = 0.99
"""How rigid the stops are [1]: at MuJoCo's 0.95 the pretension pushes them out by 0.3 mm, which is 2.5 deg of knee."""
MAX_KNEE = 2.6
"""Stop of the folded knee [rad]: before it the cable's servo has long come to its end."""
LOOP_TIME = 0.002
"""Time constant with which an open loop closes [s]: two steps, MuJoCo's least."""
LOOP_IMPEDANCE = 0.9995
"""How rigid a loop is [1]: MuJoCo's 0.95 lets the springs pull it open by half a millimetre."""


def build_pantograph_leg(robot: PantographParameters, pair: str) -> mujoco.MjSpec:
    """One leg at its hip's axis, left and right alike. `pair` front or rear: whose servos it has."""
    leg, contact = robot.leg, robot.contact
    spec = load("pantograph_leg")
    l1, l2, l3 = leg.upper_length, leg.middle_length, leg.lower_length - leg.spacing
    spec.body("middle").pos = (0.0, 0.0, -l1)
    spec.body("lower").pos = (0.0, 0.0, -l2)
    spec.body("toe").pos = (0.0, 0.0, -l3)
    for name, mass, top, bottom in (
        ("upper", leg.upper_mass, 0.0, -l1),
        ("middle", leg.middle_mass, 0.0, -l2),
        ("lower", leg.lower_mass, leg.spacing, -l3),
        ("toe", leg.toe_mass, 0.0, -leg.toe_length),
    ):
        _write_segment(spec.body(name), mass, top, bottom, SEGMENT_RADIUS)
        _draw(spec.geom(f"{name}_plate"), top, bottom, SEGMENT_RADIUS)
        if name != "toe":
            _draw(spec.geom(name), top, bottom, SEGMENT_RADIUS)
    for element, radius in ((spec.geom("foot"), 1.0), (spec.geom("sole"), 1.0), (spec.site("foot"), 2.0)):
        element.pos = (0.0, 0.0, -leg.toe_length)
        element.size = (radius * leg.foot_radius, 0.0, 0.0)
    spec.site("attachment").pos = (0.0, 0.0, -l2)

    _write_strut(spec, "diagonal", leg, l2 + leg.spacing, STRUT_SIDE)
    _write_strut(spec, "parallel", leg, l2, -STRUT_SIDE)
    spec.site("diagonal_end").pos = (0.0, STRUT_SIDE, -l2)
    spec.site("parallel_end").pos = (0.0, -STRUT_SIDE, leg.spacing)
    write_springs(spec, leg, contact)
    for loop in ("diagonal_loop", "parallel_loop"):
        spec.equality(loop).solref = (LOOP_TIME, 1.0)
        spec.equality(loop).solimp[:3] = (LOOP_IMPEDANCE, LOOP_IMPEDANCE, 0.001)

    servos = robot.servos[f"{pair}_left_hip"], robot.servos[f"{pair}_left_knee"]
    write_servo(spec, "hip", "hip_joint", servos[0], contact)
    write_servo(spec, "knee", "knee_pulley_joint", servos[1], contact)
    write_tendon(spec.tendon("knee_tendon"), contact)
    towards_the_middle = math.pi if pair == "front" else 0.0
    write_pulley(spec, leg.pulley_radius, leg.pulley_distance, towards_the_middle, wrap_at_zero(servos[1]))
    return spec


def write_springs(spec: mujoco.MjSpec, leg: PantographLeg, contact: ContactParameters) -> None:
    """Springs, dampers and stops of struts and toe, and the stops of knee and pantograph, which are the struts'."""
    diagonal, parallel, toe = spec.joint("diagonal_slider"), spec.joint("parallel_slider"), spec.joint("toe_joint")
    for joint, stiffness, damping, rest, lower, upper in (
        (
            diagonal,
            leg.diagonal_stiffness,
            leg.diagonal_damping,
            leg.diagonal_max + leg.diagonal_precompression,
            leg.diagonal(MAX_KNEE),
            leg.diagonal_max,
        ),
        (
            parallel,
            leg.parallel_stiffness,
            leg.parallel_damping,
            leg.middle_length - leg.parallel_precompression,
            leg.middle_length,
            leg.middle_length + leg.parallel_travel,
        ),
        (toe, leg.toe_stiffness, leg.toe_damping, leg.toe_rest, *leg.toe_range),
    ):
        joint.stiffness = (stiffness, 0.0, 0.0)
        joint.damping = (damping, 0.0, 0.0)
        joint.springref = rest
        joint.limited = mujoco.mjtLimited.mjLIMITED_TRUE
        joint.range = (lower, upper)
        joint.solref_limit = (contact.solref_limit, 1.0)
        joint.solimp_limit[:2] = (STOP_IMPEDANCE, STOP_IMPEDANCE)


def _write_strut(spec: mujoco.MjSpec, name: str, leg: PantographLeg, length: float, side: float) -> None:
    """Tube at P, rod sliding in it; at zero the strut hangs straight down. The value of its joint is its length."""
    tube, rod = spec.body(f"{name}_tube"), spec.body(f"{name}_rod")
    half = 0.5 * leg.middle_length
    tube.pos = (0.0, side, leg.spacing - leg.upper_length)
    rod.pos = (0.0, 0.0, -length)
    spec.joint(f"{name}_slider").ref = length
    _write_segment(tube, leg.strut_mass, 0.0, -half, STRUT_RADIUS)
    _write_segment(rod, leg.strut_mass, half, 0.0, STRUT_RADIUS)
    _draw(spec.geom(f"{name}_tube"), 0.0, -half, STRUT_RADIUS)
    _draw(spec.geom(f"{name}_rod"), half, 0.0, 0.6 * STRUT_RADIUS)


def _write_segment(body: mujoco.MjsBody, mass: float, top: float, bottom: float, radius: float) -> None:
    across, along = rod_inertia(mass, top - bottom, radius)
    write_inertia(body, mass, (0.0, 0.0, 0.5 * (top + bottom)), (across, across, along))


def _draw(geom: mujoco.MjsGeom, top: float, bottom: float, radius: float) -> None:
    geom.fromto = (0.0, 0.0, top, 0.0, 0.0, bottom)
    geom.size = (radius, 0.0, 0.0)
