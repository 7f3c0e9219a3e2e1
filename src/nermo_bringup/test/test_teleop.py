"""From sticks, buttons and keys to commands."""

from __future__ import annotations

import math
import os
import pty
import termios
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from nermo_bringup.teleop.keyboard import HOLD_S, KeyboardError, KeyMapping, raw_terminal, read_keys
from nermo_bringup.teleop.mapping import PadMapping
from nermo_bringup.teleop.pads import load_pad
from nermo_control.driver import SPEED_STEPS, Driver, Limits
from nermo_control.types import Posture, SpineModes, TrajectoryMode

PAD = load_pad("xbox", Path(__file__).parents[1] / "config" / "pads")
TICK = 0.05


class Hands:
    """A person with a pad: says which controls are held, and collects the commands of each 20 Hz tick."""

    def __init__(self) -> None:
        self.driver = Driver(Limits(max_forward_velocity=0.1, max_turn_rate=1.0), gaits=["lateral", "trot"])
        self.mapping = PadMapping(PAD, self.driver)
        self.now = 100.0
        self.hold()

    def message(self, *held: str, forward: float = 0.0, turn: float = 0.0) -> tuple[list[float], list[int]]:
        axes, buttons = [0.0] * PAD.axis_count, [0] * PAD.button_count
        axes[PAD.axes[PAD.controls.forward]] = forward
        axes[PAD.axes[PAD.controls.turn]] = turn
        for control in held:
            name = getattr(PAD.controls, control)
            if name in PAD.buttons:
                buttons[PAD.buttons[name]] = 1
            else:
                axes[PAD.axes[name[:-1]]] = 1.0 if name[-1] == "+" else -1.0
        return axes, buttons

    def hold(self, *held: str, forward: float = 0.0, turn: float = 0.0):
        """One message and the command of the tick after it."""
        self.now += TICK
        self.mapping.receive(self.now, *self.message(*held, forward=forward, turn=turn))
        return self.mapping.command(self.now, int(self.now * 1e9))

    def press(self, control: str):
        """Press and release a button with the dead-man button held."""
        command = self.hold("dead_man", control)
        self.hold("dead_man")
        return command

    def wait(self, seconds: float):
        """Commands while no message comes."""
        commands = []
        for _ in range(round(seconds / TICK)):
            self.now += TICK
            commands.append(self.mapping.command(self.now, int(self.now * 1e9)))
        return commands


def test_nothing_is_sent_without_the_dead_man_button() -> None:
    hands = Hands()
    assert hands.hold(forward=1.0) is None
    assert hands.hold("stand", forward=1.0) is None


def test_the_stick_gives_speed_and_turn() -> None:
    hands = Hands()
    command = hands.hold("dead_man", forward=0.5, turn=-0.25)
    assert command.forward_velocity == pytest.approx(0.5 * 0.1 * hands.driver.speed / SPEED_STEPS)
    assert command.turn_rate == pytest.approx(-0.25)
    assert command.posture is Posture.WALK
    assert command.stamp == int(hands.now * 1e9)


def test_releasing_the_button_stops_with_one_command() -> None:
    hands = Hands()
    hands.hold("dead_man", forward=1.0)
    stop = hands.hold(forward=1.0)
    assert (stop.forward_velocity, stop.turn_rate) == (0.0, 0.0)
    assert [hands.hold(forward=1.0) for _ in range(3)] == [None] * 3


def test_a_silent_pad_stops_within_its_time_with_one_command() -> None:
    hands = Hands()
    hands.hold("dead_man", forward=1.0)
    commands = hands.wait(0.5)
    sent = [command for command in commands if command is not None]
    assert sent[-1].forward_velocity == 0.0
    assert all(command.forward_velocity > 0.0 for command in sent[:-1])
    assert len(sent) * TICK <= 0.25 + 2 * TICK
    assert commands[-1] is None


def test_a_pad_that_comes_back_with_buttons_down_presses_none() -> None:
    hands = Hands()
    hands.wait(1.0)
    hands.hold("dead_man", "next_gait")
    assert hands.driver.gait == ""
    hands.hold("dead_man")
    hands.hold("dead_man", "next_gait")
    assert hands.driver.gait == "lateral"


