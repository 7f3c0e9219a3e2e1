"""Behind the door: whatever message it lets through, no controller, generator or estimator fails of it."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from typing import Any

from geometry_msgs.msg import TwistStamped
from hypothesis import given, settings
from hypothesis import strategies as st
from nav_msgs.msg import Odometry as OdometryMessage
from nav_msgs.msg import Path
from sensor_msgs.msg import Imu

from nermo_bringup.fuzz.messages import spoil, stamp, usual
from nermo_control.gait.knowledge_base import GaitParameters
from nermo_control.gait.trajectory import TrajectoryGenerator
from nermo_control.high_level_controller import HighLevelController, HighLevelControllerConfig
from nermo_control.motion_module import MotionModule, MotionModuleConfig
from nermo_control.nodes import conversions
from nermo_control.odometry import LegOdometry
from nermo_control.types import Odometry
from nermo_description.ranges import message_error
from nermo_description.robots import load_robot
from nermo_interfaces import msg
from nermo_node.time import to_message, to_nanoseconds

ROBOT = load_robot("nermo_lite")
SERVOS = conversions.ServoArrays(ROBOT)
START = 100 * 10**9
TICK = 5_000_000
STEPS = 30

seeds = st.integers(0, 2**32)


class Sender:
    """Sends usual and spoiled messages in turn, as far as the door and the conversion let them through."""

    def __init__(self, seed: int) -> None:
        self.chance = random.Random(seed)
        self.now = START

    def send(self, kind: type, convert: Callable[[Any], Any]) -> Any:
        """What a receiver gets of one message; None where it is refused."""
        message = usual(kind, ROBOT, self.now)
        if self.chance.random() < 0.7:
            spoil(message, self.chance)
            if self.chance.random() < 0.7:
                stamp(message, self.now)
        if message_error(f"{kind.__module__.partition('.')[0]}/{kind.__name__}", message) is not None:
            return None
        try:
            return convert(message)
        except ValueError:
            return None

    def tick(self) -> None:
        """The next tick, now and then after a jump of the clock."""
        self.now += TICK if self.chance.random() < 0.95 else self.chance.choice((-START // 2, 10**9, 10**15))
        self.now = max(self.now, 0)


@settings(max_examples=150)
@given(seeds)
def test_the_high_level_controller_stands_everything(seed: int) -> None:
    sender = Sender(seed)
    controller = HighLevelController(ROBOT, GaitParameters(), HighLevelControllerConfig())
    command, odometry = None, Odometry(START, 0.0, 0.0, 0.0)
    for _ in range(STEPS):
        kinds = (
            (msg.ControlCommand, conversions.control_command_from_message),
            (TwistStamped, conversions.control_command_from_twist),
        )
        command = sender.send(*sender.chance.choice(kinds)) or command
        odometry = sender.send(OdometryMessage, conversions.odometry_from_message) or odometry
        if (path := sender.send(Path, lambda m: conversions.path_from_message(m, 0.15))) is not None:
            controller.follow(path)
        motion = controller.step(odometry.stamp, command, odometry)
        assert math.isfinite(motion.forward_velocity) and -1.0 <= motion.turn_rate_normalized <= 1.0
        conversions.motion_command_to_message(motion)
        sender.tick()


@settings(max_examples=150)
@given(seeds, st.sampled_from(["splines", "locus"]))
def test_the_trajectory_generator_stands_everything(seed: int, foot_path: str) -> None:
    sender = Sender(seed)
    generator = TrajectoryGenerator(GaitParameters(foot_path=foot_path))

    def answer(message: msg.LegStates) -> msg.FootTrajectories:
        states = conversions.leg_states_from_message(message)
        return conversions.foot_trajectories_to_message(states.stamp, generator.step(states))

    for _ in range(STEPS):
        if (trajectories := sender.send(msg.LegStates, answer)) is not None:
            assert message_error("nermo_interfaces/FootTrajectories", trajectories) is None
        sender.tick()


@settings(max_examples=60)
@given(seeds, st.sampled_from(["timed", "cpg", "tegotae"]), st.sampled_from(["spine", "imu"]))
def test_the_motion_module_stands_everything(seed: int, coordination: str, gaze: str) -> None:
    sender = Sender(seed)
    module = MotionModule(ROBOT, GaitParameters(), TICK, MotionModuleConfig(coordination=coordination, gaze=gaze))
    generator = TrajectoryGenerator(GaitParameters())
    command = imu = loads = None
    awaited = 0

    def accept(message: msg.FootTrajectories) -> None:
        for trajectory in conversions.foot_trajectories_from_message(message):
            module.accept(trajectory)

    def aim(message: msg.FootTrajectories) -> None:
        """At the requests of the module, so that it takes it."""
        for leg, trajectory in enumerate(message.trajectories):
            trajectory.start_time = to_message(awaited)
            trajectory.leg = leg % 4
        accept(message)

    for _ in range(STEPS):
        command = sender.send(msg.MotionCommand, conversions.motion_command_from_message) or command
        imu = sender.send(Imu, conversions.imu_from_message) or imu
        loads = sender.send(msg.LegLoads, conversions.leg_loads_from_message) or loads
        if (parameters := sender.send(msg.GaitParameters, conversions.gait_parameters_from_message)) is not None:
            module.set_parameters(parameters)
        positions = sender.send(msg.ServoStates, lambda m: (to_nanoseconds(m.header.stamp), SERVOS.positions(m)))
        module.sign_of_life("gait_knowledge_base", sender.now)
        module.sign_of_life("trajectory_generator", sender.now)
        if positions is not None:
            output = module.step(positions[0], command, positions[1], imu, loads)
            assert all(map(math.isfinite, output.servo_positions))
            SERVOS.command(positions[0], output.servo_positions)
            conversions.leg_states_to_message(output.leg_states)
            awaited = output.leg_states.start_time
            for trajectory in generator.step(output.leg_states):
                module.accept(trajectory)
            sender.send(msg.FootTrajectories, aim)
        sender.tick()


@settings(max_examples=100)
@given(seeds)
def test_the_odometry_stands_everything(seed: int) -> None:
    sender = Sender(seed)
    legs = LegOdometry(ROBOT)
    imu: Any = None
    for _ in range(STEPS):
        imu = sender.send(Imu, lambda message: message) or imu
        states = sender.send(msg.ServoStates, lambda m: (to_nanoseconds(m.header.stamp), SERVOS.positions(m)))
        if states is not None:
            orientation = None
            if imu is not None:
                q = imu.orientation
                orientation = (q.w, q.x, q.y, q.z)
            state = legs.step(*states, orientation, 0.0 if imu is None else imu.angular_velocity.z)
            assert all(map(math.isfinite, (*state.position, *state.orientation, state.turn_rate)))
        sender.tick()
