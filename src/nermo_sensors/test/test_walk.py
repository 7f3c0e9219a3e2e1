"""Judging the loads of a walk: delays, contact, and the four loads as one weight."""

from __future__ import annotations

import numpy as np
import pytest

from nermo_sensors.bench.command import dynamic_requirements
from nermo_sensors.bench.judgement import best_single
from nermo_sensors.bench.walk import LoadTrace, judge_walk, touch_down_delays
from nermo_sensors.estimation.weight import felt_weight, share_weight

PERIOD = 0.005


def steps(*edges: int, length: int = 400) -> np.ndarray:
    """True between each pair of edges."""
    mask = np.zeros(length, dtype=bool)
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        mask[begin:end] = True
    return mask


def test_delays_count_from_the_true_touch_down() -> None:
    truth = steps(50, 150, 250, 350)
    delays = touch_down_delays(truth, steps(53, 155, 248, 351), PERIOD)
    np.testing.assert_allclose(delays, [0.015, -0.010])


def test_touch_down_that_is_not_noticed_in_time_is_missed() -> None:
    truth = steps(50, 150, 250, 350)
    delays = touch_down_delays(truth, steps(41, 260, 360, 390), PERIOD)
    assert delays[0] == pytest.approx(-0.045)
    assert np.isnan(delays[1])  # in contact all along: it never saw the foot come down


def test_bounces_are_no_steps() -> None:
    truth = steps(50, 100, 108, 150, 200, 206, 250, 350)
    assert len(touch_down_delays(truth, truth, PERIOD)) == 2


def test_perfect_estimate_has_no_errors() -> None:
    time = np.arange(400) * PERIOD
    truth = np.where(np.stack([steps(50, 150, 250, 350)] * 4, axis=1), 0.7, 0.0)
    rows = judge_walk(LoadTrace(time, truth, truth, np.full_like(truth, 0.01), truth > 0.15), 0.15)
    assert [row["leg"] for row in rows] == ["front_left", "front_right", "rear_left", "rear_right", "all"]
    assert all(row["rmse_n"] == 0.0 and row["precision"] == row["recall"] == 1.0 for row in rows)
    assert rows[-1]["touch_downs"] == 8 and rows[-1]["missed"] == 0
    assert rows[-1]["delay_ms"] == {"p50": 0.0, "p99": 0.0}


def test_late_and_wrong_estimate_is_told() -> None:
    time = np.arange(400) * PERIOD
    truth = np.where(np.stack([steps(50, 150, 250, 350)] * 4, axis=1), 0.7, 0.0)
    contact = np.stack([steps(54, 170, 254, 370)] * 4, axis=1)
    (*_, together) = judge_walk(LoadTrace(time, truth, truth + 0.2, np.full_like(truth, 0.01), contact), 0.15)
    assert together["rmse_n"] == pytest.approx(0.2) and together["nees"] == pytest.approx(4.0)
    assert together["delay_ms"]["p50"] == pytest.approx(20.0)
    assert together["recall"] == pytest.approx(0.96) and together["precision"] == pytest.approx(96.0 / 116.0)


def test_walk_without_a_step_is_refused() -> None:
    nothing = np.zeros((400, 4))
    with pytest.raises(ValueError, match="no foot touches down in 2.0 s"):
        judge_walk(LoadTrace(np.arange(400) * PERIOD, nothing, nothing, nothing + 1.0, nothing > 1.0), 0.15)


def test_shared_weight_is_the_conditioned_gaussian() -> None:
    load, variance = np.array([0.9, 0.1, 0.2, 0.9]), np.array([0.04, 0.01, 0.01, 0.02])
    shared, left = share_weight(load, variance, 2.6, 0.01)
    # The same as a Kalman update of the four with a reading of their sum.
    P, H = np.diag(variance), np.ones((1, 4))
    K = (P @ H.T / (H @ P @ H.T + 0.01)).ravel()
    np.testing.assert_allclose(shared, load + K * (2.6 - 2.1))
    np.testing.assert_allclose(left, np.diag((np.eye(4) - np.outer(K, H)) @ P))


@pytest.mark.parametrize(("weight", "variance"), [(np.nan, 0.1), (2.6, 0.0), (2.6, -1.0), (2.6, np.inf)])
def test_weight_that_is_none_is_refused(weight: float, variance: float) -> None:
    with pytest.raises(ValueError, match="must be finite"):
        share_weight(np.ones(4), np.ones(4), weight, variance)


def row(estimator: str, frequency: float | None, rmse: float, peak: float = 0.0) -> dict[str, object]:
    return {"estimator": estimator, "frequency_hz": frequency, "rmse_n": rmse, "peak_error_n": peak}


def test_best_single_cell_is_chosen_at_each_frequency() -> None:
    rows = [row(cell, f, r) for cell, f, r in (("piezoresistive", 1.0, 3.0), ("piezoelectric", 1.0, 2.0))]
    rows += [row("piezoresistive", None, 1.0), row("piezoelectric", None, 5.0), row("memory", None, 0.1)]
    best = best_single(rows)
    assert [(r["frequency_hz"], r["cell"], r["estimator"]) for r in best] == [
        (1.0, "piezoelectric", "best_single"),
        (None, "piezoresistive", "best_single"),
    ]


@pytest.mark.parametrize(("peak", "met"), [(-1.0, [True, True, False]), (-12.0, [False, False, False])])
def test_requirements_follow_from_the_rows(peak: float, met: list[bool]) -> None:
    rows = [row("memory", f, 0.5, peak) for f in (0.5, 4.0, None)]
    assert [r["met"] for r in dynamic_requirements(rows, 28.0)] == met


def test_felt_weight_turns_with_the_imu() -> None:
    half = np.sqrt(0.5)
    assert felt_weight(0.27, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 9.81)) == pytest.approx(0.27 * 9.81)
    assert felt_weight(0.27, (half, half, 0.0, 0.0), (0.0, 9.81, 0.0)) == pytest.approx(0.27 * 9.81)  # on its side
    assert felt_weight(0.27, (half, 0.0, half, 0.0), (-9.81, 0.0, 0.0)) == pytest.approx(0.27 * 9.81)  # nose down
    assert felt_weight(0.27, (half, 0.0, half, 0.0), (0.0, 0.0, 9.81)) == pytest.approx(0.0)
