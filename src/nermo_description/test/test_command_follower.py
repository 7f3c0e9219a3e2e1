"""Targets out of commands that come, jump, or fail to come."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from nermo_description.blend import PEAK_VELOCITY
from nermo_description.command_follower import MOVE_DURATION, CommandFollower, Following
from nermo_description.robots import load_robot
from nermo_description.silence import CROUCH as CROUCH_SILENCE
from nermo_description.silence import HOLD, SILENCES, table

ROBOT = load_robot("nermo_lite")
STAND = np.array(list(ROBOT.posture("stand").values()))
CROUCH = np.array(list(ROBOT.posture("crouch").values()))
PERIOD = 5_000_000
TICK = 0.005


@pytest.fixture
def follower() -> CommandFollower:
    return CommandFollower(CROUCH)


def settle(follower: CommandFollower, posture: np.ndarray = STAND) -> None:
    follower.command(posture)
    np.testing.assert_array_equal(follower.step(PERIOD, posture), posture)


def test_there_are_no_targets_before_the_first_command(follower):
    assert follower.step(10 * 10**9, STAND) is None
    assert follower.state is Following.WAITING


def test_near_commands_are_followed_at_once_and_far_ones_smoothly(follower):
    settle(follower)
    near = STAND + 0.05
    follower.command(near)
    np.testing.assert_array_equal(follower.step(PERIOD, STAND), near)
    follower.rest()
    follower.command(CROUCH)
    way = [follower.step(PERIOD, STAND) for _ in range(round(MOVE_DURATION / TICK) + 1)]
    steps = np.abs(np.diff(np.array([STAND, *way]), axis=0)).max(axis=1)
    assert steps.max() < 1.01 * PEAK_VELOCITY * np.abs(CROUCH - STAND).max() * TICK / MOVE_DURATION
    np.testing.assert_array_equal(way[-1], CROUCH)


def test_silence_holds_then_crouches_and_a_new_command_is_approached_smoothly(follower):
    settle(follower)
    states = []
    while follower.state is not Following.CROUCHING:
        target = follower.step(PERIOD, STAND)
        states.append(follower.state)
    assert states.count(Following.FOLLOWING) == round(HOLD.after / TICK) - 1
    assert len(states) == round(CROUCH_SILENCE.after / TICK)
    for _ in range(round(MOVE_DURATION / TICK)):
        target = follower.step(PERIOD, STAND)
    np.testing.assert_allclose(target, CROUCH)
    follower.command(STAND)
    assert np.abs(follower.step(PERIOD, CROUCH) - CROUCH).max() < 0.01
    assert follower.state is Following.FOLLOWING


def test_after_it_was_limp_a_move_begins_where_the_servos_are(follower):
    settle(follower)
    follower.rest()
    assert follower.step(PERIOD, CROUCH) is None
    follower.command(STAND)
    assert np.abs(follower.step(PERIOD, CROUCH) - CROUCH).max() < 0.01


def test_a_servo_that_does_not_know_where_it_is_goes_to_its_goal_at_once_the_others_smoothly(follower):
    measured = np.where(np.arange(len(STAND)) == 0, np.nan, STAND)
    follower.command(CROUCH)
    target = follower.step(PERIOD, measured)
    assert target[0] == CROUCH[0]
    assert np.abs(target - STAND)[1:].max() < 0.01
    assert np.isfinite(target).all()


def test_who_rests_stays_there_until_commanded_and_moves_from_there(follower):
    follower.rest(CROUCH, Following.LIMP)
    np.testing.assert_array_equal(follower.step(10 * 10**9), CROUCH)
    assert follower.state is Following.LIMP
    follower.command(STAND)
    assert np.abs(follower.step(PERIOD) - CROUCH).max() < 0.01
    assert follower.state is Following.FOLLOWING


def test_the_page_shows_the_silences():
    page = Path(__file__).parents[3] / "docs" / "architecture.md"
    assert table() in page.read_text(encoding="utf-8")
    assert all(row.after > 0.0 for row in SILENCES)
