"""Tags in files and on paper."""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from nermo_description.model import build_model
from nermo_description.parameter_files import ParameterError
from nermo_description.parameters import LEGS
from nermo_description.results import CommandError
from nermo_description.robots import load_robot
from nermo_track.calibrate import board
from nermo_track.cli import track_app
from nermo_track.layout import DICTIONARY, MODULES, TAGS, Tag, load_layout
from nermo_track.sightings import Detector

DOTS_A_MM = 300.0 / 25.4


def standing(robot: str) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """A robot in its stand."""
    model = build_model(load_robot(robot))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    return model, data


@given(
    size=st.floats(0.005, 0.5),
    place=st.tuples(*3 * [st.floats(-1.0, 1.0)]),
    turn=st.tuples(*3 * [st.floats(-180.0, 180.0)]),
)
def test_corners_are_a_square_about_the_middle(size: float, place, turn) -> None:
    tag = Tag(id=1, size=size, position=place, rpy_deg=turn)
    corners = tag.corners
    np.testing.assert_allclose(corners.mean(axis=0), place, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1), size, atol=1e-9)
    # Clockwise, seen from where the print is read.
    normal = np.cross(corners[0] - corners[1], corners[2] - corners[1])
    np.testing.assert_allclose(normal / size**2, tag.rotation.apply([0.0, 0.0, 1.0]), atol=1e-6)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("mouse: []\nfloor: [{id: 1, size: 0.05, position: [0, 0, 0]}]", "mouse"),
        ("mouse: [{id: 1, size: 0.05, position: [0, 0, 0]}]", "floor: is missing"),
        (
            "mouse: [{id: 1, size: 0.05, position: [0, 0, 0]}]\nfloor: [{id: 1, size: 0.05, position: [0, 0, 0]}]",
            "tag 1 is there twice",
        ),
        (
            "mouse: [{id: 600, size: 0.05, position: [0, 0, 0]}]\nfloor: [{id: 1, size: 0.05, position: [0, 0, 0]}]",
            "id: is 600",
        ),
        (
            "mouse: [{id: 2, size: 40.0, position: [0, 0, 0]}]\nfloor: [{id: 1, size: 0.05, position: [0, 0, 0]}]",
            "allowed: 0.004 to 1.0 m",
        ),
        (
            "mouse: [{id: 1, size: 0.05, position: [0, 0, 0]}]\nfloor: [{id: 2, size: 0.05, position: [0, 0, 0]}]\n"
            "markers: {front_left_knee: [{id: 3, size: 0.05, position: [0, 0, 0]}]}",
            "front_left_knee is no place for one; choose of front_left_foot",
        ),
        (
            "mouse: [{id: 1, size: 0.05, position: [0, 0, 0]}]\nfloor: [{id: 2, size: 0.05, position: [0, 0, 0]}]\n"
            "markers: {front_left_foot: [{id: 1, size: 0.05, position: [0, 0, 0]}]}",
            "tag 1 is there twice",
        ),
    ],
)
def test_a_file_that_cannot_be_is_named(tmp_path: Path, text: str, words: str) -> None:
    file = tmp_path / "tags.yaml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(ParameterError, match=re.escape(words)) as caught:
        load_layout(file)
    assert str(file) in str(caught.value)


@pytest.mark.parametrize("robot", ["nermo", "nermo_lite"])
def test_the_tag_lies_on_the_back(robot: str) -> None:
    """The card is 2 mm over the torso's box, and within its edges."""
    model, data = standing(robot)
    (tag,) = load_layout().mouse
    axes = data.site("base_link").xmat.reshape(3, 3)
    corners = tag.corners @ axes.T + data.site("base_link").xpos
    box = next(g for g in range(model.ngeom) if model.geom(g).name == "torso")
    inside = (corners - data.geom_xpos[box]) @ data.geom_xmat[box].reshape(3, 3)
    half = model.geom_size[box]
    assert (np.abs(inside[:, :2]) < half[:2]).all()
    assert inside[:, 2] == pytest.approx(half[2] + 0.002, abs=0.0015)


@pytest.mark.parametrize("robot", ["nermo", "nermo_lite"])
def test_cards_at_the_paws_stand_upright_look_outwards_and_touch_nothing(robot: str) -> None:
    model, data = standing(robot)
    found = load_layout().markers
    assert set(found) == {f"{leg}_foot" for leg in LEGS}
    for place, (tag,) in found.items():
        axes, origin = data.site(place).xmat.reshape(3, 3), data.site(place).xpos
        _, up, out = (axes @ tag.rotation.as_matrix()).T
        outwards = 1.0 if "left" in place else -1.0
        assert outwards * out[1] > 0.99 and up[2] > 0.97
        # The quiet zone of one module around it is part of the card.
        card = tag.model_copy(update={"size": tag.size * (MODULES + 2) / MODULES})
        corners = card.corners @ axes.T + origin
        assert corners[:, 2].min() > 0.001
        paw = model.site(place).bodyid[0]
        thick = max(
            outwards * (data.geom_xpos[g] - origin)[1] + model.geom_size[g, :2].max()
            for g in range(model.ngeom)
            if model.geom_bodyid[g] == paw and model.geom_type[g] == mujoco.mjtGeom.mjGEOM_SPHERE
        )
        assert (outwards * (corners - origin)[:, 1]).min() > thick


