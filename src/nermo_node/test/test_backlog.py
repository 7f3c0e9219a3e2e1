"""What a node leaves out where more comes than it can take, in a queue and a time that are made up."""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Callable

import pytest

from nermo_node import backlog
from nermo_node.backlog import LATE_S, MANY, PROBE_S, TELL_S, Backlog

DROP_S = 3e-5


class Queue:
    """The events executor in virtual time: one queue, served in the order in which things happened."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = 0.0
        self.executor = self
        self._waiting: deque[Callable[[], None]] = deque()
        self._coming: list[tuple[float, int, Callable[[], None]]] = []
        monkeypatch.setattr(backlog.time, "monotonic", lambda: self.now)

    def create_task(self, task: Callable[[], None]) -> None:
        self._waiting.append(task)

    def at(self, time: float, what: Callable[[], None]) -> None:
        heapq.heappush(self._coming, (time, len(self._coming), what))

    def run(self) -> None:
        while self._coming or self._waiting:
            if not self._waiting:
                self.now = max(self.now, self._coming[0][0])
            while self._coming and self._coming[0][0] <= self.now:
                self._waiting.append(heapq.heappop(self._coming)[2])
            self._waiting.popleft()()


class Receiver:
    """Takes messages, each for a time; hears a stop at once when its turn comes."""

    def __init__(self, queue: Queue, takes_s: float, helped: bool = True) -> None:
        self.queue, self._takes_s, self._helped = queue, takes_s, helped
        self.told: list[str] = []
        self.taken = 0
        self.late: list[float] = []
        self._backlog = Backlog(queue, self.told.append)  # type: ignore[arg-type]

    def message(self) -> None:
        if self._helped and self._backlog.leaves_out():
            self.queue.now += DROP_S
            return
        self.taken += 1
        self.queue.now += self._takes_s

    def stop(self, said: float) -> None:
        self.late.append(self.queue.now - said)

    def flood(self, rate: float, seconds: float, begin: float = 0.0) -> None:
        for k in range(int(rate * seconds)):
            self.queue.at(begin + k / rate, self.message)
        for k in range(int(10 * seconds)):
            said = begin + k / 10
            self.queue.at(said, lambda said=said: self.stop(said))


@pytest.mark.parametrize(("rate", "takes_s"), [(400.0, 5e-3), (1000.0, 2e-3), (14000.0, 1e-4), (1200.0, 9e-4)])
def test_a_stop_does_not_wait_behind_a_flood(monkeypatch: pytest.MonkeyPatch, rate: float, takes_s: float) -> None:
    receiver = Receiver(Queue(monkeypatch), takes_s)
    receiver.flood(rate, 10.0)
    receiver.queue.run()
    assert max(receiver.late) < PROBE_S + 2.0 * LATE_S + MANY * takes_s
    busy = receiver.taken * takes_s
    assert busy > 0.5 * min(10.0, 10.0 * rate * takes_s), "what can be taken is"
    without = Receiver(Queue(monkeypatch), takes_s, helped=False)
    without.flood(rate, 10.0)
    without.queue.run()
    if rate * takes_s > 1.1:
        assert max(without.late) > 1.0, "or there was nothing to help"
        assert receiver.told and all("left out, unread" in sentence for sentence in receiver.told)


def test_nothing_is_left_out_of_what_can_be_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    receiver = Receiver(Queue(monkeypatch), 5e-4)
    receiver.flood(1000.0, 5.0)
    # The process is not let run for a while, again and again, with what a sensor topic keeps waiting.
    for k in range(20):
        receiver.queue.at(0.11 + 0.25 * k, lambda: setattr(receiver.queue, "now", receiver.queue.now + 0.004))
    receiver.queue.run()
    assert receiver.taken == 5000
    assert not receiver.told


def test_all_is_taken_again_after_a_flood(monkeypatch: pytest.MonkeyPatch) -> None:
    receiver = Receiver(Queue(monkeypatch), 5e-3)
    receiver.flood(2000.0, 2.0)
    receiver.queue.run()
    assert receiver.told
    before, told = receiver.taken, len(receiver.told)
    receiver.flood(100.0, 1.0, begin=receiver.queue.now + 1.0)
    receiver.queue.run()
    assert receiver.taken - before == 100
    assert len(receiver.told) == told


def test_what_was_left_out_is_said_now_and_then_and_none_is_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    receiver = Receiver(Queue(monkeypatch), 5e-3)
    receiver.flood(400.0, 15.0)
    receiver.flood(10.0, 3.0 * TELL_S, begin=15.0)
    receiver.queue.run()
    assert 2 <= len(receiver.told) <= 1 + 15.0 / TELL_S + 1
    said = sum(int(sentence.split(": ")[1].split()[0]) for sentence in receiver.told)
    assert said == 400 * 15 + 10 * 3 * TELL_S - receiver.taken
