"""Cheetah-Cub before a trench: into it without a change, over it leg by leg; and what the command writes."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from nermo_description.results import CommandError
from nermo_sim.disturbance import NO_DISTURBANCE
from nermo_sim.experiments import gap_step
from nermo_sim.experiments.cli import experiment_app
from nermo_sim.experiments.registry import EXPERIMENTS
from nermo_sim.experiments.runs import Job, Result, Settings

SETTINGS = Settings("cheetah_cub", disturbance=NO_DISTURBANCE)


def test_each_leg_for_itself_steps_over_the_gap_that_it_falls_into_otherwise() -> None:
    without, changed = (
        gap_step.run(Job(gap_step.Case("cpg", change, 0.05), 1, SETTINGS)) for change in ("none", "each")
    )
    near, far = changed["gap_m"]
    assert far - near == pytest.approx(0.05)
    assert without["feet_in_gap"] and not without["crossed"]
    assert changed["crossed"] and not changed["feet_in_gap"] and not changed["fell"]
    assert any(footfall["shift_mm"] for footfall in changed["footfalls"])
    width = 1e3 * (far - near)
    assert all(high < 5.0 or low > width - 5.0 for low, high in (footfall["mm"] for footfall in changed["footfalls"]))
    # All four feet were seen on both sides.
    sides = {(footfall["leg"], footfall["mm"][0] > 0.0) for footfall in changed["footfalls"]}
    assert len(sides) == 8


def test_command_writes_rates_with_their_intervals(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def run(job: Job[gap_step.Case]) -> Result:
        crossed = job.case.change == "each"
        return {
            "gap_m": [2.6 + 0.1 * job.repeat, 2.6 + 0.1 * job.repeat + job.case.width],
            "crossed": crossed,
            "feet_in_gap": [] if crossed else ["front_left"],
            "fell": False,
            "changes_mm": [0.0, 20.0, 0.0, 0.0, 0.0],
            "footfalls": [{"leg": "front_left", "mm": [60.0, 70.0], "shift_mm": 20.0}],
        }

    monkeypatch.setitem(EXPERIMENTS, "gap-step", replace(gap_step.EXPERIMENT, run=run))
    arguments = ["gap-step", "--quick", "--repeats", "4", "--workers", "1", "--no-video"]
    result = CliRunner().invoke(
        experiment_app, [*arguments, "--out", str(tmp_path), "--json", str(tmp_path / "gap.json")]
    )
    assert result.exit_code == 0, result.output
    written: dict[str, Any] = json.loads((tmp_path / "gap.json").read_text())
    rows = {row["change"]: row for row in written["rows"]}
    assert rows["each"]["crossed"] == rows["each"]["runs"] == 4
    assert rows["none"]["rate"] == 0.0
    assert rows["each"]["rate_low"] == pytest.approx(0.51, abs=0.01)  # Wilson's, 4 of 4
    assert len(written["runs"]) == 4 * len(rows)
    assert (tmp_path / "gap-step" / "gap_steps.png").exists()


def test_a_mouse_is_refused(tmp_path: Path) -> None:
    result = CliRunner().invoke(experiment_app, ["gap-step", "--robot", "nermo_lite", "--out", str(tmp_path)])
    assert isinstance(result.exception, CommandError)
    assert result.exception.status == 2
