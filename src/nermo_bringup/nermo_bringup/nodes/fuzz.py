"""Throws messages at the subscriptions of a node process, which it learns of from ROS, and watches what it does."""

from __future__ import annotations

import json
import os
import pty
import random
import signal
import subprocess
import tempfile
import time
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any

import psutil
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import GetParameters
from rclpy.client import Client
from rclpy.context import Context
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from rclpy.topic_endpoint_info import TopicEndpointInfo

from nermo_bringup.fuzz.messages import spoil, stamp, swell, usual
from nermo_bringup.fuzz.subjects import Subject
from nermo_bringup.launch.executables import find_executable
from nermo_description.robots import AnyRobot, load_any_robot
from nermo_node.network import loopback
from nermo_node.run import EventsExecutor

NAMESPACE = "/fuzz"
PATIENCE = 60.0
"""Time that a node gets to come up, or to answer, before it counts as hanging [s]."""
ROUND = 1.0
"""Time for which one subscription is thrown at, before it is the next one's turn [s]."""
LONGEST_STALL = 0.05
"""What a node may take for one message [s]. A longer one is sent again: what was the machine does not come twice."""
TRIES = 8
DATAGRAM = 60_000
"""Bytes. Of a longer message the machine may drop parts, and DDS sends them again with its next heartbeat, up to 3 s
later. So for these the processor time of the node's thread counts where it is shorter, less what it takes when nobody
sends."""
IDLE = 2.0
"""Time for which the idle node is watched [s]."""
SETTLED = 1.5
"""Time for which no further subscription has been found [s]."""
MOST_EXITS = 5
"""After so many a node is given up."""
COMMANDS = ("/control_command", "/cmd_vel")
"""Topics that have one owner together."""
OF_ROS = ("/parameter_events", "/rosout")
SWOLLEN_SHARE, STAMPED_SHARE = 0.01, 0.8
"""Shares of messages that are much too long, and of those that keep a usable stamp."""


@dataclass
class Outcome:
    """What one node did."""

    node: str
    subscriptions: list[str] = field(default_factory=list)
    messages: int = 0
    refusals: int | None = None
    """As its diagnostics count them; None where it counts none."""
    exits: list[str] = field(default_factory=list)
    """Why it ended, by its own last words."""
    longest_stall_s: float = 0.0
    """Longest time until it answered a question after a message, where repeating the message took as long again."""
    longest_once_s: float = 0.0
    """The same without repeating, with whatever else the machine and DDS did."""
    worst: str = ""
    """Topic of the longest stall."""


def fuzz(subject: Subject, seconds: float, seed: int) -> Outcome:
    """Throws at one node for a time [s]."""
    chance = random.Random(f"{seed} {subject.name}")
    outcome = Outcome(subject.name)
    until = time.monotonic() + seconds
    while time.monotonic() < until and len(outcome.exits) < MOST_EXITS:
        with _Thrower(subject, chance, outcome) as thrower:
            thrower.throw(until)
        if not outcome.subscriptions and not outcome.exits:
            break
    return outcome


class _EndedError(Exception):
    """The node is not there any more."""


