"""A diagnosis that has to end in time gives the best answer so far, and says what was not looked at."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import mujoco
import pytest
from robots import as_from_a_terminal, plant_of, simulate
from test_diagnose import SOME, _own_coulomb

from simgap.analysis.diagnose import Diagnosis, diagnose
from simgap.analysis.options import Options
from simgap.data.recording import recording_from_table
from simgap.inference import budget
from simgap.report.sentences import sentences
from simgap.simulation.replay import Replayer


def _in_time(seconds: float) -> Diagnosis:
    plant, table = plant_of("pendulum"), simulate("pendulum", 10.0, change=_own_coulomb)
    options = Options(only=SOME, threads=1, budget=seconds)
    return diagnose([recording_from_table(table, plant)], plant, options)


def test_without_any_time_the_report_is_whole_and_says_so() -> None:
    report = _in_time(1e-6).report
    (warning,) = [w for w in report["warnings"] if "budget" in w]
    assert "1e-06 s" in warning and "not every effect was screened" in warning and "next experiment" in warning
    assert report["effects"] == [] and report["next_experiment"] is None and report["waterfall"]
    assert report["verdict"] == "unknown", "a large gap is no case of no gap because nobody looked"


def test_the_best_so_far_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    reached: list[str] = []
    monkeypatch.setattr(budget.Budget, "spent", lambda self, share=1.0: "finals" in reached and share < 1.0)
    watch = budget.Budget.watch
    monkeypatch.setattr(budget.Budget, "watch", lambda self, _: watch(self, lambda name, _: reached.append(name)))
    report = _in_time(60.0).report
    assert [e["name"] for e in report["effects"]] == ["coulomb_friction"]
    assert report["effects"][0]["parameters"]["friction"]["value"] == pytest.approx(0.1, abs=0.02)
    assert any("roughly" in w for w in report["warnings"])


@pytest.mark.parametrize(("stage", "seconds"), [("fit", 12.0), ("drop", 12.0), ("growth", 30.0)])
def test_a_budget_may_end_in_any_stage(stage: str, seconds: float, monkeypatch: pytest.MonkeyPatch) -> None:
    reached: list[str] = []
    monkeypatch.setattr(budget.Budget, "spent", lambda self, share=1.0: stage in reached and share < 1.0)
    watch = budget.Budget.watch
    monkeypatch.setattr(budget.Budget, "watch", lambda self, _: watch(self, lambda name, _: reached.append(name)))
    plant, table = plant_of("pendulum"), simulate("pendulum", seconds, change=_own_coulomb)
    report = diagnose([recording_from_table(table, plant)], plant, Options(only=SOME, threads=1, budget=60.0)).report
    assert stage in reached or stage == "drop", "one effect alone is never dropped"
    if stage in reached:
        assert any("budget" in w for w in report["warnings"])
    assert report["verdict"] and report["waterfall"]


def test_what_single_parts_speak_for_together_is_not_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    """The time may be over while the needless ones of them are taken out: then the answer is what is left by then."""
    report = _ended_in(monkeypatch, "drop")
    assert {e["name"] for e in report["effects"]} == {"servo_gain", "coulomb_friction"}
    assert report["gap"]["after"] < 0.1 * report["gap"]["before"]


def test_what_is_told_is_scored_as_starts_are_judged_in_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """The leaders' models judge the starts of windows anew; the time may be over before all is scored by that."""
    report = _ended_in(monkeypatch, "finals")
    assert {e["name"] for e in report["effects"]} == {"servo_gain", "coulomb_friction"}
    gap = report["gap"]
    assert gap["before"] == pytest.approx(report["baselines"]["nominal"]["gap"], rel=1e-6)
    assert gap["after"] < gap["nuisances_only"] < gap["before"]
    assert [step["step"] for step in report["waterfall"]][:2] == ["nominal", "recalibrated"]
    assert report["waterfall"][1]["gap"] == pytest.approx(gap["nuisances_only"])


def _ended_in(monkeypatch: pytest.MonkeyPatch, stage: str) -> dict[str, Any]:
    """The report on an arm with soft servos and dry friction whose search was over as it came to a stage."""

    def soft_and_rubbing(model: mujoco.MjModel) -> None:
        model.actuator_gainprm[:, 0] *= 0.05
        model.actuator_biasprm[:, 1:3] *= 0.05
        model.dof_frictionloss[:] = 0.1

    reached: list[str] = []
    monkeypatch.setattr(budget.Budget, "spent", lambda self, share=1.0: stage in reached and share < 1.0)
    watch = budget.Budget.watch
    monkeypatch.setattr(budget.Budget, "watch", lambda self, _: watch(self, lambda name, _: reached.append(name)))
    plant, table = plant_of("arm"), simulate("arm", 10.0, change=soft_and_rubbing)
    options = Options(only=("servo_gain", "coulomb_friction"), baselines=False, threads=1, budget=60.0)
    report = diagnose([recording_from_table(table, plant)], plant, options).report
    assert stage in reached and any("budget" in w for w in report["warnings"])
    return report


