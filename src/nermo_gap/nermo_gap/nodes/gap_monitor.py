"""Node `gap_monitor`: a model beside the robot, told the same [c]; their gap part by part on /diagnostics.

Of the mouse a twin runs on its own servo_command; of any other robot, parameters `model` and `map` say which topics
are compared.
"""

from __future__ import annotations

import sys
from typing import Protocol

from pydantic import BaseModel, ConfigDict, Field, model_validator
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu, JointState

from nermo_description.parameters import LEGS
from nermo_description.robots import load_robot
from nermo_gap.robots.channels import GYRO, encoder, position
from nermo_gap.robots.live import FAR, LiveGap
from nermo_interfaces.msg import ServoCommand, ServoStates
from nermo_node import qos, run
from nermo_node.complaints import Complaints
from nermo_node.diagnostics import OK, WARN, Diagnostics, Status
from nermo_node.inputs import Inputs
from nermo_node.parameters import blame, declare
from nermo_node.time import to_message, to_nanoseconds

SHOWN_PERIOD_S = 0.04
"""Between two messages of what the twin does, for eyes."""


class GapMonitorParameters(BaseModel):
    """Parameters of the node."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    robot: str = Field("nermo_lite", description="Name of a mouse, or path of its parameter file")
    control_rate: int = Field(
        200, ge=10, le=1000, description="Ticks of the twin a second", json_schema_extra={"unit": "Hz"}
    )
    model: str = Field("", description="Of another robot: path of its nominal model, an MJCF")
    map: str = Field("", description="Of another robot: path of the map from topics to the model")
    reference: str = Field("", description="Of another robot: a bag of it when it was well; else it learns for 10 s")

    @model_validator(mode="after")
    def _both(self) -> GapMonitorParameters:
        if bool(self.model) != bool(self.map):
            raise ValueError("model and map are of another robot than the mouse and go together; give both or none")
        return self


class Watched(Protocol):
    """Who is compared with its model."""

    name: str

    def status(self) -> Status:
        """The gap just now."""


class GapMonitor(Node):
    """Tells on /diagnostics how far a robot and its model are apart."""

    def __init__(self) -> None:
        super().__init__("gap_monitor")
        parameters = declare(self, GapMonitorParameters)
        refused = Complaints(self, "refused")
        watched: Watched
        if parameters.model:
            # What other robots need takes seconds to import.
            from nermo_gap.nodes.any_robot import AnyRobot

            with blame("model, map or reference"):
                watched = AnyRobot(self, parameters.model, parameters.map, parameters.reference, refused.add_one)
        else:
            watched = Mouse(self, parameters, refused)
        Diagnostics(self, watched.name, {"gap": watched.status, "messages": refused.status})


class Mouse:
    """Tells the twin what the robot is told, and compares what the two measure."""

    def __init__(self, node: Node, parameters: GapMonitorParameters, refused: Complaints) -> None:
        with blame("robot"):
            robot = load_robot(parameters.robot)
        with blame("control_rate"):
            self._gap = LiveGap(robot, round(1e9 / parameters.control_rate))
        self.name = robot.name
        self._shown_at = 0
        self._twin_joints = node.create_publisher(JointState, "twin/joint_states", qos.SENSOR)
        # A command that is missed would let the twin go another way.
        every = QoSProfile(depth=200, reliability=ReliabilityPolicy.RELIABLE)
        inputs = Inputs(node, refused.add_one)
        inputs.subscribe(ServoCommand, "servo_command", self._on_command, every)
        inputs.subscribe(ServoStates, "servo_states", self._on_states, qos.BEST_EFFORT)
        inputs.subscribe(JointState, "joint_states", self._on_joints, qos.BEST_EFFORT)
        inputs.subscribe(Imu, "imu/data_raw", self._on_imu, qos.BEST_EFFORT)

    def _on_command(self, message: ServoCommand) -> None:
        if len(message.name) == len(message.position):
            positions = dict(zip(message.name, message.position, strict=True))
            stamp = to_nanoseconds(message.header.stamp)
            self._gap.command(stamp, positions)
            self._show(stamp)

    def _show(self, stamp: int) -> None:
        """What the twin does, for whoever draws it beside the robot."""
        if 0 <= stamp - self._shown_at < SHOWN_PERIOD_S * 1e9 or not (angles := self._gap.joints):
            return
        self._shown_at = stamp
        shown = JointState(name=list(angles), position=list(angles.values()))
        shown.header.stamp = to_message(stamp)
        self._twin_joints.publish(shown)

    def _on_states(self, message: ServoStates) -> None:
        values = {position(name): value for name, value in zip(message.name, message.position, strict=False)}
        self._gap.measured(to_nanoseconds(message.header.stamp), values)

    def _on_joints(self, message: JointState) -> None:
        angles = dict(zip(message.name, message.position, strict=False))
        knees = {encoder(leg): angles[f"{leg}_knee_joint"] for leg in LEGS if f"{leg}_knee_joint" in angles}
        self._gap.measured(to_nanoseconds(message.header.stamp), knees)

    def _on_imu(self, message: Imu) -> None:
        rate = message.angular_velocity
        self._gap.measured(to_nanoseconds(message.header.stamp), dict(zip(GYRO, (rate.x, rate.y, rate.z), strict=True)))

    def status(self) -> Status:
        """See Watched."""
        gap = self._gap.gap()
        values = {f"{name.replace(' ', '_')}_gap": round(value, 2) for name, value in gap.items()}
        values["restarts"] = self._gap.restarts
        if not gap:
            return WARN, "nothing to compare: no servo_command, or nothing measured", values
        worst = max(gap, key=lambda name: gap[name])
        if gap[worst] > FAR:
            return WARN, f"the {worst} is {gap[worst]:.1f} sensor resolutions from its twin", values
        return OK, "robot and twin agree", values


def main() -> int:
    """Runs the node."""
    return run(GapMonitor)


if __name__ == "__main__":
    sys.exit(main())
