"""One board: its registers, its clock, and what its firmware does with an instruction and in each loop."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nermo_hw.device.interpolation import TrajectoryInterpolator
from nermo_hw.device.plant import PlantSensors
from nermo_hw.sbcp import boards, register_tables
from nermo_hw.sbcp.boards import CHANNELS, LOOP_PERIOD_NS
from nermo_hw.sbcp.packet import Instruction, Packet, Status
from nermo_hw.sbcp.registers import RegisterError, RegisterTable, Value
from nermo_hw.types import Fault

Array = NDArray[np.float64]
IMU_NOISE = 2.0
"""Standard deviation of rates and accelerations in increments of the line, as a quiet IMU has it."""


@dataclass(slots=True)
class BoardClock:
    """A quartz that runs `ppm` too fast, started at `started` of the true time [ns]."""

    ppm: float = 0.0
    started: int = 0

    def local(self, true_ns: int) -> int:
        """Time since the start on this clock [ns]."""
        elapsed = true_ns - self.started
        return elapsed + round(elapsed * self.ppm * 1e-6)


class Board:
    """What all boards have: standard registers, latched faults, a start that takes a while.

    All times are true ones [ns]; the board sees them through its clock.
    """

    def __init__(self, address: tuple[int, int], serial_number: int, ppm: float, stored: Mapping[str, Value]) -> None:
        self.device_class = address[0]
        self.clock = BoardClock(ppm)
        self.registers = RegisterTable(register_tables.REGISTERS[address[0]], {"device_id": address[1], **stored})
        self._serial_number = serial_number
        self.faults = Fault.RESTARTED
        self._deaf_until = 0
        self._on_start()

    @property
    def address(self) -> tuple[int, int]:
        """Class and present ID."""
        return self.device_class, self.registers.number("device_id")

    def restart(self, now: int, boot_time_ns: int) -> None:
        """As after the power was gone."""
        self.clock.started = now
        self._deaf_until = now + boot_time_ns
        self.registers.restart()
        self.faults = Fault.RESTARTED
        self._on_start()

    def hears(self, now: int) -> bool:
        """Whether it has booted."""
        return now >= self._deaf_until

    def handle(self, packet: Packet, now: int) -> Packet:
        """The answer to a packet, from the address that it was sent to."""
        try:
            payload = self._do(packet, now)
        except RegisterError as error:
            return Packet(*packet.address, error.status)
        except (struct.error, IndexError):
            return Packet(*packet.address, Status.WRONG_SIZE)
        return Packet(*packet.address, Status.OK, payload)

    def acknowledge(self) -> None:
        """Forgets latched faults."""
        self.faults &= Fault.UNDER_VOLTAGE | Fault.SILENT_SERVO

    def _on_start(self) -> None:
        self.registers["device_class"] = self.device_class
        self.registers["serial_number"] = self._serial_number

    def _do(self, packet: Packet, now: int) -> bytes:
        if packet.code == Instruction.GET:
            (address,) = struct.unpack("<B", packet.payload)
            self._refresh(now)
            return self.registers.get(address)
        if packet.code == Instruction.SET:
            register = self.registers.set(packet.payload[0], packet.payload[1:])
            if register.name == "faults":
                self.acknowledge()
            self._on_written(register.name)
            return b""
        if packet.code == Instruction.RESTART:
            self.restart(now, 0)
            return b""
        if packet.code == Instruction.EXCHANGE:
            return self._exchange(packet.payload, now)
        raise RegisterError(Status.UNKNOWN_INSTRUCTION, f"instruction {packet.code}")

    def _refresh(self, now: int) -> None:
        """Brings registers that change by themselves up to date."""
        self.registers["uptime"] = self.clock.local(now) // 1_000_000 & 0xFFFFFFFF
        self.registers["faults"] = int(self.faults)

    def _on_written(self, name: str) -> None:
        pass

    def _exchange(self, payload: bytes, now: int) -> bytes:
        raise RegisterError(Status.UNKNOWN_INSTRUCTION, "no exchange here")


class ServoBoard(Board):
    """Four servo channels, a knee encoder, the cells of a foot.

    servos: place of each channel's servo in the robot's order; None where nothing is plugged in. leg: place in LEGS.
    sense: gives the present sensors, angles as the servos report them.
    """

    def __init__(
        self,
        address: tuple[int, int],
        servos: Sequence[int | None],
        leg: int,
        sense: Callable[[], PlantSensors],
        *,
        current_per_torque: float,
        serial_number: int = 0,
        ppm: float = 0.0,
        stored: Mapping[str, Value],
    ) -> None:
        self.servos, self.leg = tuple(servos), leg
        self._channels = [channel for channel, servo in enumerate(servos) if servo is not None]
        self._places = [servo for servo in servos if servo is not None]
        self.populated = sum(1 << channel for channel in self._channels)
        self._sense, self._current_per_torque = sense, current_per_torque
        self.silent = 0
        """Channels whose servo does not answer."""
        self.stuck = 0
        """Channels whose readings do not change any more, although the servo answers."""
        self._frozen = np.zeros((3, CHANNELS))
        self.unreadable = 0
        """Channels whose servo answers that it cannot measure."""
        self.angle_error = np.zeros(CHANNELS)
        """How far the angle that is told is from where the servo is [rad]."""
        self.extra_current = np.zeros(CHANNELS)
        """Drawn by a servo beside what moves it [A], for tests."""
        super().__init__(address, serial_number, ppm, stored)

    def _on_start(self) -> None:
        super()._on_start()
        self.energised = 0
        self.over_current = 0
        self._drawing_since = np.full(CHANNELS, -1, dtype=np.int64)
        self._loops = 0
        self._last_exchange = 0
        self.interpolator: TrajectoryInterpolator[Array] = TrajectoryInterpolator(
            np.zeros(CHANNELS), self.registers.number("point_period"), bool(self.registers["heuristics"])
        )
        self.set_points = self.interpolator.position

    def advance(self, now: int) -> None:
        """Runs the loops that are due."""
        local = self.clock.local(now)
        due = local // LOOP_PERIOD_NS
        for _ in range(min(due - self._loops, 1000)):
            self.set_points = self.interpolator.step()
        self._loops = max(self._loops, due)
        if self.energised and local - self._last_exchange > self.registers.number("watchdog") * 1_000_000:
            self.faults |= Fault.WATCHDOG
            self._power(0)

    def watch_currents(self, now: int) -> None:
        """Makes servos limp that have drawn too much for too long; called every few loops."""
        currents = self._measure()[2]
        local, limit = self.clock.local(now), self.registers.number("current_limit") * 1e-3
        for channel in self._channels:
            if currents[channel] <= limit:
                self._drawing_since[channel] = -1
            elif self._drawing_since[channel] < 0:
                self._drawing_since[channel] = local
            elif local - self._drawing_since[channel] >= self.registers.number("over_current_time") * 1_000_000:
                self.over_current |= 1 << channel
                self.faults |= Fault.OVER_CURRENT
                self._power(self.energised & ~self.over_current)

    def set_silent(self, channels: int) -> None:
        """Servos that stop answering: they stay where they are, and so does what is read from them."""
        self._frozen = self._measure()
        self.silent = channels & self.populated
        self.faults &= ~Fault.SILENT_SERVO
        if self.silent:
            self.faults |= Fault.SILENT_SERVO

    def set_stuck(self, channels: int) -> None:
        """Servos that move, while what is read from them stays."""
        self._frozen = self._measure()
        self.stuck = channels & self.populated

    def set_unreadable(self, channels: int) -> None:
        """Servos that answer, but have no reading."""
        self.unreadable = channels & self.populated

    def acknowledge(self) -> None:
        super().acknowledge()
        self.over_current = 0
        self._drawing_since[:] = -1

    def _power(self, channels: int) -> None:
        if channels & ~self.energised:
            self.interpolator.stop(self._measure()[0])
            self.set_points = self.interpolator.position
        self.energised = channels

    def _measure(self) -> Array:
        """Positions, velocities, currents of the channels, shape (3, 4)."""
        sensors = self._sense()
        result = np.zeros((3, CHANNELS))
        result[0, self._channels] = sensors.positions[self._places]
        result[1, self._channels] = sensors.velocities[self._places]
        result[2, self._channels] = np.abs(sensors.torques[self._places]) * self._current_per_torque
        result[2] += self.extra_current
        for channel in range(CHANNELS):
            if (self.silent | self.stuck) >> channel & 1:
                result[:, channel] = self._frozen[:, channel]
        return result

    def _exchange(self, payload: bytes, now: int) -> bytes:
        request = boards.ServoRequest.decode(payload)
        self.advance(now)
        self._last_exchange = self.clock.local(now)
        if request.flags & boards.ACKNOWLEDGE:
            self.acknowledge()
        wanted = request.flags & self.populated & ~self.over_current
        if self.faults & (Fault.WATCHDOG | Fault.RESTARTED):
            wanted = 0
        if wanted != self.energised:
            self._power(wanted)
        if request.flags & boards.POINT and self.energised:
            self.interpolator.add(np.array(request.targets))
        sensors, measured = self._sense(), self._measure()
        measured[0] += self.angle_error
        measured[:, [bool(self.unreadable >> channel & 1) for channel in range(CHANNELS)]] = math.nan
        positions, velocities, currents = measured
        waiting = min(self.interpolator.waiting, 15)
        return boards.ServoAnswer(
            request.sequence,
            self.energised | self.silent << CHANNELS,
            int(self.faults) | (self.over_current | waiting << CHANNELS) << 8,
            self.clock.local(now) // 1000,
            positions,
            velocities,
            currents,
            float(sensors.knee_angles[self.leg]),
            np.array(
                [
                    sensors.cells[cell][self.leg] if cell in sensors.cells else math.nan
                    for cell in boards.TACTILE_CHANNELS
                ]
            ),
        ).encode()

    def _refresh(self, now: int) -> None:
        super()._refresh(now)
        self.advance(now)
        for name in ("missed_points", "filled_buffer_steps", "dropped_points"):
            self.registers[name] = getattr(self.interpolator, name)

    def _on_written(self, name: str) -> None:
        self.interpolator.period = self.registers.number("point_period")
        self.interpolator.heuristics = bool(self.registers["heuristics"])


class BodyBoard(Board):
    """IMU and battery.

    sense: gives the present sensors. supply: voltage [V] and current [A] of the battery. seed: of the IMU's noise,
    without which a host would have to take it for dead.
    """

    def __init__(
        self,
        address: tuple[int, int],
        sense: Callable[[], PlantSensors],
        supply: Callable[[], tuple[float, float]],
        *,
        serial_number: int = 0,
        ppm: float = 0.0,
        stored: Mapping[str, Value],
        seed: int = 0,
    ) -> None:
        self._sense, self._supply = sense, supply
        self._random = np.random.default_rng(seed)
        self.frozen: frozenset[str] = frozenset()
        """Of "imu" and "battery", those whose readings do not change any more."""
        self.unreadable: frozenset[str] = frozenset()
        """Of "imu" and "battery", those that have no reading."""
        self.no_orientation = False
        """The IMU's own computer has lost it: all zeros."""
        self._imu: tuple[Array, Array, Array] | None = None
        self._power: tuple[float, float] | None = None
        super().__init__(address, serial_number, ppm, stored)

    def _exchange(self, payload: bytes, now: int) -> bytes:
        request = boards.BodyRequest.decode(payload)
        if request.flags & boards.ACKNOWLEDGE:
            self.acknowledge()
        self._look_at_battery()
        if self._imu is None or "imu" not in self.frozen:
            sensors = self._sense()
            noise = self._random.normal(scale=IMU_NOISE, size=(2, 3))
            rate = sensors.angular_velocity + boards.RATE * noise[0]
            acceleration = sensors.linear_acceleration + boards.ACCELERATION * noise[1]
            self._imu = (0.0 * sensors.orientation if self.no_orientation else sensors.orientation, rate, acceleration)
        if self._power is None or "battery" not in self.frozen:
            self._power = self._supply()
        time = self.clock.local(now) // 1000
        orientation, rate, acceleration = self._imu
        if "imu" in self.unreadable:
            orientation, rate, acceleration = (np.full_like(part, math.nan) for part in self._imu)
        power = (math.nan, math.nan) if "battery" in self.unreadable else self._power
        return boards.BodyAnswer(
            request.sequence, int(self.faults), time, orientation, rate, acceleration, *power
        ).encode()

    def _look_at_battery(self) -> None:
        voltage, _ = self._supply()
        self.registers["battery_voltage"] = min(max(round(voltage * 1e3), 0), 0xFFFF)
        self.faults &= ~Fault.UNDER_VOLTAGE
        if voltage * 1e3 < self.registers.number("low_voltage"):
            self.faults |= Fault.UNDER_VOLTAGE

    def _refresh(self, now: int) -> None:
        self._look_at_battery()
        super()._refresh(now)
