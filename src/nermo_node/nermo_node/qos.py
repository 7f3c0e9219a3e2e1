"""The kinds of topics: commands, questions and answers, latched parameters, sensors, transforms."""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

COMMAND = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
"""Commands, for both sides: reliable, and only the newest counts."""

COMMAND_INPUT = QoSProfile(depth=20, reliability=ReliabilityPolicy.RELIABLE)
"""Commands of several publishers, for the subscriber: with a depth of 1, whoever floods the topic pushes the others'
newest command out before it is seen."""

EVENT = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)
"""Questions and answers between nodes, for both sides: each counts, also where a busy machine lets a node wait. At
200 Hz this is 0.5 s of ticks: longer than a node may be silent while the mouse walks."""

LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""Parameters, for both sides: who comes late gets the last one."""

STATE = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""States of several publishers, for the subscriber: as LATCHED, but none of a burst is passed over. Whoever floods the
topic pushes the others' states out: of 10 that are kept a stop was never seen (20 000 messages a second), of 1000 it
was after 3.5 s."""

SENSOR = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
"""Sensor data, for the publisher: reliable, so that whoever needs every sample can have it."""

BEST_EFFORT = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Sensor data, for the subscriber: an old sample is not worth sending again."""

TRANSFORM = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)
"""The topic /tf, as tf2 has it."""


def sensor_input(lockstep: bool) -> QoSProfile:
    """How a node reads sensor data: in lockstep nothing may be lost, otherwise the next sample comes soon."""
    return SENSOR if lockstep else BEST_EFFORT
