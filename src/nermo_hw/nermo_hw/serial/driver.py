"""The robot at the end of a serial line: servo targets there, sensor data back, one transfer a cycle. Without ROS."""

from __future__ import annotations

import struct
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from nermo_description.parameters import LEGS, RobotParameters
from nermo_hw.sbcp import boards
from nermo_hw.sbcp.boards import BODY_BOARD, BUS_CONTROLLER, CHANNELS, SERVO_BOARDS, TACTILE_CHANNELS, board_name
from nermo_hw.sbcp.packet import DeviceClass, Instruction, Packet, Status
from nermo_hw.sbcp.plausible import plausible_answer
from nermo_hw.sbcp.registers import Register, Value
from nermo_hw.serial.calibration import Calibration, Mountings
from nermo_hw.serial.line import UNANSWERED, Address, Line
from nermo_hw.types import (
    LATCHED,
    DeviceIdentity,
    Fault,
    LineCounters,
    LineError,
    SensorSample,
    ServoTargets,
    SilentLineError,
)

REPLY_TIMEOUT = 0.02
"""How long the device may take to answer [s]: far longer than it needs, and a tick that is late is no danger."""


@dataclass(slots=True)
class _Channel:
    """Where a servo hangs."""

    address: Address
    number: int


class Driver:
    """One device, by its URL.

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
        self._settings: dict[str, Value] = {"point_period": round(period_ms), "heuristics": 1}
        self._line, self._clock = Line(port, reply_timeout, plausible_answer), clock
        self._names = tuple(robot.servos)
        where = {
            name: _Channel((int(DeviceClass.SERVO_BOARD), number), channel)
            for number, names in SERVO_BOARDS.items()
            for channel, name in enumerate(names)
            if name is not None
        }
        self._channels = [where[name] for name in self._names]
        self._servo_boards = [(int(DeviceClass.SERVO_BOARD), number) for number in SERVO_BOARDS]
        self._populated = {
            address: sum(1 << channel.number for channel in self._channels if channel.address == address)
            for address in self._servo_boards
        }
        self._servos = Mountings(self._names, calibration.servos if calibration else {})
        self._encoders = Mountings(LEGS, calibration.knee_encoders if calibration else {})
        # Place of each servo in the concatenated channels of all boards, and back.
        self._slot = np.array(
            [self._servo_boards.index(channel.address) * CHANNELS + channel.number for channel in self._channels]
        )
        self._sequence = 0
        self._acknowledge = False
        self._last_stamp: int | None = None
        self._servo_answers: dict[Address, boards.ServoAnswer] = {}
        self._body_answer: boards.BodyAnswer | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """The servos, in the order of all arrays."""
        return self._names

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
        self._line.open()
        self._last_stamp = None
        self._servo_answers.clear()
        self._body_answer = None
        try:
            identity = self.identify()
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
        self._sequence = (self._sequence + 1) & 0xFF
        stamp = self._clock()
        packets = self._exchange_packets(targets)
        self.counters.exchanges += 1
        answers = self._line.transfer(packets, self._take_exchange)
        if all(answer.code in UNANSWERED for answer in answers.values()):
            raise SilentLineError(f"port {self.port_name}: no board answered within {self._line.timeout * 1e3:g} ms")
        self._acknowledge = False
        return self._sample(stamp, answers)

    def release(self) -> None:
        """Sets the boards up again and acknowledges latched faults: from the next exchange on, servos may have power.

        Raises LineError.
        """
        self._set_up()
        self._acknowledge = True

    def identify(self) -> DeviceIdentity:
        """Asks every board who it is. Raises LineError where the body board does not say."""
        present = []
        for address in (BUS_CONTROLLER, *self._servo_boards, BODY_BOARD):
            try:
                version = int(self.read(address, "protocol_version"))
            except SilentLineError:
                if address == BUS_CONTROLLER:  # it would speak for the others
                    break
                continue
            if version >> 8 != boards.PROTOCOL_VERSION >> 8:
                raise LineError(
                    f"port {self.port_name}: {board_name(address)} speaks SBCP {_version(version)}, "
                    f"this driver {_version(boards.PROTOCOL_VERSION)}"
                )
            present.append(board_name(address))
        if board_name(BODY_BOARD) not in present:
            there = f"only {', '.join(present)}" if present else "nobody"
            raise SilentLineError(f"port {self.port_name}: {there} answered; is this a Nermo, and has it power?")
        return DeviceIdentity(
            url=self.port_name,
            robot=str(self.read(BODY_BOARD, "robot")),
            protocol_version=_version(int(self.read(BODY_BOARD, "protocol_version"))),
            firmware_version=_version(int(self.read(BODY_BOARD, "firmware_version"))),
            serial_number=int(self.read(BODY_BOARD, "serial_number")),
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

    # One transfer

    def _set_up(self) -> None:
        for address in self._servo_boards:
            for name, value in self._settings.items():
                try:
                    self.write(address, name, value)
                except SilentLineError:
                    continue  # a board that is gone shows in every exchange

    def _exchange_packets(self, targets: ServoTargets | None) -> list[Packet]:
        flags, reported = 0, np.zeros(len(self._servo_boards) * CHANNELS)
        energised = targets is None or targets.energised
        if targets is not None:
            positions = np.asarray(targets.positions, dtype=float)
            if positions.shape != (len(self._names),) or not np.isfinite(positions).all():
                raise ValueError(f"targets {positions.tolist()}: must be {len(self._names)} finite positions [rad]")
            reported[self._slot] = self._servos.reported(positions)
            flags |= boards.POINT
        if self._acknowledge:
            flags |= boards.ACKNOWLEDGE
        packets = []
        for number, address in enumerate(self._servo_boards):
            a, b, c, d = reported[number * CHANNELS : (number + 1) * CHANNELS].tolist()
            power = self._populated[address] if energised else 0
            request = boards.ServoRequest(self._sequence, flags | power, (a, b, c, d))
            packets.append(Packet(*address, Instruction.EXCHANGE, request.encode()))
        body = boards.BodyRequest(self._sequence, flags & boards.ACKNOWLEDGE)
        packets.append(Packet(*BODY_BOARD, Instruction.EXCHANGE, body.encode()))
        return packets

    def _take_exchange(self, packet: Packet) -> bool:
        """Whether a packet answers the present exchange; if so its content is kept."""
        if packet.code != Status.OK:
            self.counters.refused += 1
            return True
        try:
            if packet.device_class == DeviceClass.SERVO_BOARD:
                answer = boards.ServoAnswer.decode(packet.payload)
                if answer.sequence == self._sequence:
                    self._servo_answers[packet.address] = answer
                return answer.sequence == self._sequence
            body = boards.BodyAnswer.decode(packet.payload)
        except (struct.error, ValueError):
            return False
        if body.sequence == self._sequence:
            self._body_answer = body
        return body.sequence == self._sequence

    # What came back

    def _sample(self, stamp: int, answered: dict[Address, Packet]) -> SensorSample:
        count = len(self._servo_boards) * CHANNELS
        positions, velocities, currents = np.zeros(count), np.zeros(count), np.zeros(count)
        knees, cells = np.zeros(len(LEGS)), np.zeros((len(TACTILE_CHANNELS), len(LEGS)))
        faults, limp = Fault(0), False
        silent, over = 0, 0
        for number, address in enumerate(self._servo_boards):
            answer = self._servo_answers.get(address)
            if answer is None:
                limp = limp or self._populated[address] != 0
                continue
            here = slice(number * CHANNELS, (number + 1) * CHANNELS)
            positions[here], velocities[here], currents[here] = answer.positions, answer.velocities, answer.currents
            knees[number], cells[:, number] = answer.knee_angle, answer.cells
            faults |= Fault(answer.faults & 0xFF)
            populated = self._populated[address]
            limp = limp or (answer.energised & populated) != populated
            silent |= ((answer.energised >> 4) & populated) << (number * CHANNELS)
            over |= ((answer.faults >> 8) & populated) << (number * CHANNELS)
        body = self._body_answer
        if body is not None:
            faults |= Fault(body.faults & 0xFF)
        elapsed = 0.0 if self._last_stamp is None else (stamp - self._last_stamp) * 1e-9
        self._last_stamp = stamp
        return SensorSample(
            stamp=stamp,
            elapsed=elapsed,
            servo_positions=self._servos.angles(positions[self._slot]),
            servo_velocities=self._servos.velocities(velocities[self._slot]),
            servo_currents=currents[self._slot],
            knee_angles=self._encoders.angles(knees),
            cells=dict(zip(TACTILE_CHANNELS, cells, strict=True)),
            orientation=np.array([1.0, 0.0, 0.0, 0.0]) if body is None else body.orientation,
            angular_velocity=np.zeros(3) if body is None else body.angular_velocity,
            linear_acceleration=np.zeros(3) if body is None else body.linear_acceleration,
            battery_voltage=float("nan") if body is None else body.voltage,
            battery_current=float("nan") if body is None else body.current,
            faults=faults,
            limp=limp or bool(faults & LATCHED),
            silent_servos=self._named(silent),
            over_current_servos=self._named(over),
            missing=tuple(
                board_name(address)
                for address in (*self._servo_boards, BODY_BOARD)
                if address not in answered or answered[address].code != Status.OK
            ),
        )

    def _named(self, mask: int) -> tuple[str, ...]:
        return tuple(name for name, slot in zip(self._names, self._slot.tolist(), strict=True) if mask >> slot & 1)


def _register(address: Address, name: str) -> Register:
    for register in boards.REGISTERS[address[0]]:
        if register.name == name:
            return register
    known = ", ".join(register.name for register in boards.REGISTERS[address[0]])
    raise KeyError(f"{board_name(address)} has no register {name!r}; it has {known}")


def _version(number: int) -> str:
    return f"{number >> 8}.{number & 0xFF}"
