"""What goes to the robot and what comes back, without ROS. SI units; servo arrays in the order of `robot.servos`."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntFlag

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class LineError(OSError):
    """The line to the robot does not work; the text says which line and what is wrong."""


class LineLostError(LineError):
    """The port is gone (a pulled cable, a closed connection): only opening it again helps."""


class SilentLineError(LineError):
    """Nobody answered this exchange; the next one may."""


class AbsentBoardError(SilentLineError):
    """A board did not answer, and the bus controller says so in its name: asking again does not help."""


class Fault(IntFlag):
    """What a board has to say about itself. All but the voltage stay until they are acknowledged (`Driver.release`)."""

    WATCHDOG = 0x01
    """No exchange came for too long: the servos were made limp."""
    RESTARTED = 0x02
    """The board has started (power-on, brown-out): the servos are limp."""
    UNDER_VOLTAGE = 0x04
    """The supply is below the board's threshold now."""
    OVER_CURRENT = 0x08
    """A servo drew too much for too long and was made limp."""
    SILENT_SERVO = 0x10
    """A servo does not answer its board."""
    EMPTY_BATTERY = 0x20
    """The supply was so low for so long that going on would ruin the battery; only the PWM board looks."""


LATCHED = Fault.WATCHDOG | Fault.RESTARTED | Fault.OVER_CURRENT | Fault.EMPTY_BATTERY
"""Faults that keep servos limp until they are acknowledged."""


@dataclass(frozen=True, slots=True)
class ServoTargets:
    """What the servos shall do until the next exchange."""

    positions: Array
    """[rad], shape (n,). Raises ValueError in `Driver.exchange` where one is not finite; limits are the caller's."""
    energised: bool = True
    """False makes the servos limp, whatever the positions are."""


@dataclass(frozen=True, slots=True)
class SensorSample:
    """What one exchange brought back. What a silent board did not say is as it was last, see `missing`.

    NaN is what a board that did answer could not measure; of a blind device everything but faults and voltage.
    """

    stamp: int
    """When it was measured [ns], on the clock given to the driver, to within a millisecond."""
    elapsed: float
    """Since the sample before [s]; 0 for the first."""
    servo_positions: Array
    """[rad], shape (n,)"""
    servo_velocities: Array
    """[rad/s], shape (n,)"""
    servo_currents: Array
    """[A], shape (n,), not negative"""
    knee_angles: Array
    """theta1 from the encoders [rad], shape (4,), in the order of LEGS"""
    cells: dict[str, Array]
    """What each cell of the feet reads [V], shape (4,) in the order of LEGS"""
    orientation: Array
    """Of the IMU in the world: unit quaternion (w, x, y, z); anything else where the IMU has none."""
    angular_velocity: Array
    """[rad/s], shape (3,), IMU axes"""
    linear_acceleration: Array
    """[m/s^2], shape (3,), IMU axes; at rest +9.81 upwards"""
    battery_voltage: float
    """[V]"""
    battery_current: float
    """[A], positive while discharging"""
    faults: Fault
    """Of all boards together."""
    limp: bool
    """Whether any servo that the robot has is without power."""
    silent_servos: tuple[str, ...] = ()
    over_current_servos: tuple[str, ...] = ()
    missing: tuple[str, ...] = ()
    """Boards that did not answer this time, as in "servo board 3"."""
    blind: bool = False
    """Whether the device has no sensors but that of its supply, so that their silence is no fault."""


@dataclass(slots=True)
class LineCounters:
    """What a line has seen since it was opened."""

    exchanges: int = 0
    sent: int = 0
    """Packets to the robot."""
    received: int = 0
    """Packets from the robot that belong to their exchange."""
    lost: int = 0
    """Answers that did not come in time."""
    late: int = 0
    """Answers to an earlier exchange; they are not used."""
    corrupt: int = 0
    """Frames with a wrong checksum."""
    garbage_bytes: int = 0
    """Bytes between frames."""
    refused: int = 0
    """Answers with an error status."""


@dataclass(frozen=True, slots=True)
class DeviceIdentity:
    """What a device says about itself."""

    url: str
    robot: str
    """Name of the robot that the device is built into."""
    protocol_version: str
    firmware_version: str
    serial_number: int
    boards: tuple[str, ...] = field(default=())
    """Boards that answered, as in "servo board 3"."""
