"""Targets out of commands that come, jump, or fail to come."""

from __future__ import annotations

import numpy as np
import pytest

from nermo_description.robots import load_robot
from nermo_hw.serial.follower import CROUCH_AFTER, HOLD_AFTER, MOVE_DURATION, CommandFollower, Following

ROBOT = load_robot("nermo_lite")
STAND = np.array(list(ROBOT.posture("stand").values()))
CROUCH = np.array(list(ROBOT.posture("crouch").values()))
TICK = 0.005


@pytest.fixture
def follower() -> CommandFollower:
    return CommandFollower(ROBOT)


def settle(follower: CommandFollower, posture: np.ndarray = STAND) -> None:
    follower.command(posture)
    np.testing.assert_array_equal(follower.step(TICK, posture), posture)


def test_there_are_no_targets_before_the_first_command(follower):
    assert follower.step(10.0, STAND) is None
    assert follower.state is Following.WAITING


def test_near_commands_are_followed_at_once_and_far_ones_smoothly(follower):
    settle(follower)
    near = STAND + 0.05
    follower.command(near)
    np.testing.assert_array_equal(follower.step(TICK, STAND), near)
    follower.forget()
    follower.command(CROUCH)
    way = [follower.step(TICK, STAND) for _ in range(round(MOVE_DURATION / TICK) + 1)]
    steps = np.abs(np.diff(np.array([STAND, *way]), axis=0)).max(axis=1)
    assert steps.max() < 1.6 * np.abs(CROUCH - STAND).max() * TICK / MOVE_DURATION
    np.testing.assert_array_equal(way[-1], CROUCH)


def test_silence_holds_then_crouches_and_a_new_command_is_approached_smoothly(follower):
    settle(follower)
    states = []
    while follower.state is not Following.CROUCHING:
        target = follower.step(TICK, STAND)
        states.append(follower.state)
    assert states.count(Following.FOLLOWING) == pytest.approx(HOLD_AFTER / TICK, abs=1)
    assert len(states) == pytest.approx(CROUCH_AFTER / TICK, abs=1)
    for _ in range(round(MOVE_DURATION / TICK)):
        target = follower.step(TICK, STAND)
    np.testing.assert_allclose(target, CROUCH)
    follower.command(STAND)
    assert np.abs(follower.step(TICK, CROUCH) - CROUCH).max() < 0.01
    assert follower.state is Following.FOLLOWING


def test_positions_out_of_range_are_clamped_and_counted(follower):
    settle(follower)
    follower.command(STAND + np.eye(len(STAND))[0] * 10.0)
    for _ in range(200):
        target = follower.step(TICK, STAND)
        follower.command(STAND + np.eye(len(STAND))[0] * 10.0)
    assert target[0] == ROBOT.servos["front_left_hip"].upper
    assert follower.clamped >= 1


def test_after_it_was_limp_a_move_begins_where_the_servos_are(follower):
    settle(follower)
    follower.forget()
    assert follower.step(TICK, CROUCH) is None
    follower.command(STAND)
    assert np.abs(follower.step(TICK, CROUCH) - CROUCH).max() < 0.01


def test_a_servo_that_does_not_know_where_it_is_goes_to_its_goal_at_once_the_others_smoothly(follower):
    measured = np.where(np.arange(len(STAND)) == 0, np.nan, STAND)
    follower.command(CROUCH)
    target = follower.step(TICK, measured)
    assert target[0] == CROUCH[0]
    assert np.abs(target - STAND)[1:].max() < 0.01
    assert np.isfinite(target).all()
