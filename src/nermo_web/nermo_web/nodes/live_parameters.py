"""The parameters of the graph's nodes that may be changed while they run, through the nodes' own services."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterDescriptor, ParameterEvent, ParameterType, ParameterValue
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import qos_profile_parameter_events

LOOK_PERIOD_S = 2.0
"""Between two looks which nodes there are."""
UNSEEN = ("use_sim_time", "start_type_description_service", "qos_overrides.")
"""Parameters that ROS itself gives every node."""

_FIELDS = {
    ParameterType.PARAMETER_BOOL: ("bool", "bool_value", bool),
    ParameterType.PARAMETER_INTEGER: ("integer", "integer_value", int),
    ParameterType.PARAMETER_DOUBLE: ("number", "double_value", float),
    ParameterType.PARAMETER_STRING: ("text", "string_value", str),
    ParameterType.PARAMETER_DOUBLE_ARRAY: ("numbers", "double_array_value", list),
}
"""Name for the page, field of the message and Python type of each type that the page can change."""


class _Subject:
    """One node: its client, and what is known of its parameters."""

    def __init__(self, client: AsyncParameterClient) -> None:
        self.client = client
        self.described: dict[str, ParameterDescriptor] = {}
        self.values: dict[str, Any] = {}
        self.asked = False

    def forget(self) -> None:
        """The node is gone. Its client stays for when it comes back: nobody destroys the services of one."""
        self.described, self.values, self.asked = {}, {}, False


class LiveParameters:
    """What there is to set, by node, always up to date: nodes come and go, and others set parameters too.

    Args:
        node: The node that asks; its own parameters and those of other namespaces are left out.
        changed: Called when there is something new to tell.
    """

    def __init__(self, node: Node, changed: Callable[[], None]) -> None:
        self._node, self._changed = node, changed
        self._subjects: dict[str, _Subject] = {}
        node.create_subscription(ParameterEvent, "/parameter_events", self._on_event, qos_profile_parameter_events)
        node.create_timer(LOOK_PERIOD_S, self._look, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def table(self) -> list[dict[str, Any]]:
        """Nodes, each with `node` and its `parameters`: `name`, `type`, `value`, `text`, `lower`, `upper`."""
        nodes = []
        for name, subject in sorted(self._subjects.items()):
            rows = [
                _row(each, subject.values[each.name])
                for each in subject.described.values()
                if each.name in subject.values
            ]
            if rows:
                nodes.append({"node": name, "parameters": rows})
        return nodes

    def set(self, node: str, name: str, value: Any, answer: Callable[[bool, str], None]) -> None:
        """Sets a parameter; `answer` gets whether it was taken, and the node's own words where it was not."""
        subject = self._subjects.get(node)
        if subject is None or name not in subject.described:
            answer(False, f"{node} has no parameter {name!r} that can be changed")
            return
        kind, field, python = _FIELDS[subject.described[name].type]
        if not _fits(value, python):
            answer(False, f"{node}: {name} is a {kind}, not {value!r}")
            return
        if not subject.client.services_are_ready():
            answer(False, f"{node} does not answer")
            return
        message = ParameterMessage(name=name, value=ParameterValue(type=subject.described[name].type))
        setattr(message.value, field, [float(one) for one in value] if python is list else python(value))

        def done(future: Any) -> None:
            results = future.result().results
            if results and results[0].successful:
                subject.values[name] = parameter_value_to_python(message.value)
                answer(True, f"{node}: {name} = {value}")
            else:
                answer(False, f"{node}: {results[0].reason if results else 'no answer'}")
            self._changed()

        subject.client.set_parameters([message], done)

    def _look(self) -> None:
        own, space = self._node.get_name(), self._node.get_namespace()
        there = {name for name, where in self._node.get_node_names_and_namespaces() if where == space and name != own}
        for name, subject in self._subjects.items():
            if name not in there and subject.asked:
                subject.forget()
                self._changed()
        for name in there:
            if name.startswith("_"):
                continue
            if name not in self._subjects:
                self._subjects[name] = _Subject(AsyncParameterClient(self._node, name))
            subject = self._subjects[name]
            if not subject.asked and subject.client.services_are_ready():
                subject.asked = True
                self._ask(subject)

    def _ask(self, subject: _Subject) -> None:
        def listed(future: Any) -> None:
            names = [name for name in future.result().result.names if not name.startswith(UNSEEN)]
            if names:
                subject.client.describe_parameters(names, described)

        def described(future: Any) -> None:
            found = [each for each in future.result().descriptors if not each.read_only and each.type in _FIELDS]
            subject.described = {each.name: each for each in found}
            if found:
                subject.client.get_parameters(list(subject.described), got)

        def got(future: Any) -> None:
            values = map(parameter_value_to_python, future.result().values)
            subject.values = dict(zip(subject.described, values, strict=False))
            self._changed()

        subject.client.list_parameters(callback=listed)

    def _on_event(self, message: ParameterEvent) -> None:
        space, _, name = message.node.rpartition("/")
        subject = self._subjects.get(name)
        if subject is None or (space or "/") != self._node.get_namespace():
            return
        if any(each.name not in subject.described for each in message.new_parameters):
            subject.asked = False  # it has started anew, or has more than it had
        for each in (*message.new_parameters, *message.changed_parameters):
            if each.name in subject.described:
                subject.values[each.name] = parameter_value_to_python(each.value)
                self._changed()


def _fits(value: Any, python: type) -> bool:
    """Whether a value from the page is one of a type; whole numbers are numbers too, and booleans are none."""
    if python in (int, float):
        return isinstance(value, (int, float) if python is float else int) and not isinstance(value, bool)
    return isinstance(value, python)


def _row(described: ParameterDescriptor, value: Any) -> dict[str, Any]:
    row = {
        "name": described.name,
        "type": _FIELDS[described.type][0],
        "value": [_shown(each) for each in value] if _FIELDS[described.type][2] is list else _shown(value),
        "text": described.description,
    }
    limits = [*described.floating_point_range, *described.integer_range]
    if limits:
        row |= {"lower": _finite(limits[0].from_value), "upper": _finite(limits[0].to_value)}
    return row


def _shown(value: Any) -> Any:
    """A value that JSON has: a number that is none becomes nothing."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _finite(limit: float) -> float | None:
    """A limit that JSON and a slider can have."""
    return limit if abs(limit) < 1e9 else None
