"""The estimator on the walking twin, in process."""

from __future__ import annotations

import numpy as np

from nermo_sensors.bench.walk import judge_walk
from nermo_sim.bench.loads import walk_and_feel


def test_loads_of_a_walk_follow_the_contact_forces() -> None:
    felt = walk_and_feel("nermo_lite", 4.0)
    trace = felt.trace(1.5)
    assert trace.load.shape == trace.truth.shape == (len(trace.time), 4)
    together = judge_walk(trace, 0.15)[-1]
    assert together["rmse_n"] < 0.25
    assert together["recall"] > 0.9
    assert together["touch_downs"] >= 4 and together["missed"] <= 1
    assert felt.estimator.broken() == []
    # The feet carry the mouse.
    assert abs(np.mean(trace.truth.sum(axis=1)) - 2.66) < 0.2
