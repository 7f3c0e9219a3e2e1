"""Writing on a thread of its own, so that a slow disk never holds up the subscriptions."""

from __future__ import annotations

import queue
import threading
import time
from dataclasses import dataclass

from nermo_bringup.recording.errors import RecordingError
from nermo_bringup.recording.writer import BagWriter, Topic

FLUSH_PERIOD_S = 0.5
BACKLOG_BYTES = 64 * 2**20


@dataclass(frozen=True, slots=True)
class Message:
    """One serialized message on its way to the disk; times in ns since the epoch."""

    topic: Topic
    log_time: int
    publish_time: int
    sequence: int
    data: bytes


class BackgroundWriter:
    """Owns a `BagWriter` and its thread.

    `put` never blocks: past the backlog limit messages are dropped and counted.
    """

    def __init__(
        self, bag: BagWriter, flush_period: float = FLUSH_PERIOD_S, backlog_bytes: int = BACKLOG_BYTES
    ) -> None:
        self._bag = bag
        self._flush_period = flush_period
        self._backlog_bytes = backlog_bytes
        self._queue: queue.SimpleQueue[Message | Topic | None] = queue.SimpleQueue()
        self._queued_bytes = 0
        self._taken_bytes = 0
        self.dropped = 0
        self.error: RecordingError | None = None
        self._thread = threading.Thread(target=self._run, name="recording", daemon=True)
        self._thread.start()

    @property
    def written(self) -> int:
        """Messages handed to the file so far."""
        return self._bag.message_count

    @property
    def backlog(self) -> int:
        """Bytes that wait to be written."""
        return self._queued_bytes - self._taken_bytes

    def add(self, topic: Topic) -> None:
        """Register a topic even if no message of it ever comes."""
        self._queue.put(topic)

    def put(self, message: Message) -> bool:
        """Hand over one message; False if it was dropped because the disk cannot keep up or writing has failed."""
        size = len(message.data)
        if self.error is not None or self.backlog + size > self._backlog_bytes:
            self.dropped += 1
            return False
        self._queued_bytes += size
        self._queue.put(message)
        return True

    def close(self) -> None:
        """Write all that waits, finish the bag and end the thread.

        Raises:
            RecordingError: writing failed, now or before.
        """
        self._queue.put(None)
        self._thread.join()
        if self.error is not None:
            raise self.error

    def _run(self) -> None:
        try:
            self._write_until_closed()
            self._bag.close()
        except RecordingError as error:
            self.error = error

    def _write_until_closed(self) -> None:
        flush_at = time.monotonic() + self._flush_period
        while True:
            try:
                item = self._queue.get(timeout=max(0.0, flush_at - time.monotonic()))
            except queue.Empty:
                pass
            else:
                if item is None:
                    return
                if isinstance(item, Topic):
                    self._bag.add(item)
                else:
                    self._taken_bytes += len(item.data)
                    self._bag.write(item.topic, item.log_time, item.publish_time, item.sequence, item.data)
            if time.monotonic() >= flush_at:
                self._bag.flush()
                flush_at = time.monotonic() + self._flush_period
