"""Films that are drawn of a walk whose truth is known, through the whole of the tracker."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from typer.testing import CliRunner

from nermo_description.markers import MARKER_TOPIC
from nermo_description.results import CommandError
from nermo_description.robots import load_robot
from nermo_gap.robots.channels import TRACKER, marker, uncertainty
from nermo_gap.robots.mcap_table import mcap_table
from nermo_node.recording_reader import Recording
from nermo_track.bench.command import BEGIN, COVERED, errors
from nermo_track.bench.walk import Walk
from nermo_track.cli import track_app
from nermo_track.clock import Motion
from nermo_track.layout import load_layout
from nermo_track.work import Shot, follow, on_clock


def silent(stage: str, share: float) -> None:
    """Progress that nobody watches."""


@pytest.mark.parametrize(
    ("name", "position_mm", "heading_deg"), [("above", 1.5, 0.2), ("oblique", 1.5, 0.2), ("behind", 3.5, 0.4)]
)
def test_the_mouse_is_where_it_was(films, walked: Walk, name: str, position_mm: float, heading_deg: float) -> None:
    place, film, _ = films[name]
    found = follow(Shot(film, place.camera), load_layout(), silent)
    timed = on_clock(found, Motion(walked.time, walked.position, walked.rotation))
    off = errors(timed, walked)
    assert off["way_m"] > 0.1
    assert off["position_rms_mm"] < position_mm
    assert off["heading_rms_deg"] < heading_deg
    assert abs(off["clock_error_ms"]) < 3.0
    assert 1.0 / 4.0 < off["error_over_said"] < 4.0


def test_a_hand_before_the_mouse_is_said(films) -> None:
    place, film, _ = films["above"]
    missing = follow(Shot(film, place.camera), load_layout(), silent).track.missing
    low, high = COVERED[0]
    covered = round((high - low) * place.fps)
    assert covered <= missing.lost + missing.misfit + missing.jump <= covered + 3
    assert missing.longest == pytest.approx(high - low, abs=1.5 / place.fps)
    assert f"{missing.lost} without a tag" in missing.sentence()


def test_a_film_becomes_a_recording_that_the_diagnosis_reads(
    films, walked: Walk, bag: Path, start: int, tmp_path: Path
) -> None:
    _, film, camera = films["oblique"]
    before = {file: file.read_bytes() for file in bag.iterdir()}
    out, facts = tmp_path / "filmed", tmp_path / "track.json"
    arguments = ["film", str(film), "--camera", str(camera), "--recording", str(bag)]
    told = CliRunner().invoke(track_app, [*arguments, "--out", str(out), "--json", str(facts)])
    assert told.exit_code == 0, told.output
    assert {file: file.read_bytes() for file in bag.iterdir()} == before
    original, copy = Recording(bag), Recording(out)
    assert [m.data for m in copy.raw(["/nermo/servo_command"])] == [m.data for m in original.raw()]
    odometry = copy.read(["/nermo/tracker/odom"])["/nermo/tracker/odom"]
    assert (np.diff(odometry.stamp) > 0).all()
    place, _ = walked.poses((odometry.stamp - start) * 1e-9)
    seen = np.column_stack([odometry[f"pose.pose.position.{axis}"] for axis in "xyz"])
    assert np.sqrt(np.mean(np.sum((seen - place) ** 2, axis=1))) < 1.5e-3
    spread = odometry["pose.covariance"].reshape(-1, 6, 6)
    assert (np.linalg.eigvalsh(spread) > 0.0).all()
    assert (odometry["twist.covariance"][:, 0] == -1.0).all()
    table = mcap_table(out, load_robot("nermo_lite"))
    rows = np.isfinite(table["base_x"])
    assert rows.sum() == len(odometry)
    assert all(np.isfinite(table[column][rows]).all() for column in TRACKER)
    # What the film says of itself is the least that the diagnosis takes for noise.
    known = uncertainty([table])
    assert [known[c] for c in TRACKER[:3]] == pytest.approx(np.median(np.sqrt(spread[:, range(3), range(3)]), axis=0))
    turned = np.sqrt(np.mean(spread[:, range(3, 6), range(3, 6)], axis=1))
    assert known["base_qw"] == pytest.approx(0.5 * np.median(turned))
    again = CliRunner().invoke(track_app, [*arguments, "--out", str(out)])
    assert isinstance(again.exception, CommandError) and "never overwritten" in str(again.exception)


def test_marked_feet_are_where_they_were_and_the_diagnosis_reads_them(
    beside, feet, bag: Path, start: int, tmp_path: Path
) -> None:
    _, film, camera = beside
    out, facts = tmp_path / "filmed", tmp_path / "track.json"
    arguments = ["film", str(film), "--camera", str(camera), "--recording", str(bag), "--out", str(out)]
    told = CliRunner().invoke(track_app, [*arguments, "--json", str(facts)])
    assert told.exit_code == 0, told.output
    # The camera stands to the right: cards on the left look away.
    seen = ("front_right_foot", "rear_right_foot")
    assert set(json.loads(facts.read_text("utf-8"))["films"][0]["markers"]) == set(seen)
    recording = Recording(out)
    table = mcap_table(out, load_robot("nermo_lite"))
    known = uncertainty([table])
    assert "marker_front_left_foot_x" not in table
    for place in seen:
        topic = f"/nermo/{MARKER_TOPIC.format(place=place)}"
        data = recording.read([topic])[topic]
        assert len(data) > 100
        truth, turned = feet[place]((data.stamp - start) * 1e-9)
        off = np.column_stack([data[f"pose.pose.position.{axis}"] for axis in "xyz"]) - truth
        spread = data["pose.covariance"].reshape(-1, 6, 6)[:, :3, :3]
        # Across the line of sight it is told well, along it as well as is said.
        assert np.sqrt(np.mean(off[:, 0] ** 2)) < 0.8e-3
        assert np.sqrt(np.mean(off**2)) < 2e-3
        scaled = np.median(np.einsum("ni,nij,nj->n", off, np.linalg.inv(spread), off)) / chi2.ppf(0.5, 3)
        assert 1.0 / 16.0 < scaled < 16.0
        turn = Rotation.from_quat(np.column_stack([data[f"pose.pose.orientation.{part}"] for part in "xyzw"]))
        assert np.degrees(np.median((turn * turned.inv()).magnitude())) < 5.0
        columns = marker(place)
        rows = np.isfinite(table[columns[0]])
        assert rows.sum() == len(data)
        assert [known[column] for column in columns] == pytest.approx(
            np.median(np.sqrt(spread[:, range(3), range(3)]), axis=0)
        )


@pytest.mark.slow
def test_two_cameras_are_no_worse_than_one(films, walked: Walk, bag: Path, start: int, tmp_path: Path) -> None:
    (_, above, one), (_, behind, other) = films["above"], films["behind"]
    arguments = ["film", str(above), str(behind), "--camera", str(one), "--camera", str(other)]
    told = CliRunner().invoke(track_app, [*arguments, "--recording", str(bag), "--out", str(tmp_path / "both")])
    assert told.exit_code == 0, told.output
    assert "degrees apart" in told.output
    odometry = Recording(tmp_path / "both").read(["/nermo/tracker/odom"])["/nermo/tracker/odom"]
    place, _ = walked.poses((odometry.stamp - start) * 1e-9)
    seen = np.column_stack([odometry[f"pose.pose.position.{axis}"] for axis in "xyz"])
    assert np.sqrt(np.mean(np.sum((seen - place) ** 2, axis=1))) < 1.5e-3


@pytest.mark.slow
def test_a_clock_is_fitted_where_it_is_asked_for(films, bag: Path, start: int, tmp_path: Path) -> None:
    _, film, camera = films["oblique"]
    arguments = ["film", str(film), "--camera", str(camera), "--recording", str(bag), "--out", str(tmp_path / "out")]
    facts = tmp_path / "facts.json"
    told = CliRunner().invoke(track_app, [*arguments, "--clock-from", "0.5", "7", "--json", str(facts)])
    assert told.exit_code == 0, told.output
    found = json.loads(facts.read_text("utf-8"))["films"][0]
    assert found["clock_offset_s"] == pytest.approx(BEGIN, abs=3e-3)
    assert found["overlap_s"] < 6.6
    nowhere = CliRunner().invoke(track_app, [*arguments, "--clock-from", "50", "60"])
    assert isinstance(nowhere.exception, CommandError) and "--clock-from: is 50 to 60 s" in str(nowhere.exception)


def test_without_a_recording_there_is_a_table(films, tmp_path: Path) -> None:
    _, film, camera = films["above"]
    out = tmp_path / "poses.csv"
    told = CliRunner().invoke(track_app, ["film", str(film), "--camera", str(camera), "--out", str(out)])
    assert told.exit_code == 0, told.output
    table = np.genfromtxt(out, delimiter=",", names=True)
    assert table["t"][0] < BEGIN and (np.diff(table["t"]) > 0.0).all()
    assert np.median(table["base_z"]) == pytest.approx(0.045, abs=0.01)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["{film}", "--camera", "{camera}", "--out", "{new}", "--recording", "{nowhere}"], "does not exist"),
        (["{nowhere}", "--camera", "{camera}", "--out", "{new}.csv"], "no such film"),
        (["{camera}", "--camera", "{camera}", "--out", "{new}.csv"], "no film that OpenCV can read"),
        (["{film}", "--camera", "{nowhere}", "--out", "{new}.csv"], "cannot be read"),
        (["{film}", "--camera", "{camera}", "--out", "{new}"], "--out a .csv"),
        (
            ["{film}", "--camera", "{camera}", "--out", "{new}.csv", "--exposure", "2"],
            "--exposure: is 2; allowed: 0 to 1",
        ),
        (
            ["{film}", "--camera", "{camera}", "--out", "{new}.csv", "--fps", "0.5"],
            "--fps: is 0.5; allowed: 1 to 10000",
        ),
        (["{film}", "--camera", "{camera}", "--camera", "{camera}", "--out", "{new}.csv"], "2 of them for 1 films"),
    ],
)
def test_what_cannot_be_used_is_named(films, tmp_path: Path, arguments: list[str], words: str) -> None:
    _, film, camera = films["above"]
    places = {"film": film, "camera": camera, "new": tmp_path / "new", "nowhere": tmp_path / "nowhere"}
    told = CliRunner().invoke(track_app, ["film", *(text.format(**places) for text in arguments)])
    assert isinstance(told.exception, CommandError)
    assert words in str(told.exception)
    assert told.exception.status == 2


def test_a_film_of_another_size_is_refused(films, tmp_path: Path) -> None:
    place, film, _ = films["above"]
    with pytest.raises(ValueError, match="576 x 432 pixels, its camera was calibrated with 577 x 432"):
        follow(Shot(film, place.camera.model_copy(update={"width": 577})), load_layout(), silent)
