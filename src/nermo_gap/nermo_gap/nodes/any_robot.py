"""Topics of any robot, compared with its nominal model: what a map names is subscribed, whatever its type."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message

from nermo_node.diagnostics import OK, WARN, Status
from nermo_node.inputs import LARGEST_MESSAGE
from simgap.data.bag import MessageColumns
from simgap.data.errors import GapInputError
from simgap.data.mapping import load_map
from simgap.data.plant import build_plant, load_spec
from simgap.data.recording import load_recording
from simgap.monitoring.monitor import KEPT, SPAN, Monitor

_LOOK, _COMPARE = 1.0, 0.25
"""[s] between two looks for topics, and between two comparisons."""


class AnyRobot:
    """A robot whose topics are named by a map.

    Args:
        node: Whose subscriptions and timers these are.
        model, map_: Paths of the nominal MJCF and of the map.
        reference: Path of a bag of the robot when it was well, or empty.
        refuse: Gets a sentence for every message that cannot be used.

    Raises:
        GapInputError: model, map or reference cannot be used.
    """

    def __init__(self, node: Node, model: str, map_: str, reference: str, refuse: Callable[[str], None]) -> None:
        self._node, self._refuse = node, refuse
        plant = build_plant(load_spec(model), load_map(map_))
        self._gathered = MessageColumns(plant.map, "topics")
        self._monitor = Monitor(plant, [load_recording(reference, plant)] if reference else [])
        self._subscribed: set[str] = set()
        self._came = False
        self._trouble = ""
        self.name = Path(model).stem
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        node.create_timer(_LOOK, self._look, clock=steady)
        node.create_timer(_COMPARE, self._compare, clock=steady)

    def _look(self) -> None:
        """Subscribe what has appeared by now."""
        known = dict(self._node.get_topic_names_and_types())
        for topic in set(self._gathered.topics) - self._subscribed:
            name = self._node.resolve_topic_name(topic)
            publishers = self._node.get_publishers_info_by_topic(name)
            if not publishers or name not in known:
                continue
            package, _, kind = known[name][0].split("/")
            try:
                message = getattr(importlib.import_module(f"{package}.msg"), kind)
            except (ImportError, AttributeError):
                self._refuse(f"{topic}: its type {package}/{kind} is not installed here")
                continue
            reliable = all(p.qos_profile.reliability == ReliabilityPolicy.RELIABLE for p in publishers)
            profile = QoSProfile(
                depth=200, reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT
            )
            self._node.create_subscription(message, topic, self._taker(topic, message), profile, raw=True)
            self._subscribed.add(topic)

    def _taker(self, topic: str, kind: type) -> Callable[[bytes], None]:
        def take(packed: bytes) -> None:
            if len(packed) > LARGEST_MESSAGE:
                self._refuse(f"{topic} refused: {len(packed)} bytes: allowed are {LARGEST_MESSAGE}")
                return
            try:
                message: Any = deserialize_message(packed, kind)
                self._gathered.take(topic, self._node.get_clock().now().nanoseconds, message)
            except (RuntimeError, GapInputError) as error:
                self._refuse(f"{topic} refused: {error}")
                return
            self._came = True

        return take

    def _compare(self) -> None:
        """Hand what has come to the monitor, and tell what it says once."""
        if not self._came or self._gathered.silent:
            return
        self._came = False
        try:
            changes = self._monitor.update(self._gathered.columns()[0])
            self._trouble = ""
        except GapInputError as error:
            changes, self._trouble = [], str(error)
        self._gathered.forget(KEPT)
        for change in changes:
            self._node.get_logger().warning(change.sentence)

    def status(self) -> Status:
        """The gap by part, and which parts are stale."""
        monitor, silent = self._monitor, self._gathered.silent
        values: dict[str, object] = {f"{name}_gap": round(value, 2) for name, value in monitor.gap.items()}
        values |= {f"{name}_usual": round(value, 2) for name, value in monitor.usual.items()}
        if silent:
            return WARN, f"nothing to compare: no message of {', '.join(silent)}", values
        if self._trouble or monitor.waits:
            return WARN, f"nothing to compare: {self._trouble or monitor.waits}", values
        if monitor.stale:
            worst = max(monitor.stale, key=lambda name: monitor.gap.get(name, 0.0))
            size = f"{monitor.gap.get(worst, 0.0):.1f} noise floors where {monitor.usual[worst]:.1f} are usual"
            return WARN, f"the model goes stale: {worst}, {size}", values
        if monitor.learned < 1.0:
            return OK, f"learning what is usual, {100 * monitor.learned:.0f} %", values
        return OK, f"robot and model agree over the last {SPAN:g} s", values
