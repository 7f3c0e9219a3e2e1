"""Node `recorder`: every topic of the graph into one MCAP bag, from its start on or as ~/record says.

Topics are discovered as they appear. Messages are taken serialized, as they were on the wire. The subscriptions are
not spun by an executor but drained on a timer, many messages at a time: that costs a fraction of one dispatch a
message, and loses no timing, because the middleware notes when a message was sent and when it arrived.
"""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import rclpy
from pydantic import BaseModel, ConfigDict, Field
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo
from std_srvs.srv import SetBool

from nermo_bringup.recording.background_writer import BackgroundWriter, Message
from nermo_bringup.recording.errors import RecordingError
from nermo_bringup.recording.qos import Offer, Request, request_for
from nermo_bringup.recording.schema import ros2msg
from nermo_bringup.recording.taps import LossCounter, TopicFilter, dated_directory
from nermo_bringup.recording.writer import BagWriter, Topic
from nermo_node import diagnostics, run
from nermo_node.parameters import declare

DISCOVERY_PERIOD_S = 0.25
DRAIN_PERIOD_S = 0.02


class RecorderParameters(BaseModel):
    """Parameters of the recorder."""

    model_config = ConfigDict(frozen=True)

    directory: str = Field("", description="bag directory to create; empty: one named by date and time in recordings/")
    include: str = Field("*", description="shell patterns of the topics to record, separated by spaces")
    exclude: str = Field("", description="shell patterns of the topics to leave out, separated by spaces")
    waits: bool = Field(False, description="record only from when ~/record says so")


@dataclass(slots=True)
class _Tap:
    """One recorded topic: its place in the bag and the subscription that feeds it."""

    topic: Topic
    subscription: Subscription[Any]
    request: Request
    losses: LossCounter


