"""Reading gamepads through SDL, with the numbers that ROS's own joy package publishes.

A pad in SDL's mapping database comes in the layout of `game_controller_node` (6 axes, 21 buttons, the same places for
every pad); any other comes as `joy_node` gives it (axes, then two for each hat; buttons as the driver counts them).
Up and left are positive, the deadzone is taken out smoothly.
"""

from __future__ import annotations

import os
import warnings
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self

# SDL wants a video driver to read events; a pad needs none.
os.environ.setdefault("SDL_VIDEODRIVER", "dummy")

with warnings.catch_warnings():  # it says which SDL it has found, to everybody, every time
    warnings.simplefilter("ignore")
    import sdl2

FULL_SCALE = 32767


class JoystickError(RuntimeError):
    """SDL cannot read gamepads on this machine."""


@dataclass(frozen=True, slots=True)
class JoyState:
    """One reading of a pad: axes in [-1, 1], buttons 0 or 1."""

    axes: tuple[float, ...]
    buttons: tuple[int, ...]


class PadReader:
    """Reads the first pad there is, or the first of a given name; pads may come and go."""

    def __init__(self, name: str = "", deadzone: float = 0.05) -> None:
        """Start SDL's gamepad part.

        Raises:
            JoystickError: SDL cannot be started.
        """
        self._wanted = name
        self._deadzone = deadzone
        self._controller: Any = None
        self._joystick: Any = None
        for hint in (sdl2.SDL_HINT_JOYSTICK_ALLOW_BACKGROUND_EVENTS, sdl2.SDL_HINT_NO_SIGNAL_HANDLERS):
            sdl2.SDL_SetHint(hint, b"1")
        if sdl2.SDL_Init(sdl2.SDL_INIT_GAMECONTROLLER | sdl2.SDL_INIT_JOYSTICK) < 0:
            raise JoystickError(f"SDL cannot read gamepads: {_error()}")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def name(self) -> str:
        """Name of the open pad; empty while there is none."""
        return (sdl2.SDL_JoystickName(self._joystick) or b"?").decode() if self._joystick else ""

    @property
    def names(self) -> list[str]:
        """Names of all pads that are plugged in."""
        return [(sdl2.SDL_JoystickNameForIndex(i) or b"?").decode() for i in range(sdl2.SDL_NumJoysticks())]

    def read(self) -> JoyState | None:
        """The pad's state now; None while there is no pad."""
        sdl2.SDL_JoystickUpdate()
        # Only states are used; the queue of events must not fill up.
        sdl2.SDL_FlushEvents(sdl2.SDL_FIRSTEVENT, sdl2.SDL_LASTEVENT)
        if self._joystick and not sdl2.SDL_JoystickGetAttached(self._joystick):
            self._release()
        if not self._joystick:
            self._open()
        if not self._joystick:
            return None
        return self._mapped() if self._controller else self._unmapped()

    def close(self) -> None:
        """Let the pad and SDL's gamepad part go."""
        self._release()
        sdl2.SDL_QuitSubSystem(sdl2.SDL_INIT_GAMECONTROLLER | sdl2.SDL_INIT_JOYSTICK)

    def _open(self) -> None:
        for index, name in enumerate(self.names):
            if self._wanted not in ("", name):
                continue
            if sdl2.SDL_IsGameController(index):
                self._controller = sdl2.SDL_GameControllerOpen(index)
            self._joystick = (
                sdl2.SDL_GameControllerGetJoystick(self._controller)
                if self._controller
                else sdl2.SDL_JoystickOpen(index)
            )
            if self._joystick:
                return

    def _release(self) -> None:
        if self._controller:
            sdl2.SDL_GameControllerClose(self._controller)
        elif self._joystick:
            sdl2.SDL_JoystickClose(self._joystick)
        self._controller = self._joystick = None

    def _mapped(self) -> JoyState:
        return JoyState(
            tuple(
                self._axis(sdl2.SDL_GameControllerGetAxis(self._controller, axis))
                for axis in range(sdl2.SDL_CONTROLLER_AXIS_MAX)
            ),
            tuple(
                sdl2.SDL_GameControllerGetButton(self._controller, button)
                for button in range(sdl2.SDL_CONTROLLER_BUTTON_MAX)
            ),
        )

    def _unmapped(self) -> JoyState:
        axes = [
            self._axis(sdl2.SDL_JoystickGetAxis(self._joystick, axis))
            for axis in range(sdl2.SDL_JoystickNumAxes(self._joystick))
        ]
        for hat in range(sdl2.SDL_JoystickNumHats(self._joystick)):
            state = sdl2.SDL_JoystickGetHat(self._joystick, hat)
            axes.append(float(bool(state & sdl2.SDL_HAT_LEFT)) - float(bool(state & sdl2.SDL_HAT_RIGHT)))
            axes.append(float(bool(state & sdl2.SDL_HAT_UP)) - float(bool(state & sdl2.SDL_HAT_DOWN)))
        buttons = (
            sdl2.SDL_JoystickGetButton(self._joystick, button)
            for button in range(sdl2.SDL_JoystickNumButtons(self._joystick))
        )
        return JoyState(tuple(axes), tuple(buttons))

    def _axis(self, raw: int) -> float:
        """SDL's axis value (-32768 to 32767, down and right positive) as ROS has it."""
        return scale_axis(raw, self._deadzone)


def scale_axis(raw: int, deadzone: float) -> float:
    """SDL's axis value as ROS's joy package scales it: in [-1, 1], 0 inside the deadzone, no jump at its edge.

    Args:
        raw: -32768 to 32767, positive down and right.
        deadzone: share of the full scale, [0, 1).
    """
    value = max(raw, -FULL_SCALE) / FULL_SCALE
    excess = max(abs(value) - deadzone, 0.0) / (1.0 - deadzone)
    return 0.0 - excess if value > 0.0 else excess


def _error() -> str:
    return sdl2.SDL_GetError().decode() or "unknown error"
