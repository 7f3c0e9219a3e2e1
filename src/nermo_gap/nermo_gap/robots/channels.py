"""What each mouse really measures, as columns of a table and as a map for the core.

Nermo has servos that report position and current, encoders at the knees and an IMU; Nermo-Lite reports nothing, and is
seen by an outside camera or motion tracker alone (N 4.3, A.2). A tracker may watch Nermo too. Ground truth of a
simulation is never used, except that its pose of base_link stands in for the tracker.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nermo_description.markers import MARKERS
from nermo_description.parameters import LEGS, RobotParameters
from simgap.data.mapping import Map, parse_map

Array = NDArray[np.float64]

TRACKER = ("base_x", "base_y", "base_z", "base_qw", "base_qx", "base_qy", "base_qz")
"""Pose of base_link in the tracker's frame, z up: [m] and quaternion."""
GYRO = ("gyro_x", "gyro_y", "gyro_z")
"""[rad/s], IMU axes."""
RESOLUTION = {
    "position": 1e-3,  # [rad] chosen: a magnetic encoder of 12 bits has 1.5e-3
    "torque": 2e-3,  # [N m] chosen: 1 % of the stall torque, from a current of 10 bits
    "encoder": 1.5e-3,  # [rad] 12 bits
    "gyro": 5e-3,  # [rad/s] chosen: a cheap MEMS gyro over 100 Hz
    "place": 1e-4,  # [m] chosen: a motion tracker of 0.1 mm
    "quaternion": 5e-4,  # chosen: 1 mrad
    "marker": 1e-4,  # [m] chosen: as the place
}
"""No noise floor is below these: what the sensors can resolve."""


@dataclass(frozen=True)
class Channels:
    """Which kinds of sensors a robot has."""

    servos: bool
    """Positions and, where they are there, torques from their currents."""
    knees: bool
    gyro: bool
    tracker: bool
    markers: bool
    """Of the tracker, on the feet and the rear torso."""

    @classmethod
    def of(cls, robot: RobotParameters, markers: bool = False) -> Channels:
        """What the robot has: Nermo's boards report, Nermo-Lite's servos do not. Who has markers must say so."""
        reports = robot.servo_type.integral_gain > 0.0 or "spine_vertical" in robot.servos
        return cls(servos=reports, knees=reports, gyro=reports, tracker=True, markers=markers)


def said(column: str) -> str:
    """Column of what the tracker itself says of one of its columns: its standard deviation, in the same unit."""
    return f"{column}_said"


def command(servo: str) -> str:
    """Column of a servo's command [rad]."""
    return f"{servo}_command"


def position(servo: str) -> str:
    """Column of a servo's measured position [rad]."""
    return f"{servo}_position"


def torque(servo: str) -> str:
    """Column of a servo's torque as its current tells it [N m]."""
    return f"{servo}_torque"


def encoder(leg: str) -> str:
    """Column of a knee encoder, theta1 [rad]."""
    return f"{leg}_knee_encoder"


def phase(leg: str) -> str:
    """Column of a leg's phase: 0 stance, 1 swing."""
    return f"{leg}_phase"


def marker(place: str) -> tuple[str, str, str]:
    """Columns of a marker's place in the tracker's frame [m]."""
    return f"marker_{place}_x", f"marker_{place}_y", f"marker_{place}_z"


def leg_servos(robot: RobotParameters) -> list[str]:
    """Servos that move the mouse: legs and spine. Tail and head are driven, but not judged."""
    return [s for s in robot.servos if s.startswith(("front", "rear", "spine"))]


def robot_map(robot: RobotParameters, columns: Collection[str], channels: Channels | None = None) -> Map:
    """The map of a table with these columns; a measurement that the table lacks is left out.

    Raises:
        GapInputError: nothing is commanded or measured.
    """
    channels = channels or Channels.of(robot, markers=True)
    inputs = [
        {"column": command(s), "unit": "rad", "actuator": s, "kind": "position"}
        for s in robot.servos
        if command(s) in columns
    ]
    outputs: list[dict[str, str]] = []
    if channels.servos:
        for servo in leg_servos(robot):
            outputs.append({"column": position(servo), "unit": "rad", "sensor": f"{servo}_position"})
            outputs.append({"column": torque(servo), "unit": "N m", "sensor": f"{servo}_torque"})
    if channels.knees:
        outputs += [{"column": encoder(leg), "unit": "rad", "sensor": f"{leg}_knee_encoder"} for leg in LEGS]
    if channels.gyro:
        outputs += [
            {"column": column, "unit": "rad/s", "sensor": "imu_gyro", "component": column[-1]} for column in GYRO
        ]
    if channels.tracker:
        outputs += [
            {"column": c, "unit": "m", "site": "base_link", "quantity": "position", "component": c[-1]}
            for c in TRACKER[:3]
        ]
        outputs += [
            {"column": c, "unit": "1", "site": "base_link", "quantity": "orientation", "component": c[-1]}
            for c in TRACKER[3:]
        ]
    if channels.markers:
        outputs += [
            {"column": c, "unit": "m", kind: name, "quantity": "position", "component": c[-1]}
            for place, (kind, name) in MARKERS.items()
            for c in marker(place)
        ]
    data: dict[str, object] = {
        "time": {"column": "t", "unit": "s"},
        "inputs": inputs,
        "outputs": [row for row in outputs if row["column"] in columns],
        "auxiliary": [{"column": phase(leg), "unit": "1"} for leg in LEGS if phase(leg) in columns],
    }
    if "run" in columns:
        data["segments"] = {"column": "run"}
    return parse_map(data, f"channels of {robot.name}")


def servos_report(mapping: Map) -> bool:
    """Whether a map holds positions that servos report."""
    return any(row.column.endswith("_position") for row in mapping.outputs)


def uncertainty(tables: Iterable[Mapping[str, Array]]) -> dict[str, float]:
    """What a tracker says of each of its columns: the median standard deviation in the worst of some recordings.

    Errors of a film are alike from picture to picture, so that its noise looks smaller than it is.
    """
    found: dict[str, float] = {}
    columns = (*TRACKER, *(column for place in MARKERS for column in marker(place)))
    for table in tables:
        for column in columns:
            if said(column) in table:
                found[column] = max(found.get(column, 0.0), float(np.nanmedian(table[said(column)])))
    return found


def resolution(columns: Collection[str]) -> dict[str, float]:
    """Least noise floor of each output column."""
    ends = {"_position": "position", "_torque": "torque", "_encoder": "encoder"}
    found = {c: RESOLUTION[kind] for c in columns for end, kind in ends.items() if c.endswith(end)}
    found |= {c: RESOLUTION["marker"] for c in columns if c.startswith("marker_")}
    found |= dict.fromkeys(GYRO, RESOLUTION["gyro"]) | dict.fromkeys(TRACKER[:3], RESOLUTION["place"])
    return found | dict.fromkeys(TRACKER[3:], RESOLUTION["quaternion"])
