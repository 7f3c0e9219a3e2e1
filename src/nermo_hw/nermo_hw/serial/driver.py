"""The robot at the end of a serial line: servo targets there, sensor data back, one transfer a cycle. Without ROS."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from nermo_description.parameters import RobotParameters
from nermo_hw.sbcp import pwm_board, register_tables
from nermo_hw.sbcp.boards import board_name
from nermo_hw.sbcp.packet import Instruction, Packet, Status
from nermo_hw.sbcp.plausible import plausible_answer
from nermo_hw.sbcp.registers import Register, Value
from nermo_hw.serial.bus import Address, Bus
from nermo_hw.serial.calibration import Calibration
from nermo_hw.serial.line import UNANSWERED, Line
from nermo_hw.serial.pwm_board import PwmBoardBus
from nermo_hw.serial.servo_boards import ServoBoardsBus
from nermo_hw.types import (
    AbsentBoardError,
    DeviceIdentity,
    LineCounters,
    LineError,
    SensorSample,
    ServoTargets,
    SilentLineError,
)

REPLY_TIMEOUT = 0.02
"""How long the device may take to answer [s]: far longer than it needs, and a tick that is late is no danger."""


class Driver:
    """One device, by its URL. Which bus it is the device says: the robot's own is asked for first.

    robot: whose servos these are; arrays are in the order of `robot.servos`. port: see `find_port`. calibration: how
    servos and encoders are mounted. point_period: time between two exchanges with new targets [s], which the device's
    trajectory interpolation needs to know (C 5.3.3); a whole number of ms. reply_timeout: how long an exchange waits
    for answers [s]. clock: gives the stamps [ns].

    The servos are limp after the start of the device, after a watchdog, and until `release` says that they may move.
    Not thread-safe: exchanges come one after another.
    """

    def __init__(
        self,
        robot: RobotParameters,
        port: str,
        *,
        calibration: Calibration | None = None,
        point_period: float = 0.005,
        reply_timeout: float = REPLY_TIMEOUT,
        clock: Callable[[], int] = time.time_ns,
    ) -> None:
        period_ms = point_period * 1e3
        if not 2.0 <= period_ms <= 1000.0 or abs(period_ms - round(period_ms)) > 1e-6:
            raise ValueError(f"point_period = {point_period} s: must be 2 to 1000 whole milliseconds")
        if not 1e-4 <= reply_timeout <= 10.0:
            raise ValueError(f"reply_timeout = {reply_timeout} s: must be within 0.0001 s and 10 s")
        self.robot = robot
        self.port_name = port
        self._line, self._clock = Line(port, reply_timeout, plausible_answer), clock
        self._names = tuple(robot.servos)
        self._buses = _buses(robot, calibration, round(period_ms))
        self._bus: Bus = self._buses[0]
        self._sequence = 0
        self._acknowledge = False
        self._last_stamp: int | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """The servos, in the order of all arrays."""
        return self._names

    @property
    def bus(self) -> Bus:
        """Who was there when the line was opened last; before that, what the robot's file says."""
        return self._bus

    @property
    def counters(self) -> LineCounters:
        """What the line has seen since it was opened."""
        return self._line.counters

    @property
    def is_open(self) -> bool:
        """Whether the port is open; whether somebody answers is another question."""
        return self._line.is_open

    def open(self, set_up: bool = True) -> DeviceIdentity:
        """Opens the port, looks who is there and sets the boards up. The servos stay as they are.

        set_up: False changes nothing on the boards.

        Raises LineError where the port cannot be opened, nobody answers, or a board is of another protocol.
        """
        self._line.open(self._buses[0].baud)
        self._last_stamp = None
        try:
            self._bus = self._who_is_there()
            identity = self.identify()
            self._bus.learn({name: self.read(self._bus.body, name) for name in self._bus.learns})
            if set_up:
                self._set_up()
        except LineError:
            self.close()
            raise
        return identity

    def close(self) -> None:
        """Closes the port; the device's watchdog then makes the servos limp."""
        self._line.close()

    def __enter__(self) -> Driver:
        self.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def exchange(self, targets: ServoTargets | None = None) -> SensorSample:
        """Gives all boards their targets and takes their sensor data, in one transfer.

        targets: None is no trajectory point: the servos go on with what they have (C's underflow heuristics let them
        come to rest) and keep their power.

        Raises ValueError for targets of a wrong shape or not finite, SilentLineError where no board answered, and
        LineLostError where the port is gone.
        """
        positions = None if targets is None else np.asarray(targets.positions, dtype=float)
        if positions is not None and (positions.shape != (len(self._names),) or not np.isfinite(positions).all()):
            raise ValueError(f"targets {positions.tolist()}: must be {len(self._names)} finite positions [rad]")
        self._sequence += 1
        stamp = self._clock()
        energised = targets is None or targets.energised
        packets = self._bus.packets(self._sequence, positions, energised, self._acknowledge)
        self.counters.exchanges += 1
        answers = self._line.transfer(packets, self._take_exchange)
        if all(answer.code in UNANSWERED for answer in answers.values()):
            raise SilentLineError(f"port {self.port_name}: no board answered within {self._line.timeout * 1e3:g} ms")
        self._acknowledge = False
        elapsed = 0.0 if self._last_stamp is None else (stamp - self._last_stamp) * 1e-9
        self._last_stamp = stamp
        missing = tuple(
            board_name(packet.address)
            for packet in packets
            if packet.address not in answers or answers[packet.address].code != Status.OK
        )
        return self._bus.sample(stamp, elapsed, missing)

    def release(self) -> None:
        """Sets the boards up again and acknowledges latched faults: from the next exchange on, servos may have power.

        Raises LineError.
        """
        self._set_up()
        self._acknowledge = True

    def identify(self) -> DeviceIdentity:
        """Asks every board who it is. Raises LineError where the body board does not say."""
        present, body = [], self._bus.body
        for address in self._bus.boards:
            try:
                version = int(self.read(address, "protocol_version"))
            except SilentLineError:
                if address == self._bus.door:  # it would speak for the others
                    break
                continue
            if version >> 8 != register_tables.PROTOCOL_VERSION >> 8:
                raise LineError(
                    f"port {self.port_name}: {board_name(address)} speaks SBCP {_version(version)}, "
                    f"this driver {_version(register_tables.PROTOCOL_VERSION)}"
                )
            present.append(board_name(address))
        if board_name(body) not in present:
            there = f"only {', '.join(present)}" if present else "nobody"
            raise SilentLineError(f"port {self.port_name}: {there} answered; is this a Nermo, and has it power?")
        return DeviceIdentity(
            url=self.port_name,
            robot=str(self.read(body, "robot")),
            protocol_version=_version(int(self.read(body, "protocol_version"))),
            firmware_version=_version(int(self.read(body, "firmware_version"))),
            serial_number=int(self.read(body, "serial_number")),
            boards=tuple(present),
        )

    def read(self, address: Address, name: str) -> Value:
        """Value of a register. Raises KeyError for an unknown name, SilentLineError, and LineError for a refusal."""
        register = _register(address, name)
        answer = self._line.ask(Packet(*address, Instruction.GET, bytes((register.address,))))
        return register.decode(answer.payload)

    def write(self, address: Address, name: str, value: Value) -> None:
        """Writes a register. Raises ValueError where the value is out of range, and as `read` does."""
        register = _register(address, name)
        register.check(value)
        self._line.ask(Packet(*address, Instruction.SET, bytes((register.address,)) + register.encode(value)))

    # Inside

    def _who_is_there(self) -> Bus:
        """The bus whose door answers, with the line at its speed. Raises SilentLineError where none does."""
        for bus in self._buses:
            self._line.set_speed(bus.baud)
            if self._answers(bus):
                return bus
        raise SilentLineError(f"port {self.port_name}: nobody answered; is this a Nermo, and has it power?")

    def _answers(self, bus: Bus) -> bool:
        until = time.monotonic() + bus.boot_time
        while True:
            try:
                self.read(bus.door, "protocol_version")
                return True
            except AbsentBoardError:
                return False
            except SilentLineError:
                if time.monotonic() >= until:
                    return False

    def _set_up(self) -> None:
        for address in self._bus.servo_boards:
            for name, value in self._bus.settings.items():
                try:
                    self.write(address, name, value)
                except SilentLineError:
                    continue  # a board that is gone shows in every exchange

    def _take_exchange(self, packet: Packet) -> bool:
        """Whether a packet answers the present exchange; if so its content is kept."""
        if packet.code != Status.OK:
            self.counters.refused += 1
            return True
        return self._bus.take(packet)


def _buses(robot: RobotParameters, calibration: Calibration | None, period_ms: int) -> list[Bus]:
    """Those that can drive this robot, its own first."""
    made: list[Bus] = [ServoBoardsBus(robot, calibration, period_ms)]
    if set(robot.servos) <= set(pwm_board.SERVOS):
        made.append(PwmBoardBus(robot, calibration, period_ms))
    return sorted(made, key=lambda bus: bus.name != robot.bus)


def _register(address: Address, name: str) -> Register:
    for register in register_tables.REGISTERS[address[0]]:
        if register.name == name:
            return register
    known = ", ".join(register.name for register in register_tables.REGISTERS[address[0]])
    raise KeyError(f"{board_name(address)} has no register {name!r}; it has {known}")


def _version(number: int) -> str:
    return f"{number >> 8}.{number & 0xFF}"
