"""The link's messages on a zenoh session."""

from __future__ import annotations

import contextlib
import threading
from typing import Any

import zenoh

from nermo_hw.link.config import LinkConfig, Side, Topic
from nermo_hw.link.log_tap import LogTap
from nermo_hw.link.session import PRIORITIES, open_session
from nermo_hw.link.transport import Answer, LinkError, Receive, Refused

EVENT_QOS = ":1:1:1,1"
DEFAULT_QOS = ":1:0:1,10"
"""Reliability, durability and history as zenoh-plugin-ros2dds writes them: reliable, volatile, keep last 10."""


class ZenohTransport:
    """A `Transport` between the two ends that `config` names."""

    def __init__(self, config: LinkConfig, side: Side) -> None:
        self._config, self._side = config, side
        self._session: zenoh.Session | None = None
        self._publishers: dict[str, Any] = {}
        self._declared: list[Any] = []
        self._lock = threading.Lock()

    def open(self, receive: Receive, answer: Answer) -> None:
        """As `Transport` says."""
        session = open_session(self._config, self._side)
        try:
            with self._lock:
                self._session = session
                self._declare(session, receive, answer)
        except zenoh.ZError as error:
            raise LinkError(f"link: {error}") from error

    def close(self) -> None:
        """As `Transport` says."""
        with self._lock:
            session, self._session = self._session, None
            self._declared.clear()
            self._publishers.clear()
        if session is not None:
            with contextlib.suppress(zenoh.ZError):
                session.close()

    def put(self, key: str, payload: bytes, note: bytes = b"") -> bool:
        """As `Transport` says."""
        with self._lock:
            publisher = self._publishers.get(key)
            if publisher is None:
                return False
            try:
                publisher.put(payload, attachment=note or None)
            except zenoh.ZError:
                return False
            return True

    def ask(self, question: bytes, note: bytes, timeout: float) -> bytes | None:
        """As `Transport` says."""
        session = self._session
        if session is not None:
            with contextlib.suppress(zenoh.ZError):
                key = self._config.release_key
                for reply in session.get(key, payload=question, attachment=note, timeout=timeout):
                    if reply.ok is not None:
                        return bytes(reply.ok.payload)
        return None

    def peers(self) -> list[str]:
        """As `Transport` says: common names where there are certificates, else addresses."""
        session = self._session
        if session is not None:
            with contextlib.suppress(zenoh.ZError):
                return sorted({str(link.auth_identifier or link.dst) for link in session.info.links()})
        return []

    def tell_refused(self, refused: Refused) -> None:
        """As `Transport` says: from zenoh's log."""
        LogTap(refused)

    def _declare(self, session: zenoh.Session, receive: Receive, answer: Answer) -> None:
        config, side = self._config, self._side
        priorities = {topic.key(config.namespace): topic.priority for topic in config.topics}
        for key in config.key_list(side.other):
            self._publishers[key] = _publisher(session, key, priorities.get(key, "real_time"))
        for topic in config.topics:
            self._declared.append(self._token(session, topic))

        def take(sample: zenoh.Sample) -> None:
            note = sample.attachment
            receive(str(sample.key_expr), bytes(sample.payload), b"" if note is None else bytes(note))

        def reply(query: zenoh.Query) -> None:
            with query:
                note = query.attachment
                query.reply(config.release_key, answer(b"" if note is None else bytes(note)))

        for key in config.key_list(side):
            self._declared.append(session.declare_subscriber(key, take))
        if side is Side.ROBOT:
            self._declared.append(session.declare_queryable(config.release_key, reply))

    def _token(self, session: zenoh.Session, topic: Topic) -> Any:
        """Tells an official bridge at the far end that this topic is published or wanted here."""
        key = topic.key(self._config.namespace).replace("/", "§")
        kind = "MS" if topic.to is self._side else "MP"
        qos = EVENT_QOS if topic.kind == "event" else DEFAULT_QOS
        token = f"@/{session.zid()}/@ros2_lv/{kind}/{key}/{topic.type.replace('/', '§')}/{qos}"
        return session.liveliness().declare_token(token)


def _publisher(session: zenoh.Session, key: str, priority: str) -> Any:
    """Sends at once and drops rather than waits: what cannot go now is old when it can."""
    return session.declare_publisher(
        key,
        congestion_control=zenoh.CongestionControl.DROP,
        priority=PRIORITIES[priority],
        express=True,
        reliability=zenoh.Reliability.BEST_EFFORT,
    )
