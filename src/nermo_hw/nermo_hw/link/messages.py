"""The robot's messages as CDR, without ROS."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cache
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from nermo_description.feet import named_readings
from nermo_description.parameters import LEGS
from nermo_hw.types import Array, SensorSample

# The robot has no nermo_interfaces; a test holds these to the package's own files.
DEFINITIONS = {
    "nermo_interfaces/msg/ServoCommand": "std_msgs/Header header\nstring[] name\nfloat64[] position",
    "nermo_interfaces/msg/ServoStates": (
        "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] torque\n"
        "float64[] current"
    ),
    "nermo_interfaces/msg/Tactile": "std_msgs/Header header\nstring[] name\nfloat64[] voltage",
}
KNEE_JOINTS = [f"{leg}_knee_joint" for leg in LEGS]
LIPO = 3
"""sensor_msgs/BatteryState.POWER_SUPPLY_TECHNOLOGY_LIPO"""
DISCHARGING = 2
"""sensor_msgs/BatteryState.POWER_SUPPLY_STATUS_DISCHARGING"""


@cache
def types() -> Any:
    """The message types by name, and what reads and writes them."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for name, text in DEFINITIONS.items():
        store.register(get_types_from_msg(text, name))
    return store


def encode(message: Any) -> bytes:
    """A message as CDR."""
    return bytes(types().serialize_cdr(message, message.__msgtype__))


def decode_command(payload: bytes) -> tuple[int, Sequence[str], Sequence[float]]:
    """Stamp [ns], names and positions [rad] of a ServoCommand. Raises ValueError for anything else."""
    try:
        message = types().deserialize_cdr(payload, "nermo_interfaces/msg/ServoCommand")
        stamp = message.header.stamp
        return stamp.sec * 1_000_000_000 + stamp.nanosec, list(message.name), message.position.tolist()
    except Exception as error:  # generated readers fail in many ways on bytes that are no message
        raise ValueError(f"not a ServoCommand: {type(error).__name__}: {error}") from error


def decode_bool(payload: bytes) -> bool:
    """A std_msgs/Bool. Raises ValueError for anything else."""
    if len(payload) < 5 or payload[4] not in (0, 1):
        raise ValueError("not a Bool")
    return bool(payload[4])


def encode_command(stamp: int, names: Sequence[str], positions: Sequence[float]) -> bytes:
    """A ServoCommand."""
    return encode(_make("nermo_interfaces/msg/ServoCommand")(_header(stamp), list(names), np.asarray(positions, float)))


def encode_bool(data: bool) -> bytes:
    """A std_msgs/Bool."""
    return encode(_make("std_msgs/msg/Bool")(data))


class SensorMessages:
    """What one sample of the device becomes, by topic. servos: their names, in the order of the arrays."""

    def __init__(self, servos: Sequence[str], imu_frame: str = "imu_link") -> None:
        self._servos, self._imu_frame = list(servos), imu_frame
        self._unknown = np.full(len(servos), math.nan)
        self._covariance = np.zeros(9)
        """Zeros mean unknown (sensor_msgs/Imu)."""

    def of(self, sample: SensorSample, due: Callable[[str], bool] = lambda _: True) -> Iterator[tuple[str, bytes]]:
        """Topic and CDR of each message that is due, `servo_states` last: who reads it finds the rest on its way."""
        makers: dict[str, Callable[[SensorSample], Any]] = {
            "imu/data_raw": self._imu,
            "tactile": _tactile,
            "joint_states": _knees,
            "battery": _battery,
            "servo_states": self._servo_states,
        }
        for topic, make in makers.items():
            if due(topic):
                yield topic, encode(make(sample))

    def _imu(self, sample: SensorSample) -> Any:
        vector = _make("geometry_msgs/msg/Vector3")
        w, x, y, z = _floats(sample.orientation)
        return _make("sensor_msgs/msg/Imu")(
            _header(sample.stamp, self._imu_frame),
            _make("geometry_msgs/msg/Quaternion")(x, y, z, w),
            self._covariance,
            vector(*_floats(sample.angular_velocity)),
            self._covariance,
            vector(*_floats(sample.linear_acceleration)),
            self._covariance,
        )

    def _servo_states(self, sample: SensorSample) -> Any:
        return _make("nermo_interfaces/msg/ServoStates")(
            _header(sample.stamp),
            self._servos,
            sample.servo_positions,
            sample.servo_velocities,
            self._unknown,
            sample.servo_currents,
        )


def encode_diagnostics(stamp: int, hardware_id: str, parts: Iterable[tuple[str, int, str, dict[str, object]]]) -> bytes:
    """A DiagnosticArray of (name, level, sentence, values)."""
    status, pair = _make("diagnostic_msgs/msg/DiagnosticStatus"), _make("diagnostic_msgs/msg/KeyValue")
    statuses = [
        status(level, name, sentence, hardware_id, [pair(key, str(value)) for key, value in values.items()])
        for name, level, sentence, values in parts
    ]
    return encode(_make("diagnostic_msgs/msg/DiagnosticArray")(_header(stamp), statuses))


def decode_diagnostics(payload: bytes) -> dict[str, dict[str, str]]:
    """Values of a DiagnosticArray by part, with its sentence as `message`."""
    array = types().deserialize_cdr(payload, "diagnostic_msgs/msg/DiagnosticArray")
    return {
        status.name: {"message": status.message, **{pair.key: pair.value for pair in status.values}}
        for status in array.status
    }


def _make(name: str) -> Any:
    return types().types[name]


def _header(stamp: int, frame: str = "") -> Any:
    seconds, nanoseconds = divmod(stamp, 1_000_000_000)
    return _make("std_msgs/msg/Header")(_make("builtin_interfaces/msg/Time")(seconds, nanoseconds), frame)


def _floats(values: Array) -> list[float]:
    return [float(value) for value in values]


def _knees(sample: SensorSample) -> Any:
    nothing = np.array([])
    return _make("sensor_msgs/msg/JointState")(_header(sample.stamp), KNEE_JOINTS, sample.knee_angles, nothing, nothing)


def _tactile(sample: SensorSample) -> Any:
    names, voltages = named_readings(sample.cells)
    return _make("nermo_interfaces/msg/Tactile")(_header(sample.stamp), names, np.array(voltages))


def _battery(sample: SensorSample) -> Any:
    nan = math.nan
    empty = np.array([], dtype=np.float32)
    return _make("sensor_msgs/msg/BatteryState")(
        header=_header(sample.stamp),
        voltage=float(sample.battery_voltage),
        temperature=nan,
        current=-float(sample.battery_current),
        charge=nan,
        capacity=nan,
        design_capacity=nan,
        percentage=nan,
        power_supply_status=DISCHARGING,
        power_supply_health=0,
        power_supply_technology=LIPO,
        present=True,
        cell_voltage=empty,
        cell_temperature=empty,
        location="",
        serial_number="",
    )
