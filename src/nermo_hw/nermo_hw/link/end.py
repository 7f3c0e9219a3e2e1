"""One end of the link: hands messages over as raw CDR, keeps the connection alive, and knows how it is doing."""

from __future__ import annotations

import contextlib
import struct
import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import zenoh

from nermo_hw.link import stamp
from nermo_hw.link.clock import LinkClock
from nermo_hw.link.config import LinkConfig, Side, Topic
from nermo_hw.link.session import PRIORITIES, LinkError, open_session

PING = struct.Struct("<Iq")
"""Sequence and the sender's clock [ns]."""
PONG = struct.Struct("<Iqq")
"""The ping's sequence and time, then the answering clock [ns]."""
HEARD = 0.5
"""Connected means: heard from the far end within this time [s]."""
REOPEN_AFTER = 5.0
"""A workstation that has not heard from the robot for so long [s] opens its session anew: connection set-up over an
unreliable transport can get stuck."""
TRANSIENT_LOCAL_QOS = ":1:1:1,1"
DEFAULT_QOS = ":1:0:1,10"
"""Reliability, durability and history as zenoh-plugin-ros2dds writes them: reliable, volatile, keep last 10."""

Deliver = Callable[[Topic, bytes], None]


@dataclass(slots=True)
class _Outgoing:
    publisher: Any
    shortest: float
    """Between two messages [s]."""
    sent_at: float = -1.0
    last: bytes | None = None
    """Of an event: its present state."""


