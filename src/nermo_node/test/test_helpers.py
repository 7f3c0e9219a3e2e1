"""Stamps, lockstep and the way from models to parameters, without a graph."""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel

from nermo_node.parameters import flatten
from nermo_node.synchronizer import LARGEST_BACKLOG, TickSynchronizer
from nermo_node.time import to_message, to_nanoseconds


@given(st.integers(0, 2**31 * 10**9 - 1))
def test_stamps_come_back(nanoseconds: int) -> None:
    message = to_message(nanoseconds)
    assert 0 <= message.nanosec < 10**9
    assert to_nanoseconds(message) == nanoseconds


@pytest.mark.parametrize("nanoseconds", [-1, 2**31 * 10**9])
def test_a_stamp_out_of_range_is_refused(nanoseconds: int) -> None:
    with pytest.raises(ValueError, match="allowed 0 to"):
        to_message(nanoseconds)


class Fired(list[tuple[int, dict[str, Any]]]):
    def __call__(self, stamp: int, values: Mapping[str, Any]) -> None:
        self.append((stamp, dict(values)))


@given(st.permutations([(name, stamp) for stamp in range(5) for name in "ab"]))
def test_a_tick_fires_once_when_it_is_complete(arrivals: list[tuple[str, int]]) -> None:
    fired = Fired()
    synchronizer = TickSynchronizer("ab", fired)
    for name, stamp in arrivals:
        synchronizer.add(name, stamp, (name, stamp))
    stamps = [stamp for stamp, _ in fired]
    assert all(values == {"a": ("a", stamp), "b": ("b", stamp)} for stamp, values in fired)
    assert len(set(stamps)) == len(stamps)


def test_in_order_every_tick_fires() -> None:
    fired = Fired()
    synchronizer = TickSynchronizer("ab", fired)
    for stamp in range(10):
        synchronizer.add("a", stamp, 1)
        synchronizer.add("b", stamp, 2)
    assert [stamp for stamp, _ in fired] == list(range(10))


def test_a_repeated_question_is_answered_again_and_an_older_one_is_dropped() -> None:
    fired = Fired()
    synchronizer = TickSynchronizer("ab", fired)
    synchronizer.add("a", 1, 1)
    synchronizer.add("a", 2, 1)
    synchronizer.add("b", 2, 2)
    synchronizer.add("b", 2, 3)
    synchronizer.add("b", 1, 2)
    assert fired == [(2, {"a": 1, "b": 2}), (2, {"a": 1, "b": 3})]


def test_a_source_alone_does_not_fill_the_memory() -> None:
    fired = Fired()
    synchronizer = TickSynchronizer("ab", fired)
    for stamp in range(10 * LARGEST_BACKLOG):
        synchronizer.add("a", stamp, None)
    synchronizer.add("b", 0, None)
    synchronizer.add("b", 10 * LARGEST_BACKLOG - 1, None)
    assert [stamp for stamp, _ in fired] == [10 * LARGEST_BACKLOG - 1]


def test_an_unknown_input_is_refused() -> None:
    with pytest.raises(KeyError):
        TickSynchronizer("ab", Fired()).add("c", 0, None)


class Colour(IntEnum):
    RED = 1


class Inner(BaseModel):
    length: float = 1.0
    pair: tuple[float, float] = (1.0, 2.0)


class Outer(BaseModel):
    inner: Inner = Inner()
    named: dict[str, Inner] = {"a": Inner(length=3.0)}
    colour: Colour = Colour.RED
    path: Path = Path("/tmp")


def test_a_nested_model_becomes_dotted_parameters() -> None:
    assert flatten(Outer()) == {
        "inner.length": 1.0,
        "inner.pair": [1.0, 2.0],
        "named.a.length": 3.0,
        "named.a.pair": [1.0, 2.0],
        "colour": 1,
        "path": "/tmp",
    }
