"""Samples that stand alone are left out, and no motion is taken for one."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from robots import MODELS, aligned_of, plant_of, simulate

from simgap.data.align import align
from simgap.data.glitches import glitches
from simgap.data.recording import recording_from_table

Array = NDArray[np.float64]
TIME = np.arange(2000) * 0.005

MOTIONS = {
    "sine": np.sin(9.0 * TIME),
    "triangle": np.abs((3.0 * TIME) % 2.0 - 1.0),
    "steps": np.floor(2.0 * TIME) % 3.0,
    "rest, then a move": np.where(TIME < 8.0, 0.0, 0.3 * (TIME - 8.0)),
    "sine at a stop": np.minimum(np.sin(9.0 * TIME), 0.4),
    "near the sampling's limit": np.sin(2.0 * np.pi * 95.0 * TIME),
}


@pytest.mark.parametrize("name", MOTIONS)
@pytest.mark.parametrize("noise", [0.0, 1e-4, 1e-2])
@pytest.mark.parametrize("step", [0.0, 1.5e-3])
def test_no_motion_is_a_glitch(name: str, noise: float, step: float) -> None:
    values = MOTIONS[name] + noise * np.random.default_rng(1).standard_normal(len(TIME))
    values = np.round(values / step) * step if step else values
    assert not glitches(values).any()


@settings(max_examples=50, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    name=st.sampled_from(sorted(set(MOTIONS) - {"near the sampling's limit"})),
    far=st.floats(0.6, 1e6),
    length=st.integers(1, 2),
)
def test_what_stands_alone_is_found_and_nothing_else(seed: int, name: str, far: float, length: int) -> None:
    random = np.random.default_rng(seed)
    values = MOTIONS[name] + 2e-4 * random.standard_normal(len(TIME))
    # Apart from each other, and not where the motion itself jumps.
    rows = np.arange(23, 1990, 40) + random.integers(0, 5, 50)
    rows = rows[[np.ptp(values[row - 2 : row + length + 2]) < 0.05 for row in rows]]
    off = far * random.choice([-1.0, 1.0], len(rows))
    for more in range(length):
        values[rows + more] += off
    bad = (rows[:, None] + np.arange(length)).ravel()
    np.testing.assert_array_equal(np.flatnonzero(glitches(values)), bad)


def test_a_log_that_asks_twice_as_often_as_the_sensor_answers() -> None:
    values = np.repeat(np.sin(0.02 * np.arange(300)), 2)
    assert not glitches(values).any()
    values[200:202] += 0.5
    assert np.flatnonzero(glitches(values)).tolist() == [200, 201]


def test_values_that_are_not_there_are_nobody_s_neighbours() -> None:
    values = np.full(300, np.nan)
    values[::3] = np.sin(0.02 * np.arange(100))
    values[150] += 1.0
    assert np.flatnonzero(glitches(values)).tolist() == [150]
    assert not glitches(np.full(300, np.nan)).any() and not glitches(np.full(300, 2.0)).any()


@pytest.mark.parametrize("name", MODELS)
def test_no_robot_has_any_and_a_bad_line_s_are_left_out(name: str) -> None:
    table = simulate(name, 8.0)
    plant, clean, _ = aligned_of(name, table)
    assert not [warning for warning in clean.warnings if "stand alone" in warning]
    output = next(o for o in plant.outputs if o.quantity in ("angle", "length"))
    row = len(table["t"]) // 2
    table[output.column] = table[output.column].copy()
    table[output.column][[row, row + 200]] += 50.0 * np.ptp(table[output.column])
    spoiled = align(recording_from_table(table, plant_of(name)), plant_of(name))
    assert [w for w in spoiled.warnings if "stand alone" in w] == [
        f"output {output.name}: 2 samples ({200.0 / len(table['t']):.2g} %) stand alone, far from those before and "
        "after; left out as glitches of the sensor"
    ]
    column = [o.name for o in plant.outputs].index(output.name)
    assert spoiled.valid[:, column].sum() == clean.valid[:, column].sum() - 2
    assert np.abs(spoiled.outputs - clean.outputs).max() < 0.1 * np.ptp(clean.outputs[:, column])
