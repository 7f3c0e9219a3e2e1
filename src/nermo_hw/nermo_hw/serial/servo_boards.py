"""Nermo's bus: four servo boards and a body board behind a bus controller, with sensors for everything."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from nermo_description.parameters import LEGS, RobotParameters
from nermo_hw.sbcp import boards
from nermo_hw.sbcp.boards import BODY_BOARD, BUS_CONTROLLER, CHANNELS, SERVO_BOARDS, TACTILE_CHANNELS
from nermo_hw.sbcp.packet import DeviceClass, Instruction, Packet
from nermo_hw.sbcp.registers import Value
from nermo_hw.serial.bus import Address
from nermo_hw.serial.calibration import Calibration, Mountings
from nermo_hw.types import LATCHED, Array, Fault, SensorSample


@dataclass(slots=True)
class _Channel:
    """Where a servo hangs."""

    address: Address
    number: int


class ServoBoardsBus:
    """As `Bus` says. period_ms: between two exchanges with new targets, which the boards' interpolation must know."""

    name = "servo_boards"
    baud = boards.BUS_BAUD
    boot_time = 0.0
    door = BUS_CONTROLLER
    servo_boards: tuple[Address, ...] = tuple((int(DeviceClass.SERVO_BOARD), number) for number in SERVO_BOARDS)
    body = BODY_BOARD
    boards: tuple[Address, ...] = (door, *servo_boards, body)
    learns: tuple[str, ...] = ()

    def __init__(self, robot: RobotParameters, calibration: Calibration | None, period_ms: int) -> None:
        self.settings: Mapping[str, Value] = {"point_period": period_ms, "heuristics": 1}
        self._names = tuple(robot.servos)
        where = {
            name: _Channel((int(DeviceClass.SERVO_BOARD), number), channel)
            for number, names in SERVO_BOARDS.items()
            for channel, name in enumerate(names)
            if name is not None
        }
        channels = [where[name] for name in self._names]
        self._populated = {
            address: sum(1 << channel.number for channel in channels if channel.address == address)
            for address in self.servo_boards
        }
        self._servos = Mountings(self._names, calibration.servos if calibration else {})
        self._encoders = Mountings(LEGS, calibration.knee_encoders if calibration else {})
        # Place of each servo in the concatenated channels of all boards, and back.
        self._slot = np.array(
            [self.servo_boards.index(channel.address) * CHANNELS + channel.number for channel in channels]
        )
        self._sequence = 0
        self.learn({})

    def learn(self, values: Mapping[str, Value]) -> None:
        self._servo_answers: dict[Address, boards.ServoAnswer] = {}
        self._body_answer: boards.BodyAnswer | None = None

    def packets(self, sequence: int, positions: Array | None, energised: bool, acknowledge: bool) -> list[Packet]:
        self._sequence = sequence & 0xFF
        flags, reported = 0, np.zeros(len(self.servo_boards) * CHANNELS)
        if positions is not None:
            reported[self._slot] = self._servos.reported(positions)
            flags |= boards.POINT
        if acknowledge:
            flags |= boards.ACKNOWLEDGE
        packets = []
        for number, address in enumerate(self.servo_boards):
            a, b, c, d = reported[number * CHANNELS : (number + 1) * CHANNELS].tolist()
            power = self._populated[address] if energised else 0
            request = boards.ServoRequest(self._sequence, flags | power, (a, b, c, d))
            packets.append(Packet(*address, Instruction.EXCHANGE, request.encode()))
        body = boards.BodyRequest(self._sequence, flags & boards.ACKNOWLEDGE)
        packets.append(Packet(*BODY_BOARD, Instruction.EXCHANGE, body.encode()))
        return packets

    def take(self, packet: Packet) -> bool:
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

    def sample(self, stamp: int, elapsed: float, missing: tuple[str, ...]) -> SensorSample:
        count = len(self.servo_boards) * CHANNELS
        positions, velocities, currents = np.zeros(count), np.zeros(count), np.zeros(count)
        knees, cells = np.zeros(len(LEGS)), np.zeros((len(TACTILE_CHANNELS), len(LEGS)))
        faults, limp = Fault(0), False
        silent, over = 0, 0
        for number, address in enumerate(self.servo_boards):
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
            missing=missing,
        )

    def _named(self, mask: int) -> tuple[str, ...]:
        return tuple(name for name, slot in zip(self._names, self._slot.tolist(), strict=True) if mask >> slot & 1)
