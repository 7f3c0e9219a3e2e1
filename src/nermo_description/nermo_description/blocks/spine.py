"""The spine (N 5.2.1): vertebrae, the lateral pair of tendons and, with free vertical joints, the lumbar tendon."""

from __future__ import annotations

import math

import mujoco
import numpy as np

from nermo_description.blocks.common import (
    ANCHOR_RADIUS,
    box_inertia,
    load,
    pitch_quaternion,
    write_inertia,
    write_joint,
    write_servo,
    write_tendon,
)
from nermo_description.parameters import RobotParameters

VERTEBRA_SIZE = (0.007, 0.018, 0.012)
"""Edges of the box whose inertia a vertebra gets [m]."""


def build_spine(robot: RobotParameters) -> mujoco.MjSpec:
    """The spine at its base frame {M}; frame `end` is {10}."""
    spine, dynamics = robot.spine, robot.spine_dynamics
    spec = load("spine")
    rows = range(1, 9)
    for row in rows:
        body = spec.body(str(row))
        body.pos = (-spine.a[row], 0.0, 0.0)
        body.quat = pitch_quaternion(spine.theta[row])
        mass = dynamics.mass / len(rows)
        write_inertia(body, mass, (0.0, 0.0, 0.0), box_inertia(mass, VERTEBRA_SIZE))
    end = spec.frame("end")
    end.pos = (-spine.a[9], 0.0, 0.0)
    end.quat = pitch_quaternion(spine.theta[9])

    half = spine.vertebra_length / 2.0
    for number, row in enumerate(spine.lateral_joints, start=1):
        write_joint(spec.joint(f"lateral_{number}_joint"), dynamics.lateral, robot.stiffness_scale, robot.contact)
        for side, y in (("left", spine.tendon_offset), ("right", -spine.tendon_offset)):
            spec.site(f"{side}_{number - 1}").pos = (half - spine.a[row], y, 0.0)
            spec.site(f"{side}_{number}").pos = (-half, y, 0.0)
    write_servo(spec, "lateral", "lateral_pulley_joint", robot.servos["spine_lateral"], robot.contact)
    radius = spine.pulley_radius
    spec.geom("lateral_pulley").size = (radius, 0.002, 0.0)
    # At the front, a quarter turn from where either tendon leaves.
    spec.site("lateral_anchor").pos = (ANCHOR_RADIUS * radius, 0.0, 0.0)
    for side in ("left", "right"):
        write_tendon(spec.tendon(side), robot.contact)
    _write_lumbar(spec, robot)
    return spec


def hip_frame(robot: RobotParameters) -> tuple[np.ndarray, np.ndarray]:
    """Place (3,) [m] and rotation (3, 3) of the hip frame {10} in base_link at rest, both with REP-103 axes."""
    place, pitch = np.zeros(3), 0.0
    for row in range(1, 10):
        place = place + robot.spine.a[row] * np.array([-math.cos(pitch), 0.0, math.sin(pitch)])
        pitch += robot.spine.theta[row]
    c, s = math.cos(pitch), math.sin(pitch)
    return place, np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def _write_lumbar(spec: mujoco.MjSpec, robot: RobotParameters) -> None:
    """The vertical joints with their one tendon below the spine; fused joints lose everything that moves them."""
    dynamics = robot.spine_dynamics
    joints = [spec.joint(f"vertical_{number}_joint") for number in range(1, 5)]
    if dynamics.vertical is None or dynamics.lumbar_tendon_offset is None:
        for quantity in ("position", "velocity", "torque"):
            spec.delete(spec.sensor(f"vertical_{quantity}"))
        for element in (spec.actuator("vertical"), spec.tendon("lumbar"), spec.body("vertical_pulley"), *joints):
            spec.delete(element)
        return
    for joint in joints:
        write_joint(joint, dynamics.vertical, robot.stiffness_scale, robot.contact)
    write_servo(spec, "vertical", "vertical_pulley_joint", robot.servos["spine_vertical"], robot.contact)
    radius = robot.spine.pulley_radius
    spec.geom("vertical_pulley").size = (radius, 0.002, 0.0)
    spec.site("vertical_anchor").pos = (ANCHOR_RADIUS * radius, 0.0, 0.0)
    for number in range(5):
        spec.site(f"lumbar_{number}").pos = (
            0.004 if number == 0 else -robot.spine.vertebra_length / 4.0,
            0.0,
            -dynamics.lumbar_tendon_offset,
        )
    write_tendon(spec.tendon("lumbar"), robot.contact)
