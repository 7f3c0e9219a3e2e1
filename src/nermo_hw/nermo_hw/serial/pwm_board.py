"""Nermo-Lite's bus: one board with hobby servos, which measures its supply and nothing else."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping

import numpy as np

from nermo_description.parameters import LEGS, RobotParameters
from nermo_hw.sbcp import pwm_board
from nermo_hw.sbcp.boards import ACKNOWLEDGE, POINT, TACTILE_CHANNELS
from nermo_hw.sbcp.packet import Instruction, Packet
from nermo_hw.sbcp.pwm_board import ADDRESS, CHANNELS, POWER, Answer, Request, State
from nermo_hw.sbcp.registers import Value
from nermo_hw.serial.bus import Address
from nermo_hw.serial.calibration import Calibration, Mountings
from nermo_hw.types import Array, Fault, SensorSample


class PwmBoardBus:
    """As `Bus` says. period_ms: a target is to be reached within so long, as the next one follows then.

    Raises ValueError for a robot with servos that the board has no channel for.
    """

    name = "pwm_board"
    baud = pwm_board.BAUD
    boot_time = pwm_board.BOOT_TIME
    door = body = ADDRESS
    boards: tuple[Address, ...] = (ADDRESS,)
    servo_boards: tuple[Address, ...] = (ADDRESS,)
    settings: Mapping[str, Value] = {}
    learns: tuple[str, ...] = ("session", "last_sequence")

    def __init__(self, robot: RobotParameters, calibration: Calibration | None, period_ms: int) -> None:
        names = tuple(robot.servos)
        self._count = len(names)
        self._channel = pwm_board.channels(names)
        self._servos = Mountings(names, calibration.servos if calibration else {})
        self._way = min(period_ms * 1e-3, pwm_board.LONGEST_WAY)
        self._sequence = self._offset = self._sent = self._session = 0
        self._answer: Answer | None = None

    def learn(self, values: Mapping[str, Value]) -> None:
        """The board goes on counting where it is, and so does this host."""
        self._session, last = int(values["session"]), int(values["last_sequence"])
        self._offset = last - self._sent
        self._answer = None

    def packets(self, sequence: int, positions: Array | None, energised: bool, acknowledge: bool) -> list[Packet]:
        self._sent = sequence
        self._sequence = (sequence + self._offset) & 0xFFFF
        flags = (POWER if energised else 0) | (ACKNOWLEDGE if acknowledge else 0)
        targets = np.zeros(CHANNELS)
        if positions is not None:
            flags |= POINT
            targets[self._channel] = self._servos.reported(positions)
        request = Request(self._session, self._sequence, flags, self._way, tuple(targets.tolist()))
        return [Packet(*ADDRESS, Instruction.EXCHANGE, request.encode())]

    def take(self, packet: Packet) -> bool:
        try:
            answer = Answer.decode(packet.payload)
        except (struct.error, ValueError):
            return False
        if answer.echo != self._sequence:
            return False
        self._answer, self._session = answer, answer.session
        return True

    def sample(self, stamp: int, elapsed: float, missing: tuple[str, ...]) -> SensorSample:
        nothing, answer = math.nan, self._answer
        return SensorSample(
            stamp=stamp,
            elapsed=elapsed,
            servo_positions=np.full(self._count, nothing),
            servo_velocities=np.full(self._count, nothing),
            servo_currents=np.full(self._count, nothing),
            knee_angles=np.full(len(LEGS), nothing),
            cells={cell: np.full(len(LEGS), nothing) for cell in TACTILE_CHANNELS},
            orientation=np.full(4, nothing),
            angular_velocity=np.full(3, nothing),
            linear_acceleration=np.full(3, nothing),
            battery_voltage=nothing if answer is None else answer.voltage,
            battery_current=nothing,
            faults=Fault(0) if answer is None else Fault(answer.faults),
            limp=answer is None or answer.state in (State.LIMP, State.FAULT),
            missing=missing,
            blind=True,
        )
