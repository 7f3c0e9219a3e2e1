"""Driving the twin from one terminal, as far as it needs no graph: the way, the keys and the screen."""

from __future__ import annotations

import math
import os
import pty
import subprocess
import sys
from io import StringIO

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from nermo_bringup.drive import display
from nermo_bringup.drive.odometer import COASTING_S, Odometer
from nermo_bringup.drive.session import Keys
from nermo_bringup.teleop.keyboard import raw_terminal
from nermo_control.driver import Driver, Limits
from nermo_control.types import Posture

TICK_S = 0.005


def walk(odometer: Odometer, begin: float, duration: float, speed: float, heading: float, sway: float = 0.0) -> float:
    """Walks on from the origin, told to; the time at the end."""
    for tick in range(round(duration / TICK_S) + 1):
        time = begin + tick * TICK_S
        way, side = speed * tick * TICK_S, sway * math.sin(2.0 * math.pi * time)
        x = way * math.cos(heading) - side * math.sin(heading)
        y = way * math.sin(heading) + side * math.cos(heading)
        odometer.add(time, x, y, heading, told=True)
    return time


@given(st.floats(0.02, 0.2), st.floats(1.0, 3.0), st.floats(-math.pi, math.pi), st.floats(0.0, 0.01))
def test_the_way_is_as_long_as_it_was_whatever_the_direction(speed, duration, heading, sway) -> None:
    odometer = Odometer()
    end = walk(odometer, 3.0, duration, speed, heading, sway)
    odometer.add(
        end + COASTING_S + 0.1, speed * duration * math.cos(heading), speed * duration * math.sin(heading), 0.0, False
    )
    # A sway of 1 cm lengthens what a ruler of 5 cm measures by less than a tenth.
    assert odometer.distance_m == pytest.approx(speed * duration, rel=0.1, abs=0.01)
    assert odometer.driven_s == pytest.approx(duration, abs=2 * TICK_S)


@given(st.booleans())
def test_backward_is_negative_and_still_a_way(told: bool) -> None:
    odometer = Odometer()
    for tick in range(400):
        odometer.add(tick * TICK_S, -0.05 * tick * TICK_S, 0.0, 0.0, told)
    assert odometer.speed_m_s == pytest.approx(-0.05)
    assert (odometer.distance_m > 0.05) is told


def test_a_mouse_that_is_told_nothing_walks_nowhere() -> None:
    odometer = Odometer()
    for tick in range(2000):
        odometer.add(tick * TICK_S, 0.004 * math.sin(tick), 0.02 * tick * TICK_S, 0.0, told=False)
    assert str(odometer) == "walked 0.00 m in 0 s"


class Typist:
    """A terminal with keys that are typed, before and after the graph is up."""

    def __init__(self) -> None:
        self._controller, self.terminal = pty.openpty()
        self.driver = Driver(Limits(), gaits=["trot", "lateral"], default_gait="trot")
        self.keys = Keys(self.driver, self.terminal)

    def type(self, keys: str) -> None:
        with raw_terminal(self.terminal):
            os.write(self._controller, keys.encode())
            self.keys.read()

    def close(self) -> None:
        os.close(self._controller)
        os.close(self.terminal)


@pytest.fixture
def typist():
    typist = Typist()
    yield typist
    typist.close()


def test_a_stop_typed_while_the_graph_comes_up_stops_at_once(typist: Typist) -> None:
    typist.type("wx")
    assert typist.driver.stopped
    typist.keys.begin()
    assert typist.driver.stopped
    assert typist.driver.posture is Posture.STOP


def test_other_keys_wait_for_the_graph_and_count_in_their_order(typist: Typist) -> None:
    typist.type("g+x1")
    assert (typist.driver.gait, typist.driver.speed) == ("", 5)
    assert typist.keys.waiting == ["g", "+", "x", "1"]
    typist.keys.begin()
    assert (typist.driver.gait, typist.driver.speed, typist.driver.stopped) == ("lateral", 6, False)
    assert typist.driver.release_wanted
    typist.type("-")
    assert typist.driver.speed == 5


