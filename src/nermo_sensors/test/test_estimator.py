"""The estimator as the robot runs it: bad input, broken cells, contact."""

from __future__ import annotations

import math

import numpy as np
import pytest

from nermo_sensors.estimation.contact import ContactDetector
from nermo_sensors.estimation.estimator import LegLoadEstimator, LegLoads
from nermo_sensors.estimation.health import Fault
from nermo_sensors.estimation.load_filter import ESTIMATORS
from nermo_sensors.models.foot import TactileFeet
from nermo_sensors.parameters import load_tactile

TICK = 5_000_000
FEET = load_tactile("nermo_lite")


class Walk:
    """Four feet that bear 0 to 1.4 N in turn at 1 Hz, and an estimator that feels them."""

    def __init__(self, estimator: str = "memory", seed: int = 0) -> None:
        self.estimator = LegLoadEstimator(FEET, estimator)
        self.feet = TactileFeet(FEET, seed=seed)
        self.stamp = 0
        self.errors: list[np.ndarray] = []

    def loads(self) -> np.ndarray:
        phases = self.stamp * 1e-9 + np.array([0.0, 0.5, 0.25, 0.75])
        return 1.4 * np.clip(np.sin(2.0 * np.pi * phases), 0.0, None)

    def go(self, seconds: float, spoil: object = None, phases_known: bool = True) -> LegLoads | None:
        answer = None
        for _ in range(round(seconds / 0.005)):
            self.stamp += TICK
            loads = self.loads()
            readings = {cell: np.array(volts) for cell, volts in self.feet.read(loads.tolist(), 0.005).items()}
            if spoil is not None:
                spoil(readings["piezoresistive"], readings["piezoelectric"])  # type: ignore[operator]
            swing = (loads == 0.0).tolist() if phases_known else None
            answer = self.estimator.step(self.stamp, readings, 2.0 * math.pi, swing)
            if answer is not None:
                self.errors.append(answer.load - loads)
        return answer

    def error(self, foot: int, seconds: float = 2.0) -> float:
        """Root mean square of the last seconds [N]."""
        return float(np.sqrt(np.mean(np.array(self.errors)[-round(seconds / 0.005) :, foot] ** 2)))

    def faults(self) -> set[tuple[int, int, Fault]]:
        return set(self.estimator.broken())


def test_healthy_feet_are_believed_and_followed() -> None:
    walk = Walk()
    answer = walk.go(6.0)
    assert answer is not None
    assert walk.faults() == set()
    assert max(walk.error(foot) for foot in range(4)) < 0.15
    assert np.all(answer.load >= 0.0) and np.all(answer.variance > 0.0)
    assert np.all((answer.contact_probability >= 0.0) & (answer.contact_probability <= 1.0))


@pytest.mark.parametrize("estimator", ESTIMATORS)
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_readings_that_are_no_numbers_are_missing(estimator: str, value: float) -> None:
    walk = Walk(estimator)
    walk.go(1.0)

    def spoil(static: np.ndarray, dynamic: np.ndarray) -> None:
        static[1] = value
        dynamic[2] = value

    answer = walk.go(0.5, spoil)
    assert answer is not None and np.all(np.isfinite(answer.load)) and np.all(np.isfinite(answer.variance))
    assert {(1, 0, Fault.MISSING), (2, 1, Fault.MISSING)} <= walk.faults()


def test_all_readings_missing_lets_the_variance_grow() -> None:
    walk = Walk()
    before = walk.go(1.0)

    def spoil(static: np.ndarray, dynamic: np.ndarray) -> None:
        static[:] = math.nan
        dynamic[:] = math.nan

    after = walk.go(0.3, spoil, phases_known=False)
    assert before is not None and after is not None
    assert np.all(after.variance > 10.0 * before.variance)


def test_frozen_static_cell_leaves_the_dynamic_one() -> None:
    walk = Walk()
    walk.go(3.0)

    def spoil(static: np.ndarray, dynamic: np.ndarray) -> None:
        static[0] = 1.7

    walk.go(4.0, spoil)
    assert (0, 0, Fault.FROZEN) in walk.faults()
    assert walk.error(0) < 0.4
    assert all(foot == 0 for foot, _, _ in walk.faults())


def test_frozen_dynamic_cell_leaves_the_static_one() -> None:
    walk = Walk()
    walk.go(3.0)

    def spoil(static: np.ndarray, dynamic: np.ndarray) -> None:
        dynamic[3] = 0.31

    walk.go(4.0, spoil)
    assert walk.faults() == {(3, 1, Fault.FROZEN)}
    assert walk.error(3) < 0.4


def test_inverted_dynamic_cell_is_found() -> None:
    walk = Walk()
    walk.go(3.0)

    def spoil(static: np.ndarray, dynamic: np.ndarray) -> None:
        dynamic[2] *= -1.0

    walk.go(4.0, spoil)
    assert (2, 1, Fault.CONTRADICTION) in walk.faults()
    assert walk.error(2) < 0.4


