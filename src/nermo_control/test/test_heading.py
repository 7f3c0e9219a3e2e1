"""Heading hold: a slipping, drifting mouse goes straight and turns as fast as it is told."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from nermo_control.gait.knowledge_base import GaitParameters
from nermo_control.heading import LARGEST_ERROR, HeadingHold
from nermo_control.high_level_controller import HighLevelController, HighLevelControllerConfig
from nermo_control.turning import TurningModel
from nermo_control.types import ControlCommand, Odometry, Posture, TrajectoryMode
from nermo_description.parameters import RobotParameters

PERIOD = 5_000_000
FREQUENCY = 0.8
WALK = ControlCommand(0, forward_velocity=0.08)


class Slipping:
    """A mouse that turns at a share of what the turning model promises, half a cycle late, and drifts to one side."""

    def __init__(self, robot: RobotParameters, share: float, drift: float, hold: bool = True) -> None:
        self.controller = HighLevelController(
            robot, GaitParameters(), HighLevelControllerConfig(heading_hold=hold, lockstep=True)
        )
        self._model: TurningModel = self.controller._turning
        self._share, self._drift = share, drift
        self._turns = [0.0] * round(0.5e9 / FREQUENCY / PERIOD)
        self.stamp, self.yaw = 0, 0.5
        self.alphas: list[float] = []

    def run(self, seconds: float, command: ControlCommand, odometry: bool = True) -> float:
        """Walks for a while; the change of heading [rad]."""
        before = self.yaw
        for tick in range(round(seconds * 1e9 / PERIOD)):
            self.stamp += PERIOD
            swing = 0.1 * math.sin(2.0 * math.pi * FREQUENCY * tick * PERIOD * 1e-9)
            pose = Odometry(self.stamp, 0.0, 0.0, math.remainder(self.yaw + swing, 2.0 * math.pi))
            motion = self.controller.step(self.stamp, replace(command, stamp=self.stamp), pose if odometry else None)
            self.alphas.append(motion.turn_rate_normalized)
            self._turns.append(self._model.turn_rate(motion.turn_rate_normalized, motion.forward_velocity, "leg"))
            self.yaw += (self._share * self._turns.pop(0) + self._drift) * PERIOD * 1e-9
        return self.yaw - before


@pytest.mark.parametrize("velocity", [0.08, -0.08])
@pytest.mark.parametrize("drift", [0.03, -0.02])
def test_a_drifting_mouse_goes_straight(robot: RobotParameters, drift: float, velocity: float) -> None:
    command = replace(WALK, forward_velocity=velocity)
    assert abs(Slipping(robot, 0.7, drift, hold=False).run(60.0, command)) > 1.0
    mouse = Slipping(robot, 0.7, drift)
    assert abs(mouse.run(30.0, command)) < 0.15
    assert abs(mouse.run(30.0, command)) < 0.01


@pytest.mark.parametrize("rate", [0.15, -0.1])
@pytest.mark.parametrize("share", [0.6, 1.0, 1.2])
def test_the_turn_rate_asked_for_is_reached(robot: RobotParameters, share: float, rate: float) -> None:
    mouse = Slipping(robot, share, 0.0)
    mouse.run(20.0, replace(WALK, turn_rate=rate))
    assert mouse.run(10.0, replace(WALK, turn_rate=rate)) / 10.0 == pytest.approx(rate, rel=0.03)


def test_the_heading_held_is_that_of_the_moment_the_stick_is_let_go(robot: RobotParameters) -> None:
    mouse = Slipping(robot, 0.6, 0.0)
    mouse.run(10.0, replace(WALK, turn_rate=0.5))
    assert max(mouse.alphas) == 1.0
    assert abs(mouse.run(20.0, WALK)) < LARGEST_ERROR + 0.1, "what could not be turned is not made up for"
    assert abs(mouse.run(10.0, WALK)) < 0.01


def test_without_odometry_or_when_switched_off_the_model_alone_decides(robot: RobotParameters) -> None:
    mouse = Slipping(robot, 0.7, 0.03)
    mouse.run(5.0, WALK, odometry=False)
    assert mouse.alphas == [0.0] * len(mouse.alphas)
    off = Slipping(robot, 0.7, 0.03, hold=False)
    off.run(5.0, WALK)
    assert off.alphas == [0.0] * len(off.alphas)


@pytest.mark.parametrize(
    "pause",
    [
        ControlCommand(0),
        replace(WALK, posture=Posture.STAND),
        replace(WALK, trajectory_mode=TrajectoryMode.STRAIGHT_LINE),
    ],
)
def test_after_a_pause_a_new_heading_is_held(robot: RobotParameters, pause: ControlCommand) -> None:
    mouse = Slipping(robot, 0.7, 0.0)
    mouse.run(2.0, WALK)
    mouse.run(1.0, pause)
    mouse.yaw += 1.0
    assert abs(mouse.run(20.0, WALK)) < 0.05


@given(st.lists(st.tuples(st.floats(-3.0, 3.0), st.floats(-4.0, 4.0)), min_size=1, max_size=20))
def test_the_correction_is_bounded(samples: list[tuple[float, float]]) -> None:
    hold = HeadingHold()
    for tick, (rate, yaw) in enumerate(samples):
        correction = hold.step(Odometry(tick * 200_000_000, 0.0, 0.0, yaw), rate, 0.8, FREQUENCY)
        assert abs(correction) <= 0.8 * LARGEST_ERROR + 1e-9
