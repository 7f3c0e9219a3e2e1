"""Poses out of corners, their covariance, and several cameras together."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from nermo_description.parameter_files import ParameterError
from nermo_track.bench.studio import look_at
from nermo_track.camera import Camera, load_camera, save_camera
from nermo_track.commands import Commands
from nermo_track.faults import longest_gap, outliers
from nermo_track.fuse import Poses, fuse
from nermo_track.layout import load_layout
from nermo_track.pose import Placement, corner_points, covariance, fits
from nermo_track.work import at_commands

CAMERA = Camera(
    width=960, height=720, fx=900.0, fy=903.0, cx=485.0, cy=357.0, distortion=(-0.25, 0.08, 1e-3, -5e-4, 0.0)
)
WORLD = look_at((0.1, -0.5, 0.55), (0.15, 0.0, 0.0))
MOUSE = load_layout().mouse
ALL = np.ones(len(MOUSE), dtype=bool)


@given(x=st.floats(0.0, 959.0), y=st.floats(0.0, 719.0))
def test_a_ray_comes_back_to_its_pixel(x: float, y: float) -> None:
    pixel = np.array([[x, y]])
    np.testing.assert_allclose(CAMERA.project(CAMERA.rays(pixel))[0], pixel, atol=1e-3)


def test_pixels_move_as_the_jacobian_says() -> None:
    point, step = np.array([[0.05, -0.08, 0.7]]), 1e-6
    pixel, slope = CAMERA.project(point)
    for axis in range(3):
        moved = CAMERA.project(point + step * np.eye(3)[axis])[0]
        np.testing.assert_allclose((moved - pixel)[0] / step, slope[0, :, axis], rtol=1e-4, atol=1e-2)


def test_a_camera_is_read_as_it_was_written(tmp_path: Path) -> None:
    save_camera(CAMERA, tmp_path / "camera.yaml")
    assert load_camera(tmp_path / "camera.yaml") == CAMERA


def test_a_camera_that_cannot_be_is_named(tmp_path: Path) -> None:
    file = tmp_path / "camera.yaml"
    save_camera(CAMERA, file)
    file.write_text(file.read_text("utf-8").replace("fx: 900.0", "fx: -3.0"), "utf-8")
    with pytest.raises(ParameterError, match=r"camera.yaml: fx: is -3.0"):
        load_camera(file)


@settings(deadline=None)
@given(
    x=st.floats(0.0, 0.3),
    y=st.floats(-0.1, 0.1),
    yaw=st.floats(-180.0, 180.0),
    pitch=st.floats(-15.0, 15.0),
    roll=st.floats(-15.0, 15.0),
)
def test_a_pose_is_found_from_its_corners(x: float, y: float, yaw: float, pitch: float, roll: float) -> None:
    body = Placement(Rotation.from_euler("xyz", [roll, pitch, yaw], degrees=True), np.array([x, y, 0.045]))
    pixels = CAMERA.project(WORLD.apply(body.apply(corner_points(MOUSE, ALL))))[0]
    best = fits(CAMERA, MOUSE, pixels.reshape(-1, 4, 2))[0]
    found = WORLD.inverse @ best.placement
    assert best.squares < 1e-3
    np.testing.assert_allclose(found.position, body.position, atol=2e-4)
    assert (found.rotation * body.rotation.inv()).magnitude() < 5e-3


def test_no_corner_no_pose() -> None:
    assert fits(CAMERA, MOUSE, np.full((len(MOUSE), 4, 2), np.nan)) == []


def test_the_covariance_is_that_of_noisy_corners() -> None:
    random, noise = np.random.default_rng(1), 0.05
    body = Placement(Rotation.from_euler("xyz", [3.0, -4.0, 30.0], degrees=True), np.array([0.12, 0.03, 0.045]))
    points = corner_points(MOUSE, ALL)
    pixels = CAMERA.project(WORLD.apply(body.apply(points)))[0]
    off = []
    for _ in range(400):
        seen = (pixels + noise * random.standard_normal(pixels.shape)).reshape(-1, 4, 2)
        near = min(
            (WORLD.inverse @ fit.placement for fit in fits(CAMERA, MOUSE, seen)),
            key=lambda pose: (pose.rotation * body.rotation.inv()).magnitude(),
        )
        off.append([*(near.position - body.position), *(near.rotation * body.rotation.inv()).as_rotvec()])
    said = covariance(CAMERA, WORLD, body, points, np.full(len(points), noise))
    np.testing.assert_allclose(np.std(off, axis=0), np.sqrt(np.diag(said)), rtol=0.2)


@settings(deadline=None)
@given(places=st.sets(st.integers(0, 12), max_size=4), far=st.floats(0.03, 0.5), turned=st.booleans())
@example(places={11}, far=0.3947141965759662, turned=True)  # half a turn
def test_poses_that_stand_alone_are_found_and_no_others(places: set[int], far: float, turned: bool) -> None:
    rows = {8 + 14 * place for place in places}  # so that no two are neighbours
    random, time = np.random.default_rng(7), np.arange(200) / 30.0
    place = np.column_stack([0.08 * time, 0.01 * np.sin(5.0 * time), np.full(200, 0.045)])
    place += 5e-4 * random.standard_normal(place.shape)
    turn = Rotation.from_euler("z", 0.4 * time[:, None])
    rotvec = 0.01 * random.standard_normal((200, 3))
    for row in rows:
        if turned:
            rotvec[row] += [0.0, 8.0 * far, 0.0]
        else:
            place[row, 1] += far
    spread = np.tile(np.diag([5e-4] * 3 + [0.01] * 3) ** 2, (200, 1, 1))
    assert set(np.flatnonzero(outliers(time, place, Rotation.from_rotvec(rotvec) * turn, spread))) == rows


@given(row=st.integers(10, 180), size=st.floats(0.01, 0.1), between=st.floats(0.0, 1.0))
def test_a_mouse_that_jumps_is_no_outlier(row: int, size: float, between: float) -> None:
    """From one place to another within two pictures, the middle one anywhere on the way."""
    random, time = np.random.default_rng(3), np.arange(200) / 30.0
    step = np.where(np.arange(200) < row, 0.0, 1.0)
    step[row] = between
    place = np.outer(step, [size, 0.2 * size, -0.1 * size]) + 3e-4 * random.standard_normal((200, 3))
    turn = Rotation.from_rotvec(np.outer(step, [0.0, 5.0 * size, 0.0]) + 2e-3 * random.standard_normal((200, 3)))
    spread = np.tile(np.diag([3e-4] * 3 + [2e-3] * 3) ** 2, (200, 1, 1))
    assert not outliers(time, place, turn, spread).any()


def test_the_longest_gap_counts_the_ends() -> None:
    time = np.arange(10) / 10.0
    assert longest_gap(time, np.array([2, 3, 7])) == pytest.approx(0.3)
    assert longest_gap(time, np.array([5])) == pytest.approx(0.5)
    assert longest_gap(time, np.arange(10)) == 0.0


@given(weights=st.tuples(st.floats(0.1, 10.0), st.floats(0.1, 10.0)), off=st.floats(-0.01, 0.01))
def test_cameras_are_weighed_by_what_they_know(weights: tuple[float, float], off: float) -> None:
    """Of scalars it is the mean weighed by the inverse variances."""
    time = np.arange(20) / 30.0
    place = np.zeros((20, 3))
    one, other = (np.tile(np.eye(6) * (1e-3 * weight) ** 2, (20, 1, 1)) for weight in weights)
    still = Rotation.identity(20)
    # The second camera's pictures are half a period later.
    shifted = Poses(time + 0.5 / 30.0, place + np.array([off, 0.0, 0.0]), still, other)
    both, apart = fuse([Poses(time, place, still, one), shifted])
    share = weights[1] ** -2 / (weights[0] ** -2 + weights[1] ** -2)
    assert both.position[1:, 0] == pytest.approx(share * off, abs=1e-9)
    assert both.position[0, 0] == 0.0  # nothing to weigh it with yet
    assert apart[0].position == pytest.approx(abs(off), abs=1e-12)
    assert (np.linalg.eigvalsh(one[1:] - both.covariance[1:]) > 0.0).all()


@given(fps=st.floats(24.0, 120.0), begin=st.floats(-0.2, 0.1))
def test_poses_are_carried_to_commands_along_their_way(fps: float, begin: float) -> None:
    """What moves and turns evenly is, at each command, where it is then."""
    time = begin + np.arange(40) / fps
    poses = Poses(
        time,
        np.outer(time, [0.1, -0.05, 0.02]),
        Rotation.from_rotvec(np.outer(time, [0.2, 0.0, 1.0])),
        np.tile(np.eye(6), (40, 1, 1)),
    )
    commands = Commands("/servo_command", 5 * 10**9 + 5_000_000 * np.arange(60), np.empty((60, 0)), 0)
    told = at_commands(poses, commands)
    assert set(np.round(told.time / 0.005, 6)) <= set(range(60)) and (np.diff(told.time) > 0.0).all()
    inside = ((time >= 0.0) & (time <= 59 * 0.005)).sum()
    assert inside <= len(told.time) <= inside + 2
    np.testing.assert_allclose(told.position, np.outer(told.time, [0.1, -0.05, 0.02]), atol=1e-12)
    off = told.rotation * Rotation.from_rotvec(np.outer(told.time, [0.2, 0.0, 1.0])).inv()
    assert off.magnitude().max() < 1e-9