def test_sheets_are_true_to_scale(tmp_path: Path) -> None:
    layout = load_layout()
    glued = tuple(tag for tags in layout.markers.values() for tag in tags)
    for what, tags in (("mouse", layout.mouse), ("markers", glued), ("floor", layout.floor)):
        out = tmp_path / f"{what}.png"
        assert CliRunner().invoke(track_app, ["sheet", "--what", what, "--out", str(out)]).exit_code == 0
        picture = cv2.imread(str(out), cv2.IMREAD_GRAYSCALE)
        assert picture.shape == (2480, 3507)
        corners = Detector(tuple(tag.id for tag in tags)).find(picture) / DOTS_A_MM
        sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
        assert sides == pytest.approx(np.repeat([[1e3 * tag.size] for tag in tags], 4, axis=1), abs=0.1)
        if what == "floor":
            middles = corners.mean(axis=1) * [1.0, -1.0]
            truth = 1e3 * np.array([tag.position[:2] for tag in tags])
            np.testing.assert_allclose(middles - middles[0], truth - truth[0], atol=0.1)


def test_the_board_is_found_on_its_sheet(tmp_path: Path) -> None:
    out = tmp_path / "board.png"
    assert CliRunner().invoke(track_app, ["sheet", "--what", "board", "--out", str(out)]).exit_code == 0
    corners, numbers, _, _ = cv2.aruco.CharucoDetector(board()).detectBoard(cv2.imread(str(out), 0))
    assert len(numbers) == 40
    truth = 1e3 * board().getChessboardCorners()[numbers.ravel(), :2]
    found = corners.reshape(-1, 2) / DOTS_A_MM
    np.testing.assert_allclose(found - found[0], truth - truth[0], atol=0.15)


def test_a_pdf_has_a_page_a4_for_each(tmp_path: Path) -> None:
    out = tmp_path / "tags.pdf"
    told = CliRunner().invoke(track_app, ["sheet", "--out", str(out)])
    assert told.exit_code == 0 and "100 %" in told.output
    boxes = re.findall(rb"/MediaBox \[ ?([\d. ]+)\]", out.read_bytes())
    assert len(boxes) == 4
    for box in boxes:
        width, height = (float(number) * 25.4 / 72.0 for number in box.split()[2:])
        assert (width, height) == pytest.approx((297.0, 210.0), abs=0.1)


def test_a_layout_without_markers_has_no_page_for_them(tmp_path: Path) -> None:
    tags, out = tmp_path / "tags.yaml", tmp_path / "tags.pdf"
    tags.write_text(
        "mouse: [{id: 0, size: 0.04, position: [0, 0, 0]}]\nfloor: [{id: 20, size: 0.06, position: [0, 0, 0]}]\n",
        encoding="utf-8",
    )
    assert CliRunner().invoke(track_app, ["sheet", "--tags", str(tags), "--out", str(out)]).exit_code == 0
    assert len(re.findall(rb"/MediaBox", out.read_bytes())) == 3
    alone = CliRunner().invoke(track_app, ["sheet", "--what", "markers", "--tags", str(tags), "--out", str(out)])
    assert isinstance(alone.exception, CommandError) and "has no markers" in str(alone.exception)


@pytest.mark.parametrize(("name", "words"), [("tags.svg", "must end in"), ("tags.png", "holds one page")])
def test_a_sheet_that_cannot_be_is_refused(tmp_path: Path, name: str, words: str) -> None:
    told = CliRunner().invoke(track_app, ["sheet", "--out", str(tmp_path / name)])
    assert isinstance(told.exception, CommandError) and words in str(told.exception) and told.exception.status == 2


@settings(max_examples=8, deadline=None)
@given(number=st.integers(0, TAGS - 1), turn=st.floats(-180.0, 180.0), seed=st.integers(0, 99))
def test_corners_are_found_to_a_tenth_of_a_pixel(number: int, turn: float, seed: int) -> None:
    """A tag of 48 pixels whose edges lie anywhere, blurred and noisy."""
    random = np.random.default_rng(seed)
    fine, edge = 8, 48.0
    inner = cv2.aruco.generateImageMarker(DICTIONARY, number, 512)
    paper = np.pad(inner, 64, constant_values=255)
    angle, middle = np.radians(turn), 64.0 + random.uniform(-0.5, 0.5, 2)
    scale = edge / 512.0 * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    matrix = np.column_stack([fine * scale, fine * (middle + 0.5 - scale @ [320.0, 320.0]) - 0.5])
    drawn = cv2.warpAffine(paper, matrix, (128 * fine, 128 * fine), borderValue=128)
    picture = cv2.GaussianBlur(cv2.resize(drawn, (128, 128), interpolation=cv2.INTER_AREA), (0, 0), 0.7)
    noisy = np.clip(picture + 2.0 * random.standard_normal(picture.shape), 0, 255).astype(np.uint8)
    truth = np.array([[64.0, 64.0], [576.0, 64.0], [576.0, 576.0], [64.0, 576.0]]) - 320.0
    found = Detector((number,)).find(noisy)[0]
    assert np.sqrt(np.mean((found - (truth @ scale.T + middle)) ** 2)) < 0.1