class _Thrower:
    """One life of a node, and whoever throws at it."""

    def __init__(self, subject: Subject, chance: random.Random, outcome: Outcome) -> None:
        self._subject, self._chance, self._outcome = subject, chance, outcome
        self._robot: AnyRobot = load_any_robot(subject.robot)
        self._words = tempfile.TemporaryFile("w+")  # noqa: SIM115 - closed with the node
        self._context = Context()
        rclpy.init(context=self._context)
        self._node = Node("thrower", context=self._context)
        self._executor = EventsExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._counted: dict[str, int] = {}
        self._heard = 0
        self._node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, QoSProfile(depth=100))
        self._terminal: int | None = None
        self._process = self._start()
        self._meter = psutil.Process(self._process.pid)
        self._idle_share = 0.0
        self._publishers: dict[str, tuple[type, Publisher]] = {}
        self._swollen: dict[str, bytes | None] = {}

    def __enter__(self) -> _Thrower:
        return self

    def __exit__(self, *_: object) -> None:
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)
            try:
                self._process.wait(10.0)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        if self._terminal is not None:
            os.close(self._terminal)
        self._words.close()
        self._executor.shutdown()
        self._node.destroy_node()
        rclpy.shutdown(context=self._context)

    def throw(self, until: float) -> None:
        """Throws until a time of the monotonic clock [s], or until the node ends; the outcome is noted."""
        try:
            name = self._wait_until_there()
            client = self._node.create_client(GetParameters, f"{name}/get_parameters")
            self._answer(client)
            topics = self._find_topics(name)
            self._outcome.subscriptions = sorted(topics)
            busy = self._busy()
            self._spin_until(lambda: False, IDLE)
            self._idle_share = (self._busy() - busy) / IDLE
            until = max(until, time.monotonic() + 1.0)
            while time.monotonic() < until and topics:
                for topic in topics:
                    end = min(time.monotonic() + ROUND, until)
                    while time.monotonic() < end:
                        self._throw_one(topic, client)
            self._spin_until(lambda: False, 0.1)
            self._note_refusals()
        except _EndedError:
            self._words.seek(0)
            words = [line for line in self._words.read().splitlines() if line.strip()]
            status = self._process.poll()
            said = words[-1][-300:] if words else "no word"
            self._outcome.exits.append(f"status {'none, it hangs' if status is None else status}: {said}")

    def _throw_one(self, topic: str, client: Client[Any, Any]) -> None:
        now = time.time_ns()
        kind, publisher = self._publishers[topic]
        for other in self._usual_beside(topic):
            its_kind, its_publisher = self._publishers[other]
            its_publisher.publish(usual(its_kind, self._robot, now))
        if self._chance.random() < 0.2:
            publisher.publish(usual(kind, self._robot, now))
        packed = self._spoiled(topic, kind, now)
        shortest = PATIENCE
        for attempt in range(TRIES):
            begin, busy = time.monotonic(), self._busy()
            publisher.publish(packed)
            self._outcome.messages += 1
            self._answer(client)
            took = time.monotonic() - begin
            self._outcome.longest_once_s = max(self._outcome.longest_once_s, took)
            if len(packed) < DATAGRAM:
                shortest = min(shortest, took)
            else:
                shortest = min(shortest, took, max(self._busy() - busy - self._idle_share * took, 0.0))
            if (took <= LONGEST_STALL and attempt == 0) or shortest <= self._outcome.longest_stall_s:
                break
        if shortest > self._outcome.longest_stall_s:
            self._outcome.longest_stall_s, self._outcome.worst = shortest, topic

    def _busy(self) -> float:
        """Processor time that the node's own thread has used [s]; the middleware has threads of its own."""
        pid = self._process.pid
        try:
            return sum(
                float(thread.user_time + thread.system_time) for thread in self._meter.threads() if thread.id == pid
            )
        except psutil.NoSuchProcess:
            raise _EndedError from None

    def _usual_beside(self, topic: str) -> list[str]:
        """The other topics, so that the node works; of those that have one owner together, one alone."""
        others = [other for other in self._publishers if other != topic]
        commands = [other for other in others if other.endswith(COMMANDS)]
        return [o for o in others if o not in (commands if topic.endswith(COMMANDS) else commands[1:])]

    def _spoiled(self, topic: str, kind: type, now: int) -> bytes:
        if topic not in self._swollen:
            message = usual(kind, self._robot, now)
            self._swollen[topic] = serialize_message(message) if swell(message) else None
        swollen = self._swollen[topic]
        if swollen is not None and self._chance.random() < SWOLLEN_SHARE:
            return swollen
        message = usual(kind, self._robot, now)
        spoil(message, self._chance)
        if self._chance.random() < STAMPED_SHARE:
            stamp(message, now)
        packed = bytes(serialize_message(message))
        return packed[: self._chance.randrange(len(packed))] if self._chance.random() < SWOLLEN_SHARE else packed

    # The node

    def _start(self) -> subprocess.Popen[bytes]:
        subject = self._subject
        command = [str(find_executable(subject.package, subject.executable)), "--ros-args", "-r", f"__ns:={NAMESPACE}"]
        for name, value in subject.parameters.items():
            command += ["-p", f"{name}:={json.dumps(value if isinstance(value, bool | int | float) else str(value))}"]
        standard_input: int = subprocess.DEVNULL
        if subject.in_terminal:
            self._terminal, standard_input = pty.openpty()
        process = subprocess.Popen(
            command,
            stdin=standard_input,
            stdout=self._words,
            stderr=self._words,
            env=loopback(os.environ),
            start_new_session=True,
        )
        if subject.in_terminal:
            os.close(standard_input)
        return process

    def _wait_until_there(self) -> str:
        """The node's full name."""
        found: list[str] = []

        def there() -> bool:
            found[:] = [
                f"{namespace}/{name}"
                for name, namespace in self._node.get_node_names_and_namespaces()
                if namespace == NAMESPACE
            ]
            return bool(found)

        self._spin_until(there, PATIENCE)
        if not found:
            raise _EndedError
        return found[0]

    def _find_topics(self, name: str) -> list[str]:
        """Topics that the node subscribes; each gets a publisher that it hears."""
        namespace, _, base = name.rpartition("/")
        subscribed: list[tuple[str, list[str]]] = []
        found_at = time.monotonic()

        def settled() -> bool:
            nonlocal subscribed, found_at
            now = self._node.get_subscriber_names_and_types_by_node(base, namespace)
            if now != subscribed:
                subscribed, found_at = now, time.monotonic()
            return time.monotonic() - found_at > SETTLED

        self._spin_until(settled, PATIENCE)
        for topic, kinds in subscribed:
            if topic in OF_ROS:
                continue
            kind = _message_type(kinds[0])
            endpoint = next(e for e in self._node.get_subscriptions_info_by_topic(topic) if e.node_name == base)
            publisher = self._node.create_publisher(kind, topic, _heard_by(endpoint))
            self._publishers[topic] = kind, publisher
            self._spin_until(lambda publisher=publisher: publisher.get_subscription_count() > 0, PATIENCE)
        return list(self._publishers)

    def _answer(self, client: Client[Any, Any]) -> None:
        """Waits until the node has answered a question."""
        if not client.service_is_ready():
            self._spin_until(client.service_is_ready, PATIENCE)
        asked = client.call_async(GetParameters.Request(names=["use_sim_time"]))
        self._spin_until(asked.done, PATIENCE)
        if not asked.done():
            raise _EndedError

    def _spin_until(self, condition: Any, patience: float) -> None:
        """Until a condition holds or the time [s] is over; raises _EndedError where the node ends."""
        deadline = time.monotonic() + patience
        while not condition() and time.monotonic() < deadline:
            if self._process.poll() is not None:
                raise _EndedError
            self._executor.spin_once(timeout_sec=0.02)

    # What it says

    def _note_refusals(self) -> None:
        """Waits for diagnostics that were made after the last message."""
        self._heard = 0
        self._spin_until(lambda: self._heard > 1, 4.0)
        if self._counted:
            self._outcome.refusals = (self._outcome.refusals or 0) + sum(self._counted.values())

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name.startswith(NAMESPACE.lstrip("/")):
                self._heard += 1
                for pair in status.values:
                    if pair.key in ("refused_count", "commands_refused"):
                        self._counted[f"{status.name}/{pair.key}"] = int(pair.value)


def _heard_by(endpoint: TopicEndpointInfo) -> QoSProfile:
    profile = endpoint.qos_profile
    return QoSProfile(depth=20, reliability=profile.reliability, durability=profile.durability)


def _message_type(name: str) -> type:
    package, _, kind = name.split("/")
    found: type = getattr(import_module(f"{package}.msg"), kind)
    return found
