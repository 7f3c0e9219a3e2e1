"""Measurement of the page in the browser: what it costs its node and the control loop, by how many look."""

from __future__ import annotations

import contextlib
import socket
import time
import urllib.request
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import psutil

from nermo_bringup.web_bench.viewer import watched
from nermo_description.results import CommandError
from nermo_interfaces.msg import ServoCommand, ServoStates
from nermo_node.time import to_nanoseconds
from nermo_sim.nodes.bench_graph import NODES, PATIENCE, Probe, Processes, started

PAGE = {"web": "nermo_web.nodes.web"}
SETTLING_S = 3.0
"""After viewers came: the scene as they find it is sent once, which is not what a second costs."""

MOST_UNANSWERED = 1000
"""Ticks that are remembered: those of 5 s. An answer that takes longer is none."""


@dataclass(frozen=True)
class Row:
    """What was measured with so many viewers."""

    viewers: int | None
    """None: without a page."""
    web_percent: float | None
    """Processor time of the node `web`, of one core."""
    web_mb: tuple[float, float] | None
    """Its memory when the time began and when it ended."""
    kb_s: float | None
    """What came to each viewer."""
    age_ms: dict[str, float]
    """p50, p99 and max of the time from `servo_states` to the `servo_command` with the same stamp, as heard here."""
    rate_hz: float
    """Servo commands."""


def bench_web(
    robot: str, viewers: Sequence[int], duration: float, say: Callable[[str], None] = lambda _: None
) -> list[Row]:
    """Walks the graph without the page, then with it before so many viewers, each for a time [s]; and measures.

    Raises:
        CommandError: the graph or the page does not come up, or a viewer is gone before the end.
    """
    with started(robot, NODES) as processes, contextlib.closing(_AgeProbe()) as probe:
        say("without a page")
        probe.walk(processes)
        rows = [_measured(probe, duration, None, None, 0)]
    port = _free_port()
    with (
        started(robot, NODES | PAGE, {"web": [f"port:={port}", f"robot:={robot}"]}) as processes,
        contextlib.closing(_AgeProbe()) as probe,
    ):
        probe.walk(processes)
        _wait_for_page(probe, port, processes)
        meter = psutil.Process(processes["web"].pid)
        for count in viewers:
            say(f"{count} viewer{'s' * (count != 1)}")
            rows.append(_measured(probe, duration, port, meter, count))
    return rows


class _AgeProbe(Probe):
    """Walks the mouse and takes the age of its commands."""

    def __init__(self) -> None:
        self._heard: dict[int, int] = {}
        self.ages: list[int] = []
        """[ns]"""
        super().__init__()
        self.hear(ServoStates, "servo_states", self._on_states)
        self.hear(ServoCommand, "servo_command", self._on_command)

    def clear(self) -> None:
        """Forgets what was measured."""
        super().clear()
        self.ages = []

    def _on_states(self, message: ServoStates) -> None:
        self._heard[to_nanoseconds(message.header.stamp)] = time.monotonic_ns()
        if len(self._heard) > MOST_UNANSWERED:
            del self._heard[next(iter(self._heard))]

    def _on_command(self, message: ServoCommand) -> None:
        if (heard := self._heard.pop(to_nanoseconds(message.header.stamp), None)) is not None:
            self.ages.append(time.monotonic_ns() - heard)


def _measured(probe: _AgeProbe, duration: float, port: int | None, meter: psutil.Process | None, count: int) -> Row:
    with watched(port or 0, count) as viewers:
        probe.spin(PATIENCE, until=lambda: all(v.received > 0 or not v.watches for v in viewers))
        probe.spin(SETTLING_S)
        probe.clear()
        before, memory = [v.received for v in viewers], _megabytes(meter)
        if meter is not None:
            meter.cpu_percent()
        begin = time.monotonic()
        probe.spin(duration)
        wall = time.monotonic() - begin
        percent = None if meter is None else meter.cpu_percent()
        received = [v.received - b for v, b in zip(viewers, before, strict=True)]
        if any(not v.watches for v in viewers) or (viewers and min(received) == 0):
            raise CommandError("a viewer is gone, or nothing comes to it: what was measured counts for nothing")
    if not probe.ages:
        raise CommandError("no servo_command was heard: nothing to measure")
    p50, p99, most = np.percentile(np.array(probe.ages) * 1e-6, [50.0, 99.0, 100.0])
    after = _megabytes(meter)
    return Row(
        None if meter is None else count,
        percent,
        None if memory is None or after is None else (memory, after),
        1e-3 * float(np.mean(received)) / wall if received else None,
        {"p50": float(p50), "p99": float(p99), "max": float(most)},
        len(probe.answers) / wall,
    )


def _megabytes(meter: psutil.Process | None) -> float | None:
    return None if meter is None else meter.memory_info().rss * 1e-6


def _free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as free:
        return int(free.getsockname()[1])


def _wait_for_page(probe: Probe, port: int, processes: Processes) -> None:
    opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
    deadline = time.monotonic() + PATIENCE
    while True:
        try:
            with opener.open(f"http://127.0.0.1:{port}/", timeout=1.0):
                return
        except OSError:
            if processes["web"].poll() is not None or time.monotonic() > deadline:
                raise CommandError("the page does not come up: `nermo up --web` says why") from None
        probe.spin(0.5)
