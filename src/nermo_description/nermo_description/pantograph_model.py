"""Makes the MuJoCo model of a robot with pantograph legs, and puts it into postures."""

from __future__ import annotations

import math

import mujoco

from nermo_description.blocks.common import box_inertia, load, write_inertia
from nermo_description.blocks.pantograph import build_pantograph_leg
from nermo_description.pantograph import PantographLeg, PantographParameters
from nermo_description.parameters import LEGS


def build_pantograph_robot(robot: PantographParameters) -> mujoco.MjSpec:
    """Trunk and four legs, the cables cut to length."""
    spec = load("pantograph_trunk")
    spec.modelname = robot.name
    write_inertia(
        spec.body("torso"), robot.trunk_mass, robot.trunk_com, box_inertia(robot.trunk_mass, robot.trunk_size)
    )
    for name in ("torso", "torso_box"):
        spec.geom(name).size = tuple(0.5 * edge for edge in robot.trunk_size)
        spec.geom(name).pos = robot.trunk_com
    for leg, hip in zip(LEGS, robot.hip_positions, strict=True):
        frame = spec.frame(f"{leg}_leg")
        frame.pos = hip
        spec.attach(build_pantograph_leg(robot, leg.split("_")[0]), prefix=f"{leg}_", frame=frame)
    for geom in spec.geoms:
        if geom.conaffinity:
            geom.friction[0] = robot.contact.friction
            geom.solref = (robot.contact.solref_contact, 1.0)
            geom.priority = 1  # over the ground's, as the mouse's
    draft = spec.compile()
    pulleys = sum(float(draft.body(f"{leg}_knee_pulley").mass[0]) for leg in LEGS)  # are part of the trunk
    mass = robot.trunk_mass - pulleys
    write_inertia(spec.body("torso"), mass, robot.trunk_com, box_inertia(mass, robot.trunk_size))
    data = mujoco.MjData(draft)
    for leg in LEGS:
        set_leg(data, leg, robot.leg, hip=0.0, knee=robot.leg.knee_reference)
    mujoco.mj_fwdPosition(draft, data)
    for leg in LEGS:
        tendon = spec.tendon(f"{leg}_knee_tendon")
        tendon.range = (0.0, data.tendon(tendon.name).length[0])
    return spec


def set_pantograph_posture(data: mujoco.MjData, robot: PantographParameters, name: str) -> None:
    """Puts the legs, closed, where the servos of a posture want them; the body stays."""
    angles = robot.posture(name)
    for leg in LEGS:
        servo = angles[f"{leg}_knee"]
        knee = robot.leg.knee_of_cable(min(robot.leg.cable_max + robot.leg.pulley_radius * servo, robot.leg.cable_max))
        set_leg(data, leg, robot.leg, angles[f"{leg}_hip"], knee)
        data.joint(f"{leg}_knee_pulley_joint").qpos = servo
    for servo_name, angle in angles.items():
        data.actuator(servo_name).ctrl = angle


def set_leg(
    data: mujoco.MjData,
    name: str,
    leg: PantographLeg,
    hip: float,
    knee: float,
    opening: float = 0.0,
    toe: float | None = None,
) -> None:
    """Puts a leg, both of its loops closed, into a configuration of hip, knee, opening and toe [rad] (C figure A.1)."""
    l2, spacing = leg.middle_length, leg.spacing
    # From P in the frame of l1, whose z points up along it: A, and Q, which is `spacing` up along l3.
    ankle_x, ankle_z = -l2 * math.sin(knee), -spacing - l2 * math.cos(knee)
    lower_x, lower_z = ankle_x - spacing * math.sin(opening), ankle_z + spacing * math.cos(opening)
    for joint, value in (
        ("hip_joint", hip),
        ("knee_joint", knee),
        ("ankle_joint", knee + opening),
        ("toe_joint", leg.toe_rest if toe is None else toe),
        ("diagonal_joint", math.atan2(ankle_x, -ankle_z)),
        ("diagonal_slider", math.hypot(ankle_x, ankle_z)),
        ("parallel_joint", math.atan2(lower_x, -lower_z)),
        ("parallel_slider", math.hypot(lower_x, lower_z)),
    ):
        data.joint(f"{name}_{joint}").qpos = value
