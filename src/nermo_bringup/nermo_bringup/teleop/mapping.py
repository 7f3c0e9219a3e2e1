"""From gamepad messages to control commands, with a dead-man button."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial

from nermo_bringup.teleop.pads import BUTTONS, Pad
from nermo_control.driver import Driver
from nermo_control.spine.functions import SPINE_FUNCTIONS
from nermo_control.types import ControlCommand, Posture
from nermo_description.silence import STICK


class PadMapping:
    """Turns gamepad messages into commands for as long as the dead-man button is held.

    When it is released, or the messages stop, one command that stops the mouse is given and then none. The emergency
    stop and the freeze work without the dead-man button; an emergency stop is repeated until it is taken back.
    Times are seconds of any clock that does not stop.
    """

    def __init__(self, pad: Pad, driver: Driver, joy_timeout: float = STICK.after) -> None:
        self.driver = driver
        self._pad = pad
        self._timeout = joy_timeout
        self._received = -math.inf
        self._forward = 0.0
        self._turn = 0.0
        self._held = False
        self._driving = False
        self._pressed: dict[str, bool] = {}
        self.fault = ""
        """Why the last message could not be used; empty when it could."""
        self._on_press: dict[str, Callable[[], None]] = {
            "stand": lambda: driver.take(Posture.STAND),
            "sit": lambda: driver.take(Posture.SIT),
            "crouch": lambda: driver.take(Posture.CROUCH),
            "lift_leg": driver.lift_leg,
            "next_gait": driver.next_gait,
            "faster": lambda: driver.change_speed(1),
            "slower": lambda: driver.change_speed(-1),
            "higher_frequency": lambda: driver.change_frequency(1),
            "lower_frequency": lambda: driver.change_frequency(-1),
            "trim_left": lambda: driver.change_trim(1),
            "trim_right": lambda: driver.change_trim(-1),
            **{f"spine_{name}": partial(driver.toggle_spine, name) for name in SPINE_FUNCTIONS},
        }

    def receive(self, now: float, axes: Sequence[float], buttons: Sequence[int]) -> None:
        """Take one joy message. One that does not fit the pad counts as none, and says why in `fault`."""
        pad = self._pad
        self.fault = ""
        if len(axes) < pad.axis_count or len(buttons) < pad.button_count:
            self.fault = (
                f"joy has {len(axes)} axes and {len(buttons)} buttons, "
                f"the pad ({pad.description}) needs {pad.axis_count} and {pad.button_count}"
            )
            return
        if not all(math.isfinite(value) and abs(value) <= 1.0 for value in axes):
            self.fault = f"joy has an axis outside [-1, 1]: {', '.join(f'{value:g}' for value in axes)}"
            return
        pressed = {name: bool(pad.read(name, list(axes), list(buttons))) for name in BUTTONS}
        # A button that is already down in the first message after a silence was not pressed now.
        fresh = now - self._received > self._timeout
        news = {name for name in BUTTONS if pressed[name] and not fresh and not self._pressed.get(name, False)}
        self._received = now
        self._pressed = pressed
        self._forward = float(pad.read("forward", list(axes), list(buttons)))
        self._turn = float(pad.read("turn", list(axes), list(buttons)))
        self._held = pressed["dead_man"]
        if pressed["emergency_stop"]:
            self.driver.emergency_stop()
        if "freeze" in news:
            self.driver.take(Posture.STOP)
            self._driving = True
        if self._held:
            self.driver.straight_line = pressed["straight_line"]
            for name, action in self._on_press.items():
                if name in news:
                    action()

    def command(self, now: float, stamp: int) -> ControlCommand | None:
        """The command to send now, if any; to be asked for at a steady rate. `stamp` in ns of ROS time."""
        driver = self.driver
        if driver.stopped:
            self._driving = False
            return driver.command(stamp, 0.0, 0.0)
        if self._held and now - self._received <= self._timeout:
            self._driving = True
            return driver.command(stamp, self._forward, self._turn)
        if self._driving:
            self._driving = False
            driver.straight_line = False
            return driver.command(stamp, 0.0, 0.0)
        return None
