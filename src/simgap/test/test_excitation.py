"""What counts as motion, and what as standing still."""

from __future__ import annotations

import numpy as np
import pytest
from robots import aligned_of, simulate

from simgap.data.excitation import excited, still_joints


@pytest.mark.parametrize("noise", [0.0, 2e-4, 5e-3])
def test_a_robot_that_is_told_to_move_is_excited(noise: float) -> None:
    seen = aligned_of("arm", simulate("arm", 5.0, noise=noise))
    assert excited(*seen)
    assert still_joints(*seen) == []


@pytest.mark.parametrize("noise", [2e-4, 5e-3])
def test_noise_is_no_motion(noise: float) -> None:
    seen = aligned_of("arm", simulate("arm", 5.0, noise=noise, told=0.0))
    assert not excited(*seen)
    assert still_joints(*seen) == ["shoulder", "elbow"]


def test_a_robot_that_is_told_to_move_and_does_not_has_a_gap() -> None:
    told, still = simulate("arm", 5.0), simulate("arm", 5.0, told=0.0)
    seen = aligned_of("arm", told | {column: still[column] for column in ("q0", "q1")})
    assert excited(*seen)
    assert still_joints(*seen) == ["shoulder", "elbow"]


def test_a_robot_that_swings_by_itself_is_excited() -> None:
    table = simulate("arm", 5.0, told=0.0)
    table["q1"] = table["q1"] + 0.3 * np.sin(6.0 * table["t"])
    seen = aligned_of("arm", table)
    assert excited(*seen)
    assert still_joints(*seen) == ["shoulder"]


def test_runs_that_stand_in_different_places_hold_no_motion() -> None:
    table = simulate("arm", 6.0, told=0.0)
    later = table["t"] > 3.0
    table["t"] = table["t"] + np.where(later, 5.0, 0.0)
    for column in ("q0", "q1"):
        table[column] = table[column] + np.where(later, 0.5, 0.0)
    assert not excited(*aligned_of("arm", table))