class Recorder(Node):
    """Records until it is shut down; a recording error ends it.

    ``~/record`` (SetBool) ends the recording, and begins another beside it.
    """

    _writer: BackgroundWriter | None = None
    """Where messages go; None while nothing is recorded."""
    _listener: Node | None = None

    def __init__(self) -> None:
        # Its last words come after the graph has gone, so they go to the console alone.
        super().__init__("recorder", enable_rosout=False)
        parameters = declare(self, RecorderParameters)
        named = Path(parameters.directory) if parameters.directory else None
        self._parent = Path("recordings") if named is None else named.parent
        self._wanted = TopicFilter(parameters.include, parameters.exclude)
        self._taps: dict[str, _Tap] = {}
        self._refused: set[str] = set()
        self._directory = named or dated_directory(self._parent)
        if not parameters.waits:
            self._begin()
        # Recording goes on while a simulation is paused, so its timers run on the machine's clock.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(DISCOVERY_PERIOD_S, self._discover, clock=steady)
        self.create_timer(DRAIN_PERIOD_S, self._drain, clock=steady)
        self.create_service(SetBool, "~/record", self._on_record)
        diagnostics.Diagnostics(self, "recorder", {"recording": self._status})

    def destroy_node(self) -> None:
        """Take what has arrived, finish the bag, then leave the graph."""
        try:
            if self._writer is not None:
                self._end()
        finally:
            super().destroy_node()

    def _on_record(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        if request.data == (self._writer is not None):
            response.message = f"{self._directory} is being recorded already" if request.data else "nothing is recorded"
            return response
        try:
            if request.data:
                if self._directory.exists():
                    self._directory = dated_directory(self._parent)
                self._begin()
                response.message = f"recording into {self._directory}"
            else:
                response.message = self._end()
        except RecordingError as error:
            response.message = str(error)
            return response
        response.success = True
        return response

    def _begin(self) -> None:
        """Raises RecordingError."""
        self._writer = BackgroundWriter(BagWriter(self._directory))
        self._taps, self._refused = {}, set()
        # A node without an executor carries the subscriptions: only the drain takes their messages.
        self._listener = rclpy.create_node(
            f"_{self.get_name()}_taps",
            context=self.context,
            namespace=self.get_namespace(),
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=False,
        )
        self.get_logger().info(f"recording into {self._directory}")
        self._discover()

    def _end(self) -> str:
        """Takes what has arrived and finishes the bag; how much there is. Raises RecordingError."""
        writer = self._writer
        assert writer is not None
        try:
            self._drain()
            writer.close()
        finally:
            self._writer = None
            if self._listener is not None:
                self._listener.destroy_node()
                self._listener = None
        said = f"recorded {writer.written} messages, dropped {writer.dropped}"
        self.get_logger().info(said)
        return f"{said}: {self._directory}"

    def _discover(self) -> None:
        if self._writer is None:
            return
        for name, types in self.get_topic_names_and_types():
            if not self._wanted(name):
                continue
            publishers = self.get_publishers_info_by_topic(name)
            if not publishers:
                continue
            offers = [_offer(publisher) for publisher in publishers]
            if name not in self._taps:
                self._tap(name, types, _type_hash(publishers[0]), offers)
            else:
                self._retap(self._taps[name], offers)

    def _tap(self, name: str, types: list[str], type_hash: str, offers: list[Offer]) -> None:
        assert self._writer is not None
        if name in self._refused:
            return
        try:
            if len(types) != 1:
                raise RecordingError(f"its publishers disagree on its type: {', '.join(types)}")
            topic = Topic(name, types[0], ros2msg(types[0]), type_hash, offers)
            request = request_for(offers)
            self._taps[name] = _Tap(topic, self._subscribe(topic, request), request, LossCounter())
        except (RecordingError, ImportError, AttributeError) as error:
            self._refused.add(name)
            self.get_logger().warning(f"{name} is not recorded: {error}")
            return
        self._writer.add(topic)

    def _retap(self, tap: _Tap, offers: list[Offer]) -> None:
        """Subscribe anew when publishers came that the present subscription could not hear."""
        request = request_for(offers)
        known = set(tap.topic.offers)
        tap.topic.offers.extend(offer for offer in offers if offer not in known)
        if tap.request.reliable <= request.reliable and tap.request.transient_local <= request.transient_local:
            return
        self._drain_tap(tap)
        assert self._listener is not None
        self._listener.destroy_subscription(tap.subscription)
        tap.subscription = self._subscribe(tap.topic, request)
        tap.request = request

    def _subscribe(self, topic: Topic, request: Request) -> Subscription[Any]:
        package, _, name = topic.type.split("/")
        message_type = getattr(importlib.import_module(f"{package}.msg"), name)
        qos = QoSProfile(
            depth=request.depth,
            reliability=ReliabilityPolicy.RELIABLE if request.reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if request.transient_local else DurabilityPolicy.VOLATILE,
        )
        assert self._listener is not None
        return self._listener.create_subscription(message_type, topic.name, _never_called, qos, raw=True)

    def _drain(self) -> None:
        if self._writer is None:
            return
        if self._writer.error is not None:
            raise self._writer.error
        for tap in self._taps.values():
            self._drain_tap(tap)

    def _drain_tap(self, tap: _Tap) -> None:
        assert self._writer is not None
        subscription = tap.subscription
        with subscription.handle:
            while (taken := subscription.handle.take_message(subscription.msg_type, True)) is not None:
                data, info = taken
                sequence = info["publication_sequence_number"] or 0
                if sequence and info["publisher_gid"]:
                    tap.losses.see(info["publisher_gid"]["data"], sequence)
                self._writer.put(
                    Message(
                        tap.topic,
                        log_time=info["received_timestamp"],
                        publish_time=info["source_timestamp"],
                        sequence=sequence & 0xFFFFFFFF,
                        data=data,
                    )
                )

    def _status(self) -> diagnostics.Status:
        if self._writer is None:
            return diagnostics.OK, "waits", {}
        lost = {name: tap.losses.lost for name, tap in self._taps.items() if tap.losses.lost}
        dropped, missing = self._writer.dropped, sum(lost.values())
        values = {
            "directory": self._directory,
            "topics": len(self._taps),
            "messages_written": self._writer.written,
            "messages_dropped": dropped,
            "messages_lost": missing,
            "lost_by_topic": " ".join(f"{name}={count}" for name, count in lost.items()),
            "backlog_bytes": self._writer.backlog,
        }
        if dropped or missing:
            return diagnostics.WARN, f"dropped {dropped}, lost {missing} messages", values
        return diagnostics.OK, "recording", values


def _never_called(_: bytes) -> None:
    """Callback of the drained subscriptions; no executor spins them."""


def _type_hash(publisher: TopicEndpointInfo) -> str:
    """RIHS01 hash of a publisher's type; empty where its middleware does not tell."""
    text = str(publisher.topic_type_hash)
    return text if text.startswith("RIHS") else ""


def _offer(publisher: TopicEndpointInfo) -> Offer:
    qos = publisher.qos_profile
    return Offer(
        reliability=qos.reliability.short_key,
        durability=qos.durability.short_key,
        history=qos.history.short_key,
        depth=qos.depth,
        deadline_ns=_nanoseconds(qos.deadline),
        lifespan_ns=_nanoseconds(qos.lifespan),
        liveliness=qos.liveliness.short_key,
        lease_ns=_nanoseconds(qos.liveliness_lease_duration),
    )


def _nanoseconds(duration: Duration) -> int:
    return int(duration.nanoseconds)


def main() -> int:
    """Run the recorder."""
    return run(Recorder)
