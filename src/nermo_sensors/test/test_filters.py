"""The filters: gradients against finite differences, NumPy against filterpy, saturation, missing readings."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import truncnorm

from nermo_sensors.bench.rig import Rig
from nermo_sensors.estimation.bank import CovarianceError, FilterpyBank, KalmanBank, cut_below
from nermo_sensors.estimation.consistency import find_bumps, judge
from nermo_sensors.estimation.load_filter import ESTIMATORS, LoadFilter, make_model
from nermo_sensors.estimation.memory import MemoryModel
from nermo_sensors.estimation.model import LoadModel
from nermo_sensors.estimation.offline import estimate, smooth
from nermo_sensors.models.foot import TactileFeet
from nermo_sensors.parameters import load_tactile

FEET = load_tactile("cheetah_cub")
PERIOD = 0.005
LOADS = st.floats(-2.0, 25.0)
RATES = st.floats(-250.0, 250.0)


def model_of(name: str) -> LoadModel:
    return make_model(name, FEET.calibration, FEET.noises)


def a_state(model: LoadModel, load: float, rate: float, others: float) -> np.ndarray:
    """Somewhere in the state space; the small states get a share of `others`."""
    sizes = {
        "bias": 0.1,
        "acceleration": 500.0,
        "frequency": 10.0,
        "creep": 0.1,
        "load_error": 1.0,
        "charge": 5.0,
    }
    # Plays are somewhere about the load.
    rest = (load - 0.3 * others if name.startswith("play_") else sizes[name] * others for name in model.states[2:])
    x = np.array([[load, rate, *rest]])
    return np.abs(x) if "frequency" in model.states and others < 0.0 else x


def numeric(function: object, x: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Central differences; one column a state."""
    columns = []
    for number, step in enumerate(steps):
        up, down = x.copy(), x.copy()
        up[0, number] += step
        down[0, number] -= step
        columns.append((np.ravel(function(up)) - np.ravel(function(down))) / (2.0 * step))  # type: ignore[operator]
    return np.stack(columns, axis=-1)


@pytest.mark.parametrize("name", ESTIMATORS)
@given(load=LOADS, rate=RATES.filter(lambda rate: abs(rate) > 30.0), others=st.floats(0.1, 1.0))
@settings(max_examples=30)
def test_jacobians_agree_with_finite_differences(name: str, load: float, rate: float, others: float) -> None:
    model = model_of(name)
    x = a_state(model, load, rate, others)
    steps = np.full(x.shape[1], 1e-5)
    _, transition = model.predict(x, PERIOD)
    found = numeric(lambda y: model.predict(y, PERIOD)[0], x, steps)
    np.testing.assert_allclose(np.broadcast_to(transition, (1, *found.shape))[0], found, rtol=1e-4, atol=1e-7)
    read = model.cells["piezoelectric"].read
    found = numeric(lambda y: read(y, x[:, 0]).value, x, steps)
    np.testing.assert_allclose(read(x, x[:, 0]).gradient, found, rtol=1e-4, atol=1e-7)
    # Where the reading is the expected one, the memory model's secant is the tangent.
    static = model.cells["piezoresistive"].read
    expected = static(x, np.array([1.0])).value
    found = numeric(lambda y: static(y, expected).value, x, steps)
    np.testing.assert_allclose(static(x, expected).gradient, found, rtol=5e-3, atol=1e-3)


@pytest.mark.parametrize("name", ESTIMATORS)
def test_numpy_and_filterpy_agree(name: str) -> None:
    """The same model on both engines, with gaps in the readings, to rounding."""
    random = np.random.default_rng(2)
    model = model_of(name)
    fast, plain = LoadFilter(model, 2), LoadFilter(model_of(name), 2, FilterpyBank)
    for row in range(150):
        load = 6.0 * (1.0 - np.cos(0.06 * row))
        static = 1.0 + 0.37 * min(load, 10.0) + 0.01 * random.standard_normal(2)
        dynamic = 0.1 * np.sin(0.06 * row) + 0.01 * random.standard_normal(2)
        static[0] = np.nan if row % 7 == 0 else static[0]
        dynamic[1] = np.nan if row % 5 == 0 else dynamic[1]
        for filters in (fast, plain):
            filters.step(PERIOD, np.array([static, dynamic]), 6.0)
        scale = np.maximum(np.abs(plain.bank.x), 1.0)
        np.testing.assert_allclose(fast.bank.x / scale, plain.bank.x / scale, atol=1e-7)
    np.testing.assert_allclose(fast.variance, plain.variance, rtol=1e-6)


