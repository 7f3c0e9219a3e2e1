"""The device of a measurement: the emulator on a bench, which can also be tilted and run down.

python -m nermo_hw.bench.device PSEUDO_TERMINAL ROBOT
"""

from __future__ import annotations

import math
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from nermo_description.battery import BatteryModel
from nermo_description.robots import load_robot
from nermo_hw.device.device import Device
from nermo_hw.device.emulator import Emulator, control_path
from nermo_hw.device.plant import PlantSensors, ServoPlant


class BenchPlant(ServoPlant):
    """Servos on a bench that somebody may tip over."""

    tilt = 0.0
    """[rad]"""

    def sensors(self) -> PlantSensors:
        """As `Plant` says."""
        sensors = super().sensors()
        sensors.orientation = np.array([math.cos(self.tilt / 2), math.sin(self.tilt / 2), 0.0, 0.0])
        return sensors


class BenchEmulator(Emulator):
    """With the words `tilt` (angle [rad]) and `voltage` (open-circuit [V], None: that of the pack)."""

    def _tilt(self, angle: float) -> None:
        plant = self.device.plant
        assert isinstance(plant, BenchPlant)
        plant.tilt = angle

    def _voltage(self, value: float | None) -> None:
        self.device.battery.model = BatteryModel() if value is None else BatteryModel(full=value, empty=value)

    _words = {**Emulator._words, "tilt": _tilt, "voltage": _voltage}  # noqa: RUF012


def main() -> int:
    """Runs until it is killed."""
    link, robot = Path(sys.argv[1]), load_robot(sys.argv[2])
    plant: Any = BenchPlant(robot)
    device = Device(robot, plant, now=time.monotonic_ns())
    device.trace = True
    BenchEmulator(device, link, control=control_path(link)).run()
    return 0


if __name__ == "__main__":
    sys.exit(main())