def test_leaving_does_not_wait(typist: Typist) -> None:
    typist.type("q")
    assert typist.keys.mapping.left


def shown(renderable: object, width: int) -> list[str]:
    console = Console(file=StringIO(), width=width, height=24, force_terminal=True, color_system=None)
    console.print(renderable)
    return console.file.getvalue().splitlines()


def view(**changes: object) -> display.View:
    given = {
        "title": "nermo_lite on its twin",
        "driver": Driver(Limits(), default_gait="trot"),
        "odometer": Odometer(),
        "forward_velocity": 0.0,
        "turn_rate": 0.0,
        "state": "following commands",
        "fallen": False,
        "trouble": (),
        "real_time_factor": "1.00",
    }
    return display.View(**{**given, **changes})


def test_the_screen_fits_a_small_terminal_whatever_is_wrong() -> None:
    driver = Driver(Limits(), posture=Posture.LIFT_REAR_LEFT, straight_line=True, trim=0.3, gait="lateral_sequence")
    for mode in driver.spine_modes.__slots__:
        driver.toggle_spine(mode)
    driver.emergency_stop()
    lines = shown(display.screen(view(driver=driver, state="limp: " + "x" * 30, trouble=["y" * 300])), 80)
    assert len(lines) <= 24
    assert max(map(len, lines)) <= 80


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({}, "ready to walk, servos following commands"),
        ({"forward_velocity": 0.06}, "walking, servos following commands"),
        ({"driver": Driver(Limits(), posture=Posture.LIFT_FRONT_LEFT)}, "lift front left"),
        (
            {"driver": Driver(Limits(), stopped=True)},
            "EMERGENCY STOP, following commands; 1 releases",
        ),
        (
            {"state": "limp: emergency_stop (SIGUSR1)"},
            "EMERGENCY STOP, limp: emergency_stop (SIGUSR1); 1 releases",
        ),
        ({"fallen": True}, "FELL OVER; q ends"),
        ({"fallen": True, "state": "limp: x"}, "EMERGENCY STOP, limp: x; 1 releases"),
        ({"trouble": ["a: old", "b: new"]}, "b: new"),
        ({"driver": Driver(Limits(), gait="pace", gait_frequency=1.2)}, "pace at 1.2 Hz, speed 5/10"),
    ],
)
def test_the_screen_says_how_it_is(changes: dict[str, object], words: str) -> None:
    assert any(words in line for line in shown(display.screen(view(**changes)), 100))


def test_what_was_typed_shows_while_the_graph_comes_up() -> None:
    (line,) = shown(display.starting("nermo", 3, 8, 2.4, ["x", "g"]), 100)
    assert line == "bringing up the twin of nermo: 3 of 8 nodes, 2 s; typed so far: x g (q ends)"


def test_a_gamepad_is_found_where_one_is_plugged_in() -> None:
    code = """
from nermo_bringup.drive.session import _plugged_in
from nermo_bringup.teleop.joystick import sdl2
print([_plugged_in()])
sdl2.SDL_Init(sdl2.SDL_INIT_GAMECONTROLLER)
sdl2.SDL_JoystickAttachVirtual(sdl2.SDL_JOYSTICK_TYPE_GAMECONTROLLER, 6, 15, 0)
print([_plugged_in()])
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == ["['']", "['Virtual Controller']"]
    assert not done.stderr


def test_driving_needs_a_terminal() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "nermo_bringup", "drive"], stdin=subprocess.DEVNULL, capture_output=True, text=True
    )
    assert done.returncode == 2
    assert "takes its keys from a terminal, and its input is none" in done.stderr
    assert not done.stdout


@pytest.mark.parametrize(
    ("arguments", "words"), [(["--robot", "moon"], "cheetah_cub"), (["--record", "/"], "new folder")]
)
def test_wrong_options_are_said_before_anything_starts(arguments: list[str], words: str) -> None:
    controller, terminal = pty.openpty()
    done = subprocess.run(
        [sys.executable, "-m", "nermo_bringup", "drive", *arguments], stdin=terminal, capture_output=True, text=True
    )
    os.close(controller)
    os.close(terminal)
    assert done.returncode == 2
    assert words in done.stderr
