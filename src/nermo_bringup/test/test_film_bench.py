"""`nermo bench film`: a hidden mouse on film, tracked, diagnosed, its seal opened."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest
from typer.testing import CliRunner

from nermo_bringup.film_bench import whole_way
from nermo_bringup.film_bench.cli import FAULTS, bench_app
from nermo_description.robots import load_robot
from nermo_gap.blind.mice.faults import KINDS, KNOWN, UNKNOWN
from nermo_gap.blind.mice.seal import SEALED
from nermo_gap.protocol.standard import standard
from nermo_gap.protocol.types import Protocol
from nermo_node.recording_reader import Recording
from simgap.data.errors import GapInputError


def quiet(stage: str, share: float) -> None:
    """Says nothing."""


@pytest.mark.long
def test_a_mouse_goes_the_whole_way_from_its_film_to_its_opened_seal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera = whole_way.CAMERA
    half = {name: 0.5 * getattr(camera, name) for name in ("fx", "fy", "cx", "cy")}
    size = {"width": camera.width // 2, "height": camera.height // 2, "line_delay": 2.0 * camera.line_delay}
    monkeypatch.setattr(whole_way, "CAMERA", camera.model_copy(update={**half, **size}))
    monkeypatch.setattr(whole_way, "EYE", (0.05, -0.42, 0.33))
    monkeypatch.setattr(whole_way, "TARGET", (0.05, 0.0, 0.0))
    monkeypatch.setattr(whole_way, "FPS", 12.0)
    monkeypatch.setattr(whole_way, "SEGMENTS", ("standing",))
    standing = next(s for s in standard(load_robot("nermo_lite")).segments if s.name == "standing")
    short = Protocol("standard", (dataclasses.replace(standing, pieces=standing.pieces[:1] + standing.pieces[4:6]),))
    monkeypatch.setattr(whole_way, "protocol_of", lambda *_, **__: short)
    robot, out = load_robot("nermo_lite"), tmp_path / "mouse"
    row = whole_way.whole_way(robot, "nermo_lite", 7, "hip_offset", out, 10.0, quiet)
    assert row["standing_seen"] > 0.9
    assert abs(row["standing_clock_ms"]) < max(5.0, 4.0 * row["standing_clock_said_ms"])
    told, filmed = out / "told" / "1_standing", out / "filmed" / "1_standing"
    assert not [topic for topic in Recording(told / "recording").topics if "tracker" in topic], "told has no answer"
    assert "/nermo/tracker/odom" in Recording(filmed / "recording").topics
    assert (out / SEALED).is_file() and not list(filmed.rglob(SEALED)), "the seal is not where the diagnosis reads"
    assert (out / "diagnosis" / "diagnosis.json").is_file()
    assert row["truth"].startswith("hip offset") and row["mouse"] == 7
    assert row["judged"] in ("right", "right part", "near", "missed", "wrong")
    assert whole_way.whole_way(robot, "nermo_lite", 7, "hip_offset", out, 10.0, quiet) == row, "not done again"
    (out / whole_way.ROW).unlink()
    monkeypatch.setattr(whole_way, "follow", None)
    again = whole_way.whole_way(robot, "nermo_lite", 7, "hip_offset", out, 10.0, quiet)
    assert again["standing_clock_ms"] == row["standing_clock_ms"], "goes on where it was stopped"
    with pytest.raises(GapInputError, match="holds something already"):
        whole_way.film(robot, "nermo_lite", 7, None, out, quiet)


def test_what_it_takes_by_default_can_be_hidden() -> None:
    assert set(FAULTS) <= set(KINDS | KNOWN | UNKNOWN)


def test_a_fault_that_is_none_is_refused_and_leaves_nothing(tmp_path: Path) -> None:
    run = CliRunner().invoke(bench_app, ["film", "--fault", "none", "--fault", "rust", "--out", str(tmp_path / "new")])
    assert run.exit_code == 2 and "fault 'rust' is unknown: choose one of weak_knee" in run.output
    assert not (tmp_path / "new").exists()


def test_its_help_has_examples() -> None:
    told = CliRunner().invoke(bench_app, ["film", "--help"])
    assert told.exit_code == 0 and "nermo bench film --fault late_hips" in told.output