def test_inverted_static_cell_is_found() -> None:
    walk = Walk()
    walk.go(3.0)

    def spoil(static: np.ndarray, dynamic: np.ndarray) -> None:
        static[2] = 6.0 - static[2]

    walk.go(6.0, spoil)
    assert walk.faults() == {(2, 0, Fault.INVERTED)}
    assert walk.error(2) < 0.4


def test_a_robot_that_stops_with_a_foot_in_the_air_has_healthy_cells() -> None:
    walk = Walk()

    def step(loads: list[float], swing: list[bool], frequency: float | None) -> None:
        walk.stamp += TICK
        readings = {cell: np.array(volts) for cell, volts in walk.feet.read(loads, 0.005).items()}
        walk.estimator.step(walk.stamp, readings, frequency, swing)

    for _ in range(3):
        for tick in range(800):  # a trot whose swinging feet scuff
            left = tick % 200 < 100
            step(
                [1.2, 0.6, 0.6, 1.2] if left else [0.6, 1.2, 1.2, 0.6], [not left, left, left, not left], 2.0 * math.pi
            )
        for _ in range(400):  # stands on one diagonal
            step([1.4, 0.1, 0.1, 1.1], [False] * 4, None)
            assert walk.faults() == set()


def test_cell_that_comes_back_is_believed_again() -> None:
    walk = Walk()
    walk.go(2.0)

    def spoil(static: np.ndarray, dynamic: np.ndarray) -> None:
        static[1] = math.nan

    walk.go(1.0, spoil)
    assert (1, 0, Fault.MISSING) in walk.faults()
    walk.go(5.0)
    assert walk.faults() == set()
    assert walk.error(1) < 0.15


def test_repeated_and_late_samples_change_nothing() -> None:
    walk = Walk()
    answer = walk.go(1.0)
    zeros = {cell: np.zeros(4) for cell in walk.estimator.cells}
    assert walk.estimator.step(walk.stamp, zeros) is answer
    assert walk.estimator.step(walk.stamp - 2 * TICK, zeros) is answer
    assert walk.estimator.ignored == 2 and walk.estimator.restarts == 0


def test_clock_that_runs_backwards_starts_anew() -> None:
    walk = Walk()
    walk.go(2.0)
    walk.stamp = 0
    answer = walk.go(2.0)
    assert walk.estimator.restarts == 1
    assert answer is not None and answer.stamp == walk.stamp
    assert walk.error(0, 1.0) < 0.2


def test_long_gap_is_survived() -> None:
    walk = Walk()
    walk.go(1.0)
    walk.stamp += 3_000_000_000
    answer = walk.go(2.0)
    assert answer is not None and np.all(np.isfinite(answer.load))
    assert walk.error(0, 1.0) < 0.2


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_poisoned_covariance_starts_the_filter_anew(estimator: str) -> None:
    walk = Walk(estimator)
    walk.go(1.0)
    bank = walk.estimator._filters.bank
    bank.predict(bank.x, np.eye(bank.x.shape[1]), np.full((4, bank.x.shape[1]), -1e6))
    walk.go(0.01)
    assert walk.estimator.restarts >= 1
    answer = walk.go(1.0)
    assert answer is not None and np.all(answer.variance > 0.0)


def test_wrong_number_of_feet_is_named() -> None:
    with pytest.raises(ValueError, match="piezoresistive: 3 of them for 4 feet"):
        LegLoadEstimator(FEET).step(0, {"piezoresistive": [1.0] * 3})


def test_new_covariances_do_not_make_the_load_jump() -> None:
    walk = Walk()
    before = walk.go(1.1)
    noises = FEET.noises.model_copy(
        update={"memory": FEET.noises.memory.model_copy(update={"piezoresistive": 1.0, "acceleration": 1e3})}
    )
    walk.estimator.set_noises(noises)
    after = walk.go(0.005)
    assert before is not None and after is not None
    assert np.max(np.abs(after.load - before.load)) < 0.1


def test_contact_follows_the_load_with_its_events() -> None:
    detector = ContactDetector(1, 0.2)
    probability = [
        float(detector.step(stamp, np.array([load]), np.array([0.0025]))[0])
        for stamp, load in enumerate((0.0, 0.2, 0.4, 0.25, 0.2, 0.0), start=10)
    ]
    assert probability[1] == pytest.approx(0.5)
    assert probability[2] > 0.999
    assert not detector.contact[0] and detector.since[0] == 15


def test_contact_does_not_chatter_where_it_is_uncertain() -> None:
    detector, random = ContactDetector(1, 0.2), np.random.default_rng(0)
    changes = 0
    for stamp in range(1, 500):
        detector.step(stamp, np.array([0.2 + 0.03 * random.standard_normal()]), np.array([0.01]))
        changes += int(detector.since[0] == stamp)
    assert changes == 0


@pytest.mark.parametrize(("threshold", "certainty"), [(0.0, 0.9), (0.2, 0.5), (0.2, 1.0), (math.nan, 0.9)])
def test_bad_contact_settings_are_refused(threshold: float, certainty: float) -> None:
    with pytest.raises(ValueError, match="must be above"):
        ContactDetector(1, threshold, certainty)
