"""The supervisor in front of a walking twin: as long as nothing is wrong it has nothing to say."""

from __future__ import annotations

import numpy as np
import pytest

from nermo_control.controller import Controller
from nermo_control.gait.knowledge_base import GaitParameters
from nermo_control.types import ControlCommand, Posture
from nermo_description.battery_model import Battery
from nermo_description.robots import load_robot
from nermo_hw.safety.rules import Cause, State
from nermo_hw.safety.supervisor import SafetySupervisor
from nermo_hw.types import Fault, SensorSample
from nermo_sim.sensor_data import TYPICAL_NOISE
from nermo_sim.twin import Twin

STALL_CURRENT = 0.9


class SupervisedTwin:
    """Controller, supervisor and twin, tick by tick."""

    def __init__(self, robot: str, noise: float, seed: int = 0) -> None:
        self.robot = load_robot(robot)
        self.twin = Twin(self.robot, noise=TYPICAL_NOISE.times(noise) if noise else None, seed=seed)
        self.controller = Controller(self.robot, GaitParameters(), self.twin.period_ns)
        self.supervisor = SafetySupervisor(self.robot, now=self.twin.time_ns)
        self.battery = Battery()
        self.sensors = self.twin.reset("stand")
        self.seen: set[Cause] = set()
        self._per_torque = STALL_CURRENT / max(servo.max_torque for servo in self.robot.servos.values())

    def sample(self) -> SensorSample:
        sensors = self.sensors
        torques = np.array(sensors.servo_torques)
        velocities = np.array(sensors.servo_velocities)
        self.battery.draw(float(np.abs(torques * velocities).sum()), 0.005)
        return SensorSample(
            stamp=sensors.stamp,
            elapsed=0.005,
            servo_positions=np.array(sensors.servo_positions),
            servo_velocities=velocities,
            servo_currents=np.abs(torques) * self._per_torque,
            knee_angles=np.array(sensors.knee_encoders),
            cells={},
            orientation=np.array(sensors.orientation),
            angular_velocity=np.array(sensors.angular_velocity),
            linear_acceleration=np.array(sensors.linear_acceleration),
            battery_voltage=self.battery.voltage,
            battery_current=self.battery.current,
            faults=Fault(0),
            limp=False,
        )

    def run(self, seconds: float, **command: object) -> None:
        for _ in range(round(seconds * 200)):
            now = self.sensors.stamp
            wanted = ControlCommand(now, **command)  # type: ignore[arg-type]
            answer = self.controller.step(
                now, wanted, self.twin.odometry(), self.sensors.servo_positions, self.sensors.imu
            )
            self.supervisor.take_command(now, list(self.robot.servos), answer.servo_positions, now)
            output = self.supervisor.step(now)
            self.seen.update(output.causes)
            self.sensors = self.twin.step(output.targets.positions.tolist())
            self.supervisor.take_sensors(self.sample(), self.sensors.stamp)


@pytest.mark.parametrize("noise", [0.0, 1.0])
@pytest.mark.parametrize("robot", ["nermo_lite", "nermo"])
def test_a_walk_is_no_lie(robot: str, noise: float) -> None:
    walk = SupervisedTwin(robot, noise)
    walk.run(0.1, posture=Posture.STAND)
    assert walk.supervisor.release(walk.sensors.stamp) == ""
    walk.run(0.01)
    walk.seen.clear()
    begin = np.array(walk.twin.base_state().position)
    walk.run(2.0, posture=Posture.STAND)
    walk.run(6.0, forward_velocity=0.1, gait="trot", gait_frequency=0.8)
    walk.run(2.0, forward_velocity=0.05, turn_rate=0.5)
    walk.run(2.0, posture=Posture.CROUCH)
    walk.run(2.0, posture=Posture.SIT)
    walk.run(2.0, posture=Posture.STAND)
    walk.run(3.0, forward_velocity=0.1, gait="trot", gait_frequency=1.2)
    assert walk.seen == set()
    assert walk.supervisor.state is State.FOLLOW
    assert np.linalg.norm(np.array(walk.twin.base_state().position) - begin) > 0.3
