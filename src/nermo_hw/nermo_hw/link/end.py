"""One end of the link: hands messages over as raw CDR, keeps the connection alive, and knows how it is doing."""

from __future__ import annotations

import contextlib
import os
import socket
import struct
import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

from nermo_description.emergency_stops import EmergencyStops
from nermo_description.silence import GONE, LINK
from nermo_hw.link import stamp
from nermo_hw.link.clock import LinkClock
from nermo_hw.link.config import LinkConfig, Side, Topic
from nermo_hw.link.heartbeat import Ping, Pong
from nermo_hw.link.transport import LinkError, Refused, Transport
from nermo_hw.link.transports import transport_at

LARGEST_NUMBER_OF_ENDS = 16
"""Workstations that are known by name at a time."""

Deliver = Callable[[Topic, bytes, str], None]
"""Gets a message and who sent it: text that tells one workstation's end from another, empty where it does not say."""


@dataclass(slots=True)
class _Outgoing:
    topic: Topic
    key: str
    shortest: float
    """Between two messages [s]."""
    sent_at: float = -1e9


@dataclass(slots=True)
class _FarEnd:
    """A workstation's end, as the robot's knows it."""

    name: str
    heard_at: float
    sequence: int


class LinkEnd:
    """The link at one side.

    deliver: gets each message that came, from a thread of the transport's. clock: this side's [ns]. heard: called, from
    a thread of the transport's, at every sign of life of the far end. stops: what is said and latched at the
    workstation is told to the robot with every heartbeat, and at the robot's end put here. name: of this end, in what
    people read at the other. The stamps that are handed in and out are by this side's clock: the workstation's end
    moves them, by the offset that the heartbeats measure.
    """

    def __init__(
        self,
        config: LinkConfig,
        side: Side,
        deliver: Deliver,
        clock: Callable[[], int],
        heard: Callable[[], None] = lambda: None,
        *,
        stops: EmergencyStops | None = None,
        name: str = "",
        transport: Transport | None = None,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        self.config, self.side = config, side
        self.stops = stops or EmergencyStops()
        self.name = name or f"{socket.gethostname()} (process {os.getpid()})"
        self._id = os.urandom(8)
        self._deliver, self._clock, self._heard = deliver, clock, heard
        self._transport = transport or transport_at(config.endpoint(side))(config, side)
        self._monotonic = monotonic
        self._outgoing = {
            # Half a period early is still in time; nothing is left out for a little jitter.
            topic.name: _Outgoing(topic, topic.key(config.namespace), 0.5 / topic.max_rate if topic.max_rate else 0.0)
            for topic in config.topics
            if topic.to is not side
        }
        self._incoming = {topic.key(config.namespace): topic for topic in config.topics if topic.to is side}
        self._ends: dict[str, _FarEnd] = {}
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._heard_at = self._opened_at = -1e9
        self._sequence = 0
        self._answer_release: Callable[[], str] | None = None
        self.link_clock = LinkClock()
        self.counters: Counter[str] = Counter()

    # Life

    def tell_refused(self, refused: Refused) -> None:
        """Before it is opened: who is turned away is told from now on, as `Transport` says. Once a process."""
        self._transport.tell_refused(refused)

    def open(self, beating: bool = True) -> None:
        """Opens the connection and begins with the heartbeats. Raises LinkError.

        beating: False leaves it to the caller to `beat`.
        """
        self._transport.open(self._on_message, self._on_release)
        self._opened_at = self._monotonic()
        if beating:
            self._thread = threading.Thread(target=self._keep_alive, name="link heartbeat", daemon=True)
            self._thread.start()

    def close(self) -> None:
        """Ends the connection."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join(timeout=5.0)
        self._transport.close()

    def __enter__(self) -> LinkEnd:
        self.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def connected(self) -> bool:
        """Whether the far end was heard lately."""
        return self._monotonic() - self._heard_at < LINK.after

    def wait(self, seconds: float) -> bool:
        """Waits until the far end is heard; false where it is not."""
        deadline = self._monotonic() + seconds
        while not self.connected and self._monotonic() < deadline:
            time.sleep(0.02)
        return self.connected

    # Messages

    def send(self, name: str, payload: bytes) -> bool:
        """Sends a message of a topic of the list; false where it was left out: too soon, too old, or nobody is there.

        Raises KeyError for a topic that does not go this way.
        """
        with self._lock:
            outgoing, now = self._outgoing[name], self._monotonic()
            if now - outgoing.sent_at < outgoing.shortest:
                self.counters["left_out_rate"] += 1
                return False
            if outgoing.topic.kind == "command" and not self._is_fresh(payload):
                return False
            outgoing.sent_at = now
        ready = self._moved(outgoing.topic, payload, 1)
        if ready is None:
            return False
        sent = self._transport.put(outgoing.key, ready, self._id if self.side is Side.WORKSTATION else b"")
        self.counters["sent" if sent else "left_out_no_session"] += 1
        return sent

    def is_due(self, name: str) -> bool:
        """Whether a message of this topic would go out now, as far as its rate is concerned."""
        outgoing = self._outgoing.get(name)
        return outgoing is not None and self._monotonic() - outgoing.sent_at >= outgoing.shortest

    def beat(self) -> None:
        """One heartbeat; also between two, to tell at once what has changed about the stops."""
        now = self._monotonic()
        if self.side is Side.WORKSTATION:
            if now - max(self._heard_at, self._opened_at) > GONE.after:
                self._reopen()
            self._transport.put(self.config.heartbeat_key(Side.ROBOT), self._ping(), self._id)
            return
        with self._lock:
            for identity, end in list(self._ends.items()):
                if now - end.heard_at > GONE.after:
                    self._give_up(identity)

    def ask_release(self, timeout: float = 2.0) -> str:
        """At the workstation: asks the robot to release what is latched; its answer, empty where nothing is left.

        The question brings along what the sources say here, so that none is passed over. Raises LinkError where no
        answer came.
        """
        answer = self._transport.ask(_TRIGGER_REQUEST, self._ping(), timeout)
        if answer is None:
            raise LinkError(f"the robot did not answer {self.config.release_key} within {timeout:g} s")
        left = _trigger_answer(answer)
        if not left:
            self.stops.release()
        return left

    def answer_release(self, release: Callable[[], str]) -> None:
        """At the robot: who does the releasing; what is left comes back in words."""
        self._answer_release = release

    def name_of(self, sender: str) -> str:
        """At the robot: who that is, in words."""
        end = self._ends.get(sender)
        return "a peer without a name" if end is None else end.name

    def status(self) -> dict[str, object]:
        """How the link is doing, for the diagnostics."""
        return {
            "connected": self.connected,
            "peers": ", ".join(self._transport.peers()),
            **{name: f"{value:.3f}" for name, value in self.link_clock.statistics().items()},
            **dict(sorted(self.counters.items())),
        }

    # Inside

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

    def _ping(self) -> bytes:
        with self._lock:
            self._sequence = (self._sequence + 1) & 0xFFFFFFFF
            sequence = self._sequence
        return Ping(sequence, self._clock(), self._id, self.name, self.stops.told()).encode()

    def _keep_alive(self) -> None:
        while not self._stop.wait(1.0 / self.config.heartbeat_rate):
            self.beat()

    def _reopen(self) -> None:
        self.counters["reopened"] += 1
        self._transport.close()
        with contextlib.suppress(LinkError):
            self._transport.open(self._on_message, self._on_release)
        self._opened_at = self._monotonic()

    # From the transport's threads

    def _on_message(self, key: str, payload: bytes, note: bytes) -> None:
        topic = self._incoming.get(key)
        if topic is None:
            with contextlib.suppress(ValueError):  # a heartbeat that is none counts for nothing
                if self.side is Side.ROBOT:
                    self._on_ping(Ping.decode(payload))
                else:
                    self._on_pong(Pong.decode(payload))
            return
        self._alive()
        ready = self._moved(topic, payload, -1)
        if ready is not None:
            self.counters["received"] += 1
            self._deliver(topic, ready, note.hex())

    def _alive(self) -> None:
        self._heard_at = self._monotonic()
        self._heard()

    def _on_ping(self, ping: Ping) -> None:
        self._alive()
        self._take_stops(ping)
        pong = Pong(ping.sequence, ping.sent, self._clock(), ping.end)
        self._transport.put(self.config.heartbeat_key(Side.WORKSTATION), pong.encode())

    def _take_stops(self, ping: Ping) -> None:
        """What an end says counts until it says something else, or is given up. Overtaken heartbeats say nothing."""
        with self._lock:
            identity = ping.end.hex()
            end = self._ends.get(identity)
            if end is not None and ping.sequence < end.sequence:
                return
            if end is None and len(self._ends) >= LARGEST_NUMBER_OF_ENDS:
                self._give_up(min(self._ends, key=lambda other: self._ends[other].heard_at))
            self._ends[identity] = _FarEnd(ping.name, self._monotonic(), ping.sequence)
            self.stops.take(identity, ping.stops)

    def _give_up(self, identity: str) -> None:
        del self._ends[identity]
        self.stops.forget(identity)

    def _on_pong(self, pong: Pong) -> None:
        if pong.end != self._id:  # another workstation's
            return
        if not self.connected:  # it may have started anew, with another clock
            self.link_clock.clear()
        self._alive()
        self.link_clock.add(pong.sent, pong.answered, self._clock())

    def _on_release(self, note: bytes) -> bytes:
        with contextlib.suppress(ValueError):  # an official bridge brings nothing along
            self._take_stops(Ping.decode(note))
        left = "nobody here releases anything" if self._answer_release is None else self._answer_release()
        return _trigger_response(left)


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
