"""The robot as a MuJoCo model: blocks, attached to each other, strung, balanced and stood on the ground."""

from __future__ import annotations

from collections.abc import Callable
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from nermo_description.blocks.common import box_inertia, load, pitch_quaternion, write_inertia
from nermo_description.blocks.head import build_head
from nermo_description.blocks.leg import build_leg, knee_angle
from nermo_description.blocks.spine import build_spine, hip_frame
from nermo_description.blocks.tail import build_tail
from nermo_description.deviations import enter_deviations
from nermo_description.pantograph_model import build_pantograph_robot, set_pantograph_posture
from nermo_description.parameters import LEGS, RobotParameters
from nermo_description.robots import AnyRobot
from nermo_description.stand import Stand


class _Family(NamedTuple):
    """What makes the models of a family of robots."""

    build: Callable[[Any], mujoco.MjSpec]
    set_posture: Callable[[mujoco.MjData, Any, str], None]


SCENES = Path(str(files("nermo_description"))) / "scenes"
HUNG = "hung"
"""The scene with a stand, which the compiled model has."""
SETTLING_TIME = 2.0
"""Simulated time that a keyframe's posture is given to come to rest [s]."""


def scene_names() -> tuple[str, ...]:
    """Scenes that come with the package."""
    return tuple(sorted(path.stem for path in SCENES.glob("*.xml")))


def build_spec(robot: AnyRobot, scene: str | Path = "flat") -> mujoco.MjSpec:
    """The robot in a scene, by name or from an MJCF file, with keyframes; elements of the scene are named `scene_...`.

    Raises ValueError for a scene that does not exist.
    """
    spec = build_robot(robot)
    spec.attach(_load_scene(scene), prefix="scene_", frame=spec.worldbody.add_frame())
    for name in robot.postures:
        spec.add_key(name=name)
    _write_keyframes(spec, robot)
    return spec


def build_model(robot: AnyRobot, scene: str | Path = "flat") -> mujoco.MjModel:
    """`build_spec`, compiled; in the scene `hung` with the torso in a stand.

    Raises ValueError for a scene that does not exist, and for one that is not for this family of robots.
    """
    if scene == HUNG and robot.family != "mouse":
        raise ValueError(f"scene '{HUNG}' is the stand of a mouse, and {robot.name} is a {robot.family}")
    model = build_spec(robot, scene).compile()
    if scene == HUNG:
        Stand().hang(model)
    return model


def build_robot(robot: AnyRobot) -> mujoco.MjSpec:
    """The robot alone, its tendons strung and its torsos balanced."""
    spec = _FAMILIES[robot.family].build(robot)
    enter_deviations(spec, robot)
    return spec


def set_posture(model: mujoco.MjModel, data: mujoco.MjData, robot: AnyRobot, name: str) -> None:
    """Puts legs, pulleys and head where the servos of a posture want them, spine and tail straight; the body stays."""
    _FAMILIES[robot.family].set_posture(data, robot, name)


def _build_mouse(robot: RobotParameters) -> mujoco.MjSpec:
    spec = _assemble(robot)
    draft = spec.compile()
    _string_tendons(spec, draft, robot)
    _balance(spec, draft, robot)
    return spec


def _set_mouse_posture(data: mujoco.MjData, robot: RobotParameters, name: str) -> None:
    angles = robot.posture(name)
    for leg in LEGS:
        parameters = robot.front_leg if leg.startswith("front") else robot.rear_leg
        data.joint(f"{leg}_hip_joint").qpos = angles[f"{leg}_hip"]
        data.joint(f"{leg}_knee_pulley_joint").qpos = angles[f"{leg}_knee"]
        data.joint(f"{leg}_knee_joint").qpos = knee_angle(parameters, angles[f"{leg}_knee"])
        data.joint(f"{leg}_ankle_joint").qpos = parameters.ankle_angle
    for servo, angle in angles.items():
        data.actuator(servo).ctrl = angle
        if servo.startswith("head"):
            data.joint(f"{servo}_joint").qpos = angle


def _assemble(robot: RobotParameters) -> mujoco.MjSpec:
    """All blocks, attached; torsos without mass, tendons without length."""
    spec = load("front_torso")
    spec.modelname = robot.name
    rear = load("rear_torso")
    place, rotation = hip_frame(robot)
    for leg, hip in zip(LEGS, robot.hip_positions, strict=True):
        pair, side = leg.split("_")
        if pair == "front":
            frame = spec.frame(f"{leg}_leg")
            frame.pos = hip
        else:
            frame = rear.frame(f"{side}_leg")
            frame.pos = tuple(rotation.T @ (np.array(hip) - place))
            frame.quat = _inverse_pitch(rotation)
    for torso in (spec.body("torso"), rear.body("torso")):
        write_inertia(torso, 1e-3, (0.0, 0.0, 0.0), (1e-6, 1e-6, 1e-6))
    frame = rear.frame("tail")
    frame.pos = tuple(rotation.T @ (np.array(robot.tail.position) - place))
    frame.quat = pitch_quaternion(robot.tail.pitch)

    head_frame = spec.frame("head")
    head_frame.pos = robot.head.position
    spec.attach(build_spine(robot), prefix="spine_", frame=spec.frame("spine"))
    spec.attach(rear, prefix="rear_", frame=spec.frame("spine_end"))
    for leg in LEGS:
        spec.attach(
            build_leg(robot, "front" if leg.startswith("front") else "rear"),
            prefix=f"{leg}_",
            frame=spec.frame(f"{leg}_leg"),
        )
    spec.attach(build_tail(robot), prefix="tail_", frame=spec.frame("rear_tail"))
    spec.attach(build_head(robot), prefix="head_", frame=head_frame)
    # A prefix cannot make `tail` out of anything.
    spec.actuator("tail_servo").name = "tail"
    for quantity in ("position", "velocity", "torque"):
        spec.sensor(f"tail_servo_{quantity}").name = f"tail_{quantity}"
    spec.sensor("tail_torque").objname = "tail"
    for geom in spec.geoms:
        if geom.conaffinity:
            geom.friction[0] = robot.contact.friction
            geom.solref = (robot.contact.solref_contact, 1.0)
            geom.priority = 1  # over the ground's: otherwise MuJoCo takes the larger friction and the mean softness
    return spec


