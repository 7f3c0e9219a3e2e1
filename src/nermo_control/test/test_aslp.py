"""The pantograph leg of C appendix A, against its own points."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nermo_control.legs.aslp import AslpLeg, AslpPose, AslpSprings, UnreachableError

LEG = AslpLeg(l1=0.050, l2=0.055, l3=0.060, l_delta=0.015, cable_max=0.099, parallel_travel=0.008)
SPRINGS = AslpSprings(diagonal_stiffness=4400.0, diagonal_rest=0.07, parallel_stiffness=1800.0, parallel_rest=0.054)

hips = st.floats(-1.2, 1.2)
knees = st.floats(LEG.knee_reference, 2.6)
shares = st.floats(0.0, 1.0)


def distance(one: tuple[float, float], other: tuple[float, float]) -> float:
    return math.dist(one, other)


def test_ten_thousand_feet_come_back() -> None:
    random = np.random.default_rng(0)
    nearest = LEG.l1 + LEG.l3 - LEG.l_delta - LEG.l2
    worst = 0.0
    for length, angle in zip(
        random.uniform(nearest * 1.001, LEG.longest, 10_000), random.uniform(-1.5, 1.5, 10_000), strict=True
    ):
        x, z = length * math.sin(angle), -length * math.cos(angle)
        found = LEG.forward(LEG.inverse(x, z))
        worst = max(worst, math.hypot(found[0] - x, found[1] - z))
    assert worst < 1e-9


@given(hips, knees)
def test_closed_leg_is_the_two_segmented_one(hip: float, knee: float) -> None:
    pose = AslpPose(hip, knee)
    pose_again = LEG.inverse(*LEG.forward(pose))
    assert pose_again.hip == pytest.approx(hip, abs=1e-6)
    assert pose_again.knee == pytest.approx(knee, abs=1e-6)
    assert LEG.widest(knee) >= 0.0


@given(hips, knees, shares)
def test_lengths_are_those_between_the_points(hip: float, knee: float, share: float) -> None:
    """Cable, diagonal and slider, open and closed, against the joints themselves."""
    pose = AslpPose(hip, knee, share * LEG.widest(knee))
    points = LEG.points(pose)
    assert distance((0.0, 0.0), points.knee) == pytest.approx(LEG.l1)
    assert distance(points.knee, points.ankle) == pytest.approx(LEG.l2)
    assert distance(points.lower, points.foot) == pytest.approx(LEG.l3)
    assert distance((0.0, 0.0), points.ankle) == pytest.approx(LEG.cable_of_knee(knee))
    assert distance(points.upper, points.ankle) == pytest.approx(LEG.diagonal(knee))
    assert distance(points.upper, points.lower) == pytest.approx(LEG.parallel(pose), abs=1e-9)


@given(knees)
def test_limits_of_the_opening_are_those_of_the_slider(knee: float) -> None:
    assert LEG.parallel(AslpPose(0.0, knee)) == pytest.approx(LEG.l2)
    widest = LEG.parallel(AslpPose(0.0, knee, LEG.widest(knee)))
    assert widest == pytest.approx(min(LEG.l2 + LEG.parallel_travel, LEG.diagonal(knee) + LEG.l_delta), abs=1e-7)


@given(knees)
def test_knee_follows_from_cable_and_diagonal(knee: float) -> None:
    assert LEG.knee_of_cable(LEG.cable_of_knee(knee)) == pytest.approx(knee, abs=1e-7)
    assert LEG.knee_of_diagonal(LEG.diagonal(knee)) == pytest.approx(knee, abs=1e-7)


def test_stretched_leg_stands_over_its_foot() -> None:
    foot = LEG.forward(AslpPose(LEG.hip_reference, LEG.knee_reference))
    assert foot == pytest.approx((0.0, -LEG.longest))
    assert LEG.cable_of_knee(LEG.knee_reference) == pytest.approx(LEG.cable_max)


@given(hips, st.floats(LEG.knee_reference + 0.05, 2.2), st.floats(0.05, 0.9))
def test_torques_are_the_slope_of_the_energy(hip: float, knee: float, share: float) -> None:
    pose = AslpPose(hip, knee, share * LEG.widest(knee))
    step = 1e-6
    slopes = [
        (
            SPRINGS.energy(LEG, pose._replace(**{name: value + step}))
            - SPRINGS.energy(LEG, pose._replace(**{name: value - step}))
        )
        / (2.0 * step)
        for name, value in (("knee", pose.knee), ("opening", pose.opening))
    ]
    assert SPRINGS.torques(LEG, pose) == pytest.approx([-slope for slope in slopes], rel=1e-4, abs=1e-5)


def test_compressed_leg_is_pushed_open_by_its_springs() -> None:
    at_knee, at_opening = SPRINGS.torques(LEG, AslpPose(0.0, 1.4, 0.1))
    assert at_knee < 0.0  # the diagonal straightens it
    assert at_opening < 0.0  # the parallel spring closes the pantograph


@pytest.mark.parametrize(("x", "z", "message"), [(0.2, 0.0, "the leg reaches"), (0.0, -1e-4, "the leg folds to")])
def test_feet_out_of_reach_are_refused_by_name(x: float, z: float, message: str) -> None:
    with pytest.raises(UnreachableError, match=message):
        LEG.inverse(x, z)
    with pytest.raises(UnreachableError, match="the leg reaches"):
        LEG.inverse(math.nan, 0.0)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"l1": 0.0}, "l1 = 0.0 m"),
        ({"l_delta": 0.07}, "l_delta = 0.07 m"),
        ({"cable_max": 0.2}, "cable_max = 0.2 m"),
        ({"parallel_travel": 0.02}, "parallel_travel = 0.02 m"),
        ({"l3": math.nan}, "l3 = nan m"),
    ],
)
def test_impossible_legs_are_refused(changes: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(LEG, **changes)
