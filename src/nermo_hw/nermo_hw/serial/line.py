"""One serial line: packets out together, their answers in, and an account of what went wrong on the way."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterable
from typing import Any

from nermo_hw.sbcp import register_tables
from nermo_hw.sbcp.boards import board_name
from nermo_hw.sbcp.packet import OVERHEAD, Instruction, Packet, Status, status_name
from nermo_hw.sbcp.parser import Parser, Plausible
from nermo_hw.serial.bus import Address
from nermo_hw.serial.port import open_port
from nermo_hw.types import AbsentBoardError, LineCounters, LineError, LineLostError, SilentLineError

LARGEST_OVERTIME = 1.0
"""A line that never ends to babble is given up after this time [s]."""
ATTEMPTS = 3
"""How often a register is asked for, at least, before its board counts as silent."""
ASK_FOR = 0.5
"""Where not even the bus controller says anything, asking goes on for so long [s]: one of the two may be busy."""
UNANSWERED = (Status.NO_ANSWER, Status.DAMAGED_ANSWER)
"""What the bus controller says in the name of a board."""


class Line:
    """A port with packets on it. Not thread-safe: transfers come one after another.

    port: see `find_port`. timeout: how long a transfer waits for answers [s]. plausible: what can come back (`Parser`).
    """

    def __init__(self, port: str, timeout: float, plausible: Plausible) -> None:
        self.name, self.timeout = port, timeout
        self.counters = LineCounters()
        self._plausible = plausible
        self._parser = Parser(plausible, prefer_later=True)
        self._port: Any = None

    @property
    def is_open(self) -> bool:
        """Whether the port is open; whether somebody answers is another question."""
        return self._port is not None

    def open(self, baud: int) -> None:
        """Opens the port at a speed [bit/s]; counting starts anew. Raises LineError."""
        self.close()
        self.counters = LineCounters()
        self._parser = Parser(self._plausible, prefer_later=True)
        self._port = open_port(self.name, self.timeout, baud)

    def set_speed(self, baud: int) -> None:
        """Goes on at another speed [bit/s]; what has come is forgotten. Raises LineLostError."""
        if self._port is None:
            raise LineLostError(f"port {self.name} is not open")
        try:
            self._port.baudrate = baud
            self._port.reset_input_buffer()
        except (OSError, ValueError) as error:
            self.close()
            raise LineLostError(f"port {self.name} does not do {baud} bit/s: {error}") from error
        self._parser = Parser(self._plausible, prefer_later=True)

    def close(self) -> None:
        """Closes the port."""
        if self._port is not None:
            port, self._port = self._port, None
            with contextlib.suppress(OSError):  # the cable is gone already
                port.close()

    def transfer(self, packets: list[Packet], take: Callable[[Packet], bool]) -> dict[Address, Packet]:
        """Sends packets together and collects one answer each, until all are there or the time is over.

        take: whether a packet is an answer to this transfer; what the bus controller says for a silent board is one.

        Raises LineLostError where the port is gone.
        """
        if self._port is None:
            raise LineLostError(f"port {self.name} is not open")
        waiting = {packet.address for packet in packets}
        answers: dict[Address, Packet] = {}
        deadline = time.monotonic() + self.timeout
        try:
            self._port.write(b"".join(packet.encode() for packet in packets))
            self.counters.sent += len(packets)
            while waiting:
                data = self._port.read(max(len(waiting) * OVERHEAD - self._parser.pending, 1, self._port.in_waiting))
                self._collect(self._parser.feed(data), waiting, answers, take)
                # What has come in time is read, even if this process was held up meanwhile.
                over = time.monotonic() - deadline
                if over >= 0.0 and (self._port.in_waiting == 0 or over > LARGEST_OVERTIME):
                    break
            if waiting:  # what waits for the rest of a cut-off packet may hide whole ones
                self._collect(self._parser.flush(), waiting, answers, take)
        except (OSError, TypeError) as error:  # pyserial lets a TypeError out where another thread closed the port
            self.close()
            raise LineLostError(f"port {self.name} is gone: {' '.join(str(error).split())}") from error
        self.counters.lost += len(waiting)
        self.counters.corrupt, self.counters.garbage_bytes = self._parser.corrupt, self._parser.garbage_bytes
        return answers

    def _collect(
        self,
        packets: Iterable[Packet],
        waiting: set[Address],
        answers: dict[Address, Packet],
        take: Callable[[Packet], bool],
    ) -> None:
        for packet in packets:
            if packet.code in UNANSWERED:
                if packet.address in waiting:
                    waiting.discard(packet.address)
                    answers[packet.address] = packet
                    self.counters.lost += 1
            elif packet.address not in waiting or not take(packet):
                self.counters.late += 1
            else:
                waiting.discard(packet.address)
                answers[packet.address] = packet
                self.counters.received += 1

    def ask(self, packet: Packet) -> Packet:
        """Has one GET or SET answered, asking again where it got lost.

        Raises SilentLineError where nobody answers and LineError where the board refuses.
        """
        size = 0
        if packet.code == Instruction.GET:
            size = next(
                r.kind.size for r in register_tables.REGISTERS[packet.device_class] if r.address == packet.payload[0]
            )

        def answers_this(answer: Packet) -> bool:
            return answer.code != Status.OK or len(answer.payload) == size

        attempts, until = 0, time.monotonic() + ASK_FOR
        spoken_for = False
        while attempts < ATTEMPTS or (not spoken_for and time.monotonic() < until):
            attempts += 1
            answer = self.transfer([packet], answers_this).get(packet.address)
            spoken_for = answer is not None
            if answer is None or answer.code in UNANSWERED:
                continue
            if answer.code != Status.OK:
                self.counters.refused += 1
                raise LineError(
                    f"port {self.name}: {board_name(packet.address)} refused "
                    f"{Instruction(packet.code).name}: {status_name(answer.code)}"
                )
            return answer
        kind = AbsentBoardError if spoken_for else SilentLineError
        raise kind(f"port {self.name}: {board_name(packet.address)} does not answer")