@pytest.mark.parametrize(
    ("axes", "buttons"),
    [([0.0] * 3, [1] * 15), ([0.0] * 6, [1] * 3), ([0.0] * 5 + [math.nan], [1] * 15), ([0.0] * 5 + [7.0], [1] * 15)],
)
def test_a_message_that_does_not_fit_counts_as_none(axes: list[float], buttons: list[int]) -> None:
    hands = Hands()
    hands.hold("dead_man", forward=1.0)
    for _ in range(10):
        hands.now += TICK
        hands.mapping.receive(hands.now, axes, buttons)
        last = hands.mapping.command(hands.now, 0)
    assert hands.mapping.fault
    assert last is None


def test_postures_stay_until_the_stick_moves() -> None:
    hands = Hands()
    assert hands.press("sit").posture is Posture.SIT
    assert hands.hold("dead_man").posture is Posture.SIT
    assert hands.hold().posture is Posture.SIT
    assert hands.hold("dead_man", forward=0.5).posture is Posture.WALK
    assert hands.press("stand").posture is Posture.STAND


def test_each_press_lifts_the_next_leg_then_none_and_the_stick_ends_it() -> None:
    hands = Hands()
    lifts = [Posture.LIFT_FRONT_LEFT, Posture.LIFT_FRONT_RIGHT, Posture.LIFT_REAR_LEFT, Posture.LIFT_REAR_RIGHT]
    assert [hands.press("lift_leg").posture for _ in range(6)] == [*lifts, Posture.STAND, lifts[0]]
    assert hands.hold("dead_man", forward=0.5).posture is Posture.WALK
    hands.hold("emergency_stop")
    assert hands.press("lift_leg").posture is Posture.STOP


def test_an_emergency_stop_needs_no_dead_man_and_ends_only_by_standing() -> None:
    hands = Hands()
    hands.hold("dead_man", forward=1.0)
    assert hands.hold("emergency_stop").posture is Posture.STOP
    assert hands.driver.stopped
    assert all(command.posture is Posture.STOP for command in hands.wait(1.0))
    hands.hold()
    for command in (hands.hold("dead_man", forward=1.0), hands.press("sit"), hands.hold("stand")):
        assert command.posture is Posture.STOP
        assert command.forward_velocity == 0.0
    hands.hold("dead_man")
    assert hands.press("stand").posture is Posture.STAND
    assert not hands.driver.stopped


def test_freezing_holds_against_the_stick_until_a_posture_is_chosen() -> None:
    hands = Hands()
    assert hands.hold("freeze").posture is Posture.STOP
    frozen = hands.hold("dead_man", forward=1.0)
    assert (frozen.posture, frozen.forward_velocity) == (Posture.STOP, 0.0)
    hands.press("stand")
    assert hands.hold("dead_man", forward=1.0).posture is Posture.WALK


def test_settings_change_by_buttons() -> None:
    hands = Hands()
    for _ in range(20):
        hands.press("faster")
    assert hands.driver.speed == SPEED_STEPS
    assert [hands.press("next_gait").gait for _ in range(3)] == ["lateral", "trot", "lateral"]
    assert hands.press("higher_frequency").gait_frequency == pytest.approx(0.9)
    assert hands.press("spine_turning").spine_modes == SpineModes(turning=True)
    assert hands.press("spine_turning").spine_modes == SpineModes()
    held = hands.hold("dead_man", "straight_line", forward=1.0)
    assert held.trajectory_mode is TrajectoryMode.STRAIGHT_LINE
    assert hands.hold("dead_man", forward=1.0).trajectory_mode is TrajectoryMode.EXTERNAL


def test_trim_turns_with_the_distance_walked() -> None:
    hands = Hands()
    hands.press("trim_left")
    assert hands.hold("dead_man").turn_rate == 0.0
    command = hands.hold("dead_man", forward=1.0)
    assert command.turn_rate == pytest.approx(0.1 * command.forward_velocity)


