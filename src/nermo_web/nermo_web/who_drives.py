"""Who drives from the page, for how long, and the control command that follows from it.

Times are seconds of a clock of this machine that does not stop, unless something else is said.
"""

from __future__ import annotations

import math
from dataclasses import replace

from nermo_control.driver import Driver
from nermo_control.holding import WhoHolds
from nermo_control.spine.functions import SPINE_FUNCTIONS
from nermo_control.types import ControlCommand, Posture
from nermo_description.silence import STICK
from nermo_web.door import Settings, Stick, Take

HOLD_S = 0.7
"""So long a posture is commanded after its button was pressed, as from the keyboard."""


class WhoDrives:
    """The page's one source of commands, whoever looks at it.

    Whoever holds the stick drives (`WhoHolds`). When it is let go, one command that stops is given and then none. A
    press that has met a stop drives no more.
    """

    def __init__(self, driver: Driver, timeout: float = STICK.after) -> None:
        self.driver = driver
        self._hands = WhoHolds(timeout)
        self._stick = (0.0, 0.0)
        self._driving = False
        self._posture_until = -math.inf

    @property
    def viewers(self) -> int:
        """How many look at the page."""
        return self._hands.viewers

    def join(self, viewer: int) -> None:
        """Somebody opens the page."""
        self._hands.join(viewer)

    def leave(self, viewer: int, now: float) -> None:
        """Somebody closes it, or is not reached any more: if it is who drives, it stops, and others may drive."""
        self._hands.leave(viewer, now)

    def holder(self, now: float) -> int | None:
        """The viewer who drives, and a moment longer."""
        return self._hands.holder(now)

    def beat(self, viewer: int, sent: float, arrived: float) -> None:
        """A sign of life: `sent` [s] by the browser's clock."""
        self._hands.beat(viewer, sent, arrived)

    def stick(self, viewer: int, stick: Stick, arrived: float) -> str:
        """Takes where somebody's stick is; why it does not drive, in words, empty where it does."""
        refusal = "emergency stop: release it before you drive" if self.driver.stopped else ""
        said = self._hands.press(viewer, stick.press, stick.sent * 1e-3, arrived, refusal)
        if said is None:
            self._stick = (stick.forward, stick.turn)
            self._posture_until = -math.inf
        return said or ""

    def stop(self, now: float) -> None:
        """Emergency stop, by whoever looks at the page."""
        self.driver.emergency_stop()
        self._hands.let_go(now)

    def release(self, now: float) -> None:
        """Takes the page's stop back and asks for the servos' power."""
        self.driver.take(Posture.STAND)
        self._posture_until = now + HOLD_S

    def take(self, viewer: int, wanted: Take, now: float) -> str:
        """Takes a posture; why not, in words."""
        if (refusal := self.refusal(viewer, now)) or self.driver.stopped:
            return refusal or "emergency stop: release it first"
        if self._hands.holds(now):
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
        held = self._hands.holds(now)
        if self.driver.stopped:
            self._driving = False
            return self.driver.command(stamp, 0.0, 0.0)
        if held:
            self._driving = True
            return self.driver.command(stamp, *self._stick)
        if self._driving or now < self._posture_until:
            self._driving = False
            return self.driver.command(stamp, 0.0, 0.0)
        return None

    @property
    def ends(self) -> bool:
        """Whether the next command is the one that stops: it does not wait for its turn."""
        return self._driving and not self._hands.pressed
