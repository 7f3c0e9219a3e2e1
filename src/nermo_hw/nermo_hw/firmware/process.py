"""The firmware as a process of this machine, in a time that it is told: `firmware/host/serve.cpp`."""

from __future__ import annotations

import struct
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nermo_hw.firmware.build import FirmwareError, host_program
from nermo_hw.sbcp.pwm_board import CHANNELS, PULSE, State

Array = NDArray[np.float64]

_RECORD = struct.Struct("<cQH")
_SIZE = struct.Struct("<H")
_REPLY = struct.Struct(f"<BH{CHANNELS}H")
LARGEST_PIECE = 4096
"""Bytes of one record."""


@dataclass(frozen=True, slots=True)
class Reply:
    """What the board makes of a record."""

    line: bytes
    """Bytes to the host."""
    state: State
    session: int
    pulses: Array
    """[s], shape (CHANNELS,); 0 where there is none"""


class Firmware:
    """One board. Times are [us] and never run backwards; it steps through the loops between two of them.

    program: a build of `serve`, by default one without sanitizers.

    Raises FirmwareError, also later, where the program has ended; a sanitizer's words are in the text.
    """

    def __init__(self, program: Path | None = None) -> None:
        self._process = subprocess.Popen(
            [str(program or host_program("serve"))],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            start_new_session=True,  # Ctrl-C is for whoever started the emulator
        )

    def receive(self, data: bytes, now: int) -> Reply:
        """Bytes from the line; none, and time goes on."""
        reply = self._record(b"b", data[:LARGEST_PIECE], now)
        if len(data) <= LARGEST_PIECE:
            return reply
        rest = self.receive(data[LARGEST_PIECE:], now)
        return Reply(reply.line + rest.line, rest.state, rest.session, rest.pulses)

    def supply(self, voltage: float, now: int) -> Reply:
        """The supply is measured [V]."""
        return self._record(b"v", struct.pack("<H", min(max(round(voltage * 1e3), 0), 0xFFFE)), now)

    def power_up(self, session: int, now: int) -> Reply:
        """Power was gone and is there again."""
        return self._record(b"r", struct.pack("<H", session), now)

    def close(self) -> None:
        """Ends the process."""
        self._process.kill()
        self._process.communicate()

    def _record(self, what: bytes, data: bytes, now: int) -> Reply:
        assert self._process.stdin is not None and self._process.stdout is not None, "both are pipes"
        try:
            self._process.stdin.write(_RECORD.pack(what, now, len(data)) + data)
            self._process.stdin.flush()
            line = self._read(_SIZE.unpack(self._read(_SIZE.size))[0])
            state, session, *pulses = _REPLY.unpack(self._read(_REPLY.size))
        except (OSError, EOFError) as error:
            self._process.kill()
            _, said = self._process.communicate()
            raise FirmwareError(f"the firmware has ended: {said.decode(errors='replace').strip()[:4000]}") from error
        return Reply(line, State(state), session, np.array(pulses, dtype=float) * PULSE)

    def _read(self, size: int) -> bytes:
        assert self._process.stdout is not None, "it is a pipe"
        data = self._process.stdout.read(size)
        if len(data) < size:
            raise EOFError
        return data
