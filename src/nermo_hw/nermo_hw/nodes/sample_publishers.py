"""One sample of the device as ROS messages: the topics, units and names of the twin."""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import BatteryState, Imu, JointState

from nermo_description.battery import BatteryModel
from nermo_description.feet import named_readings
from nermo_description.parameters import LEGS, RobotParameters
from nermo_hw.types import SensorSample
from nermo_interfaces.msg import ServoStates, Tactile
from nermo_node import qos
from nermo_node.time import to_message


@dataclass(frozen=True, slots=True)
class _Topic:
    """A topic, the samples from one of its messages to the next, and how its one message is filled."""

    publisher: Publisher
    every: int
    message: Any
    fill: Callable[[Any, SensorSample], None]


class SamplePublishers:
    """Publishes imu/data_raw, tactile, joint_states (the knees), battery, and last servo_states.

    every: samples from one message to the next by topic; 1 where a topic is not named.
    """

    def __init__(self, node: Node, robot: RobotParameters, frame_prefix: str, every: Mapping[str, int]) -> None:
        self._count = 0
        pack, servos = BatteryModel(), list(robot.servos)
        imu, tactile = Imu(), Tactile()  # covariances are 0, which means unknown (sensor_msgs/Imu)
        imu.header.frame_id = f"{frame_prefix}imu_link"
        tactile.header.frame_id = f"{frame_prefix}base_link"
        battery = BatteryState(
            temperature=math.nan,
            charge=math.nan,
            capacity=math.nan,
            percentage=math.nan,
            design_capacity=pack.capacity,
            power_supply_technology=BatteryState.POWER_SUPPLY_TECHNOLOGY_LIPO,
            power_supply_status=BatteryState.POWER_SUPPLY_STATUS_DISCHARGING,
            present=True,
        )

        def topic(name: str, message: Any, fill: Callable[[Any, SensorSample], None]) -> _Topic:
            return _Topic(node.create_publisher(type(message), name, qos.SENSOR), every.get(name, 1), message, fill)

        self._topics = (
            # The rest goes first: who reads the servo states finds it on its way.
            topic("imu/data_raw", imu, _fill_imu),
            topic("tactile", tactile, _fill_tactile),
            topic("joint_states", JointState(name=[f"{leg}_knee_joint" for leg in LEGS]), _fill_joints),
            topic("battery", battery, _fill_battery),
            topic("servo_states", ServoStates(name=servos, torque=[math.nan] * len(servos)), _fill_servos),
        )

    def publish(self, sample: SensorSample) -> None:
        """Publishes what is due with this sample."""
        stamp = to_message(sample.stamp)
        for topic in self._topics:
            if self._count % topic.every == 0:
                topic.message.header.stamp = stamp
                topic.fill(topic.message, sample)
                topic.publisher.publish(topic.message)
        self._count += 1


def _fill_imu(message: Imu, sample: SensorSample) -> None:
    q, rate, acceleration = message.orientation, message.angular_velocity, message.linear_acceleration
    q.w, q.x, q.y, q.z = sample.orientation.tolist()
    rate.x, rate.y, rate.z = sample.angular_velocity.tolist()
    acceleration.x, acceleration.y, acceleration.z = sample.linear_acceleration.tolist()


def _fill_tactile(message: Tactile, sample: SensorSample) -> None:
    message.name, message.voltage = named_readings(sample.cells)


def _fill_joints(message: JointState, sample: SensorSample) -> None:
    message.position = array("d", sample.knee_angles)


def _fill_battery(message: BatteryState, sample: SensorSample) -> None:
    message.voltage, message.current = sample.battery_voltage, -sample.battery_current


def _fill_servos(message: ServoStates, sample: SensorSample) -> None:
    message.position = array("d", sample.servo_positions)
    message.velocity = array("d", sample.servo_velocities)
    message.current = array("d", sample.servo_currents)
