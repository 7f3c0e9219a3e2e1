"""The device of a measurement: the emulator on a bench, which can also be tilted and run down.

python -m nermo_hw.bench.device_process PSEUDO_TERMINAL ROBOT
"""

from __future__ import annotations

import math
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from nermo_description.battery_model import BatteryModel
from nermo_description.robots import load_robot
from nermo_hw.device.emulator import Emulator, control_path
from nermo_hw.device.plant import PlantSensors, ServoPlant
from nermo_hw.device.servo_boards import ServoBoards

GRAVITY = 9.81
"""[m/s^2]"""


class BenchPlant(ServoPlant):
    """Servos on a bench that somebody may tip over."""

    tilt = 0.0
    """[rad]"""
    upside_down = False
    """The accelerometer says so, the orientation does not."""

    def sensors(self) -> PlantSensors:
        """As `Plant` says."""
        sensors = super().sensors()
        sensors.orientation = np.array([math.cos(self.tilt / 2), math.sin(self.tilt / 2), 0.0, 0.0])
        up = -GRAVITY if self.upside_down else GRAVITY
        sensors.linear_acceleration = up * np.array([0.0, math.sin(self.tilt), math.cos(self.tilt)])
        return sensors


class BenchEmulator(Emulator):
    """With the words `tilt` (angle [rad]), `voltage` (open-circuit [V], None: that of the pack), `upside_down` (on) and
    `no_orientation` (on).
    """

    def _tilt(self, angle: float) -> None:
        plant = self.device.plant
        assert isinstance(plant, BenchPlant)
        plant.tilt = angle

    def _voltage(self, value: float | None) -> None:
        self.device.battery.model = BatteryModel() if value is None else BatteryModel(full=value, empty=value)

    def _upside_down(self, on: bool) -> None:
        plant = self.device.plant
        assert isinstance(plant, BenchPlant)
        plant.upside_down = on

    def _no_orientation(self, on: bool) -> None:
        assert isinstance(self.device, ServoBoards)
        self.device.body.no_orientation = on

    _words = {  # noqa: RUF012
        **Emulator._words,
        "tilt": _tilt,
        "voltage": _voltage,
        "upside_down": _upside_down,
        "no_orientation": _no_orientation,
    }


def main() -> int:
    """Runs until it is killed."""
    link, robot = Path(sys.argv[1]), load_robot(sys.argv[2])
    plant: Any = BenchPlant(robot)
    device = ServoBoards(robot, plant, now=time.monotonic_ns())
    device.trace = True
    BenchEmulator(device, link, control=control_path(link)).run()
    return 0


if __name__ == "__main__":
    sys.exit(main())
