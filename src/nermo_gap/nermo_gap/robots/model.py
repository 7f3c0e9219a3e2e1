"""The twin's model as the diagnosis replays it: the same mouse, with what only costs time taken out."""

from __future__ import annotations

import mujoco

from nermo_description.model import build_spec, settle
from nermo_description.parameters import LEGS, RobotParameters


def diagnosis_spec(robot: RobotParameters, scene: str = "flat") -> mujoco.MjSpec:
    """The robot's MJCF for replays: its tail is stiff, and only feet and bellies touch the ground.

    With the tail's eighteen joints a step takes twice the time, and replays come no nearer to the full twin: how the
    tail swings at a window's start is not known anyway.
    """
    spec = build_spec(robot, scene)
    for key in list(spec.keys):
        spec.delete(key)
    for joint in list(spec.joints):
        if joint.name.startswith("tail_") and joint.name != "tail_pulley_joint":
            spec.delete(joint)
    touching = {*(f"{leg}_foot" for leg in LEGS), "torso", "rear_torso"}
    for geom in spec.geoms:
        if geom.conaffinity and geom.name not in touching and not geom.name.startswith("scene_"):
            geom.conaffinity = 0
    # The stiff tail becomes one body. What an exclusion names is kept apart, for effects act at the rear torso.
    # Parent and child never touch anyway.
    spec.compiler.fusestatic = True
    spec.add_exclude(bodyname1="rear_torso", bodyname2="tail_pulley")
    model = spec.compile()
    data = settle(model, robot, "stand")
    stand = spec.add_key(name="stand", qpos=data.qpos.copy(), ctrl=data.ctrl.copy())
    if model.na:
        stand.act = data.act.copy()
    return spec
