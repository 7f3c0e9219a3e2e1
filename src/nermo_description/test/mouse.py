"""What several tests need to know of the mouse."""

from __future__ import annotations

import copy

import mujoco

from nermo_description.parameters import LEGS, JointParameters


def pair_of(leg: str) -> str:
    return leg.split("_")[0]


def leg_of(robot, leg: str):
    return robot.front_leg if pair_of(leg) == "front" else robot.rear_leg


def compliant_joints(robot) -> dict[str, JointParameters]:
    joints = {}
    for leg in LEGS:
        dynamics = robot.front_leg_dynamics if pair_of(leg) == "front" else robot.rear_leg_dynamics
        ankle = dynamics.ankle.model_copy(update={"rest": leg_of(robot, leg).ankle_angle})
        joints |= {f"{leg}_knee_joint": dynamics.knee, f"{leg}_ankle_joint": ankle}
    joints |= {f"spine_lateral_{n}_joint": robot.spine_dynamics.lateral for n in range(1, 5)}
    if robot.spine_dynamics.vertical:
        joints |= {f"spine_vertical_{n}_joint": robot.spine_dynamics.vertical for n in range(1, 5)}
    return joints | {f"tail_{n}_joint": robot.tail.joint for n in range(1, 19)}


def servo_joint(servo: str) -> str:
    direct = servo.endswith("_hip") or servo.startswith("head")
    return f"{servo}_joint" if direct else f"{servo}_pulley_joint"


def weightless(model: mujoco.MjModel) -> mujoco.MjModel:
    free = copy.copy(model)
    free.opt.gravity[:] = 0.0
    return free