class LinkEnd:
    """The link at one side.

    deliver: gets each message that came, from a thread of zenoh's. clock: this side's [ns]. heard: called, from a
    thread of zenoh's, at every sign of life of the far end. The stamps that are handed in and out are by this side's
    clock: the workstation's end moves them, by the offset that the heartbeats measure.
    """

    def __init__(
        self,
        config: LinkConfig,
        side: Side,
        deliver: Deliver,
        clock: Callable[[], int],
        heard: Callable[[], None] = lambda: None,
    ) -> None:
        self.config, self.side = config, side
        self._deliver, self._clock, self._heard = deliver, clock, heard
        self._session: zenoh.Session | None = None
        self._outgoing: dict[str, _Outgoing] = {}
        self._incoming = {topic.key(config.namespace): topic for topic in config.topics if topic.to is side}
        self._events: dict[str, bytes] = {}
        self._declared: list[Any] = []
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._heard_at = -1e9
        self._sequence = 0
        self._answer_release: Callable[[], str] | None = None
        self.link_clock = LinkClock()
        self.counters: Counter[str] = Counter()

    # Life

    def open(self) -> None:
        """Opens the session and begins with the heartbeats. Raises LinkError."""
        self._open_session()
        self._thread = threading.Thread(target=self._keep_alive, name="link heartbeat", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Ends the connection."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join(timeout=5.0)
        self._close_session()

    def __enter__(self) -> LinkEnd:
        self.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def connected(self) -> bool:
        """Whether the far end was heard lately."""
        return time.monotonic() - self._heard_at < HEARD

    def wait(self, seconds: float) -> bool:
        """Waits until the far end is heard; false where it is not."""
        deadline = time.monotonic() + seconds
        while not self.connected and time.monotonic() < deadline:
            time.sleep(0.02)
        return self.connected

    # Messages

    def send(self, name: str, payload: bytes) -> bool:
        """Sends a message of a topic of the list; false where it was left out: too soon, too old, or nobody is there.

        Raises KeyError for a topic that does not go this way.
        """
        with self._lock:
            outgoing, topic = self._outgoing[name], self._topic(name)
            if topic.kind == "event":
                outgoing.last = payload
            now = time.monotonic()
            if now - outgoing.sent_at < outgoing.shortest:
                self.counters["left_out_rate"] += 1
                return False
            if topic.kind == "command" and not self._is_fresh(payload):
                return False
            outgoing.sent_at = now
            return self._put(outgoing, topic, payload)

    def is_due(self, name: str) -> bool:
        """Whether a message of this topic would go out now, as far as its rate is concerned."""
        outgoing = self._outgoing.get(name)
        return outgoing is not None and time.monotonic() - outgoing.sent_at >= outgoing.shortest

    def ask_release(self, timeout: float = 2.0) -> str:
        """At the workstation: asks the robot to release what is latched; its answer, empty where nothing is left.

        Raises LinkError where no answer came.
        """
        session = self._session
        if session is not None:
            with contextlib.suppress(zenoh.ZError):
                for reply in session.get(self.config.release_key, payload=_TRIGGER_REQUEST, timeout=timeout):
                    if reply.ok is not None:
                        return _trigger_answer(bytes(reply.ok.payload))
        raise LinkError(f"the robot did not answer {self.config.release_key} within {timeout:g} s")

    def answer_release(self, release: Callable[[], str]) -> None:
        """At the robot: who does the releasing; what is left comes back in words."""
        self._answer_release = release

    def status(self) -> dict[str, object]:
        """How the link is doing, for the diagnostics."""
        peers = []
        session = self._session
        if session is not None:
            with contextlib.suppress(zenoh.ZError):
                peers = sorted({str(link.auth_identifier or link.dst) for link in session.info.links()})
        return {
            "connected": self.connected,
            "peers": ", ".join(peers),
            **{name: f"{value:.3f}" for name, value in self.link_clock.statistics().items()},
            **dict(sorted(self.counters.items())),
        }

    # Inside

    def _topic(self, name: str) -> Topic:
        return next(topic for topic in self.config.topics if topic.name == name)

    def _is_fresh(self, payload: bytes) -> bool:
        try:
            age = self._clock() - stamp.read(payload)
        except ValueError:
            self.counters["left_out_malformed"] += 1
            return False
        if age > self.config.max_command_age * 1e9:
            self.counters["left_out_stale"] += 1
            return False
        return True

    def _moved(self, topic: Topic, payload: bytes, sign: int) -> bytes | None:
        """The message with its stamp on the other clock; None where it has none, or the offset is not known yet."""
        if not topic.stamped or self.side is Side.ROBOT:
            return payload
        offset = self.link_clock.offset
        if offset is None:
            self.counters["left_out_clock_unknown"] += 1
            return None
        try:
            return stamp.moved(payload, sign * offset)
        except ValueError:
            self.counters["left_out_malformed"] += 1
            return None

    def _put(self, outgoing: _Outgoing, topic: Topic, payload: bytes) -> bool:
        ready = self._moved(topic, payload, 1)
        if ready is None:
            return False
        try:
            outgoing.publisher.put(ready)
        except zenoh.ZError:
            self.counters["left_out_no_session"] += 1
            return False
        self.counters["sent"] += 1
        return True

    def _on_sample(self, sample: zenoh.Sample) -> None:
        topic = self._incoming.get(str(sample.key_expr))
        if topic is None:
            return
        self._alive()
        payload = bytes(sample.payload)
        if topic.kind == "event":
            if self._events.get(topic.name) == payload:
                return
            self._events[topic.name] = payload
        ready = self._moved(topic, payload, -1)
        if ready is not None:
            self.counters["received"] += 1
            self._deliver(topic, ready)

    def _alive(self) -> None:
        self._heard_at = time.monotonic()
        self._heard()

    def _on_ping(self, sample: zenoh.Sample) -> None:
        payload = bytes(sample.payload)
        if len(payload) != PING.size:
            return
        self._alive()
        sequence, sent = PING.unpack(payload)
        with self._lock, contextlib.suppress(zenoh.ZError):
            if self._session is not None:
                self._heartbeat.put(PONG.pack(sequence, sent, self._clock()))

    def _on_pong(self, sample: zenoh.Sample) -> None:
        payload = bytes(sample.payload)
        if len(payload) != PONG.size:
            return
        if not self.connected:  # it may have started anew, with another clock
            self.link_clock.clear()
        self._alive()
        _, sent, answered = PONG.unpack(payload)
        self.link_clock.add(sent, answered, self._clock())

    def _on_release(self, query: zenoh.Query) -> None:
        with query:
            left = "nobody here releases anything" if self._answer_release is None else self._answer_release()
            query.reply(self.config.release_key, _trigger_response(left))

    def _keep_alive(self) -> None:
        period = 1.0 / self.config.heartbeat_rate
        opened = time.monotonic()
        while not self._stop.wait(period):
            if self.side is Side.WORKSTATION:
                now = time.monotonic()
                if now - max(self._heard_at, opened) > REOPEN_AFTER:
                    self.counters["reopened"] += 1
                    self._close_session()
                    with contextlib.suppress(LinkError):
                        self._open_session()
                    opened = time.monotonic()
                self._ping()
            self._repeat_events()

    def _ping(self) -> None:
        self._sequence = (self._sequence + 1) & 0xFFFFFFFF
        with self._lock, contextlib.suppress(zenoh.ZError):
            if self._session is not None:
                self._heartbeat.put(PING.pack(self._sequence, self._clock()))

    def _repeat_events(self) -> None:
        with self._lock:
            for name, outgoing in self._outgoing.items():
                if outgoing.last is not None and self._session is not None:
                    self._put(outgoing, self._topic(name), outgoing.last)

    # The session

    def _open_session(self) -> None:
        session = open_session(self.config, self.side)
        config, namespace = self.config, self.config.namespace
        try:
            with self._lock:
                self._session = session
                self._heartbeat = _publisher(session, config.heartbeat_key(self.side.other), "real_time")
                for topic in config.topics:
                    if topic.to is not self.side:
                        publisher = _publisher(session, topic.key(namespace), topic.priority)
                        before = self._outgoing.get(topic.name)
                        # Half a period early is still in time; nothing is left out for a little jitter.
                        shortest = 0.5 / topic.max_rate if topic.max_rate else 0.0
                        self._outgoing[topic.name] = _Outgoing(
                            publisher, shortest, last=before.last if before else None
                        )
                for topic in config.topics:
                    self._declared.append(self._token(session, topic))
                for key in self._incoming:
                    self._declared.append(session.declare_subscriber(key, self._on_sample))
                answer = self._on_ping if self.side is Side.ROBOT else self._on_pong
                self._declared.append(session.declare_subscriber(config.heartbeat_key(self.side), answer))
                if self.side is Side.ROBOT:
                    self._declared.append(session.declare_queryable(config.release_key, self._on_release))
        except zenoh.ZError as error:
            raise LinkError(f"link: {error}") from error

    def _token(self, session: zenoh.Session, topic: Topic) -> Any:
        """Tells an official bridge at the far end that this topic is published or wanted here."""
        key = topic.key(self.config.namespace).replace("/", "§")
        kind = "MS" if topic.to is self.side else "MP"
        qos = TRANSIENT_LOCAL_QOS if topic.kind == "event" else DEFAULT_QOS
        token = f"@/{session.zid()}/@ros2_lv/{kind}/{key}/{topic.type.replace('/', '§')}/{qos}"
        return session.liveliness().declare_token(token)

    def _close_session(self) -> None:
        with self._lock:
            session, self._session = self._session, None
            self._declared.clear()
        if session is not None:
            with contextlib.suppress(zenoh.ZError):
                session.close()


def _publisher(session: zenoh.Session, key: str, priority: str) -> Any:
    """Sends at once and drops rather than waits: what cannot go now is old when it can."""
    return session.declare_publisher(
        key,
        congestion_control=zenoh.CongestionControl.DROP,
        priority=PRIORITIES[priority],
        express=True,
        reliability=zenoh.Reliability.BEST_EFFORT,
    )


# std_srvs/Trigger as CDR, little-endian.

_CDR_HEADER = b"\x00\x01\x00\x00"
_TRIGGER_REQUEST = _CDR_HEADER + b"\x00"


def _trigger_response(left: str) -> bytes:
    text = left.encode() + b"\x00"
    return _CDR_HEADER + struct.pack("<B3xI", not left, len(text)) + text


def _trigger_answer(payload: bytes) -> str:
    try:
        success, length = struct.unpack_from("<B3xI", payload, len(_CDR_HEADER))
        text = payload[len(_CDR_HEADER) + 8 :][: max(length - 1, 0)].decode()
    except (struct.error, UnicodeDecodeError) as error:
        raise LinkError(f"the robot's answer cannot be read: {error}") from error
    return "" if success else text
