"""`nermo bench firmware`: what the PWM board's firmware stands, how fast it is, and when it lets go."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from nermo_description.silence import HOLD, WATCHDOG
from nermo_hw.bench.serial import exchange_in_real_time
from nermo_hw.firmware.build import FirmwareError, host_program
from nermo_hw.firmware.process import Firmware
from nermo_hw.sbcp.boards import ACKNOWLEDGE, BITS_PER_BYTE, POINT
from nermo_hw.sbcp.packet import OVERHEAD, Instruction, Packet
from nermo_hw.sbcp.pwm_board import (
    ADDRESS,
    ANSWER_SIZE,
    BAUD,
    CHANNELS,
    LOOP_PERIOD,
    POWER,
    REQUEST_SIZE,
    ROBOT,
    Request,
    State,
)

RATE = 200.0
"""Of the control ticks [Hz], each of which is an exchange."""
LONGEST_RUN = 3600.0
"""[s]"""

Say = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Silence:
    """A state that silence leads to: when it must be taken, and when it was [us after the last good frame]."""

    state: State
    expected: int
    earliest: int
    latest: int

    @property
    def in_time(self) -> bool:
        """Whether never before its time, and never later than the loop of the firmware after it."""
        return self.expected <= self.earliest and self.latest <= self.expected + round(LOOP_PERIOD * 1e6)


def bench_firmware(
    fuzzed_bytes: int = 10_000_000,
    seed: int = 0,
    trials: int = 200,
    exchanges: int = 1_000_000,
    real_time: float = 10.0,
    say: Say = lambda _: None,
) -> dict[str, Any]:
    """Everything that is measured of it.

    real_time: how long to exchange with the driver on a pseudo-terminal [s].

    Raises FirmwareError where it cannot be built, CommandError where the emulator does not come up.
    """
    say("building the firmware for this machine")
    sanitized = host_program("fuzz", sanitized=True)
    say(f"fuzzing with {fuzzed_bytes} bytes")
    begin = time.monotonic()
    fuzz = _run(str(sanitized), str(fuzzed_bytes), str(seed))
    fuzz["seconds"] = round(time.monotonic() - begin, 2)
    say(f"{trials} silences in virtual time")
    silences = silence_times(trials, seed)
    say(f"{exchanges} exchanges as fast as they go")
    rate = _run(str(host_program("rate")), str(exchanges))
    say(f"{real_time:g} s of exchanges in real time")
    real = exchange_in_real_time(ROBOT, real_time, bus="pwm_board", rate=RATE)
    return {
        "fuzz": fuzz,
        "silences": [
            {
                "state": row.state.name,
                "expected_ms": row.expected / 1e3,
                "earliest_ms": row.earliest / 1e3,
                "latest_ms": row.latest / 1e3,
                "in_time": row.in_time,
            }
            for row in silences
        ],
        "trials": trials,
        "line": line_facts(),
        "real_time": real,
        "exchanges_a_second_on_this_machine": 1e9 / rate["nanoseconds_each"],
        "passed": bool(fuzz["passed"]) and all(row.in_time for row in silences),
    }


def silence_times(trials: int, seed: int = 0) -> list[Silence]:
    """Drives a board, falls silent at a random moment of its loop, and looks every 0.1 ms, in virtual time."""
    dice = np.random.default_rng(seed)
    seen: dict[State, list[int]] = {State.HOLDING: [], State.FAULT: []}
    firmware, now = Firmware(), 0
    try:
        for _ in range(trials):
            now += int(dice.integers(1, 5000))
            session = firmware.power_up(int(dice.integers(0x10000)), now).session
            for sequence in range(1, int(dice.integers(2, 100))):
                now += 5000
                flags = POWER | POINT | ACKNOWLEDGE
                request = Request(session, sequence, flags, 1.0 / RATE, (0.0,) * CHANNELS)
                firmware.receive(Packet(*ADDRESS, Instruction.EXCHANGE, request.encode()).encode(), now)
            last, left = now, set(seen)
            while left:
                now += 100
                state = firmware.receive(b"", now).state
                if state in left:
                    left.discard(state)
                    seen[state].append(now - last)
    finally:
        firmware.close()
    due = {State.HOLDING: round(HOLD.after * 1e6), State.FAULT: round(WATCHDOG.after * 1e6)}
    return [Silence(state, due[state], min(times), max(times)) for state, times in seen.items()]


def line_facts() -> dict[str, float]:
    """What an exchange takes of its line."""
    request, answer = (OVERHEAD + size for size in (REQUEST_SIZE, ANSWER_SIZE))
    busy = (request + answer) * BITS_PER_BYTE / BAUD
    return {
        "baud_bit_s": float(BAUD),
        "request_bytes": float(request),
        "answer_bytes": float(answer),
        "exchange_ms": busy * 1e3,
        "largest_rate_hz": 1.0 / busy,
        f"minimum_baud_at_{RATE:g}_hz_bit_s": (request + answer) * BITS_PER_BYTE * RATE,
        "bytes_in_a_loop_of_the_firmware": BAUD / BITS_PER_BYTE * LOOP_PERIOD,
    }


def _run(*command: str) -> dict[str, Any]:
    """What a program prints as `name value`, and whether it has passed."""
    run = subprocess.run(command, capture_output=True, text=True, timeout=LONGEST_RUN)
    if run.returncode not in (0, 1) or run.stderr:
        raise FirmwareError(f"the firmware has ended: {run.stderr.strip()[:4000] or run.returncode}")
    found: dict[str, Any] = {name: int(value) for name, value in (line.split() for line in run.stdout.splitlines())}
    return {**found, "passed": run.returncode == 0}
