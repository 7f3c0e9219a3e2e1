"""Dead reckoning, on servo positions of a mouse that walks exactly as commanded."""

from __future__ import annotations

import math

import pytest

from nermo_control.controller import Controller
from nermo_control.gait.knowledge_base import GaitParameters
from nermo_control.odometry import BaseState, LegOdometry, Quaternion
from nermo_control.types import ControlCommand, Odometry
from nermo_description.parameters import RobotParameters

PERIOD = 5_000_000


def heading(yaw: float, pitch: float = 0.0) -> Quaternion:
    """Yaw after pitch."""
    cy, sy, cp, sp = math.cos(yaw / 2), math.sin(yaw / 2), math.cos(pitch / 2), math.sin(pitch / 2)
    return cy * cp, -sy * sp, cy * sp, sy * cp


def walk(robot: RobotParameters, velocity: float, gait: str, seconds: float, yaw: float = 0.0) -> list[BaseState]:
    controller, odometry = Controller(robot, GaitParameters(), PERIOD), LegOdometry(robot)
    servos = [servo.neutral for servo in robot.servos.values()]
    states = []
    for tick in range(round(seconds / 5e-3)):
        stamp = tick * PERIOD
        command = ControlCommand(stamp, forward_velocity=velocity, gait=gait)
        servos = list(controller.step(stamp, command, Odometry(stamp, 0.0, 0.0, 0.0), servos).servo_positions)
        states.append(odometry.step(stamp, servos, heading(yaw)))
    return states


@pytest.mark.parametrize(("gait", "within"), [("trot", 0.05), ("walking_trot", 0.3), ("lateral_walk", 0.3)])
@pytest.mark.parametrize("velocity", [0.06, -0.04])
def test_the_distance_walked_is_velocity_times_time(
    robot: RobotParameters, gait: str, within: float, velocity: float
) -> None:
    """Where stance phases overlap, feet rest at both ends of their paths (table 5.6) while others move: some slip."""
    states = walk(robot, velocity, gait, 12.5)
    first, last = states[500], states[-1]
    assert last.position[0] - first.position[0] == pytest.approx(velocity * 10.0, rel=within)
    assert last.position[1] == pytest.approx(0.0, abs=1e-3)
    assert last.linear_velocity[0] == pytest.approx(velocity, rel=0.6)
    assert last.stamp == 2499 * PERIOD


def test_odom_begins_along_the_mouse_whatever_the_compass_says(robot: RobotParameters) -> None:
    assert walk(robot, 0.06, "trot", 5.0, yaw=1.0)[-1].position == pytest.approx(
        walk(robot, 0.06, "trot", 5.0)[-1].position, abs=1e-9
    )


def test_turning_turns_the_way(robot: RobotParameters) -> None:
    """Half the walk, then a right angle to the left in place: what follows goes along y."""
    controller, odometry = Controller(robot, GaitParameters(), PERIOD), LegOdometry(robot)
    servos = [servo.neutral for servo in robot.servos.values()]
    corner = state = odometry.step(0, servos, heading(0.3))
    for tick in range(1, 4000):
        stamp = tick * PERIOD
        command = ControlCommand(stamp, forward_velocity=0.06)
        servos = list(controller.step(stamp, command, Odometry(stamp, 0.0, 0.0, 0.0), servos).servo_positions)
        state = odometry.step(stamp, servos, heading(0.3 + (math.pi / 2 if tick > 2000 else 0.0)))
        if tick == 2000:
            corner = state
    assert state.position[1] - corner.position[1] == pytest.approx(0.06 * 10.0, rel=0.15)
    w, _, _, z = state.orientation
    assert 2.0 * math.atan2(z, w) == pytest.approx(math.pi / 2)


def test_standing_still_stays_put_even_when_the_body_pitches(robot: RobotParameters) -> None:
    odometry = LegOdometry(robot)
    servos = [servo.neutral for servo in robot.servos.values()]
    states = [odometry.step(tick * PERIOD, servos, heading(0.0)) for tick in range(100)]
    assert states[-1].position[:2] == (0.0, 0.0)
    assert 0.03 < states[-1].position[2] < 0.07
    assert states[-1].linear_velocity == (0.0, 0.0, 0.0)


def test_without_an_orientation_the_gyro_is_integrated(robot: RobotParameters) -> None:
    odometry = LegOdometry(robot)
    servos = [servo.neutral for servo in robot.servos.values()]
    states = [odometry.step(tick * PERIOD, servos, None, 0.5) for tick in range(401)]
    w, _, _, z = states[-1].orientation
    assert 2.0 * math.atan2(z, w) == pytest.approx(1.0)
    assert states[-1].turn_rate == pytest.approx(0.5, rel=1e-3)


def test_gaps_and_nonsense_do_not_move_the_mouse(robot: RobotParameters) -> None:
    states = walk(robot, 0.06, "trot", 3.0)
    odometry = LegOdometry(robot)
    servos = [servo.neutral for servo in robot.servos.values()]
    before = odometry.step(0, servos, heading(0.0))
    odometry.step(PERIOD, [math.nan] * len(servos), (math.nan,) * 4, math.nan)
    odometry.step(2 * PERIOD, servos, (0.0, 0.0, 0.0, 0.0))
    moved = [position + 0.3 for position in servos]
    after = odometry.step(10_000_000_000, moved, heading(0.0))
    assert after.position[:2] == before.position[:2]
    assert all(math.isfinite(value) for state in states for value in (*state.position, *state.orientation))
