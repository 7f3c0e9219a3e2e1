"""Probabilities weighed anew: the numbers under which they mean what they say are found."""

from __future__ import annotations

import json

import numpy as np
import pytest

from simgap.blind.calibrate import Case, case, propose
from simgap.inference.calibrated import calibrated
from simgap.inference.decision import Evidence
from simgap.inference.thresholds import LAW_ERROR, SPARSITY


def _made(rng: np.random.Generator, law_error: float) -> Case:
    """Two rivals of which the truth is as likely to lead as a law error of that size lets it."""
    gain, blocks = 1000.0, 20
    lead = float(rng.normal(0.0, 1.5 * law_error * gain))
    first_is_right = bool(rng.random() < 1.0 / (1.0 + np.exp(-lead / (law_error * gain))))
    costs = np.tile(rng.uniform(40.0, 60.0, blocks), (2, 1))
    costs[1] += lead / blocks
    none = np.zeros(2)
    evidence = Evidence(np.arange(2), costs, none, none, none, gain)
    told = evidence.told() | {"effects": [[["mass@fore"]], [["armature@elbow"]]]}
    return case(json.loads(json.dumps(told)), ["mass@fore" if first_is_right else "armature@elbow"])


@pytest.mark.parametrize("law_error", [0.02, 0.08])
def test_the_law_error_that_made_the_truths_is_found(law_error: float) -> None:
    rng = np.random.default_rng(3)
    found = propose([_made(rng, law_error) for _ in range(400)])
    assert law_error / 1.6 <= found["best"]["law_error"] <= 1.6 * law_error
    assert found["best"]["log_score"] >= found["in_use"]["log_score"]
    assert found["cases"] == 400


def test_evidence_comes_back_from_a_report_as_it_was() -> None:
    rng = np.random.default_rng(0)
    costs = rng.uniform(0.0, 9.0, (3, 6))
    evidence = Evidence(np.array([0, 0, 1]), costs, rng.uniform(size=3), rng.uniform(size=3), np.zeros(3), 80.0)
    again = Evidence.of(json.loads(json.dumps(evidence.told())))
    np.testing.assert_allclose(again.weights(), evidence.weights(), atol=1e-3)


def test_a_class_is_right_where_one_of_its_hypotheses_is() -> None:
    none = np.zeros(3)
    evidence = Evidence(np.array([0, 0, 1]), np.zeros((3, 2)), none, none, none, 1.0)
    told = evidence.told() | {"effects": [[["a@x"], ["a@all"]], [["b@y", "a@x"]]]}
    assert case(told, ["a@all"]).right.tolist() == [True, True, False]
    assert case(told, ["a@x", "b@y"]).right.tolist() == [False, False, True]
    assert case(told, []).right.tolist() == [False, False, False]


def test_what_was_stated_weighs_the_same_beside_any_gain() -> None:
    none, stated = np.zeros(2), np.array([0.0, np.log(9.0)])
    for gain in (1.0, 5000.0):
        evidence = Evidence(np.arange(2), np.zeros((2, 4)), none, none, stated, gain)
        np.testing.assert_allclose(evidence.weights(), [0.9, 0.1])


def test_the_numbers_in_use_are_those_of_the_file() -> None:
    assert (calibrated().law_error, calibrated().sparsity) == (LAW_ERROR, SPARSITY)
    assert calibrated().how
