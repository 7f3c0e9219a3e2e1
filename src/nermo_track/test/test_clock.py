"""The clock of a film, by how a mouse moves."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from nermo_description.robots import load_robot
from nermo_gap.blind.mice.mouse import draw
from nermo_gap.protocol.record import record
from nermo_gap.protocol.standard import protocol_of
from nermo_track.bench.walk import Walk
from nermo_track.clock import Motion, fit_clock
from nermo_track.commands import Commands, expected_motion
from nermo_track.errors import TrackError

NOISE = 3e-4, 2e-3
"""[m] and [rad] of a tracker."""


def seen(walked: Walk, offset: float, rate: float, seconds: float, seed: int, fps: float = 30.0) -> Motion:
    """A film of a walk: its own time, its noise, a tenth of its pictures without a pose."""
    random = np.random.default_rng(seed)
    time = np.arange(round(seconds * fps)) / fps
    time = time[random.uniform(size=len(time)) > 0.1]
    place, turn = walked.poses(offset + (1.0 + rate) * time)
    noisy = Rotation.from_rotvec(NOISE[1] * random.standard_normal((len(time), 3))) * turn
    return Motion(time, place + NOISE[0] * random.standard_normal(place.shape), noisy)


def expected(walked: Walk) -> Motion:
    return Motion(walked.time, walked.position, walked.rotation)


@settings(max_examples=10, deadline=None)
@given(offset=st.floats(-0.5, 2.5), seed=st.integers(0, 1000))
def test_a_clock_is_found_wherever_the_film_begins(walked: Walk, offset: float, seed: int) -> None:
    found = fit_clock(seen(walked, offset, 0.0, 6.5, seed), expected(walked), "film")
    assert found.offset == pytest.approx(offset, abs=max(5.0 * found.deviation, 4e-3))
    assert found.deviation < 5e-3
    assert found.agreement > 0.2


def test_a_long_film_tells_its_rate(walked: Walk) -> None:
    # Three walks one after the other, each a little longer than the one before, so that none looks like another.
    spans = [(0.0, 7.0), (0.0, 8.0), (0.0, 9.0)]
    time = np.concatenate([np.arange(*span, 0.005) for span in spans])
    place, turn = walked.poses(time)
    whole = Motion(0.005 * np.arange(len(time)), place, turn)
    longer = Walk(whole.time, np.empty((len(time), 0)), whole.position, whole.rotation)
    found = fit_clock(seen(longer, 0.4, 1e-3, 23.0, 3), whole, "film")
    assert found.rate == pytest.approx(1e-3, abs=3e-4)
    assert found.at(np.array([11.5]))[0] == pytest.approx(0.4 + 1.001 * 11.5, abs=4e-3)


def test_a_walk_that_never_changes_tells_no_clock(walked: Walk) -> None:
    # The same stride over and over again: each clock a stride off is as good.
    time = np.arange(0.0, 20.0, 0.005)
    swing = 2.0 * np.pi * time / 1.25
    place = np.column_stack([0.05 * time, 2e-3 * np.sin(swing), 2e-3 * np.cos(2.0 * swing)])
    steady = Motion(time, place, Rotation.from_euler("y", 0.05 * np.sin(swing)[:, None]))
    walk = Walk(time, np.empty((len(time), 0)), place, steady.rotation)
    with pytest.raises(TrackError, match="cannot be told"):
        fit_clock(seen(walk, 4.0, 0.0, 10.0, 1), steady, "film")


def test_a_film_of_something_else_tells_no_clock(walked: Walk) -> None:
    random = np.random.default_rng(5)
    time = np.arange(200) / 30.0
    steps = random.standard_normal((2, len(time), 3))
    other = Motion(time, 1e-3 * np.cumsum(steps[0], axis=0), Rotation.from_rotvec(0.01 * steps[1]))
    with pytest.raises(TrackError, match="cannot be told"):
        fit_clock(other, expected(walked), "film")


def test_a_film_that_is_too_short_is_refused(walked: Walk) -> None:
    with pytest.raises(TrackError, match=r"needed: 4 s"):
        fit_clock(seen(walked, 1.0, 0.0, 2.0, 0), expected(walked), "film")


def test_a_camera_that_ran_long_before_is_no_matter(walked: Walk) -> None:
    """The film is longer than the recording: the mouse stands before it."""
    found = fit_clock(seen(walked, -6.0, 0.0, 15.0, 2), expected(walked), "film")
    assert found.offset == pytest.approx(-6.0, abs=max(5.0 * found.deviation, 4e-3))
    assert found.overlap == pytest.approx(9.0, abs=0.5)


def test_a_leg_that_is_off_moves_the_clock_of_a_walk_and_not_that_of_the_piece_before_it(tmp_path: Path) -> None:
    """A hidden mouse, all of whose numbers are off and one hip's horn by some degrees; the film began with it."""
    robot = load_robot("nermo_lite")
    asked = protocol_of("standard", robot, filmed=True)
    walking = next(s for s in asked.segments if s.name == "walking")
    body, _ = draw(robot, 203, "hip_offset", False)
    (folder,) = record(replace(asked, segments=(walking,)), body, tmp_path / "mouse", 203)
    table = np.load(folder / "recording.npz")
    told = np.isfinite(table[f"{next(iter(robot.servos))}_command"])
    angles = np.column_stack([table[f"{servo}_command"][told] for servo in robot.servos])
    begin = float(table["t"][told][0])
    commands = Commands("servo_command", np.round(1e9 * table["t"][told]).astype(np.int64), angles, 0)
    rows = np.flatnonzero(np.isfinite(table["base_x"]))
    place = np.column_stack([table[f"base_{axis}"][rows] for axis in "xyz"])
    turn = Rotation.from_quat(np.column_stack([table[f"base_q{axis}"][rows] for axis in "wxyz"]), scalar_first=True)
    film, twin = Motion(table["t"][rows] - begin, place, turn), expected_motion(commands, robot)
    end = walking.pieces[0].seconds
    middle = float(film.time.mean())
    walk, piece = (fit_clock(film, twin.between(*part), "film") for part in ((end, 99.0), (0.0, end)))
    late, right = (abs(float(found.at(np.array([middle]))[0]) - middle) for found in (walk, piece))
    assert right < 3e-3 < 8e-3 < late
    assert late > 5.0 * walk.deviation and right < 4.0 * piece.deviation
    # The walk's clock looks as sure, so that it is warned of; the piece's is not.
    assert walk.walked > 0.7 and "may be wrong by 20 ms" in walk.warnings()[0]
    assert piece.walked < 0.1 and piece.warnings() == []
