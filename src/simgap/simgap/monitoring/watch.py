"""A file followed while another process writes it, with what the monitor says of it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

from simgap.data.growing import Growing
from simgap.monitoring.monitor import KEPT, SPAN, Change, Monitor

_PAUSE = 0.25
"""[s] between two looks at the file: what a window takes."""


def watch(
    source: Growing,
    monitor: Monitor,
    idle: float,
    clock: Callable[[], float] = time.monotonic,
    pause: Callable[[float], None] = time.sleep,
) -> Iterator[list[Change]]:
    """What has changed, after every look at a file, until nothing has been written to it for ``idle`` seconds.

    Raises:
        GapInputError: what was written cannot be used, or contradicts the map.
    """
    written = clock()
    while True:
        columns = source.read(KEPT)
        if columns is not None:
            written = clock()
            yield monitor.update(columns)
        elif clock() - written >= idle:
            return
        else:
            pause(_PAUSE)
            yield []


def line(monitor: Monitor) -> str:
    """How it stands, in one line."""
    if monitor.waits:
        return f"{monitor.time:.1f} s: {monitor.waits}"
    usual, gap = monitor.usual, monitor.gap
    told = [f"{name} {gap[name]:.1f}" + (f" ({usual[name]:.1f})" if name in usual else "") for name in gap]
    learning = "" if monitor.learned == 1.0 else f"; learning what is usual, {100 * monitor.learned:.0f} %"
    return f"{monitor.time:.1f} s: " + "  ".join(told) + learning


def report(monitor: Monitor, changes: list[Change]) -> dict[str, Any]:
    """As JSON."""
    return {
        "schema": "simgap/monitor/1",
        "watched_until_s": monitor.time,
        "span_s": SPAN,
        "stale": monitor.stale,
        "changes": [dict(vars(change)) for change in changes],
        "gap": monitor.gap,
        "usual": monitor.usual,
        "learned": monitor.learned,
    }
