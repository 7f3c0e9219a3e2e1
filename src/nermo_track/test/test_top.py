"""The way of a mouse without tags, on films from above that are drawn of the twin's own shape."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from nermo_description.results import CommandError
from nermo_description.robots import load_robot
from nermo_track.bench.studio import save_film
from nermo_track.bench.top import EYE, LENS, Scene, errors, shoot_scene
from nermo_track.bench.walk import Walk, walk
from nermo_track.camera import Camera, save_camera
from nermo_track.cli import track_app
from nermo_track.errors import TrackError
from nermo_track.layout import load_layout
from nermo_track.plane import Plane
from nermo_track.silhouette import Outlines
from nermo_track.top import View, overlook
from nermo_track.way import way

SECONDS = 4.0
CAMERA = Camera(width=240, height=180, fx=180.0, fy=180.0, cx=119.5, cy=89.5)


def silent(stage: str, share: float) -> None:
    """Progress that nobody watches."""


@pytest.fixture(scope="module")
def gone() -> Walk:
    return walk(load_robot("nermo_lite"), SECONDS + 1.5, ((0.0, 0.0, 0.0), (1.2, 0.08, 0.0)))


@pytest.fixture(scope="module")
def film(gone: Walk, tmp_path_factory: pytest.TempPathFactory) -> View:
    scene = Scene("floor's tags", seconds=SECONDS, empty=True)
    return shoot_scene(scene, load_robot("nermo_lite"), gone, load_layout(), tmp_path_factory.mktemp("top"), LENS, 0)


def test_the_way_is_what_it_was(film: View, gone: Walk) -> None:
    found = overlook(film, load_layout(), silent)
    off = errors(found, gone)
    assert off["way_m"] > 0.1
    assert off["seen"] > 0.9 * off["pictures"]
    assert off["nose_by"] == "tail"
    assert abs(off["mean_speed_error_mm_s"]) < 3.0
    assert off["speed_rms_mm_s"] < 10.0
    assert off["heading_rms_deg"] < 3.0
    assert abs(off["drift_end_mm"]) < max(3.0 * off["drift_said_mm"], 8.0)


def test_a_height_does_as_well_as_tags(film: View, tmp_path: Path) -> None:
    out, facts, camera = tmp_path / "way.csv", tmp_path / "way.json", tmp_path / "camera.yaml"
    save_camera(LENS, camera)
    by_tags = overlook(film, load_layout(), silent)
    arguments = ["top", str(film.film), "--floor", str(film.floor), "--camera", str(camera), "--height", str(EYE[2])]
    told = CliRunner().invoke(track_app, [*arguments, "--out", str(out), "--json", str(facts)])
    assert told.exit_code == 0, told.output
    assert "pictures (" in told.output and "mm/s" in told.output and "to the left" in told.output
    table = np.genfromtxt(out, delimiter=",", names=True)
    assert (np.diff(table["t"]) > 0.0).all() and (table["sd_speed"] > 0.0).all()
    said = json.loads(facts.read_text("utf-8"))["film"]
    assert said["mean_speed_m_s"] == pytest.approx(by_tags.way.mean_speed, rel=0.02)
    assert table["drift"][-1] == pytest.approx(by_tags.way.drift[-1], abs=5e-3)


# What moves, drawn in a blink: boxes on a floor with a pattern.


def floor_picture(seed: int = 0) -> np.ndarray:
    random = np.random.default_rng(seed)
    grain = cv2.GaussianBlur(random.standard_normal((260, 340)), (0, 0), 3.0)
    return np.clip(130.0 + 60.0 * grain / np.std(grain) * 0.3, 0, 255)


def box_film(path: Path, places: list[list[tuple[float, float]]], shake: float = 0.0, tail: int = 0) -> Path:
    """Boxes of 40 x 16 px at places in each picture, with a tail [px] to the right; the camera shakes [px]."""
    random, wide = np.random.default_rng(1), floor_picture()

    def pictures():
        for several in places:
            dx, dy = np.round(shake * random.standard_normal(2)).astype(int)
            picture = wide[40 + dy : 220 + dy, 50 + dx : 290 + dx].copy()
            for x, y in several:
                cv2.rectangle(picture, (round(x) - 20, round(y) - 8), (round(x) + 20, round(y) + 8), 30.0, -1)
                if tail:
                    cv2.line(picture, (round(x), round(y)), (round(x) + 20 + tail, round(y)), 30.0, 2)
            noisy = cv2.GaussianBlur(picture, (0, 0), 0.7) + 1.5 * random.standard_normal(picture.shape)
            yield np.clip(noisy, 0, 255).astype(np.uint8)

    save_film(pictures(), path, CAMERA, 30.0)
    return path


def straight(count: int = 60) -> list[list[tuple[float, float]]]:
    return [[(40.0 + 2.5 * number, 90.0)] for number in range(count)]


def test_a_scale_alone_tells_the_speed_and_the_way_tells_the_nose(tmp_path: Path) -> None:
    path = box_film(tmp_path / "film.avi", straight())
    found = overlook(View(path, scale=2e-3), load_layout(), silent).way
    assert found.nose_by == "way"
    assert found.mean_speed == pytest.approx(2.5 * 30.0 * 2e-3, rel=0.01)
    assert found.drift[-1] == pytest.approx(0.0, abs=2e-3)
    assert np.abs(found.heading).max() < 0.02


def test_a_tail_tells_the_nose_of_a_mouse_that_walks_backwards(tmp_path: Path) -> None:
    path = box_film(tmp_path / "film.avi", straight(), tail=24)
    found = overlook(View(path, scale=2e-3), load_layout(), silent).way
    assert found.nose_by == "tail"
    assert np.abs(np.cos(found.heading) + 1.0).max() < 1e-3
    assert np.median(found.speed) == pytest.approx(-2.5 * 30.0 * 2e-3, rel=0.02)


def test_pictures_with_something_else_are_left_out_and_counted(tmp_path: Path) -> None:
    places = straight()
    for number in range(20, 26):
        places[number].append((150.0, 30.0))
    found = overlook(View(box_film(tmp_path / "film.avi", places), scale=2e-3), load_layout(), silent).way
    assert found.unseen.several == 6 and found.unseen.count == 6
    assert found.unseen.longest == pytest.approx(0.2, abs=1e-6)
    assert "6 with something else that moves" in found.unseen.sentence()


def test_a_mouse_that_stands_is_seen_before_a_floor_filmed_alone(tmp_path: Path) -> None:
    places = [[(60.0, 90.0)]] * 30 + [[(60.0 + 2.0 * number, 90.0)] for number in range(25)]
    path, floor = box_film(tmp_path / "film.avi", places), box_film(tmp_path / "floor.avi", [[]] * 5)
    with pytest.raises(TrackError, match=r"--floor"):
        overlook(View(path, scale=2e-3), load_layout(), silent)
    found = overlook(View(path, scale=2e-3, floor=floor), load_layout(), silent).way
    assert found.along == pytest.approx(48.0 * 2e-3, rel=0.03)


@pytest.mark.parametrize(
    ("places", "shake", "words"),
    [
        ([[]] * 40, 0.0, "nothing as large as a mouse moves"),
        ([[(40.0 + 2.5 * k, 50.0), (190.0 - 2.5 * k, 130.0)] for k in range(60)], 0.0, "several things move in"),
        (straight(), 3.0, "the camera must stand still"),
    ],
)
def test_a_film_that_does_not_tell_is_refused(tmp_path: Path, places, shake: float, words: str) -> None:
    path, out = box_film(tmp_path / "film.avi", places, shake), tmp_path / "way.csv"
    told = CliRunner().invoke(track_app, ["top", str(path), "--scale", "0.002", "--out", str(out)])
    assert isinstance(told.exception, CommandError), told.output
    assert words in str(told.exception) and "film.avi" in str(told.exception) and told.exception.status == 2
    assert not out.exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nowhere.mp4", "--scale", "0.002", "--out", "way.csv"], "no such film"),
        (["{film}", "--out", "way.csv"], "--scale"),
        (["{film}", "--scale", "0.002", "--height", "1", "--out", "way.csv"], "give one of them"),
        (["{film}", "--scale", "0.002", "--out", "way.txt"], "must end in .csv"),
        (["{film}", "--camera", "{camera}", "--out", "way.csv"], "none of the floor's tags"),
        (["{film}", "--camera", "{camera}", "--height", "0.08", "--out", "way.csv"], "--height: the camera is 0.08 m"),
    ],
)
def test_what_cannot_be_used_is_named(tmp_path: Path, arguments: list[str], words: str) -> None:
    film, camera = box_film(tmp_path / "film.avi", straight(15)), tmp_path / "camera.yaml"
    save_camera(CAMERA, camera)
    told = CliRunner().invoke(track_app, ["top", *(text.format(film=film, camera=camera) for text in arguments)])
    assert isinstance(told.exception, CommandError)
    assert words in str(told.exception) and told.exception.status == 2


@given(x=st.floats(0.0, 239.0), y=st.floats(0.0, 179.0), scale=st.floats(1e-4, 1e-2))
def test_a_scale_is_metres_a_pixel_everywhere(x: float, y: float, scale: float) -> None:
    plane = Plane.of_scale(None, scale, 240, 180)
    place = plane.metres(np.array([[x, y]]))[0]
    assert place == pytest.approx([scale * (x - 119.5), scale * (89.5 - y)], abs=1e-9)


@settings(deadline=None)
@given(start=st.floats(-3.1, 3.1), rate=st.floats(-1.0, 1.0), speed=st.floats(0.05, 0.3))
def test_a_nose_is_found_whichever_way_the_axis_was_told(start: float, rate: float, speed: float) -> None:
    """A mouse that walks a curve and whose axis is told at random by either of its ends."""
    random, time = np.random.default_rng(4), np.arange(90) / 30.0
    heading = start + rate * time
    middle = np.cumsum(speed / 30.0 * np.column_stack([np.cos(heading), np.sin(heading)]), axis=0)
    axis = heading + np.pi * random.integers(0, 2, 90)
    ones = np.ones(90)
    zero = np.zeros(90, dtype=np.int64)
    seen = Outlines(time, zero, middle, axis, 0.1 * ones, 3e-3 * ones, 0.0 * ones, 0.0 * ones)
    found = way(seen, "film")
    assert found.nose_by == "way"
    np.testing.assert_allclose(np.cos(found.heading - heading), 1.0, atol=1e-3)
    np.testing.assert_allclose(found.speed, speed, rtol=0.02)