def _string_tendons(spec: mujoco.MjSpec, draft: mujoco.MjModel, robot: RobotParameters) -> None:
    """Cuts every tendon to length, as at the real mouse (N A.2.1): legs held in a brace, all servos at 0."""
    data = mujoco.MjData(draft)
    for leg in LEGS:
        parameters = robot.front_leg if leg.startswith("front") else robot.rear_leg
        data.joint(f"{leg}_knee_joint").qpos = knee_angle(parameters, 0.0)
    mujoco.mj_fwdPosition(draft, data)
    for tendon in spec.tendons:
        tendon.range = (0.0, data.tendon(tendon.name).length[0])


def _balance(spec: mujoco.MjSpec, draft: mujoco.MjModel, robot: RobotParameters) -> None:
    """Gives the torsos the mass that the limbs leave, placed so that the COM of both groups is where N has it."""
    data = mujoco.MjData(draft)
    set_posture(draft, data, robot, "stand")
    mujoco.mj_fwdPosition(draft, data)
    origin = data.site("base_link").xpos.copy()
    place, rotation = hip_frame(robot)
    groups = {
        "torso": (robot.front_mass, np.array(robot.masses.front_com), robot.masses.front_size),
        "rear_torso": (robot.masses.rear, place + rotation @ np.array(robot.masses.rear_com), robot.masses.rear_size),
    }
    for name, (mass, com, size) in groups.items():
        others = [body for body in range(draft.nbody) if _group(draft, body) == name and draft.body(body).name != name]
        left = mass - float(sum(draft.body_mass[others]))
        moment = mass * com - sum(draft.body_mass[body] * (data.xipos[body] - origin) for body in others)
        local = data.body(name).xmat.reshape(3, 3).T @ (moment / left + origin - data.body(name).xpos)
        write_inertia(spec.body(name), left, local, box_inertia(left, size))


def _group(model: mujoco.MjModel, body: int) -> str:
    """`torso`, `rear_torso` or, for vertebrae, `spine`: to what a body's mass counts."""
    while body:
        name = model.body(body).name
        if name in ("torso", "rear_torso"):
            return name
        if name in {f"spine_{number}" for number in range(1, 9)}:
            return "spine"
        body = int(model.body_parentid[body])
    return "world"


def _write_keyframes(spec: mujoco.MjSpec, robot: AnyRobot) -> None:
    """Settles every posture on the scene's ground."""
    model = spec.compile()
    for key in spec.keys:
        data = settle(model, robot, key.name)
        key.qpos, key.ctrl = data.qpos.copy(), data.ctrl.copy()
        if model.na:
            key.act = data.act.copy()


def settle(model: mujoco.MjModel, robot: AnyRobot, posture: str) -> mujoco.MjData:
    """The robot at rest in a posture: set down at the origin and left alone for SETTLING_TIME."""
    data = mujoco.MjData(model)
    set_posture(model, data, robot, posture)
    mujoco.mj_kinematics(model, data)
    lowest = min(data.geom(f"{leg}_foot").xpos[2] - model.geom(f"{leg}_foot").size[0] for leg in LEGS)
    data.joint("root").qpos[2] -= lowest
    for _ in range(round(SETTLING_TIME / model.opt.timestep)):
        mujoco.mj_step(model, data)
    return data


def _inverse_pitch(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Quaternion of the inverse of a rotation about y."""
    return pitch_quaternion(-float(np.arctan2(rotation[0, 2], rotation[0, 0])))


def _load_scene(scene: str | Path) -> mujoco.MjSpec:
    path = Path(scene) if str(scene).endswith(".xml") else SCENES / f"{scene}.xml"
    if not path.is_file():
        raise ValueError(
            f"scene {str(scene)!r} does not exist; known are {', '.join(scene_names())}, or give an MJCF file"
        )
    return mujoco.MjSpec.from_file(str(path))


_FAMILIES = {
    "mouse": _Family(_build_mouse, _set_mouse_posture),
    "pantograph": _Family(build_pantograph_robot, set_pantograph_posture),
}
