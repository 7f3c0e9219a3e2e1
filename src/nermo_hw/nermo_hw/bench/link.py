"""`nermo bench link`: what a bad network does to commands on their way to the servos."""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nermo_hw.bench.rig import Rig
from nermo_hw.bench.walker import COUNT, FIRST, STEP, coded

RATE = 200.0
"""Commands [Hz]."""
OLDEST_MS = 250.0
"""What is executed later than this after it was sent is stale: the robot's end takes commands of up to 200 ms, then
come a control tick and the exchange with the device."""
SAME = 3e-4
"""Two positions that differ by less [rad] are one: boards take steps of 1e-4."""


@dataclass(frozen=True, slots=True)
class Row:
    """One network."""

    delay_ms: float = 0.0
    jitter_ms: float = 0.0
    loss: float = 0.0
    reorder: bool = False


ROWS = (
    Row(),
    Row(delay_ms=20.0, jitter_ms=10.0),
    Row(delay_ms=20.0, jitter_ms=10.0, reorder=True),
    Row(delay_ms=20.0, loss=0.05),
    Row(delay_ms=20.0, loss=0.30),
)


def bench_link(
    robot: str = "nermo_lite",
    transport: str = "quic",
    count: int = COUNT,
    rows: tuple[Row, ...] = ROWS,
    progress: Callable[[str], None] = lambda _: None,
) -> list[dict[str, Any]]:
    """Sends `count` commands at 200 Hz over each network, through robot's end and serial line, into the device.

    Latency is from the call that sends a command to the packet in which the device takes it; the wait for the robot's
    next control tick (5 ms) is part of it. `delivered` is the share that reached the robot's end; `executed` the share
    that the device took, where of two that came in one tick only the newer is.

    Raises NoNamespacesError, CommandError.
    """
    with tempfile.TemporaryDirectory(prefix="nermo_bench_link_") as folder, Rig(Path(folder), robot, transport) as rig:
        results = []
        for row in rows:
            progress(f"{row.delay_ms:g} +- {row.jitter_ms:g} ms, loss {row.loss:.0%}{', reordered' * row.reorder}")
            results.append(measure(rig, row, count))
        return results


def measure(rig: Rig, row: Row, count: int, oldest_ms: float = OLDEST_MS) -> dict[str, Any]:
    """One row over a path that is up."""
    rig.impair()
    rig.walker("walk", on=True)
    rig.release()
    rig.walker("walk", on=False)
    received = rig.received()
    received += rig.walker("prepare", rate=RATE)
    rig.impair(delay=row.delay_ms * 1e-3, jitter=row.jitter_ms * 1e-3, loss=row.loss, reorder=row.reorder)
    rig.points()
    begin = time.monotonic()
    cpu = {name: rig.network.do("cpu", name=name) for name in ("robot_end", "walker")}
    sent = np.array(rig.walker("send", count=count, rate=RATE))
    wall = time.monotonic() - begin
    cpu = {name: (rig.network.do("cpu", name=name) - before) / wall * 100.0 for name, before in cpu.items()}
    time.sleep(0.5)  # what is still on its way
    judged = _judge(rig, sent, oldest_ms)
    rig.impair()
    received = rig.received() - received
    return {
        "delay_ms": row.delay_ms,
        "jitter_ms": row.jitter_ms,
        "loss": row.loss,
        "reorder": row.reorder,
        **judged,
        "delivered": received / len(sent),
        "cpu_percent": cpu,
    }


def _judge(rig: Rig, sent: np.ndarray, oldest_ms: float) -> dict[str, Any]:
    """Latency and staleness of what the device executed, by the number in the positions of three servos."""
    names = list(rig.robot.servos)
    places = [names.index(servo) for servo in coded(0)]
    latencies, stale, newest = [], 0, -1
    for at, targets in rig.points():
        told = targets[places]
        number = round((told[0] - FIRST) / STEP) if np.isfinite(told).all() else -1
        if not 0 <= number < len(sent) or number == newest or sent[number] == 0:
            continue
        if np.abs(told - list(coded(number).values())).max() > SAME:
            continue  # the way to somewhere
        age_ms = (at - sent[number]) * 1e-6
        stale += number < newest or age_ms > oldest_ms
        newest = max(newest, number)
        latencies.append(age_ms)
    p50, p99, largest = np.percentile(latencies, [50.0, 99.0, 100.0]) if latencies else (math.nan,) * 3
    return {
        "latency_ms": {"p50": float(p50), "p99": float(p99), "max": float(largest)},
        "executed": len(latencies) / len(sent),
        "stale_executed": int(stale),
    }
