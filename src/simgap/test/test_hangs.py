"""Sensors that hang are told from joints that rest."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from robots import MODELS, aligned_of, plant_of, simulate
from test_glitches import MOTIONS

from simgap.data.align import align
from simgap.data.hangs import hangs
from simgap.data.recording import recording_from_table

Array = NDArray[np.float64]
TIME = np.arange(2000) * 0.005


def _hung(values: Array, begin: int, count: int) -> Array:
    values = values.copy()
    values[begin + 1 : begin + 1 + count] = values[begin]
    return values


@pytest.mark.parametrize("name", MOTIONS)
@pytest.mark.parametrize("noise", [0.0, 1e-4, 1e-2])
@pytest.mark.parametrize("step", [0.0, 1.5e-3])
@pytest.mark.parametrize("repeated", [1, 2, 5])
def test_no_motion_is_a_hang(name: str, noise: float, step: float, repeated: int) -> None:
    values = MOTIONS[name] + noise * np.random.default_rng(1).standard_normal(len(TIME))
    values = np.round(values / step) * step if step else values
    values = np.repeat(values[::repeated], repeated)[: len(TIME)]
    assert not hangs(values[:, None]).any()


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 10_000), count=st.integers(8, 60), turn=st.floats(-0.8, 0.8))
def test_what_a_moving_robot_s_sensor_repeats_is_found(seed: int, count: int, turn: float) -> None:
    """Also where another channel tells it: the second turns back meanwhile. The third never hangs, the fourth rests."""
    random = np.random.default_rng(seed)
    noise = 2e-4 * random.standard_normal((3, len(TIME)))
    begin = 700
    middle = TIME[begin] + 0.0025 * count
    moves = 3.0 * TIME + 0.1 * turn * np.sin(TIME), np.cos(4.0 * (TIME - middle)), np.sin(9.0 * TIME)
    outputs = np.column_stack([move + wobble for move, wobble in zip(moves, noise, strict=True)])
    outputs = np.column_stack([outputs, np.where(TIME < 5.0, 0.2, noise[0])])
    for channel in (0, 1):
        outputs[:, channel] = _hung(outputs[:, channel], begin, count)
    wanted = np.zeros(outputs.shape, dtype=bool)
    wanted[begin + 1 : begin + 1 + count, :2] = True
    np.testing.assert_array_equal(hangs(outputs), wanted)


def test_a_coarse_encoder_that_rests_and_starts_does_not_hang() -> None:
    place = np.cumsum(np.where((TIME % 1.0) < 0.5, 0.0, 0.004))
    assert not hangs((np.round(place / 1.5e-3) * 1.5e-3)[:, None]).any()
    assert not hangs(np.full((300, 2), np.nan)).any() and not hangs(np.full((300, 1), 2.0)).any()


@pytest.mark.parametrize("name", MODELS)
def test_no_robot_has_any(name: str) -> None:
    for noise in (0.0, 1e-3):
        table = simulate(name, 8.0, noise=noise)
        aligned = align(recording_from_table(table, plant_of(name)), plant_of(name))
        assert not [warning for warning in aligned.warnings if "hangs" in warning]


def test_a_hanging_tracker_is_said_and_left_out() -> None:
    table = simulate("arm", 8.0)
    plant, clean, _ = aligned_of("arm", table)
    speed = np.abs(np.gradient(table["q0"]))
    begin = int(np.argmax(speed[200:-200])) + 200 - 10
    for column in ("q0", "q1"):
        table[column] = _hung(table[column], begin, 20)
    hung = align(recording_from_table(table, plant_of("arm")), plant)
    assert [w.partition(":")[2] for w in hung.warnings if "hangs" in w] == [
        f" 20 samples ({2000.0 / len(table['t']):.2g} %) repeat the one before while the robot moves; left out, as of "
        "a sensor that hangs"
    ] * 2
    assert (clean.valid.sum(axis=0) - hung.valid.sum(axis=0) >= 20).all()
