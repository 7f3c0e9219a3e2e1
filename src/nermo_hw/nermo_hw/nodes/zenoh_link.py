"""Node `zenoh_link`: the workstation's end of the Wi-Fi link. Topics of the list cross it as raw CDR, not decoded."""

from __future__ import annotations

import socket
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node
from rclpy.publisher import Publisher

from nermo_description.commanding import command_time
from nermo_description.parameter_files import ParameterError as FileError
from nermo_hw.link import stamp
from nermo_hw.link.config import DEFAULT, Side, Topic, load_link
from nermo_hw.link.end import LinkEnd
from nermo_hw.link.transport import LinkError
from nermo_hw.nodes.sample_publishers import message_type
from nermo_node import qos
from nermo_node.command_input import CommandInput
from nermo_node.complaints import Complaints
from nermo_node.diagnostics import OK, WARN, Diagnostics, Status
from nermo_node.emergency_stop_input import TOPIC, EmergencyStopInput
from nermo_node.parameters import ParameterError, declare
from nermo_node.run import run

_QOS_IN = {"event": qos.LATCHED, "sensor": qos.BEST_EFFORT}
_QOS_OUT = {"command": qos.COMMAND, "event": qos.LATCHED, "sensor": qos.SENSOR}


class ZenohLinkParameters(BaseModel):
    """Parameters of the node."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    robot: str = Field("nermo_lite", description="Name of the robot, for the diagnostics")
    link: str = Field("", description="The link's YAML file, the same as at the robot; empty: the one that comes along")
    endpoint: str = Field("", description="Where the robot is, as in quic/10.0.0.7:7447?rel=0; empty: as the file says")


class ZenohLinkNode(Node):
    """Hands messages over as they are; the service `release` lets the robot go on after a latched fault."""

    def __init__(self) -> None:
        super().__init__("zenoh_link")
        settings = declare(self, ZenohLinkParameters)
        namespace = self.get_namespace().strip("/")
        overrides: list[tuple[str, object]] = [("namespace", namespace)]
        if settings.endpoint:
            overrides.append(("workstation.endpoints", [settings.endpoint]))
        try:
            config = load_link(Path(settings.link) if settings.link else DEFAULT, overrides)
        except FileError as error:
            raise ParameterError(str(error)) from error
        self._outputs: dict[str, Publisher] = {}
        self._lock = threading.Lock()
        self._connected = False
        self._config = config
        name = f"{socket.gethostname()} {self.get_fully_qualified_name()}"
        self._end = LinkEnd(config, Side.WORKSTATION, self._on_far_message, self._now, name=name)
        self._refused = Complaints(self, "refused")
        self._commands = CommandInput(self, lambda text: self._refused.add([text]), self._now, oldest=None)
        release = MutuallyExclusiveCallbackGroup()
        self._stop_input = EmergencyStopInput(self, self._end.stops, self._end.beat, self._release, release)
        for topic in config.topics:
            kind = _message_type(topic)
            if topic.to is Side.WORKSTATION:
                self._outputs[topic.name] = self.create_publisher(kind, topic.name, _QOS_OUT[topic.kind])
            elif topic.kind == "command":
                self._commands.subscribe(kind, topic.name, self._command_sender(topic), raw=True)
            elif topic.name != TOPIC:  # stops cross with the heartbeat
                self.create_subscription(kind, topic.name, self._sender(topic), _QOS_IN[topic.kind], raw=True)
        parts = {"link": self._status, "commands": self._refused.status, "owner": self._commands.status}
        Diagnostics(self, settings.robot, parts)
        self._end.open()
        self.get_logger().info(f"looking for the robot at {', '.join(config.workstation.endpoints)}")

    def destroy_node(self) -> None:
        """Ends the connection."""
        if hasattr(self, "_end"):  # the constructor may have failed before
            self._end.close()
        super().destroy_node()

    def _now(self) -> int:
        return int(self.get_clock().now().nanoseconds)

    def _sender(self, topic: Topic) -> Any:
        def send(payload: bytes) -> None:
            self._end.send(topic.name, payload)

        return send

    def _command_sender(self, topic: Topic) -> Callable[[bytes], None]:
        oldest = self._config.max_command_age

        def send(payload: bytes) -> None:
            at = stamp.read(payload)
            counts = command_time(at, self._now(), oldest, oldest)
            self._end.send(topic.name, payload if counts == at else stamp.moved(payload, counts - at))

        return send

    def _on_far_message(self, topic: Topic, payload: bytes, _: str) -> None:
        with self._lock:
            self._outputs[topic.name].publish(payload)

    def _release(self) -> str:
        try:
            return self._end.ask_release()
        except LinkError as error:
            return str(error)

    def _status(self) -> Status:
        self._stop_input.forget_the_gone()
        values = self._end.status()
        connected = bool(values["connected"])
        if connected != self._connected:
            self._connected = connected
            self.get_logger().info("the robot is there" if connected else "the robot is not heard any more")
        if not connected:
            return WARN, "the robot is not heard", values
        return OK, f"delay {values.get('delay_p50_ms', '?')} ms", values


def _message_type(topic: Topic) -> type:
    try:
        return message_type(topic.type)
    except (ImportError, AttributeError) as error:
        raise ParameterError(f"topic {topic.name}: the type {topic.type} is not installed") from error


def main() -> int:
    """Runs the node."""
    return run(ZenohLinkNode)


if __name__ == "__main__":
    sys.exit(main())
