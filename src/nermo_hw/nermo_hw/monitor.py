"""`nermo hw scan` and `nermo hw monitor`: what is there, and what it says, as tables."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from rich.console import Group
from rich.table import Table
from serial.tools import list_ports

from nermo_description.parameters import LEGS, RobotParameters
from nermo_hw.serial.driver import Driver
from nermo_hw.types import LineCounters, LineError, SensorSample


def scan(ports: Iterable[str], robot: RobotParameters, timeout: float) -> list[dict[str, Any]]:
    """Who is at each port; a row a port, with `error` where nobody is. Nothing is changed on a device."""
    described = {port.device: port for port in list_ports.comports()}
    rows: list[dict[str, Any]] = []
    for name in ports:
        info = described.get(name)
        usb = f"{info.vid:04x}:{info.pid:04x}" if info is not None and info.vid is not None else None
        row: dict[str, Any] = {"port": name, "usb": usb, "description": info.description if info is not None else None}
        driver = Driver(robot, name, reply_timeout=timeout)
        try:
            identity = driver.open(set_up=False)
            row |= {
                "robot": identity.robot,
                "boards": list(identity.boards),
                "protocol": identity.protocol_version,
                "firmware": identity.firmware_version,
                "serial_number": identity.serial_number,
                "error": None,
            }
        except LineError as error:
            row["error"] = str(error)
        finally:
            driver.close()
        rows.append(row)
    return rows


def serial_ports() -> list[str]:
    """Ports of this machine that could lead to a robot."""
    return sorted(port.device for port in list_ports.comports())


def scan_table(rows: list[dict[str, Any]]) -> Table:
    """A row a port."""
    table = Table("port", "USB", "robot", "boards", "SBCP", "firmware", "serial", "what is wrong")
    for row in rows:
        if row["error"] is None:
            found = (row["robot"], str(len(row["boards"])), row["protocol"], row["firmware"], str(row["serial_number"]))
        else:
            found = ("-",) * 5
        table.add_row(row["port"], row["usb"] or "-", *found, row["error"] or "")
    return table


def sample_facts(names: tuple[str, ...], sample: SensorSample, counters: LineCounters) -> dict[str, Any]:
    """One sample as plain data."""
    roll, pitch, yaw = roll_pitch_yaw(sample)
    return {
        "servos": {
            name: {
                "position_rad": float(sample.servo_positions[place]),
                "velocity_rad_s": float(sample.servo_velocities[place]),
                "current_a": float(sample.servo_currents[place]),
            }
            for place, name in enumerate(names)
        },
        "legs": {
            leg: {
                "knee_rad": float(sample.knee_angles[place]),
                **{f"{cell}_v": float(volts[place]) for cell, volts in sample.cells.items()},
            }
            for place, leg in enumerate(LEGS)
        },
        "roll_deg": roll,
        "pitch_deg": pitch,
        "yaw_deg": yaw,
        "battery_v": sample.battery_voltage,
        "battery_a": sample.battery_current,
        "faults": [str(fault.name) for fault in sample.faults],
        "limp": sample.limp,
        "missing_boards": list(sample.missing),
        "silent_servos": list(sample.silent_servos),
        "blind": sample.blind,
        "exchanges": counters.exchanges,
        "frames_lost": counters.lost,
        "frames_late": counters.late,
        "frames_corrupt": counters.corrupt,
    }


def monitor_view(facts: dict[str, Any], robot: RobotParameters) -> Group:
    """One sample as tables."""
    if facts["blind"]:
        return Group("This board has no sensors but that of its supply.", _body(facts))
    servos = Table("servo", "position [rad]", "range [rad]", "velocity [rad/s]", "current [A]", "")
    for name, servo in facts["servos"].items():
        limits = robot.servos[name]
        remark = "silent" if name in facts["silent_servos"] else ""
        if not limits.lower - 0.02 <= servo["position_rad"] <= limits.upper + 0.02:
            remark = "out of range: calibrated?"
        servos.add_row(
            name,
            f"{servo['position_rad']:+.3f}",
            f"{limits.lower:+.2f} to {limits.upper:+.2f}",
            f"{servo['velocity_rad_s']:+.2f}",
            f"{servo['current_a']:.2f}",
            remark,
        )
    cells = [key for key in next(iter(facts["legs"].values())) if key.endswith("_v")]
    legs = Table("leg", "knee [rad]", *(f"{cell.removesuffix('_v')} [V]" for cell in cells))
    for leg, values in facts["legs"].items():
        legs.add_row(leg, f"{values['knee_rad']:.3f}", *(f"{values[cell]:+.3f}" for cell in cells))
    return Group(servos, legs, _body(facts))


def _body(facts: dict[str, Any]) -> Table:
    body = Table("roll, pitch, yaw [deg]", "battery", "faults", "missing", "lost, late, corrupt frames")
    body.add_row(
        f"{facts['roll_deg']:+.1f} {facts['pitch_deg']:+.1f} {facts['yaw_deg']:+.1f}",
        f"{facts['battery_v']:.2f} V, {facts['battery_a']:.2f} A",
        ", ".join(facts["faults"]) or "none",
        ", ".join(facts["missing_boards"]) or "none",
        f"{facts['frames_lost']}, {facts['frames_late']}, {facts['frames_corrupt']} of {facts['exchanges']} exchanges",
    )
    return body


def roll_pitch_yaw(sample: SensorSample) -> tuple[float, float, float]:
    """Of the IMU, REP-103 [deg]."""
    w, x, y, z = sample.orientation.tolist()
    roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = math.asin(min(max(2.0 * (w * y - z * x), -1.0), 1.0))
    yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return math.degrees(roll), math.degrees(pitch), math.degrees(yaw)
