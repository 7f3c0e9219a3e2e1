"""Dead reckoning on a mouse that rolls, sinks into its knees and drags its feet, as the twin does."""

from __future__ import annotations

import pytest

from nermo_control.gait.knowledge_base import GaitParameters
from nermo_control.odometry import LegOdometry
from nermo_control.types import ControlCommand
from nermo_description.robots import load_robot
from nermo_sim.loop import Loop

SECONDS, BEGIN = 8.0, 3.0


@pytest.mark.parametrize(
    ("name", "gait", "velocity"),
    [
        ("nermo", "trot", 0.06),
        ("nermo_lite", "trot", 0.06),
        ("nermo_lite", "trot", -0.05),
        ("nermo", "lateral_walk", 0.04),
    ],
)
def test_dead_reckoning_finds_the_way_of_the_twin(name: str, gait: str, velocity: float) -> None:
    robot = load_robot(name)
    loop, odometry = Loop.build(robot, GaitParameters()), LegOdometry(robot)
    begin = None
    while loop.sensors.stamp < SECONDS * 1e9:
        loop.tick(ControlCommand(loop.sensors.stamp, forward_velocity=velocity, gait=gait))
        reckoned = odometry.step(loop.sensors.stamp, loop.sensors.servo_positions, loop.sensors.orientation)
        true = loop.twin.odometry()
        if begin is None and loop.sensors.stamp >= BEGIN * 1e9:
            begin = reckoned.position[0], true.x
    assert begin is not None
    way = true.x - begin[1]
    assert abs(way) > 0.1
    assert reckoned.position[0] - begin[0] == pytest.approx(way, rel=0.3)
