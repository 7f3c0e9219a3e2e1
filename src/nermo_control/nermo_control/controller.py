"""The whole controller in one process, wired as the graph is in lockstep: the same objects, the same order."""

from __future__ import annotations

from collections.abc import Sequence

from nermo_control.gait.knowledge_base import GaitParameters
from nermo_control.gait.trajectory import TrajectoryGenerator
from nermo_control.high_level_controller import HighLevelController, HighLevelControllerConfig
from nermo_control.motion.config import MotionModuleConfig
from nermo_control.motion_module import MotionModule
from nermo_control.types import ControlCommand, Imu, LegLoads, MotionOutput, Odometry
from nermo_description.parameters import RobotParameters

LOCKSTEP_HIGH_LEVEL = HighLevelControllerConfig(lockstep=True)
LOCKSTEP_MOTION = MotionModuleConfig(lockstep=True)


class Controller:
    """High-level controller -> motion module -> trajectory generator -> motion module, once a control tick."""

    def __init__(
        self,
        robot: RobotParameters,
        gait_parameters: GaitParameters,
        period_ns: int,
        high_level: HighLevelControllerConfig = LOCKSTEP_HIGH_LEVEL,
        motion: MotionModuleConfig = LOCKSTEP_MOTION,
    ) -> None:
        self.high_level_controller = HighLevelController(robot, gait_parameters, high_level)
        self.motion_module = MotionModule(robot, gait_parameters, period_ns, motion)
        self.trajectory_generator = TrajectoryGenerator(gait_parameters)

    def set_parameters(self, parameters: GaitParameters) -> None:
        """Takes new gait parameters in all three parts."""
        self.high_level_controller.set_parameters(parameters)
        self.motion_module.set_parameters(parameters)
        self.trajectory_generator.set_parameters(parameters)

    def step(
        self,
        stamp: int,
        control_command: ControlCommand | None,
        odometry: Odometry | None,
        servo_positions: Sequence[float],
        imu: Imu | None = None,
        loads: LegLoads | None = None,
    ) -> MotionOutput:
        """One control tick at `stamp` [ns]: servo commands [rad] from the command and the sensor data of that tick."""
        motion_command = self.high_level_controller.step(stamp, control_command, odometry)
        output = self.motion_module.step(stamp, motion_command, servo_positions, imu, loads)
        for trajectory in self.trajectory_generator.step(output.leg_states):
            self.motion_module.accept(trajectory)
        return output
