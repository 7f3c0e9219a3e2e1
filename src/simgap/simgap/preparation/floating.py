"""Rows of a map for a body that floats: its pose, which a tracker or an odometry gives, and its gyroscope."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mujoco

from simgap.data.bag import Topic, topics
from simgap.data.channels import model_names

Row = tuple[dict[str, Any], str]
"""A row and why, or what to doubt."""
Obj = mujoco.mjtObj

_POSES = ("pose.pose.", "pose.", "transform.", "")
_PLACES = ("position", "translation")
_SEEN = ("truth", "tracker", "mocap", "vicon", "optitrack", "ground")
"""In the name of a topic whose pose was seen from outside, and not worked out on the robot."""
_FRAME = "base_link"
"""What a robot's body is called in ROS."""


def body_rows(recording: Path, model: mujoco.MjModel) -> list[Row]:
    """Outputs of a bag for the one free body of a model; none where it has none, several, or nobody saw it.

    Raises:
        GapInputError: the bag cannot be read.
    """
    free = [j for j in range(model.njnt) if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_FREE]
    if len(free) != 1:
        return []
    found = topics(recording)
    return [*_pose(found, _frame(model, int(model.jnt_bodyid[free[0]]))), *_gyro(found, model)]


def _frame(model: mujoco.MjModel, body: int) -> dict[str, str]:
    """Which frame of the model a pose is of: what is called base_link, else the body itself."""
    sites = model_names(model, Obj.mjOBJ_SITE)
    if _FRAME in sites and int(model.site_bodyid[sites.index(_FRAME)]) == body:
        return {"site": _FRAME}
    return {"body": model_names(model, Obj.mjOBJ_BODY)[body]}


def _pose(found: list[Topic], frame: dict[str, str]) -> Iterator[Row]:
    """Place and orientation from the topic that saw most from outside."""
    poses = [
        (topic.name, f"{pose}{place}", f"{pose}{turn}")
        for topic in found
        for pose in _POSES
        for place, turn in zip(_PLACES, ("orientation", "rotation"), strict=True)
        if {f"{pose}{place}.x", f"{pose}{turn}.w"} <= set(topic.fields) and topic.count > 1
    ]
    if not poses:
        return
    name, place, turn = min(poses, key=lambda p: not any(word in p[0].lower() for word in _SEEN))
    outside = any(word in name.lower() for word in _SEEN)
    others = sorted({p[0] for p in poses} - {name})
    why = "" if outside else "the robot's own estimate? it is compared as if it were measured"
    why = why or (f"and not {', '.join(others)}" if others else "")
    ((where, label),) = frame.items()
    for component in "xyz":
        row = {"topic": name, "field": f"{place}.{component}", "unit": "m", where: label}
        yield {**row, "quantity": "position", "component": component}, why if component == "x" else ""
    for component in "wxyz":
        row = {"topic": name, "field": f"{turn}.{component}", "unit": "1", where: label}
        yield {**row, "quantity": "orientation", "component": component}, ""


def _gyro(found: list[Topic], model: mujoco.MjModel) -> Iterator[Row]:
    """The model's one gyroscope from the one topic that has an IMU's fields."""
    sensors = model_names(model, Obj.mjOBJ_SENSOR)
    gyros = [n for n, kind in zip(sensors, model.sensor_type, strict=True) if kind == mujoco.mjtSensor.mjSENS_GYRO]
    imus = [t for t in found if {"angular_velocity.x", "linear_acceleration.x"} <= set(t.fields) and t.count > 1]
    if len(gyros) == 1 and len(imus) == 1:
        for axis in "xyz":
            row = {"topic": imus[0].name, "field": f"angular_velocity.{axis}", "unit": "rad/s", "sensor": gyros[0]}
            yield {**row, "component": axis}, ""
