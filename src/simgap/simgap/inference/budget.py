"""How long a diagnosis may take: the search ends in time, with the best answer so far and what was not looked at."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

NUISANCES, SEARCH, PROPOSAL, LONG_WINDOWS, ALL = 0.3, 0.6, 0.75, 0.85, 1.0
"""Shares of a budget after which nominal numbers are taken as far as they are fitted, and the search, that for the next
experiment, and the fit in long windows end. What is left is for whole runs."""
LEAST = 0.05
"""Share of a budget that whole runs get in any case."""
_STAGES = {
    "nuisances": "nominal numbers were not fitted to the end",
    "screen": "not every effect was screened",
    "fit": "effects were screened, not all of the promising ones were fitted",
    "finals": "leading effects were fitted roughly, not to the end",
    "chance": "links that are late or lose by chance were not looked at to the end",
    "parts": "whether parts of what was found have values of their own was not looked at",
    "growth": "whether what was found grows over the recording was not looked at",
    "next experiment": "no next experiment was looked for to the end",
    "long windows": "numbers were not fitted again in long windows",
    "all long windows": "in long windows, numbers were fitted again in a part of them",
    "wider priors": "in long windows, numbers were not fitted again by every prior",
}
_LATER = "no further effect beside the first was looked for to the end"


class OutOfTimeError(Exception):
    """The search has used its share of the budget."""


@dataclass
class Hurry:
    """Whether somebody wants the best answer so far, now; may be set at any time, by a handler of signals too."""

    wanted: bool = False


@dataclass
class Budget:
    """Seconds that a diagnosis may take, from ``started`` (`time.monotonic`) on; no limit where None.

    Attributes:
        left_out: what was not looked at for want of time, in words.
        asked: what somebody asked for, where a part of it was spent before.
        hurry: wanted, it is as if all of it were spent.
    """

    seconds: float | None = None
    started: float = field(default_factory=time.monotonic)
    left_out: list[str] = field(default_factory=list)
    asked: float | None = None
    hurry: Hurry = field(default_factory=Hurry)
    _stage: str = "nuisances"
    _ends: float | None = None

    def spent(self, share: float = ALL) -> bool:
        """Whether a share of the budget is used up."""
        over = self.seconds is not None and time.monotonic() - self.started > share * self.seconds
        return over or self.hurry.wanted

    @property
    def limited(self) -> bool:
        """Whether it ends at some time, whatever is left to do."""
        return self.seconds is not None or self.hurry.wanted

    def remaining(self) -> float | None:
        """[s] that are left for the last stage, at least LEAST; None without a limit."""
        used = time.monotonic() - self.started
        if self.hurry.wanted:
            return LEAST * used
        return None if self.seconds is None else max(self.seconds - used, LEAST * self.seconds)

    def rest(self) -> Budget:
        """What is left, to be shared out anew."""
        return Budget(self.remaining(), time.monotonic(), asked=self.asked or self.seconds, hurry=self.hurry)

    @contextmanager
    def until(self, share: float) -> Iterator[None]:
        """In here `check` raises once a share of the budget is used up; what is done by then has to be kept outside."""
        self._ends = share
        try:
            yield
        finally:
            self._ends = None

    def check(self) -> None:
        """Called before each replay, so that no stage goes on long after its end.

        Raises:
            OutOfTimeError: the time of `until` is over. It names the stage.
        """
        if self._ends is not None and self._stage != "nuisances" and self.spent(self._ends):
            raise OutOfTimeError(self._stage)

    def watch(self, progress: Callable[[str, float], None] | None) -> Callable[[str, float], None]:
        """A report of progress that raises `OutOfTimeError` where the time of `until` is over."""

        def tell(stage: str, share: float) -> None:
            self._stage = stage
            if progress:
                progress(stage, share)
            self.check()

        return tell

    def ended(self, stage: str) -> None:
        """Note that the search ended in a stage."""
        self.left_out.append(_STAGES.get(stage, _LATER))

    def warning(self) -> str:
        """What was not looked at, in a sentence; empty where all was."""
        if not self.left_out:
            return ""
        until = "ended by hand:" if self.hurry.wanted else f"within the budget of {self.asked or self.seconds:g} s"
        return f"{until} {'; '.join(self.left_out)}"
