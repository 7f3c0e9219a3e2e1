"""One owner of the commands at the link: who else sends, however fresh or early, neither moves it nor starves."""

from __future__ import annotations

from typing import Any

import pytest
from standing import BEGIN, NEUTRAL, SERVOS
from stop_places import Link

from nermo_description.commanding import RefusedCommandError
from nermo_hw.link.config import Side
from nermo_hw.link.end import LinkEnd
from nermo_hw.link.intake import LARGEST_NUMBER_OF_SENDERS, CommandIntake
from nermo_hw.link.messages import decode_diagnostics, encode_command

MS = 1_000_000
TAIL = SERVOS.index("tail")


class Table:
    """A robot between two workstations, `good` and `other`; the robot's tail shows whom it follows."""

    def __init__(self) -> None:
        self.link = Link()
        self.told: dict[str, dict[str, str]] = {}
        self.good, self.other = self._end("good"), self._end("other")
        self.link.pass_time(0.1)
        assert self.link.release() == ""

    def _end(self, name: str) -> LinkEnd:
        wire = self.link.wire.end(Side.WORKSTATION)
        end = LinkEnd(
            self.link.config,
            Side.WORKSTATION,
            self._on_message,
            self.link._clock,
            name=name,
            transport=wire,
            monotonic=self.link._now,
        )
        end.open(beating=False)
        end.beat()
        return end

    def _on_message(self, topic: Any, payload: bytes, _: str) -> None:
        if topic.name == "/diagnostics":
            self.told |= decode_diagnostics(payload)

    def send(self, end: LinkEnd, tail: float, ahead: int = 0) -> None:
        """A command stamped so much ahead [ns]. Heartbeats have measured clocks that are one."""
        positions = NEUTRAL.copy()
        positions[TAIL] = tail
        end.beat()
        end.send("servo_command", encode_command(self.link._clock() + ahead, SERVOS, positions.tolist()))

    def tail(self) -> float:
        return float(self.link.servos._positions[TAIL])

    def run(self, seconds: float, other_ahead: int, good: bool = True) -> None:
        """Both send, the other one more often and first."""
        for _ in range(round(seconds / 0.05)):
            self.send(self.other, -0.5, other_ahead)
            if good:
                self.send(self.good, 0.5)
            self.send(self.other, -0.5, other_ahead + MS)
            self.link.pass_time(0.05)


@pytest.mark.parametrize("ahead", [0, 10 * MS, 1000 * MS, 4 * 10**17])
def test_another_workstation_neither_moves_nor_starves_the_robot_and_is_named(ahead: int) -> None:
    table = Table()
    table.send(table.good, 0.5)
    table.link.pass_time(0.05)
    table.run(3.0, ahead)
    assert table.tail() == pytest.approx(0.5, abs=0.02)
    assert table.told["robot_end: safety"]["state"] == "follow"
    owner = table.told["robot_end: owner"]
    assert owner["owner"] == "good"
    assert owner["message"] == "refused: other has to wait, good commands until it is silent for 0.5 s"


@pytest.mark.parametrize("ahead", [1000 * MS, 4 * 10**17])
def test_who_floods_with_unusable_commands_before_anybody_commands_does_not_keep_the_good_one_out(ahead: int) -> None:
    table = Table()
    table.run(3.0, ahead)
    assert table.tail() == pytest.approx(0.5, abs=0.02)
    assert table.told["robot_end: owner"]["owner"] == "good"


def test_another_may_begin_when_the_owner_is_silent() -> None:
    table = Table()
    table.send(table.good, 0.5)
    table.link.pass_time(0.05)
    table.run(3.0, 0, good=False)
    assert table.told["robot_end: owner"]["owner"] == "other"
    assert table.tail() == pytest.approx(-0.5, abs=0.02)


def test_senders_of_one_tick_are_bounded() -> None:
    intake = CommandIntake(lambda sender: sender, lambda: 0)
    command = encode_command(BEGIN, SERVOS, NEUTRAL.tolist())
    for number in range(LARGEST_NUMBER_OF_SENDERS):
        intake.put(command, str(number))
    with pytest.raises(RefusedCommandError, match="8 others try to command"):
        intake.put(command, "one more")
    assert len(intake.take()) == LARGEST_NUMBER_OF_SENDERS
    assert intake.take() == {}


def test_of_one_sender_the_newest_counts() -> None:
    intake = CommandIntake(lambda sender: sender)
    for at in (2, 3, 1):
        intake.put(encode_command(BEGIN + at, SERVOS, [at] * len(SERVOS)), "a")
    assert intake.take() == {"a": encode_command(BEGIN + 3, SERVOS, [3] * len(SERVOS))}
    with pytest.raises(ValueError, match="no CDR message"):
        intake.put(b"", "a")
