"""The twin's sensor data and ground truth as ROS messages. Messages are built once and refilled each tick."""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from builtin_interfaces.msg import Time
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import BatteryState, Imu, JointState

from nermo_description.battery_model import Battery
from nermo_description.feet import named_readings
from nermo_interfaces.msg import FootForces, ServoStates, Tactile
from nermo_node import qos
from nermo_node.time import to_message
from nermo_sensors.models.foot import TactileFeet
from nermo_sensors.parameters import tactile_of_robot
from nermo_sim.sensor_data import SensorData
from nermo_sim.twin import BaseState, Twin


@dataclass(frozen=True, slots=True)
class _Topic:
    """A topic, the ticks from one of its messages to the next, and how its one message is filled."""

    publisher: Publisher
    every: int
    message: Any
    fill: Callable[[Any, SensorData], None]


class SensorPublishers:
    """Publishes one tick of a twin; `rates` are in Hz by topic, as whole parts of the control rate."""

    def __init__(
        self, node: Node, twin: Twin[Any], frame_prefix: str, rates: dict[str, float], publish_clock: bool
    ) -> None:
        self._twin = twin
        self._tick = 0
        self._battery = Battery()
        self._tactile = TactileFeet(tactile_of_robot(twin.robot.name))
        self._tactile_period = 1.0 / rates["tactile"]
        self._clock = node.create_publisher(Clock, "/clock", qos.SENSOR) if publish_clock else None
        self._clock_message = Clock()
        self._published: list[_Topic] = []
        """What the last tick has published."""

        def topic(name: str, message: Any, fill: Callable[[Any, SensorData], None]) -> _Topic:
            publisher = node.create_publisher(type(message), name, qos.SENSOR)
            return _Topic(publisher, round(1e9 / twin.period_ns / rates[name]), message, fill)

        servos, joints = list(twin.layout.servos), list(twin.layout.joints)
        self._topics = (
            # Ground truth and IMU go first: who reads the servo states finds the rest of the tick on its way.
            topic("truth/odom", _odometry_message(frame_prefix), self._fill_odometry),
            topic("imu/data_raw", _imu_message(frame_prefix), self._fill_imu),
            topic("truth/foot_forces", _foot_forces_message(frame_prefix), self._fill_foot_forces),
            topic("tactile", Tactile(), self._fill_tactile),
            topic("joint_states", JointState(name=joints), self._fill_joints),
            topic("battery", _battery_message(self._battery), self._fill_battery),
            topic("servo_states", ServoStates(name=servos, current=[math.nan] * len(servos)), self._fill_servos),
        )

    def publish(self, sensors: SensorData) -> None:
        """Publishes what is due in this tick, `/clock` first and `servo_states` last."""
        stamp = to_message(sensors.stamp)
        self._draw_power(sensors)
        self._published = [topic for topic in self._topics if self._tick % topic.every == 0]
        self._tick += 1
        self._publish_clock(stamp)
        for topic in self._published:
            topic.message.header.stamp = stamp
            topic.fill(topic.message, sensors)
            topic.publisher.publish(topic.message)

    def repeat(self) -> None:
        """Publishes the last tick once more, as it was, for who has missed it."""
        self._publish_clock(self._clock_message.clock)
        for topic in self._published:
            topic.publisher.publish(topic.message)

    def clear(self) -> None:
        """Forgets what sensors remember, after a reset."""
        self._tactile.clear()

    def _publish_clock(self, stamp: Time) -> None:
        if self._clock is not None:
            self._clock_message.clock = stamp
            self._clock.publish(self._clock_message)

    def _draw_power(self, sensors: SensorData) -> None:
        pairs = zip(sensors.servo_torques, sensors.servo_velocities, strict=True)
        self._battery.draw(sum(abs(torque * velocity) for torque, velocity in pairs), self._twin.period_ns * 1e-9)

    def _fill_servos(self, message: ServoStates, sensors: SensorData) -> None:
        message.position = array("d", sensors.servo_positions)
        message.velocity = array("d", sensors.servo_velocities)
        message.torque = array("d", sensors.servo_torques)

    def _fill_imu(self, message: Imu, sensors: SensorData) -> None:
        q, rate, acceleration = message.orientation, message.angular_velocity, message.linear_acceleration
        q.w, q.x, q.y, q.z = sensors.orientation
        rate.x, rate.y, rate.z = sensors.angular_velocity
        acceleration.x, acceleration.y, acceleration.z = sensors.linear_acceleration

    def _fill_odometry(self, message: Odometry, sensors: SensorData) -> None:
        fill_odometry(message, self._twin.base_state())

    def _fill_foot_forces(self, message: FootForces, sensors: SensorData) -> None:
        forces, touching = self._twin.foot_forces()
        for vector, force in zip(message.force, forces.tolist(), strict=True):
            vector.x, vector.y, vector.z = force
        message.contact = list(touching)

    def _fill_tactile(self, message: Tactile, sensors: SensorData) -> None:
        message.name, message.voltage = named_readings(self._tactile.read(sensors.foot_forces, self._tactile_period))

    def _fill_joints(self, message: JointState, sensors: SensorData) -> None:
        positions, velocities = self._twin.joint_states()
        message.position, message.velocity = array("d", positions), array("d", velocities)

    def _fill_battery(self, message: BatteryState, sensors: SensorData) -> None:
        battery = self._battery
        message.voltage, message.current = battery.voltage, -battery.current
        message.percentage, message.charge = battery.charge, battery.charge * battery.model.capacity


def _odometry_message(frame_prefix: str) -> Odometry:
    message = Odometry(child_frame_id=f"{frame_prefix}base_link")
    message.header.frame_id = f"{frame_prefix}odom"
    return message


def _imu_message(frame_prefix: str) -> Imu:
    # All covariances stay zero, which Imu.msg has for "unknown"; -1 would say that there is no such measurement.
    message = Imu()
    message.header.frame_id = f"{frame_prefix}imu_link"
    return message


def _foot_forces_message(frame_prefix: str) -> FootForces:
    message = FootForces()
    message.header.frame_id = f"{frame_prefix}odom"
    return message


def _battery_message(battery: Battery) -> BatteryState:
    return BatteryState(
        temperature=math.nan,
        design_capacity=battery.model.capacity,
        power_supply_technology=BatteryState.POWER_SUPPLY_TECHNOLOGY_LIPO,
        power_supply_status=BatteryState.POWER_SUPPLY_STATUS_DISCHARGING,
        present=True,
    )


def fill_odometry(message: Odometry, state: BaseState) -> None:
    """Sets pose and twist to the truth."""
    pose, twist = message.pose.pose, message.twist.twist
    pose.position.x, pose.position.y, pose.position.z = state.position
    q = pose.orientation
    q.w, q.x, q.y, q.z = state.quaternion
    twist.linear.x, twist.linear.y, twist.linear.z = state.linear_velocity
    twist.angular.x, twist.angular.y, twist.angular.z = state.angular_velocity
