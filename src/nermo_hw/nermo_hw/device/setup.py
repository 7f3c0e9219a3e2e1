"""What an emulator is told when it is started, and the emulator that comes of it."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Literal

from pydantic import Field

from nermo_description.parameter_files import ParameterError, read_yaml
from nermo_description.parameters import RobotParameters
from nermo_description.robots import load_robot
from nermo_hw.device.device import Device, DeviceSettings
from nermo_hw.device.emulator import Emulator, control_path
from nermo_hw.device.plant import Plant, ServoPlant
from nermo_hw.device.pwm_board import PwmBoard
from nermo_hw.device.servo_boards import ServoBoards
from nermo_hw.firmware.build import FirmwareError
from nermo_hw.sbcp.registers import RegisterError
from nermo_hw.serial.calibration import Calibration, load_calibration
from nermo_hw.types import LineError

PlantFactory = Callable[[RobotParameters], Plant]


class EmulatorSettings(DeviceSettings):
    """Everything that can be chosen; a place is needed: `link`, `tcp_port` or both."""

    robot: str = Field("nermo_lite", description="Name of the robot, or path of its parameter file")
    bus: Literal["", "servo_boards", "pwm_board"] = Field(
        "", description="What its servos hang on: servo_boards or pwm_board; empty: what the robot's file says"
    )
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
    device = _make_device(settings, robot, plant(robot), mounting)
    link = Path(settings.link) if settings.link else None
    return Emulator(
        device,
        link,
        (settings.tcp_host, settings.tcp_port) if settings.tcp_port >= 0 else None,
        control_path(link) if link else None,
        Path(settings.store) if settings.store else None,
    )


def _make_device(
    settings: EmulatorSettings, robot: RobotParameters, plant: Plant, mounting: Calibration | None
) -> Device:
    own = DeviceSettings(**settings.model_dump(include=set(DeviceSettings.model_fields)))
    now = time.monotonic_ns()
    if (settings.bus or robot.bus) == "pwm_board":
        if settings.store:
            raise ValueError("store: a PWM board has no non-volatile registers")
        try:
            return PwmBoard(robot, plant, own, mounting=mounting, seed=settings.seed, now=now)
        except FirmwareError as error:
            raise LineError(str(error)) from error
    stored = read_yaml(Path(settings.store)) if settings.store and Path(settings.store).exists() else {}
    try:
        return ServoBoards(robot, plant, own, mounting=mounting, stored=stored or {}, seed=settings.seed, now=now)
    except (RegisterError, AttributeError, TypeError) as error:
        raise ParameterError(f"{settings.store}: is not a store of registers: {error}") from error
