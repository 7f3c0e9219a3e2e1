"""A host of a PWM board in virtual time: frames in, answers and pulses out."""

from __future__ import annotations

import os
import shutil

import numpy as np
import pytest

from nermo_description.robots import load_robot
from nermo_hw.firmware.build import COMPILERS, FirmwareError, host_program
from nermo_hw.firmware.process import Firmware, Reply
from nermo_hw.sbcp.boards import ACKNOWLEDGE, POINT
from nermo_hw.sbcp.packet import Instruction, Packet
from nermo_hw.sbcp.parser import Parser
from nermo_hw.sbcp.pwm_board import (
    ADDRESS,
    CHANNELS,
    POWER,
    PULSE_CENTRE,
    PULSE_PER_RADIAN,
    STAGGER,
    Answer,
    Request,
)

ROBOT = load_robot("nermo_lite")
SERVOS = list(ROBOT.servos.values())
LOWER, UPPER = (np.array([getattr(servo, side) for servo in SERVOS]) for side in ("lower", "upper"))
MIDDLE = (LOWER + UPPER) / 2.0
ALL_ON_MS = round(STAGGER * 1e3) * CHANNELS
"""After so long all servos have their pulses."""


def need_compiler() -> None:
    """Skips a test of the firmware on a machine that cannot build it, and says so."""
    if not any(name and shutil.which(name) for name in (os.environ.get("CXX", ""), *COMPILERS)):
        pytest.skip("no C++ compiler: the firmware cannot be built here (nermo doctor says how to get one)")


def need_sanitizers() -> None:
    """The same where the sanitizers' libraries are missing, which some distributions have in packages of their own."""
    need_compiler()
    try:
        host_program("serve", sanitized=True)
    except FirmwareError as error:
        if "asan" in str(error) or "ubsan" in str(error):
            pytest.skip(f"no sanitizers: {error}")
        raise


def pulse(angles: np.ndarray) -> np.ndarray:
    """What the board must put out for angles [rad], as the data sheet says it [s]."""
    return PULSE_CENTRE + PULSE_PER_RADIAN * (np.clip(angles, LOWER, UPPER) - MIDDLE)


class PwmHost:
    """Sends what a test tells it, at its own time."""

    def __init__(self, firmware: Firmware | None = None, now: int = 0) -> None:
        self.firmware = firmware or Firmware(host_program("serve", sanitized=True))
        self.now = now
        """[us]"""
        self.session = self.sequence = 0

    def close(self) -> None:
        self.firmware.close()

    def power_up(self, session: int = 7) -> Reply:
        self.session, self.sequence = session, 0
        self.last = self.firmware.power_up(session, self.now)
        return self.last

    def wait(self, milliseconds: float) -> Reply:
        self.now += round(milliseconds * 1e3)
        self.last = self.firmware.receive(b"", self.now)
        return self.last

    def send(self, raw: bytes) -> list[Packet]:
        self.last = self.firmware.receive(raw, self.now)
        return Parser().feed(self.last.line)

    def ask(self, code: int, payload: bytes = b"") -> Packet:
        (answer,) = self.send(Packet(*ADDRESS, code, payload).encode())
        return answer

    def frame(self, targets: np.ndarray | None = None, flags: int = POWER, time: float = 0.005, **other: int) -> bytes:
        """The next exchange, as bytes."""
        self.sequence = (self.sequence + 1) & 0xFFFF
        fields = {"session": self.session, "sequence": self.sequence, **other}
        angles = np.zeros(CHANNELS) if targets is None else targets
        flags |= 0 if targets is None else POINT
        request = Request(fields["session"], fields["sequence"], flags, time, tuple(angles.tolist()))
        return Packet(*ADDRESS, Instruction.EXCHANGE, request.encode()).encode()

    def exchange(self, *arguments: object, **fields: object) -> Answer:
        (packet,) = self.send(self.frame(*arguments, **fields))
        answer = Answer.decode(packet.payload)
        self.session = answer.session
        return answer

    def drive(self, targets: np.ndarray, cycles: int = 60) -> Answer:
        """Acknowledges what is latched and sends points at 200 Hz until every servo has its pulse."""
        self.exchange(flags=POWER | ACKNOWLEDGE)
        for _ in range(cycles):
            answer = self.exchange(targets)
            self.wait(5)
        return answer
