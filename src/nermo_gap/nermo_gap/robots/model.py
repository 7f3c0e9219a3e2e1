"""The twin's model as the diagnosis replays it: the same mouse, with what only costs time taken out."""

from __future__ import annotations

import mujoco

from nermo_description.model import build_spec, settle
from nermo_description.parameters import LEGS, RobotParameters

ONLY_SEEN = 2
"""Group of geoms that neither touch nor are wound by a cable (mjcf/common.xml)."""


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
    for geom in list(spec.geoms):
        if geom.conaffinity and geom.name not in touching and not geom.name.startswith("scene_"):
            spec.delete(geom)
    _leave_out_what_is_only_seen(spec)
    # All that is in contact hangs together: finding out which costs a sixteenth of a step, and changes no bit.
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ISLAND)
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


def _leave_out_what_is_only_seen(spec: mujoco.MjSpec) -> None:
    """Deletes cameras, lights and meshes: a twentieth of a step. Bodies have inertias of their own."""
    for geom in [geom for geom in spec.geoms if geom.group == ONLY_SEEN]:
        spec.delete(geom)
    for seen in (*spec.cameras, *spec.lights):
        spec.delete(seen)
