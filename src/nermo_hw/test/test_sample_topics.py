"""One sample of the device becomes the same messages at the cable and over the link."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from rclpy.serialization import deserialize_message

from nermo_description.robots import load_robot
from nermo_hw.link.messages import SensorMessages
from nermo_hw.nodes.sample_publishers import message_type
from nermo_hw.sample_topics import SAMPLE_TOPICS, fill
from nermo_hw.types import Fault, SensorSample

ROBOT = load_robot("nermo_lite")
SERVOS = len(ROBOT.servos)
SAMPLE = SensorSample(
    stamp=1_234_567_890_123_456_789,
    elapsed=0.005,
    servo_positions=np.arange(SERVOS) * 0.1,
    servo_velocities=np.arange(SERVOS) * -0.2,
    servo_currents=np.full(SERVOS, 0.3),
    knee_angles=np.array([0.1, 0.2, 0.3, 0.4]),
    cells={"piezoresistive": np.array([1.0, 2.0, 3.0, 4.0])},
    orientation=np.array([0.5, -0.5, 0.5, -0.5]),
    angular_velocity=np.array([1.0, 2.0, 3.0]),
    linear_acceleration=np.array([0.0, 0.1, 9.81]),
    battery_voltage=7.5,
    battery_current=0.5,
    faults=Fault(0),
    limp=False,
)


@pytest.mark.parametrize("name", SAMPLE_TOPICS)
def test_a_message_over_the_link_is_the_one_at_the_cable(name: str) -> None:
    topic = SAMPLE_TOPICS[name]
    payload = dict(SensorMessages(ROBOT).of(SAMPLE))[name]
    crossed = deserialize_message(payload, message_type(topic.type))
    published = message_type(topic.type)()
    published.header.frame_id = topic.frame
    published.header.stamp.sec, published.header.stamp.nanosec = divmod(SAMPLE.stamp, 10**9)
    fill(published, topic.fixed(ROBOT), list)
    fill(published, topic.fields(SAMPLE), list)
    assert str(crossed) == str(published)  # NaN is not equal to itself


def test_a_device_without_sensors_says_nothing_of_those_that_it_has_not() -> None:
    blind = replace(SAMPLE, blind=True)
    assert list(dict(SensorMessages(ROBOT).of(blind))) == ["battery", "servo_states"]


def test_what_is_not_due_is_not_made() -> None:
    due = dict(SensorMessages(ROBOT).of(SAMPLE, lambda name: name != "battery"))
    assert set(due) == set(SAMPLE_TOPICS) - {"battery"}
    assert list(due)[-1] == "servo_states", "who reads the servo states finds the rest on its way"
