"""One sample of the device as messages: topics, types, and how their fields are filled; units and names of the twin.

The driver publishes them (`nodes/sample_publishers.py`), the robot's end sends them over the link (`link/messages.py`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from nermo_description.battery_model import BatteryModel
from nermo_description.feet import named_readings
from nermo_description.parameters import LEGS, RobotParameters
from nermo_hw.types import Array, SensorSample

LIPO = 3
"""sensor_msgs/BatteryState.POWER_SUPPLY_TECHNOLOGY_LIPO"""
DISCHARGING = 2
"""sensor_msgs/BatteryState.POWER_SUPPLY_STATUS_DISCHARGING"""

Fields = dict[str, Any]
"""Of a message, by name: numbers, arrays, lists of words, and the fields of the messages within it."""


@dataclass(frozen=True, slots=True)
class SampleTopic:
    """What one topic says."""

    type: str
    fields: Callable[[SensorSample], Fields]
    """Those that change from sample to sample, but for the stamp."""
    frame: str = ""
    """Of the header, without a robot's prefix."""
    fixed: Callable[[RobotParameters], Fields] = lambda _: {}
    """Those that stay, where they are not zero or empty."""
    blind: bool = False
    """Whether a device without sensors says it too."""

    def said_with(self, sample: SensorSample) -> bool:
        """Whether the device that a sample is of has this to say."""
        return self.blind or not sample.blind


def _vector(values: Array) -> Fields:
    return dict(zip("xyz", values.tolist(), strict=True))


def _imu(sample: SensorSample) -> Fields:
    return {
        "orientation": dict(zip("wxyz", sample.orientation.tolist(), strict=True)),
        "angular_velocity": _vector(sample.angular_velocity),
        "linear_acceleration": _vector(sample.linear_acceleration),
    }


def _tactile(sample: SensorSample) -> Fields:
    names, voltages = named_readings(sample.cells)
    return {"name": names, "voltage": np.array(voltages)}


def _servo_states(sample: SensorSample) -> Fields:
    return {
        "position": sample.servo_positions,
        "velocity": sample.servo_velocities,
        "current": sample.servo_currents,
    }


def _pack(robot: RobotParameters) -> Fields:
    return {
        **dict.fromkeys(("temperature", "charge", "capacity", "percentage"), math.nan),
        "design_capacity": BatteryModel().capacity,
        "power_supply_technology": LIPO,
        "power_supply_status": DISCHARGING,
        "present": True,
    }


SAMPLE_TOPICS: dict[str, SampleTopic] = {
    # Covariances of zero mean unknown (sensor_msgs/Imu).
    "imu/data_raw": SampleTopic("sensor_msgs/msg/Imu", _imu, "imu_link"),
    "tactile": SampleTopic("nermo_interfaces/msg/Tactile", _tactile, "base_link"),
    "joint_states": SampleTopic(
        "sensor_msgs/msg/JointState",
        lambda sample: {"position": sample.knee_angles},
        fixed=lambda _: {"name": [f"{leg}_knee_joint" for leg in LEGS]},
    ),
    "battery": SampleTopic(
        "sensor_msgs/msg/BatteryState",
        lambda sample: {"voltage": float(sample.battery_voltage), "current": -float(sample.battery_current)},
        fixed=_pack,
        blind=True,
    ),
    # Last: who reads the servo states finds the rest on its way.
    "servo_states": SampleTopic(
        "nermo_interfaces/msg/ServoStates",
        _servo_states,
        fixed=lambda robot: {"name": list(robot.servos), "torque": np.full(len(robot.servos), math.nan)},
        blind=True,
    ),
}


def fill(message: Any, fields: Mapping[str, Any], sequence: Callable[[Array], Any] = lambda values: values) -> None:
    """Sets fields of a message. sequence: makes of an array what this kind of message takes."""
    for name, value in fields.items():
        if isinstance(value, dict):
            fill(getattr(message, name), value, sequence)
        else:
            setattr(message, name, sequence(value) if isinstance(value, np.ndarray) else value)
