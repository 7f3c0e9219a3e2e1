"""Who drives from the page, for how long, and the control command that follows from it.

Times are seconds of a clock of this machine that does not stop, unless something else is said.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from nermo_control.driver import Driver
from nermo_control.spine.functions import SPINE_FUNCTIONS
from nermo_control.types import ControlCommand, Posture
from nermo_description.silence import OWNER, STICK
from nermo_web.door import Settings, Stick, Take

HOLD_S = 0.7
"""So long a posture is commanded after its button was pressed, as from the keyboard."""
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
    """Presses up to this one drive no more: they ended, by the hand, a stop or a refusal."""


class WhoDrives:
    """The page's one source of commands, whoever looks at it.

    The first viewer to press the stick drives until it has been let go for `silence.OWNER`. The stick counts only while
    its messages come: after `timeout` without one, one command that stops is given and then none, until fresh ones come
    of a hand that still presses. What is later than `timeout` counts as if it had not come. A press that has met a stop
    or another driver drives no more.
    """

    def __init__(self, driver: Driver, timeout: float = STICK.after) -> None:
        self.driver = driver
        self._timeout = timeout
        self._viewers: dict[int, _Viewer] = {}
        self._holder: int | None = None
        self._press = 0
        """The press that drives; 0: the stick is let go."""
        self._heard = -math.inf
        self._stick = (0.0, 0.0)
        self._driving = False
        self._posture_until = -math.inf

    @property
    def viewers(self) -> int:
        """How many look at the page."""
        return len(self._viewers)

    def join(self, viewer: int) -> None:
        """Somebody opens the page."""
        self._viewers[viewer] = _Viewer(Lateness())

    def leave(self, viewer: int, now: float) -> None:
        """Somebody closes it, or is not reached any more: if it is who drives, it stops, and others may drive."""
        self._viewers.pop(viewer, None)
        if viewer == self._holder:
            self._let_go(now)
            self._holder = None

    def holder(self, now: float) -> int | None:
        """The viewer who drives, and a moment longer."""
        if self._press and now - self._heard > self._timeout:
            self._press, self._heard = 0, self._heard + self._timeout
        if not self._press and now - self._heard > OWNER.after:
            self._holder = None
        return self._holder

    def beat(self, viewer: int, sent: float, arrived: float) -> None:
        """A sign of life: `sent` [s] by the browser's clock."""
        self._viewers[viewer].lateness.of(sent, arrived)

    def stick(self, viewer: int, stick: Stick, arrived: float) -> str:
        """Takes where somebody's stick is; why it does not drive, in words, empty where it does."""
        seen = self._viewers[viewer]
        late = seen.lateness.of(stick.sent * 1e-3, arrived)
        holder = self.holder(arrived)
        if stick.press == 0:
            if viewer == holder and self._press:
                self._let_go(arrived)
            return ""
        if stick.press <= seen.spent or late > self._timeout:
            return ""
        if holder not in (None, viewer):
            seen.spent = stick.press
            return f"viewer {holder} drives: wait until the stick there has been let go for {OWNER.after:g} s"
        if self.driver.stopped:
            seen.spent = stick.press
            return "emergency stop: release it before you drive"
        self._holder, self._press, self._heard = viewer, stick.press, arrived
        self._stick = (stick.forward, stick.turn)
        self._posture_until = -math.inf
        return ""

    def stop(self, now: float) -> None:
        """Emergency stop, by whoever looks at the page."""
        self.driver.emergency_stop()
        self._let_go(now)

    def release(self, now: float) -> None:
        """Takes the page's stop back and asks for the servos' power."""
        self.driver.take(Posture.STAND)
        self._posture_until = now + HOLD_S

    def take(self, viewer: int, wanted: Take, now: float) -> str:
        """Takes a posture; why not, in words."""
        if (refusal := self.refusal(viewer, now)) or self.driver.stopped:
            return refusal or "emergency stop: release it first"
        if self._press:
            return "let the stick go first"
        self.driver.take(Posture[wanted.posture.upper()])
        self._posture_until = now + HOLD_S
        return ""

    def change(self, viewer: int, wanted: Settings, now: float) -> str:
        """Changes what commands say beside the stick; why not, in words."""
        driver = self.driver
        if refusal := self.refusal(viewer, now):
            return refusal
        if wanted.gait is not None and wanted.gait not in driver.gaits:
            return f"there is no gait {wanted.gait!r}: the knowledge-base has {', '.join(driver.gaits) or 'none yet'}"
        if unknown := [name for name in wanted.spine if name not in SPINE_FUNCTIONS]:
            return f"there is no spine function {unknown[0]!r}: there are {', '.join(SPINE_FUNCTIONS)}"
        driver.gait = driver.gait if wanted.gait is None else wanted.gait
        driver.gait_frequency = driver.gait_frequency if wanted.frequency is None else wanted.frequency
        driver.speed = driver.speed if wanted.speed is None else wanted.speed
        driver.straight_line = driver.straight_line if wanted.straight_line is None else wanted.straight_line
        driver.spine_modes = replace(driver.spine_modes, **wanted.spine)
        return ""

    def refusal(self, viewer: int, now: float) -> str:
        """Why a viewer may change nothing now; empty where it may."""
        holder = self.holder(now)
        return "" if holder in (None, viewer) else f"viewer {holder} drives: only there things are changed meanwhile"

    def command(self, now: float, stamp: int) -> ControlCommand | None:
        """The command to send now, if any; to be asked for at a steady rate. `stamp` in ns of ROS time."""
        self.holder(now)
        if self.driver.stopped:
            self._driving = False
            return self.driver.command(stamp, 0.0, 0.0)
        if self._press:
            self._driving = True
            return self.driver.command(stamp, *self._stick)
        if self._driving or now < self._posture_until:
            self._driving = False
            return self.driver.command(stamp, 0.0, 0.0)
        return None

    @property
    def ends(self) -> bool:
        """Whether the next command is the one that stops: it does not wait for its turn."""
        return self._driving and not self._press

    def _let_go(self, at: float) -> None:
        if self._holder in self._viewers:
            seen = self._viewers[self._holder]
            seen.spent = max(seen.spent, self._press)
        self._press, self._heard, self._stick = 0, at, (0.0, 0.0)
