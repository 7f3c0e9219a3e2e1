"""Who may command, and when a command counts."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from nermo_description.commanding import Ownership, RefusedCommandError, command_time

SECOND = 10**9
WALL = 1_800_000_000 * SECOND
SIMULATED = 42 * SECOND


def test_the_first_sender_keeps_the_robot_until_it_is_silent() -> None:
    ownership: Ownership[str] = Ownership(silence=0.5)
    assert ownership.owner(0) is None
    ownership.heard("keyboard", 0)
    assert ownership.admits("keyboard", SECOND // 2)
    assert not ownership.admits("pad", SECOND // 2)
    assert ownership.admits("pad", SECOND // 2 + 1)


def test_a_sender_that_was_only_looked_at_owns_nothing() -> None:
    ownership: Ownership[str] = Ownership()
    assert ownership.admits("noise", 0)
    assert ownership.admits("keyboard", 1)


@given(st.lists(st.tuples(st.sampled_from("abc"), st.integers(0, SECOND)), max_size=40))
def test_two_senders_are_never_mixed(arrivals: list[tuple[str, int]]) -> None:
    """Between the commands of two senders that were obeyed there is always the whole silence."""
    ownership: Ownership[str] = Ownership(silence=0.5)
    now, obeyed = 0, []
    for sender, pause in arrivals:
        now += pause
        if ownership.admits(sender, now):
            ownership.heard(sender, now)
            obeyed.append((sender, now))
    for (before, earlier), (after, later) in pairwise(obeyed):
        assert before == after or later - earlier > SECOND // 2


def test_a_stamp_near_now_is_kept_and_a_missing_one_is_now() -> None:
    assert command_time(SIMULATED - 1, SIMULATED, 0.3, 0.1) == SIMULATED - 1
    assert command_time(0, SIMULATED, 0.3, 0.1) == SIMULATED
    assert command_time(0, WALL, 0.3, 0.1) == WALL


def test_the_first_tick_of_a_clock_that_begins_at_zero_keeps_its_stamp() -> None:
    assert command_time(0, 5_000_000, 0.3, 0.1) == 0


@pytest.mark.parametrize(
    ("stamp", "now", "says"),
    [
        (WALL, SIMULATED, r"wall clock's.*/clock.*use_sim_time:=true"),
        (SIMULATED, WALL, r"simulation's.*wall clock.*use_sim_time:=false"),
        (SIMULATED - SECOND, SIMULATED, r"stale: 1\.000 s old, at most 0\.3 s"),
        (SIMULATED + SECOND, SIMULATED, r"1\.000 s in the future, at most 0\.1 s"),
        (-SECOND, SIMULATED, r"43\.000 s old"),
    ],
)
def test_any_other_stamp_is_refused_with_its_remedy(stamp: int, now: int, says: str) -> None:
    with pytest.raises(RefusedCommandError, match=says):
        command_time(stamp, now, 0.3, 0.1)