controls = st.lists(st.sampled_from(["dead_man", "stand", "sit", "freeze", "faster", "next_gait", "straight_line"]))


@given(st.lists(st.tuples(controls, st.floats(-1, 1), st.floats(-1, 1)), max_size=20))
def test_every_command_stays_in_its_limits_and_silence_ends_it(steps) -> None:
    hands = Hands()
    for held, forward, turn in steps:
        command = hands.hold(*held, forward=forward, turn=turn)
        if command is not None:
            assert abs(command.forward_velocity) <= 0.1
            assert abs(command.turn_rate) <= 1.0 + 0.1 * abs(hands.driver.trim)
    assert hands.wait(1.0)[-5:] == [None] * 5


@given(st.lists(st.sampled_from("wsader x120g+-][,.l\x00ß"), max_size=30))
def test_a_keyboard_left_alone_ends_in_silence_or_stop(keys: list[str]) -> None:
    mapping = KeyMapping(Driver(Limits(max_forward_velocity=0.1)))
    for key in keys:
        mapping.press(key, 0.0)
        mapping.command(0.0, 0)
    for tick in range(40):
        last = mapping.command(tick * TICK, 0)
    assert last is None or last.posture is Posture.STOP


def test_a_held_key_drives_and_a_released_one_stops() -> None:
    mapping = KeyMapping(Driver(Limits(max_forward_velocity=0.1)))
    mapping.press("w", 0.0)
    assert mapping.command(HOLD_S / 2, 0).forward_velocity > 0.0
    mapping.press("w", HOLD_S / 2)
    assert mapping.command(HOLD_S, 0).forward_velocity > 0.0
    assert mapping.command(1.6 * HOLD_S, 0).forward_velocity == 0.0
    assert mapping.command(1.7 * HOLD_S, 0) is None


def test_keys_and_arrows_are_read_and_the_terminal_comes_back() -> None:
    controller, terminal = pty.openpty()
    before = termios.tcgetattr(terminal)

    def type_and_fail() -> None:
        with raw_terminal(terminal):
            os.write(controller, b"w\x1b[A\x1b[15~x")
            assert read_keys(terminal) == ["w", "w", "x"]
            raise RuntimeError("the node failed")

    with pytest.raises(RuntimeError, match="the node failed"):
        type_and_fail()
    assert termios.tcgetattr(terminal) == before
    os.close(controller)
    with pytest.raises(KeyboardError, match="closed"):
        read_keys(terminal)
    os.close(terminal)


def test_keys_typed_before_anybody_reads_are_not_lost() -> None:
    controller, terminal = pty.openpty()
    os.write(controller, b"gx")
    with raw_terminal(terminal):
        assert read_keys(terminal) == ["g", "x"]
    os.close(controller)
    os.close(terminal)


@pytest.mark.parametrize("key", ["q", "\x1b", "\x03"])
def test_a_key_to_leave_stops_first(key: str) -> None:
    mapping = KeyMapping(Driver(Limits()))
    mapping.press("w", 0.0)
    assert mapping.command(0.1, 0).forward_velocity > 0.0
    mapping.press(key, 0.1)
    assert mapping.left
    assert mapping.command(0.1, 0).forward_velocity == 0.0


def test_the_first_change_of_the_gait_leaves_the_default() -> None:
    driver = Driver(Limits(), gaits=["trot", "lateral", "diagonal"], default_gait="lateral")
    driver.next_gait()
    assert driver.gait == "diagonal"


def test_standing_asks_for_the_power_back_unless_a_stop_follows() -> None:
    driver = Driver(Limits())
    driver.take(Posture.SIT)
    assert not driver.release_wanted
    driver.take(Posture.STAND)
    assert driver.release_wanted
    driver.emergency_stop()
    assert not driver.release_wanted


def test_a_pipe_is_no_keyboard() -> None:
    reading, writing = os.pipe()
    with pytest.raises(KeyboardError, match="needs a terminal"), raw_terminal(reading):
        pass
    os.close(reading)
    os.close(writing)
