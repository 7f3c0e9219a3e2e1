"""How long a diagnosis may take: the search ends in time, with the best answer so far and what was not looked at."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

SEARCH = 0.6
"""Share of a budget after which the search ends: intervals, free runs and the report are still to come."""
_STAGES = {
    "nuisances": "nominal numbers were not fitted to the end",
    "screen": "not every effect was screened",
    "fit": "effects were screened, not all of the promising ones were fitted",
    "finals": "leading effects were fitted roughly, not to the end",
    "chance": "links that are late or lose by chance were not looked at to the end",
    "growth": "whether what was found grows over the recording was not looked at",
}
_LATER = "no further effect beside the first was looked for to the end"


class OutOfTimeError(Exception):
    """The search has used its share of the budget."""


@dataclass
class Budget:
    """Seconds that a diagnosis may take, from ``started`` (`time.monotonic`) on; no limit where None.

    Attributes:
        left_out: what was not looked at for want of time, in words.
    """

    seconds: float | None = None
    started: float = field(default_factory=time.monotonic)
    left_out: list[str] = field(default_factory=list)

    def spent(self, share: float = 1.0) -> bool:
        """Whether a share of the budget is used up."""
        return self.seconds is not None and time.monotonic() - self.started > share * self.seconds

    def watch(self, progress: Callable[[str, float], None] | None) -> Callable[[str, float], None]:
        """A report of progress that raises `OutOfTimeError` where the search has to end."""

        def tell(stage: str, share: float) -> None:
            if progress:
                progress(stage, share)
            if self.spent(SEARCH) and stage != "nuisances":
                raise OutOfTimeError(stage)

        return tell

    def ended(self, stage: str) -> None:
        """Note that the search ended in a stage."""
        self.left_out.append(_STAGES.get(stage, _LATER))

    def warning(self) -> str:
        """What was not looked at, in a sentence; empty where all was."""
        if not self.left_out:
            return ""
        return f"the budget of {self.seconds:g} s was spent: {'; '.join(self.left_out)}"
