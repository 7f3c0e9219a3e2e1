"""Who, of several that look at a page, holds what counts only while it is pressed.

Times are seconds of a clock of this machine that does not stop, unless something else is said.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from nermo_description.silence import OWNER, STICK

FORGET = 1e-4
"""[s/s] by which the shortest way that a message ever took is forgotten: more than two clocks ever drift apart."""


class Lateness:
    """How much longer than the shortest a message was on its way, where only the sender's own clock is known."""

    def __init__(self) -> None:
        self._offset = math.inf
        self._at = 0.0

    def of(self, sent: float, arrived: float) -> float:
        """[s] For a message sent at `sent` of the sender's clock and arrived at `arrived` of ours."""
        offset = arrived - sent
        self._offset = min(offset, self._offset + FORGET * max(arrived - self._at, 0.0))
        self._at = arrived
        return offset - self._offset


@dataclass
class _Viewer:
    lateness: Lateness
    spent: int = 0
    """Presses up to this one count no more: they ended, by the hand, a stop or a refusal."""


class WhoHolds:
    """One at a time: the first viewer to press, until it has been let go for `silence.OWNER` or that page is gone.

    A press counts only while its messages come: after `timeout` without one it is let go, until fresh ones come of a
    hand that still presses. What is later than `timeout` counts as if it had not come. A press that has met a refusal
    or another holder does not count later either.
    """

    def __init__(self, timeout: float = STICK.after) -> None:
        self._timeout = timeout
        self._viewers: dict[int, _Viewer] = {}
        self._holder: int | None = None
        self._press = 0
        """The press that counts; 0: nobody presses."""
        self._heard = -math.inf

    @property
    def viewers(self) -> int:
        """How many look at the page."""
        return len(self._viewers)

    def knows(self, viewer: int) -> bool:
        """Whether somebody looks at the page under this number."""
        return viewer in self._viewers

    def join(self, viewer: int) -> None:
        """Somebody opens the page."""
        self._viewers[viewer] = _Viewer(Lateness())

    def leave(self, viewer: int, now: float) -> None:
        """Somebody closes it, or is not reached any more: what they held is let go, and others may have it."""
        self._viewers.pop(viewer, None)
        if viewer == self._holder:
            self.let_go(now)
            self._holder = None

    def holder(self, now: float) -> int | None:
        """The viewer who holds it, and a moment longer."""
        if self._press and now - self._heard > self._timeout:
            self._press, self._heard = 0, self._heard + self._timeout
        if not self._press and now - self._heard > OWNER.after:
            self._holder = None
        return self._holder

    def holds(self, now: float) -> bool:
        """Whether it is held."""
        self.holder(now)
        return self.pressed

    @property
    def pressed(self) -> bool:
        """Whether it was held when somebody looked last."""
        return self._press != 0

    def beat(self, viewer: int, sent: float, arrived: float) -> None:
        """A sign of life: `sent` [s] by the browser's clock."""
        self._viewers[viewer].lateness.of(sent, arrived)

    def press(self, viewer: int, number: int, sent: float, arrived: float, refusal: str = "") -> str | None:
        """Takes that somebody presses for the `number`-th time, 0: does not; None where it counts, else why not.

        `sent` [s] by the browser's clock. `refusal`: why no press counts now. What nobody need be told is empty.
        """
        seen = self._viewers[viewer]
        late = seen.lateness.of(sent, arrived)
        holder = self.holder(arrived)
        if number == 0:
            if viewer == holder and self._press:
                self.let_go(arrived)
            return ""
        if number <= seen.spent or late > self._timeout:
            return ""
        if holder not in (None, viewer):
            refusal = f"viewer {holder} drives: wait until it has been let go there for {OWNER.after:g} s"
        if refusal:
            seen.spent = number
            return refusal
        self._holder, self._press, self._heard = viewer, number, arrived
        return None

    def let_go(self, at: float) -> None:
        """Ends the press that counts; it counts no more."""
        if self._holder in self._viewers:
            seen = self._viewers[self._holder]
            seen.spent = max(seen.spent, self._press)
        self._press, self._heard = 0, at
