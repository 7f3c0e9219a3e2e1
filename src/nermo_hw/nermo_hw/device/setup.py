"""What an emulator is told when it is started, and the emulator that comes of it."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from pydantic import Field

from nermo_description.parameter_files import ParameterError, read_yaml
from nermo_description.parameters import RobotParameters
from nermo_description.robots import load_robot
from nermo_hw.device.device import Device, DeviceSettings
from nermo_hw.device.emulator import Emulator, control_path
from nermo_hw.device.plant import Plant, ServoPlant
from nermo_hw.sbcp.registers import RegisterError
from nermo_hw.serial.calibration import load_calibration

PlantFactory = Callable[[RobotParameters], Plant]


class EmulatorSettings(DeviceSettings):
    """Everything that can be chosen; a place is needed: `link`, `tcp_port` or both."""

    robot: str = Field("nermo_lite", description="Name of the robot, or path of its parameter file")
    link: str = Field("", description="Path of the symbolic link to the pseudo-terminal; empty: none")
    tcp_host: str = Field("127.0.0.1", description="Address to listen at for pyserial's socket://")
    tcp_port: int = Field(-1, ge=-1, le=65535, description="Port to listen at; 0: any that is free, -1: none")
    mounting: str = Field("", description="Calibration file that says how servos and encoders sit; empty: as drawn")
    store: str = Field("", description="YAML file of the non-volatile registers; empty: they are forgotten")
    seed: int = Field(0, ge=0, description="Of clocks, jitter and faults")


def make_emulator(settings: EmulatorSettings, plant: PlantFactory = ServoPlant) -> Emulator:
    """The emulator, listening. Raises ValueError for settings that do not fit, LineError for a place that is taken."""
    if not settings.link and settings.tcp_port < 0:
        raise ValueError("where shall the host find the device? Give link, or tcp_port")
    robot = load_robot(settings.robot)
    mounting = load_calibration(Path(settings.mounting), robot) if settings.mounting else None
    stored = read_yaml(Path(settings.store)) if settings.store and Path(settings.store).exists() else {}
    try:
        device = Device(
            robot,
            plant(robot),
            DeviceSettings(**settings.model_dump(include=set(DeviceSettings.model_fields))),
            mounting=mounting,
            stored=stored or {},
            seed=settings.seed,
            now=time.monotonic_ns(),
        )
    except (RegisterError, AttributeError, TypeError) as error:
        raise ParameterError(f"{settings.store}: is not a store of registers: {error}") from error
    link = Path(settings.link) if settings.link else None
    return Emulator(
        device,
        link,
        (settings.tcp_host, settings.tcp_port) if settings.tcp_port >= 0 else None,
        control_path(link) if link else None,
        Path(settings.store) if settings.store else None,
    )
