"""Rows that are late, lost or stamped when they came: a healthy robot still has no gap."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from robots import aligned_of, plant_of, simulate

from simgap.data.align import align
from simgap.data.recording import recording_from_table
from simgap.data.sample_times import sample_times
from simgap.inference.residual import Residuals, channel_gap
from simgap.simulation.replay import Replayer
from simgap.simulation.variant import Variant
from simgap.simulation.windows import cut

Array = NDArray[np.float64]
Table = dict[str, Array]
PERIOD = 0.005


def _stamped(table: Table, stamps: Array) -> Table:
    return {**table, "t": stamps}


def _since_1970(table: Table) -> Table:
    return _stamped(table, table["t"] + 1.7e9)


def _scattered(table: Table) -> Table:
    off = np.random.default_rng(3).uniform(-0.4, 0.4, len(table["t"]))
    return _stamped(table, table["t"] + off * PERIOD)


def _few_digits(table: Table) -> Table:
    return _stamped(table, np.round(table["t"], 2))


def _five_at_once(table: Table) -> Table:
    rows = np.arange(len(table["t"]))
    return _stamped(table, PERIOD * (rows // 5 * 5 + 4) + 1e-5 * (rows % 5))


def _some_lost(table: Table) -> Table:
    kept = np.random.default_rng(3).random(len(table["t"])) > 0.05
    return {name: values[kept] for name, values in table.items()}


def _scattered_and_lost(table: Table) -> Table:
    return _some_lost(_scattered(table))


DEFECTS: list[Callable[[Table], Table]] = [
    _since_1970,
    _scattered,
    _few_digits,
    _five_at_once,
    _some_lost,
    _scattered_and_lost,
]


@pytest.mark.parametrize("name", ["arm", "pendulum"])
@pytest.mark.parametrize("defect", DEFECTS)
def test_gap_of_the_truth_stays_at_one(defect: Callable[[Table], Table], name: str) -> None:
    plant, aligned, floor = aligned_of(name, defect(simulate(name, 12.0)))
    replayer = Replayer(plant, aligned, cut(aligned), floor, 1)
    nominal = Variant.nominal(plant)
    residuals = Residuals.build(replayer, nominal)
    gap = channel_gap(residuals.of([nominal])[0], residuals.mask)
    assert (gap > 0.5).all() and (gap < 1.3).all()
    assert aligned.period == pytest.approx(PERIOD, rel=1e-5)


def test_stamps_that_the_motion_follows_are_kept() -> None:
    """A loop that is late samples late: there the steady clock is wrong, however the stamps scatter."""
    random = np.random.default_rng(4)
    late = np.cumsum(PERIOD * random.uniform(0.7, 1.3, 2000))
    steady = PERIOD * np.arange(2000) + 0.001 * random.standard_normal(2000)
    for time in (late, steady):
        outputs = np.column_stack([np.sin(9.0 * time), np.cos(5.0 * time)]) + 1e-4 * random.standard_normal((2000, 2))
        found, scatter = sample_times(time, outputs)
        assert scatter == 0.0 and found is time


def test_where_noise_hides_the_motion_stamps_are_kept() -> None:
    random = np.random.default_rng(5)
    time = PERIOD * np.arange(1000) + 0.001 * random.standard_normal(1000)
    assert sample_times(time, random.standard_normal((1000, 1)))[1] == 0.0
    assert sample_times(time, np.full((1000, 1), np.nan))[1] == 0.0
    assert sample_times(time[:50], np.sin(time[:50, None]))[1] == 0.0


def test_what_was_told_in_lost_rows_is_interpolated_unless_the_map_holds() -> None:
    table = simulate("arm", 8.0)
    kept = np.arange(len(table["t"])) % 50 != 25
    spoiled = {name: values[kept] for name, values in table.items()}

    def hold(data: dict[str, object]) -> None:
        for row in data["inputs"]:  # type: ignore[attr-defined]
            row["hold"] = "zero"

    for edit, wanted in ((None, "between"), (hold, "before")):
        plant = plant_of("arm", edit)
        aligned = align(recording_from_table(spoiled, plant), plant)
        (said,) = [warning for warning in aligned.warnings if "steady clock are missing" in warning]
        assert said.startswith(f"time: {int((~kept).sum())} rows (2 %)")
        told = table[plant.inputs[0].column]
        expected = {"between": 0.5 * (told[74] + told[76]), "before": told[74]}
        assert aligned.inputs[75, 0] == pytest.approx(expected[wanted])
        assert aligned.inputs[74, 0] == told[74] and aligned.inputs[76, 0] == told[76]


def test_a_loop_that_comes_late_was_told_nothing_meanwhile() -> None:
    table = simulate("arm", 8.0)
    late = table["t"] + 0.6 * PERIOD * np.cumsum(np.arange(len(table["t"])) % 100 == 50)
    plant = plant_of("arm")
    aligned = align(recording_from_table(_stamped(table, late), plant), plant)
    assert not [warning for warning in aligned.warnings if "steady clock" in warning]
