"""The pad reader on a virtual pad of SDL."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import sdl2
from hypothesis import given
from hypothesis import strategies as st

from nermo_bringup.teleop.joystick import PadReader, scale_axis


@pytest.fixture
def reader() -> Iterator[PadReader]:
    with PadReader() as made:
        yield made


def plug_in(kind: int, axes: int, buttons: int, hats: int = 0) -> tuple[int, object]:
    index = sdl2.SDL_JoystickAttachVirtual(kind, axes, buttons, hats)
    assert index >= 0
    return index, sdl2.SDL_JoystickOpen(index)


def test_a_pad_that_sdl_knows_has_the_layout_of_game_controller_node(reader: PadReader) -> None:
    assert reader.read() is None
    index, pad = plug_in(sdl2.SDL_JOYSTICK_TYPE_GAMECONTROLLER, 6, 15)
    state = reader.read()
    assert state is not None
    assert (len(state.axes), len(state.buttons)) == (6, 21)
    assert reader.name == "Virtual Controller"
    sdl2.SDL_JoystickSetVirtualAxis(pad, 1, -32768)
    sdl2.SDL_JoystickSetVirtualAxis(pad, 2, 32767)
    sdl2.SDL_JoystickSetVirtualButton(pad, 9, 1)
    state = reader.read()
    assert state.axes[1] == pytest.approx(1.0)
    assert state.axes[2] == pytest.approx(-1.0)
    assert [place for place, pressed in enumerate(state.buttons) if pressed] == [
        sdl2.SDL_CONTROLLER_BUTTON_LEFTSHOULDER
    ]
    sdl2.SDL_JoystickDetachVirtual(index)


def test_a_pad_can_be_pulled_and_plugged_in_again(reader: PadReader) -> None:
    index, _ = plug_in(sdl2.SDL_JOYSTICK_TYPE_GAMECONTROLLER, 6, 15)
    assert reader.read() is not None
    sdl2.SDL_JoystickDetachVirtual(index)
    assert reader.read() is None
    assert reader.name == ""
    index, _ = plug_in(sdl2.SDL_JOYSTICK_TYPE_GAMECONTROLLER, 6, 15)
    assert reader.read() is not None
    sdl2.SDL_JoystickDetachVirtual(index)


def test_an_unknown_pad_has_the_layout_of_joy_node(reader: PadReader) -> None:
    index, pad = plug_in(sdl2.SDL_JOYSTICK_TYPE_UNKNOWN, 3, 4, 1)
    if sdl2.SDL_IsGameController(index):
        pytest.fail("SDL knows a pad of unknown type")
    sdl2.SDL_JoystickSetVirtualAxis(pad, 0, -32768)
    sdl2.SDL_JoystickSetVirtualHat(pad, 0, sdl2.SDL_HAT_UP)
    sdl2.SDL_JoystickSetVirtualButton(pad, 3, 1)
    state = reader.read()
    assert state.axes == pytest.approx((1.0, 0.0, 0.0, 0.0, 1.0))
    assert state.buttons == (0, 0, 0, 1)
    sdl2.SDL_JoystickDetachVirtual(index)


def test_only_the_pad_of_the_wanted_name_is_read() -> None:
    with PadReader("Somebody Else's Pad") as reader:
        index, _ = plug_in(sdl2.SDL_JOYSTICK_TYPE_GAMECONTROLLER, 6, 15)
        assert reader.names == ["Virtual Controller"]
        assert reader.read() is None
        sdl2.SDL_JoystickDetachVirtual(index)


@given(st.integers(-32768, 32767), st.floats(0.0, 0.9))
def test_axes_are_scaled_without_a_jump(raw: int, deadzone: float) -> None:
    value = scale_axis(raw, deadzone)
    assert -1.0 <= value <= 1.0
    assert value == -scale_axis(max(-raw, -32767) if raw > -32768 else 32767, deadzone)
    if abs(raw) < deadzone * 32767:
        assert value == 0.0
    assert abs(scale_axis(min(raw + 1, 32767), deadzone) - value) <= 1.0 / (32767 * (1.0 - deadzone)) + 1e-12
