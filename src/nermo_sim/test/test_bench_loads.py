"""The estimator on the walking twin, in process."""

from __future__ import annotations

import numpy as np
import pytest

from nermo_control.types import ControlCommand
from nermo_sensors.bench.walk import judge_walk
from nermo_sim.bench.loads import walk_and_feel


def test_loads_of_a_walk_follow_the_contact_forces() -> None:
    felt = walk_and_feel("nermo_lite", 4.0)
    trace = felt.trace(1.5)
    assert trace.load.shape == trace.truth.shape == (len(trace.time), 4)
    together = judge_walk(trace, 0.15)[-1]
    assert together["rmse_n"] < 0.1
    assert together["within_3_sigma"] > 0.97
    assert together["precision"] > 0.9 and together["recall"] > 0.95
    assert together["touch_downs"] >= 4 and together["missed"] <= 1
    assert felt.estimator.broken() == []
    # The feet carry the mouse.
    assert abs(np.mean(trace.truth.sum(axis=1)) - 2.66) < 0.2


@pytest.mark.parametrize("robot", ["nermo", "nermo_lite"])
def test_a_mouse_that_stands_is_felt_to_stand_for_as_long_as_it_does(robot: str) -> None:
    """The dynamic cell's offset says that the load changes all the time; nothing may take up what that adds up to."""
    trace = walk_and_feel(robot, 25.0, command=ControlCommand(0)).trace(2.0)
    assert trace.contact.all()
    assert np.abs(trace.load - trace.truth).max() < 0.6 * trace.truth.mean()
    early, late = (np.abs(trace.load[part] - trace.truth[part]).mean() for part in (slice(0, 1000), slice(-1000, None)))
    assert late < 1.5 * early
    assert trace.load.sum(axis=1)[-1000:].mean() == pytest.approx(trace.truth.sum(axis=1).mean(), rel=0.2)
