"""Nothing unusable gets through the door."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from nermo_description.servo_command import RefusedCommandError, ServoCommandDoor

SERVOS = ("hip", "knee", "tail")
NOW = 1_000_000_000


@pytest.fixture
def door() -> ServoCommandDoor:
    return ServoCommandDoor(SERVOS, oldest=0.2)


@given(st.permutations(list(zip(SERVOS, (0.1, 0.2, 0.3), strict=True))))
def test_any_order_is_matched_by_name(pairs: list[tuple[str, float]]) -> None:
    names, positions = zip(*pairs, strict=True)
    assert ServoCommandDoor(SERVOS, 0.2).open(NOW, names, positions, NOW) == [0.1, 0.2, 0.3]


@pytest.mark.parametrize(
    ("names", "positions", "stamp", "message"),
    [
        (SERVOS, [0.0, 0.0], NOW, "3 names but 2 positions"),
        (("hip", "knee", "wing"), [0.0] * 3, NOW, "unknown servo wing: the robot has hip, knee, tail"),
        (("hip", "knee"), [0.0] * 2, NOW, "2 servos named, 3 needed: tail missing"),
        (("hip", "knee", "tail", "tail"), [0.0] * 4, NOW, "named twice"),
        (SERVOS, [0.0, math.nan, 0.0], NOW, "position of knee = nan rad"),
        (SERVOS, [0.0, 0.0, -math.inf], NOW, "position of tail = -inf rad"),
        (SERVOS, [math.inf, -math.inf, 0.0], NOW, "allowed -10 to 10 rad"),
        (SERVOS, [0.0] * 3, NOW + 1, "in the future"),
        (SERVOS, [0.0] * 3, NOW - 200_000_001, "stale: 0.200 s old"),
    ],
)
def test_unusable_command_is_refused(
    door: ServoCommandDoor, names: tuple[str, ...], positions: list[float], stamp: int, message: str
) -> None:
    with pytest.raises(RefusedCommandError, match=message):
        door.open(stamp, names, positions, NOW)
    assert door.open(NOW, SERVOS, [0.0] * 3, NOW) == [0.0] * 3


def test_each_stamp_opens_once_and_only_forwards(door: ServoCommandDoor) -> None:
    door.open(NOW, SERVOS, [0.0] * 3, NOW)
    with pytest.raises(RefusedCommandError, match="repeated"):
        door.open(NOW, SERVOS, [0.0] * 3, NOW)
    with pytest.raises(RefusedCommandError, match="out of order"):
        door.open(NOW - 1, SERVOS, [0.0] * 3, NOW)


def test_a_command_without_a_stamp_counts_as_now(door: ServoCommandDoor) -> None:
    assert door.open(0, SERVOS, [0.1] * 3, NOW) == [0.1] * 3
    with pytest.raises(RefusedCommandError, match="repeated"):
        door.open(NOW, SERVOS, [0.0] * 3, NOW)


def test_another_clock_is_named(door: ServoCommandDoor) -> None:
    with pytest.raises(RefusedCommandError, match="use_sim_time:=true"):
        door.open(1_800_000_000 * 10**9, SERVOS, [0.0] * 3, NOW)
