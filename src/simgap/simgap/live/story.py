"""What is told of a diagnosis while it runs: a list that only grows, for any number of readers."""

from __future__ import annotations

import threading
import time
from typing import Any

from pydantic import ConfigDict, TypeAdapter

STEPS = ("checks", "where", "screen", "leaders", "decision", "free runs", "report")
"""Of a diagnosis, in words for whoever watches it."""
_STEP = {
    "align": "checks",
    "where": "where",
    "nuisances": "where",
    "screen": "screen",
    "compare": "screen",
    **dict.fromkeys(
        (
            "fit",
            "finals",
            "fit partners",
            "screen partners",
            "fit beside untouched",
            "drop",
            "parts",
            "growth",
            "chance",
        ),
        "leaders",
    ),
    "decision": "decision",
    "next experiment": "decision",
    "long windows": "decision",
    "free runs": "free runs",
    "report": "report",
}
"""Of each stage that progress names; any other belongs to the step that it comes in."""
_EVENT = TypeAdapter(dict[str, Any], config=ConfigDict(ser_json_inf_nan="null"))
_FINEST = 0.02
"""Of a stage: smaller progress is not told."""


class Story:
    """Events in order, each the JSON of an object with ``kind``; none is taken back.

    Readers are threads that wait for what they have not read.
    """

    def __init__(self) -> None:
        self._events: list[bytes] = []
        self._changed = threading.Condition()
        self._begun = time.monotonic()
        self._stage, self._share, self._step = "", 0.0, STEPS[0]
        self.ended = False
        """Whether nothing more will be told."""

    def tell(self, kind: str, content: dict[str, Any], last: bool = False) -> None:
        """Add an event; numbers that are none are null. Nothing is added after the last one."""
        event = {"kind": kind, "seconds": time.monotonic() - self._begun, **content}
        text = _EVENT.dump_json(event)
        with self._changed:
            if self.ended:
                return
            self._events.append(text)
            self.ended = last
            self._changed.notify_all()

    def progress(self, stage: str, share: float) -> None:
        """A stage's share of 1, as `simgap.analysis.options.Options.progress` is told it."""
        if stage == self._stage and abs(share - self._share) < _FINEST:
            return
        self._stage, self._share = stage, share
        self._step = _STEP.get(stage, self._step)
        self.tell("progress", {"step": self._step, "stage": stage, "share": share})

    def since(self, number: int, patience: float) -> tuple[list[bytes], bool]:
        """Events from ``number`` on, and whether the last is among them or before.

        Waits for one, at most ``patience`` [s].
        """
        with self._changed:
            self._changed.wait_for(lambda: len(self._events) > number or self.ended, patience)
            return self._events[number:], self.ended
