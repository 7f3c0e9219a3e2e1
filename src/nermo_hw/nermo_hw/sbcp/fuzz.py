"""Parser fuzzer: millions of random and mutated bytes with whole packets between them, and a strict judge.

python -m nermo_hw.sbcp.fuzz --bytes 10000000 --seed 0
"""

from __future__ import annotations

import argparse
import random
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass

from nermo_hw.sbcp import boards
from nermo_hw.sbcp.boards import BODY_BOARD, SERVO_BOARDS
from nermo_hw.sbcp.packet import HEADER, OVERHEAD, DeviceClass, Packet, Status
from nermo_hw.sbcp.parser import Parser, Plausible
from nermo_hw.sbcp.plausible import plausible_answer

BATCH = 20_000
"""Bytes that are judged together."""


@dataclass(slots=True)
class FuzzReport:
    """What a run has found. `exceptions`, `wrong_checksums` and `lost` must be 0."""

    seed: int
    bytes: int = 0
    packets: int = 0
    """Whole packets that stood in the garbage."""
    found: int = 0
    """Of these, found."""
    overlapped: int = 0
    """Of these, not found because garbage and packet together made a frame with a right checksum."""
    accidental: int = 0
    """Frames with a right checksum that nobody had sent."""
    lost: int = 0
    """Packets not found for another reason."""
    wrong_checksums: int = 0
    """Frames accepted that do not stand in the stream, in this order and with a right checksum."""
    exceptions: int = 0
    first_exception: str = ""
    """What it was; empty without any."""

    @property
    def passed(self) -> bool:
        """Whether nothing happened that must not."""
        return self.exceptions == self.wrong_checksums == self.lost == 0


def fuzz(
    size: int,
    seed: int = 0,
    plausible: Plausible | None = plausible_answer,
    progress: Callable[[int], None] | None = None,
) -> FuzzReport:
    """Sends at least `size` bytes through a parser, in pieces of random length.

    plausible: as for `Parser`; None for one that knows nothing of what can come. progress: is told the bytes so far.
    """
    dice, report = random.Random(seed), FuzzReport(seed)
    while report.bytes < size:
        stream, sent = _stream(dice)
        _judge(stream, sent, dice, plausible, report)
        report.bytes += len(stream)
        report.packets += len(sent)
        if progress is not None:
            progress(report.bytes)
    return report


def _stream(dice: random.Random) -> tuple[bytes, dict[int, Packet]]:
    """Garbage with packets in it, and where each of these begins."""
    stream, sent = bytearray(), {}
    while len(stream) < BATCH:
        kind = dice.random()
        if kind < 0.35:
            packet = _packet(dice)
            sent[len(stream)] = packet
            stream += packet.encode()
        elif kind < 0.6:
            stream += dice.randbytes(dice.randrange(1, 120))
        elif kind < 0.7:  # nothing but headers, or what looks like the begin of a packet
            stream += bytes((HEADER,)) * dice.randrange(1, 12)
        elif kind < 0.8:
            stream += _packet(dice).encode()[: dice.randrange(1, 20)]
        else:
            stream += _mutated(dice)
    return bytes(stream), sent


def _packet(dice: random.Random) -> Packet:
    """An answer as a Nermo gives it; its payload is random, headers included."""
    kind = dice.random()
    number = dice.choice(list(SERVO_BOARDS))
    if kind < 0.6:
        return Packet(DeviceClass.SERVO_BOARD, number, Status.OK, dice.randbytes(boards.SERVO_ANSWER_SIZE))
    if kind < 0.8:
        return Packet(*BODY_BOARD, Status.OK, dice.randbytes(boards.BODY_ANSWER_SIZE))
    return Packet(DeviceClass.SERVO_BOARD, number, Status.OK, dice.randbytes(dice.choice((0, 1, 2, 4, 16))))


def _mutated(dice: random.Random) -> bytes:
    """A packet with bytes changed, lost, doubled or put in."""
    raw = bytearray(_packet(dice).encode())
    for _ in range(dice.randrange(1, 4)):
        place, kind = dice.randrange(len(raw)), dice.random()
        if kind < 0.4:
            raw[place] ^= 1 << dice.randrange(8)
        elif kind < 0.6:
            raw[place] = dice.randrange(256)
        elif kind < 0.8 and len(raw) > 1:
            del raw[place]
        else:
            raw.insert(place + 1, dice.randrange(256))
    return bytes(raw)


def _judge(
    stream: bytes, sent: dict[int, Packet], dice: random.Random, plausible: Plausible | None, report: FuzzReport
) -> None:
    parser, got, position = Parser(plausible, prefer_later=True), [], 0
    try:
        while position < len(stream):
            step = dice.randrange(1, 400)
            got += parser.feed(stream[position : position + step])
            position += step
        got += parser.flush()
    except Exception as error:  # whatever the parser may raise is what is looked for
        report.exceptions += 1
        report.first_exception = report.first_exception or repr(error)
        return
    taken: dict[int, int] = {}
    """Begin and end of each frame that was accepted, one after another in the stream."""
    end = 0
    for packet in got:
        raw = packet.encode()  # with the right checksum
        start = stream.find(raw, end)
        if start < 0:
            report.wrong_checksums += 1
            continue
        end = start + len(raw)
        taken[start] = end
    for start, packet in sent.items():
        end = start + OVERHEAD + len(packet.payload)
        if start in taken:
            report.found += 1
        elif any(other < end and start < other_end for other, other_end in taken.items()):
            report.overlapped += 1
        else:
            report.lost += 1
    report.accidental += len(taken.keys() - sent.keys())


def main() -> int:
    """Runs the fuzzer from the command line; exit status 1 if something was found."""
    arguments = argparse.ArgumentParser(prog="python -m nermo_hw.sbcp.fuzz", description="Fuzz the SBCP parser.")
    arguments.add_argument("--bytes", type=int, default=10_000_000, help="how many at least")
    arguments.add_argument("--seed", type=int, default=0)
    given = arguments.parse_args()
    begin = time.monotonic()
    report = fuzz(given.bytes, given.seed)
    print("\n".join(f"{name}: {value}" for name, value in asdict(report).items()))
    print(f"{'passed' if report.passed else 'FAILED'} in {time.monotonic() - begin:.1f} s")
    return 0 if report.passed else 1


if __name__ == "__main__":
    sys.exit(main())
