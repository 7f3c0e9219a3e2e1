"""Node `state_publisher`: truth/odom, or servo_states and imu/data_raw -> odom and TF of base_footprint and base_link.

The transforms of the joints come from `robot_state_publisher`, which reads the URDF and joint_states.
"""

from __future__ import annotations

import math
import sys

from geometry_msgs.msg import Quaternion as QuaternionMessage
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry
from pydantic import Field
from rclpy.node import Node
from sensor_msgs.msg import Imu
from tf2_msgs.msg import TFMessage

from nermo_control.nodes import conversions
from nermo_control.nodes.robot import RobotChoice
from nermo_control.odometry import BaseState, LegOdometry, Quaternion
from nermo_interfaces.msg import ServoStates
from nermo_node import qos, run
from nermo_node.complaints import Complaints
from nermo_node.diagnostics import OK, WARN, Diagnostics, Status, Ticks
from nermo_node.inputs import Inputs
from nermo_node.parameters import declare
from nermo_node.time import to_nanoseconds


class StatePublisherParameters(RobotChoice):
    """Parameters of the node."""

    use_truth: bool = Field(
        True,
        description="Take the pose from truth/odom, of a twin or a tracking system; otherwise by dead reckoning",
        json_schema_extra={"readOnly": True},
    )
    frame_prefix: str = Field(
        "", description="In front of every frame name, as in mouse_1/", json_schema_extra={"readOnly": True}
    )
    tf_rate: float = Field(
        50.0,
        ge=1.0,
        le=1000.0,
        description="Highest rate of the transforms; odom comes with every tick",
        json_schema_extra={"unit": "Hz", "readOnly": True},
    )
    lockstep: bool = Field(
        False,
        description="The robot waits for each answer, so every sample must arrive",
        json_schema_extra={"readOnly": True},
    )


class StatePublisherNode(Node):
    """Publishes odom with the stamp of the tick it belongs to: it is what the high-level controller ticks with."""

    def __init__(self) -> None:
        super().__init__("state_publisher")
        parameters = declare(self, StatePublisherParameters)
        robot = parameters.load()
        self._use_truth = parameters.use_truth
        self._prefix = parameters.frame_prefix
        self._tf_period = round(1e9 / parameters.tf_rate)
        self._tf_stamp: int | None = None
        self._servos = conversions.ServoArrays(robot)
        self._legs = LegOdometry(robot)
        self._imu: Imu | None = None
        self._refused = Complaints(self, "refused")
        self._ticks = Ticks()

        self._odometry = self.create_publisher(Odometry, "odom", qos.SENSOR)
        self._transforms = self.create_publisher(TFMessage, "/tf", qos.TRANSFORM)
        inputs, reading = Inputs(self, self._refused.add_one), qos.sensor_input(parameters.lockstep)
        if parameters.use_truth:
            inputs.subscribe(Odometry, "truth/odom", self._publish, reading)
        else:
            inputs.subscribe(Imu, "imu/data_raw", self._on_imu, reading)
            inputs.subscribe(ServoStates, "servo_states", self._on_servo_states, reading)
        Diagnostics(self, robot.name, {"state": self._state, "messages": self._refused.status})

    def _on_imu(self, message: Imu) -> None:
        self._imu = message

    def _on_servo_states(self, message: ServoStates) -> None:
        positions = self._servos.positions(message)
        orientation, yaw_rate = None, 0.0
        if self._imu is not None:
            yaw_rate = self._imu.angular_velocity.z
            if self._imu.orientation_covariance[0] != -1.0:  # REP-145: -1 where there is no orientation
                orientation = _quaternion(self._imu.orientation)
        state = self._legs.step(to_nanoseconds(message.header.stamp), positions, orientation, yaw_rate)
        self._publish(_to_message(state))

    def _publish(self, odometry: Odometry) -> None:
        odometry.header.frame_id = f"{self._prefix}odom"
        odometry.child_frame_id = f"{self._prefix}base_link"
        self._odometry.publish(odometry)
        self._ticks.count()
        stamp = to_nanoseconds(odometry.header.stamp)
        if self._tf_stamp is None or not 0 <= stamp - self._tf_stamp < self._tf_period:
            self._tf_stamp = stamp
            self._transforms.publish(TFMessage(transforms=self._base_transforms(odometry)))

    def _base_transforms(self, odometry: Odometry) -> list[TransformStamped]:
        """Odom -> base_footprint: level, on the ground; base_footprint -> base_link: height and tilt (REP-105)."""
        position = odometry.pose.pose.position
        w, x, y, z = _quaternion(odometry.pose.pose.orientation)
        yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        c, s = math.cos(0.5 * yaw), math.sin(0.5 * yaw)

        footprint = TransformStamped(header=odometry.header, child_frame_id=f"{self._prefix}base_footprint")
        footprint.transform.translation.x, footprint.transform.translation.y = position.x, position.y
        footprint.transform.rotation.w, footprint.transform.rotation.z = c, s

        base = TransformStamped(child_frame_id=f"{self._prefix}base_link")
        base.header.stamp = odometry.header.stamp
        base.header.frame_id = footprint.child_frame_id
        base.transform.translation.z = position.z
        base.transform.rotation = _quaternion_message((c * w + s * z, c * x + s * y, c * y - s * x, c * z - s * w))
        return [footprint, base]

    def _state(self) -> Status:
        ticks = self._ticks.since_told()
        values = {"source": "truth" if self._use_truth else "legs", "ticks_in_last_second": ticks}
        if ticks == 0:
            return WARN, "no truth/odom" if self._use_truth else "no servo_states", values
        if not self._use_truth and self._imu is None:
            return WARN, "no imu/data_raw: the heading is not known", values
        return OK, "running", values


def _to_message(state: BaseState) -> Odometry:
    message = Odometry(header=conversions.header(state.stamp))
    pose, twist = message.pose.pose, message.twist.twist
    pose.position.x, pose.position.y, pose.position.z = state.position
    pose.orientation = _quaternion_message(state.orientation)
    twist.linear.x, twist.linear.y, twist.linear.z = state.linear_velocity
    twist.angular.z = state.turn_rate
    return message


def _quaternion(message: QuaternionMessage) -> Quaternion:
    return message.w, message.x, message.y, message.z


def _quaternion_message(quaternion: Quaternion) -> QuaternionMessage:
    w, x, y, z = quaternion
    return QuaternionMessage(w=w, x=x, y=y, z=z)


def main() -> int:
    """Runs the node."""
    return run(StatePublisherNode)


if __name__ == "__main__":
    sys.exit(main())
