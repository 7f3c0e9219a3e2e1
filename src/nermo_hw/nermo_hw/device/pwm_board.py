"""Nermo-Lite's board: its firmware, built for this machine, with hobby servos behind its pulses."""

from __future__ import annotations

import heapq
import struct
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nermo_description.parameters import RobotParameters
from nermo_description.robots import load_robot
from nermo_hw.device.board import BoardClock
from nermo_hw.device.device import STEP_NS, WATCH_EVERY, Array, Device, DeviceSettings, Point
from nermo_hw.device.plant import Plant
from nermo_hw.firmware.process import Firmware, Reply
from nermo_hw.sbcp import pwm_board
from nermo_hw.sbcp.boards import BITS_PER_BYTE, POINT
from nermo_hw.sbcp.packet import Instruction, Packet
from nermo_hw.sbcp.parser import Parser
from nermo_hw.sbcp.plausible import plausible_answer, plausible_request
from nermo_hw.serial.calibration import Calibration


class PwmBoard(Device):
    """As `Device` says. Without faults of the line, the firmware gets every byte as it came, and finds packets itself.

    program: a build of the firmware, by default one without sanitizers.

    Raises FirmwareError where it cannot be built, ValueError for a robot with servos that it has no channel for.
    """

    what = "a PWM board"

    def __init__(
        self,
        robot: RobotParameters,
        plant: Plant,
        settings: DeviceSettings | None = None,
        *,
        mounting: Calibration | None = None,
        seed: int = 0,
        now: int = 0,
        program: Path | None = None,
    ) -> None:
        super().__init__(robot, plant, settings, mounting=mounting, seed=seed, now=now)
        self._baud = self.settings.baud or pwm_board.BAUD
        self._clock = BoardClock(self._ppm(), now)
        self._deaf_until = now
        self._request_parser, self._answer_parser = Parser(plausible_request), Parser(plausible_answer)
        self._channels = pwm_board.channels(self._names)
        # The firmware was built for this one, whatever its description says of the robot's own servos.
        built_for = load_robot(pwm_board.ROBOT).servos
        servos = [built_for[name] for name in self._names]
        self._middle = np.array([(servo.lower + servo.upper) / 2.0 for servo in servos])
        self._firmware = Firmware(program)
        self._last = self._firmware.power_up(self._new_session(), 0)

    def close(self) -> None:
        self._firmware.close()

    # The line

    def receive(self, data: bytes, now: int) -> None:
        faults = self.line_faults
        if faults.drop or faults.double or faults.corrupt or faults.delay or faults.garbage or faults.wrong_id:
            super().receive(data, now)
            return
        self.advance(now)
        heapq.heappush(self._inbox, (now, next(self._order), data))
        self._serve(now)

    def _serve(self, now: int) -> None:
        while self._inbox and self._inbox[0][0] <= now:
            raw = heapq.heappop(self._inbox)[2]
            if self._board_time(now) < self._deaf_until:
                continue
            self._last = self._firmware.receive(raw, self._local(self._board_time(now)))
            at = now + round(len(raw) * BITS_PER_BYTE * 1e9 / self._baud)
            answers = self._answer_parser.feed(self._last.line)
            for answer in answers:
                whole = answer.encode()
                at += round(len(whole) * BITS_PER_BYTE * 1e9 / self._baud)
                late = abs(self._random.standard_normal()) * self.settings.reply_jitter
                self._send(whole, at + round(late * 1e9))
            if self.trace:
                self._note(self._request_parser.feed(raw), answers, now)

    def _note(self, requests: list[Packet], answers: list[Packet], now: int) -> None:
        """Keeps the targets of points that were accepted."""
        accepted = set()
        for packet in answers:
            if len(packet.payload) == pwm_board.ANSWER_SIZE:
                answer = pwm_board.Answer.decode(packet.payload)
                if answer.echo == answer.last and answer.state == pwm_board.State.DRIVING:
                    accepted.add(answer.last)
        for packet in requests:
            if packet.code != Instruction.EXCHANGE:
                continue
            try:
                request = pwm_board.Request.decode(packet.payload)
            except (struct.error, pwm_board.DamagedPayloadError):
                continue
            if request.sequence in accepted and request.flags & POINT:
                mounted = np.array(request.targets)[self._channels]
                self.points.append(Point(now, self._servos.angles(mounted)))

    # Time

    def _step(self) -> None:
        if self.time >= self._deaf_until:
            self._last = self._firmware.receive(b"", self._local(self.time))
        self.plant.step(self._targets(), self.energised)
        self._steps += 1
        if self._steps % WATCH_EVERY == 0:
            sensors = self.plant.sensors()
            power = float(np.abs(sensors.torques * sensors.velocities).sum())
            self.battery.draw(power, WATCH_EVERY * STEP_NS * 1e-9)
            self._last = self._firmware.supply(self.battery.voltage, self._local(self.time))
            if self.battery.voltage < self.settings.brown_out_voltage:
                self.brown_out()

    def _targets(self) -> Array:
        """Joint angles that the pulses ask for [rad]."""
        mounted = self._middle + (self._pulses - pwm_board.PULSE_CENTRE) / pwm_board.PULSE_PER_RADIAN
        return self._servos.angles(mounted)

    def _local(self, now: int) -> int:
        """The board's own time [us]."""
        return self._clock.local(now) // 1000

    # Faults, at run time

    def brown_out(self) -> None:
        self._deaf_until = self.time + round(self.settings.boot_time * 1e9)
        self._last = self._firmware.power_up(self._new_session(), self._local(self.time))

    # What there is to know

    @property
    def _pulses(self) -> Array:
        """[s], in the robot's order."""
        return self._last.pulses[self._channels]

    @property
    def energised(self) -> NDArray[np.bool_]:
        return self._pulses > 0.0

    @property
    def reply(self) -> Reply:
        """The board's newest word: its state, session and pulses."""
        return self._last

    def state(self) -> dict[str, object]:
        return {**super().state(), "state": self._last.state.name, "pulses_us": (self._pulses * 1e6).tolist()}

    def _new_session(self) -> int:
        """As the microcontroller's random numbers make one."""
        return int(self._random.integers(0x10000))
