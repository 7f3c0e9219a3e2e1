"""The robot's path over a bad network: needs network namespaces, which CI must have."""

from __future__ import annotations

import os
from collections.abc import Iterator

import numpy as np
import pytest

from nermo_hw.bench import faults
from nermo_hw.bench.faults import INJECTIONS, gait
from nermo_hw.bench.link import Row, measure
from nermo_hw.bench.network import Network, NoNamespacesError
from nermo_hw.bench.rig import Rig
from nermo_hw.safety.rules import Cause, State

pytestmark = pytest.mark.ros  # one by one: watchdogs and time-outs of real processes do not go with a busy processor


def namespaces() -> str:
    """Why there are none; empty where there are."""
    try:
        Network().close()
    except NoNamespacesError as error:
        return str(error.strerror)
    return ""


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    if missing := namespaces():
        text = f"what a bad network does to commands was not tried: {missing}"
        if os.environ.get("CI"):
            pytest.fail(text)
        pytest.skip(text)
    with Rig(tmp_path_factory.mktemp("rig")) as made:
        made.walker("gait", postures=gait(made.robot).tolist())
        yield made


def test_nothing_stale_is_executed_over_a_lossy_reordering_network(rig: Rig) -> None:
    # On a busy machine the device itself is late; what a network brings back from before is older than that.
    row = measure(rig, Row(delay_ms=20.0, jitter_ms=10.0, loss=0.2, reorder=True), 200, oldest_ms=1000.0)
    assert row["stale_executed"] == 0
    assert 0.0 < row["executed"] < 0.95
    assert row["latency_ms"]["p50"] > 10.0


def test_a_cut_makes_it_safe_and_it_walks_on_with_fresh_commands(rig: Rig) -> None:
    rig.walker("walk", on=True)
    rig.release()
    seen = len(rig.states())
    rig.impair(cut=True)
    lost = str(Cause.LINK_LOST)
    rig.until(lambda: any(lost in entry["causes"] for entry in rig.states()[seen:]), "the loss is noticed")
    entries = rig.states()[seen:]
    assert "follow" not in {entry["state"] for entry in entries}
    assert State[entries[-1]["state"].upper()] >= State.CROUCH
    rig.impair()
    rig.release()  # not needed after the cut, but after what a busy machine does
    assert rig.states()[-1]["command_age_ms"] < 1000.0


@pytest.mark.parametrize("name", ["command_nan", "fall", "robot_end_killed"])
def test_a_fault_while_walking_is_made_safe_and_recovered_from(rig: Rig, name: str) -> None:
    rig.walker("walk", on=True)
    injection = next(injection for injection in INJECTIONS if injection.name == name)
    row = faults.measure(rig, injection, 1, np.random.default_rng(0))
    assert (row["reached"], row["recovered"]) == (1, 1), row
    # A busy machine may be late; then the device did follow in between.
    assert row["executed_after"] == 0 or row["in_time"] == 0, row


def test_every_cause_but_the_start_is_injected() -> None:
    assert {injection.cause for injection in INJECTIONS} >= set(Cause) - {Cause.START}