@pytest.mark.parametrize("name", ESTIMATORS)
def test_covariances_stay_positive_definite(name: str) -> None:
    random, filters = np.random.default_rng(4), LoadFilter(model_of(name), 3)
    for _ in range(400):
        filters.step(PERIOD, np.array([random.uniform(0.5, 5.5, 3), random.uniform(-2.0, 2.0, 3)]), 12.0)
        for covariance in filters.bank.P:
            scale = np.sqrt(np.diag(covariance))
            assert np.linalg.eigvalsh(covariance / np.outer(scale, scale))[0] > -1e-9
            np.testing.assert_array_equal(covariance, covariance.T)


@pytest.mark.parametrize(
    ("covariance", "message"),
    [
        (np.diag([1.0, -1.0]), "not positive definite"),
        (np.diag([1.0, 0.0]), "not positive definite"),
        (np.array([[1.0, 0.5], [0.0, 1.0]]), "not symmetric"),
        (np.diag([1.0, np.nan]), "not finite"),
    ],
)
@pytest.mark.parametrize("bank", [KalmanBank, FilterpyBank])
def test_what_is_no_covariance_is_refused(bank: type, covariance: np.ndarray, message: str) -> None:
    with pytest.raises(CovarianceError, match=rf"P\[0\]: .*{message}"):
        bank(np.zeros((1, 2)), covariance[None])


@given(st.floats(-4.0, 5.5))
def test_cut_gaussian_has_the_moments_of_scipy(bound: float) -> None:
    mean, variance = cut_below(bound)
    expected = truncnorm.stats(bound, np.inf, moments="mv")
    assert float(mean) == pytest.approx(float(expected[0]), rel=1e-6, abs=1e-9)
    assert float(variance) == pytest.approx(float(expected[1]), rel=1e-4)


@pytest.mark.parametrize("bank", [KalmanBank, FilterpyBank])
def test_bound_moves_only_what_violates_it(bank: type) -> None:
    filters = bank(np.array([[1.0, 0.0], [20.0, 0.0]]), np.tile([[4.0, 1.0], [1.0, 2.0]], (2, 1, 1)))
    filters.raise_to(0, np.array([10.0, 10.0]), np.array([True, False]))
    assert filters.x[0, 0] > 10.0 and filters.x[0, 1] > 0.0
    assert filters.P[0, 0, 0] < 4.0
    np.testing.assert_array_equal(filters.x[1], [20.0, 0.0])


@pytest.mark.parametrize("bank", [KalmanBank, FilterpyBank])
def test_vague_bound_moves_as_sampling_says(bank: type) -> None:
    """Load 8 +- 2 N, and at least 10 +- 1 N: against samples of both."""
    filters = bank(np.array([[8.0, 0.0]]), np.array([[[4.0, 1.0], [1.0, 2.0]]]))
    filters.raise_to(0, np.array([10.0]), np.array([True]), 1.0)
    random = np.random.default_rng(0)
    state = random.multivariate_normal([8.0, 0.0], [[4.0, 1.0], [1.0, 2.0]], 400_000)
    left = state[state[:, 0] > random.normal(10.0, 1.0, len(state))]
    np.testing.assert_allclose(filters.x[0], left.mean(axis=0), atol=0.02)
    np.testing.assert_allclose(filters.P[0], np.cov(left.T), atol=0.03)


@pytest.mark.parametrize("name", ESTIMATORS)
def test_saturated_reading_is_a_bound_and_no_measurement(name: str) -> None:
    """At 5 V the load is 10 N or more: an estimate below is lifted, and one far above is left where it is."""
    model = model_of(name)
    low, high = LoadFilter(model, 1), LoadFilter(model_of(name), 1)
    high.bank.x[0, 0] = 20.0
    for filters in (low, high):
        filters.bank.P[:] = np.diag([9.0] + [1e-3] * (len(model.states) - 1))
        filters.step(PERIOD, np.array([[5.0], [np.nan]]))
    assert low.load[0] > 6.0
    assert high.load[0] == pytest.approx(20.0, abs=0.2)


@pytest.mark.parametrize("name", ESTIMATORS)
@pytest.mark.parametrize("period", [0.0, -0.005, np.nan, np.inf])
def test_bad_period_is_refused(name: str, period: float) -> None:
    with pytest.raises(ValueError, match="must be finite and above 0"):
        LoadFilter(model_of(name), 1).step(period, np.zeros((2, 1)))


def test_unknown_estimator_is_named() -> None:
    with pytest.raises(ValueError, match="'f3' is not one of f1, f2, memory"):
        model_of("f3")


def test_memory_filter_recovers_from_believing_the_cell_saturated() -> None:
    """A tangent would be flat there, and the filter deaf; F1 and F2 have that fault."""
    filters = LoadFilter(model_of("memory"), 1)
    filters.bank.x[0, 0] = 25.0
    for _ in range(20):
        filters.step(PERIOD, np.array([[2.0], [0.0]]))
    assert filters.load[0] < 6.0