def _counted(monkeypatch: pytest.MonkeyPatch, seconds: float | None) -> tuple[float, dict[str, Any]]:
    """Simulated seconds of a diagnosis, and its report, where the clock that it looks at is that of its simulations."""
    clock = [0.0]
    run = Replayer.run_pairs

    def counted(self: Replayer, *args: Any, **more: Any) -> Any:
        before = self.simulated_seconds
        try:
            return run(self, *args, **more)
        finally:
            clock[0] += self.simulated_seconds - before

    monkeypatch.setattr(Replayer, "run_pairs", counted)
    monkeypatch.setattr(budget.time, "monotonic", lambda: clock[0])
    plant, table = plant_of("pendulum"), simulate("pendulum", 20.0, change=_own_coulomb)
    report = diagnose([recording_from_table(table, plant)], plant, Options(threads=1, budget=seconds)).report
    monkeypatch.undo()
    return clock[0], report


@pytest.mark.long
def test_no_stage_goes_on_long_after_a_budget(monkeypatch: pytest.MonkeyPatch) -> None:
    """Simulations are what a diagnosis spends its time on: here nothing else counts, so that it comes out the same."""
    whole, _ = _counted(monkeypatch, None)
    for share in (0.5, 0.25):
        used, report = _counted(monkeypatch, share * whole)
        assert used < 1.2 * share * whole
        assert report["free_running"] and report["waterfall"]
        assert any("budget" in w for w in report["warnings"])


def test_what_a_reference_has_used_is_not_shared_out_again(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr(budget.time, "monotonic", lambda: now[0])
    whole = budget.Budget(100.0, 0.0)
    now[0] = 40.0
    left = whole.rest()
    assert whole.spent(budget.NUISANCES) and not left.spent(budget.NUISANCES)
    now[0] = 40.0 + budget.NUISANCES * 60.0 + 0.1
    assert left.spent(budget.NUISANCES)
    left.ended("nuisances")
    assert left.warning() == "within the budget of 100 s nominal numbers were not fitted to the end"
    assert budget.Budget(None).rest().seconds is None


def test_hurry_ends_it_as_a_spent_budget_does() -> None:
    plant, table = plant_of("pendulum"), simulate("pendulum", 10.0, change=_own_coulomb)
    hurry = budget.Hurry()

    def told(stage: str, share: float) -> None:
        if stage == "finals":
            hurry.wanted = True

    options = Options(only=SOME, threads=1, progress=told, hurry=hurry)
    report = diagnose([recording_from_table(table, plant)], plant, options).report
    assert [e["name"] for e in report["effects"]] == ["coulomb_friction"]
    (warning,) = [w for w in report["warnings"] if w.startswith("ended by hand: ")]
    assert "leading effects were fitted roughly" in warning
    assert f"E{warning[1:]}." in sentences(report), "it stands beside the answer, not only among the warnings"
    assert report["next_experiment"] is None and report["waterfall"], "the report is whole"


@pytest.mark.parametrize("pressed", [1, 2])
def test_ctrl_c_ends_with_the_best_answer_so_far_and_a_second_one_without(pressed: int, tmp_path: Path) -> None:
    """The command, in a process of its own."""
    simgap = [sys.executable, "-m", "simgap"]
    make = [*simgap, "example", "--out", str(tmp_path), "--make-only"]
    subprocess.run(make, check=True, capture_output=True)
    words = ["diagnose", "log.csv", "--model", "model.xml", "--map", "map.yaml", "--out", "found", "--no-baselines"]
    with subprocess.Popen(
        [*simgap, *words], cwd=tmp_path, stderr=subprocess.PIPE, text=True, preexec_fn=as_from_a_terminal
    ) as process:
        assert process.stderr is not None
        for _ in range(pressed):
            # In the midst of the search; the second once the first is answered.
            next(line for line in process.stderr if line.startswith(("fit: ", "ending with the best")))
            process.send_signal(signal.SIGINT)
        told = process.stderr.read()
    written = tmp_path / "found" / "diagnosis.json"
    if pressed == 2:
        assert process.returncode != 0 and not written.exists(), told
        return
    assert process.returncode == 0, told
    report = json.loads(written.read_text())
    assert any(w.startswith("ended by hand: ") for w in report["warnings"]) and report["next_experiment"] is None