@given(st.floats(0.3, 3.0), st.floats(-3.0, 3.0))
def test_slopes_towards_a_load_lead_there(load: float, change: float) -> None:
    """A landing goes through several plays at once: the secant says where they are then, the tangent does not."""
    model = model_of("memory")
    x = a_state(model, load, 0.0, 0.5)
    towards = np.array([load + change])
    after, jacobian = model.predict(x, PERIOD, towards)
    moved = x.copy()
    moved[0, 0] += change - (after[0, 0] - load)
    exact, _ = model.predict(moved, PERIOD)
    np.testing.assert_allclose(exact[0], after[0] + jacobian[0] @ (moved - x)[0], atol=1e-6)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_load_of_a_foot_that_lands_hard_and_bounces_is_followed(seed: int) -> None:
    """As the front feet on knees that comply: up to 2.5 N between two readings, down again, then a stance."""
    feet, cells = load_tactile("nermo_lite"), TactileFeet(load_tactile("nermo_lite"), feet=1, seed=seed)
    filters = LoadFilter(make_model("memory", feet.calibration, feet.noises), 1)
    stance = np.concatenate([[1.2, 2.5, 0.3, 0.6, 0.3, 0.5], np.linspace(0.3, 1.8, 110), [0.9]])
    loads = np.tile(np.concatenate([stance, np.zeros(120)]), 6)
    errors = []
    for load in loads.tolist():
        read = cells.read([load], PERIOD)
        filters.step(PERIOD, np.array(list(read.values())))
        errors.append(float(filters.load[0]) - load)
    settled = np.array(errors[len(loads) // 3 :])
    assert np.sqrt(np.mean(settled**2)) < 0.12


@pytest.fixture(scope="module")
def third_run() -> object:
    return Rig(periods=3, seconds=2.0).run(FEET, seed=13)


@pytest.mark.slow
def test_memory_filter_beats_both_of_the_thesis_and_is_honest(third_run: object) -> None:
    """On a run that was neither fitted nor tuned on."""
    settled = third_run.time > 2.0  # type: ignore[attr-defined]
    truth = third_run.force[settled]  # type: ignore[attr-defined]
    quality = {}
    for name in ESTIMATORS:
        with np.errstate(all="ignore"):
            found = estimate(model_of(name), third_run)  # type: ignore[arg-type]
        quality[name] = judge(truth, found.load[settled, 0], found.variance[settled, 0], find_bumps(truth))
    assert quality["memory"].rmse < 0.1 * min(quality["f1"].rmse, quality["f2"].rmse)
    assert abs(quality["memory"].peak_error) < 0.2
    assert quality["memory"].within_3_sigma > 0.99
    assert 0.7 < quality["memory"].nees < 1.3


@pytest.mark.slow
def test_hindsight_helps(third_run: object) -> None:
    part = third_run.part(slice(1600, 2800))  # type: ignore[attr-defined]
    forward, backward = estimate(model_of("memory"), part), smooth(model_of("memory"), part)
    settled = slice(200, None)
    error = [
        float(np.sqrt(np.mean((found.load[settled, 0] - part.force[settled]) ** 2))) for found in (forward, backward)
    ]
    assert error[1] < error[0]
    assert np.all(backward.variance[settled] <= forward.variance[settled] * (1.0 + 1e-6))


def test_linear_filter_is_consistent_over_many_runs() -> None:
    """Model and world alike: the normalised squared error is that of a Gaussian."""
    count, steps = 400, 60
    random = np.random.default_rng(0)
    bank = KalmanBank(np.zeros((count, 2)), np.tile(np.eye(2), (count, 1, 1)))
    truth = random.standard_normal((count, 2))
    transition = np.array([[1.0, 0.1], [0.0, 1.0]])
    gradient = np.tile([1.0, 0.0], (count, 1))
    for _ in range(steps):
        truth = truth @ transition.T
        truth[:, 1] += 0.1 * random.standard_normal(count)
        bank.predict(bank.x @ transition.T, transition, np.array([0.0, 0.01]))
        reading = truth[:, 0] + 0.5 * random.standard_normal(count)
        bank.update(reading - bank.x[:, 0], gradient, 0.25, np.ones(count, dtype=bool))
    error = bank.x - truth
    nees = np.mean(np.einsum("bi,bij,bj->b", error, np.linalg.inv(bank.P), error)) / 2.0
    assert 0.85 < nees < 1.15


def test_gradient_of_memory_model_is_a_secant_away_from_the_reading() -> None:
    model = model_of("memory")
    assert isinstance(model, MemoryModel)
    x = np.zeros((1, len(model.states)))
    x[0, model.states.index("load_error")] = 20.0
    reading = model.piezoresistive(x, np.array([2.5]))
    by_felt = reading.gradient[0, model.states.index("load_error")]
    implied = by_felt * (20.0 - 5.0)
    assert by_felt > 0.05
    assert implied == pytest.approx(reading.value[0] - 2.5, rel=0.5)
