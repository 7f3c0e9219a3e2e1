"""The words `experiment` and `bench`: what they write, and how they refuse."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from nermo_description.results import CommandError
from nermo_sim.bench.cli import BENCHES, bench_app, run_bench
from nermo_sim.bench.loop import BenchSettings, bench_loop, bench_tick
from nermo_sim.experiments import suite
from nermo_sim.experiments.cli import experiment_app, offer
from nermo_sim.experiments.experiment import Experiment, Outcome, Repeats
from nermo_sim.experiments.registry import EXPERIMENTS
from nermo_sim.experiments.runs import Job, Result, Settings
from simgap.execution.batch import run_batch


def test_bench_tick_and_loop_measure_what_they_say() -> None:
    settings = BenchSettings(duration=0.5)
    tick = bench_tick(settings)["tick_us"]
    assert 0.0 < tick["p50"] <= tick["p99"]
    loop = bench_loop(settings)
    assert loop["fraction"] == pytest.approx(loop["closed_loop_x_real_time"] / loop["bare_step_x_real_time"])
    assert loop["fraction"] > 0.0
    assert set(loop["tails"]) == {"chain", "rigid"}
    assert loop["fraction"] == loop["tails"]["chain"]["fraction"]
    assert loop["batch"]["workers"] >= 1
    assert loop["batch"]["x_real_time"] > 0.0


def test_bench_writes_its_facts_under_their_names(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for name in ("tick", "loop"):
        monkeypatch.setitem(BENCHES, name, lambda robot, quick, name=name: {f"{name}_us": 1.0})
    result = CliRunner().invoke(bench_app, ["tick", "loop", "--json", str(tmp_path / "bench.json")])
    assert result.exit_code == 0, result.output
    written = json.loads((tmp_path / "bench.json").read_text())
    assert written["tick_us"] == written["loop_us"] == 1.0
    assert written["schema"] == "nermo/bench/1"
    assert written["robot"] == "nermo_lite"


def test_unknown_bench_is_wrong_usage() -> None:
    with pytest.raises(CommandError, match="choose among tick, loop, graph") as caught:
        run_bench("speed")
    assert caught.value.status == 2


def test_straight_line_writes_rows_and_pictures(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    from nermo_sim.experiments import straight_line

    one = replace(straight_line.EXPERIMENT, cases=lambda quick: [straight_line.Case("trot", 0.8, 0.06)])
    monkeypatch.setitem(EXPERIMENTS, "straight-line", one)
    arguments = ["straight-line", "--repeats", "1", "--out", str(tmp_path), "--json", str(tmp_path / "rows.json")]
    result = CliRunner().invoke(experiment_app, [*arguments, "--no-video", "--quick", "--seed", "3"])
    assert result.exit_code == 0, result.output
    written = json.loads((tmp_path / "rows.json").read_text())
    assert written["seed"] == 3
    assert written["rows"][0]["theory_m_s"] == pytest.approx(0.096)
    assert (tmp_path / "straight-line" / "trot.png").exists()
    assert "trot" in result.output


def test_unknown_robot_is_said(tmp_path: Path) -> None:
    result = CliRunner().invoke(experiment_app, ["straight-line", "--robot", "elephant", "--out", str(tmp_path)])
    assert isinstance(result.exception, CommandError)
    assert result.exception.status == 2
    assert "elephant" in str(result.exception)


# What an experiment's record says is what its command does


@dataclass(frozen=True, slots=True)
class Coin:
    side: str

    @property
    def key(self) -> str:
        return self.side


def toss(job: Job[Coin]) -> Result:
    return {"lands": job.seed % 2 == 0}


def count(cases: Sequence[Coin], settings: Settings, robot: Any, results: list[list[Result]]) -> list[dict[str, Any]]:
    return [{"side": case.side, "runs": len(runs)} for case, runs in zip(cases, results, strict=True)]


def draw(done: Outcome) -> list[Path]:
    done.folder.joinpath("picture.txt").write_text(done.about(COIN.source))
    return [done.folder / "picture.txt"]


COIN = Experiment(
    name="coin",
    title="Coin",
    help="Tosses a coin.",
    columns=("side", "runs"),
    cases=lambda quick: [Coin("head")] if quick else [Coin("head"), Coin("tail")],
    run=toss,
    table=count,
    repeats=Repeats(4, 2, "Tosses"),
    disturbed=False,
    further=lambda done: {"logged": done.cases[0].key + ", run 0" in done.log},
    source="N 0.0",
    pictures=draw,
    failure=lambda facts: "no tail" if len(facts["rows"]) == 1 else None,
)


def test_an_experiment_s_command_follows_from_its_record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    app = typer.Typer()
    app.callback()(lambda: None)
    offer(app, COIN)
    monkeypatch.setitem(EXPERIMENTS, "coin", COIN)
    told = CliRunner().invoke(app, ["coin", "--help"], env={"COLUMNS": "100"}).output
    assert "Tosses a coin." in told
    assert "Tosses a row; 4, or 2 with --quick." in told
    assert "--disturbed" in told
    assert "--video" not in told
    arguments = ["coin", "--workers", "1", "--out", str(tmp_path), "--json", str(tmp_path / "coin.json")]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    written = json.loads((tmp_path / "coin.json").read_text())
    assert written["rows"] == [{"side": "head", "runs": 4}, {"side": "tail", "runs": 4}]
    assert (written["disturbed"], written["logged"]) == (False, True)
    assert (tmp_path / "coin" / "picture.txt").read_text() == "Robot nermo_lite, N 0.0, seed 0."
    result = CliRunner().invoke(app, [*arguments, "--quick", "--disturbed"])
    assert str(result.exception) == "no tail"
    assert json.loads((tmp_path / "coin.json").read_text())["rows"] == [{"side": "head", "runs": 2}]


def test_experiments_refuse_robots_of_another_family(tmp_path: Path) -> None:
    strangers = {"mouse": "nermo_lite", "pantograph": "cheetah_cub"}
    for name, experiment in EXPERIMENTS.items():
        for family in set(strangers) - set(experiment.families):
            result = CliRunner().invoke(experiment_app, [name, "--robot", strangers[family], "--out", str(tmp_path)])
            assert isinstance(result.exception, CommandError), name
            assert f"is of the family {family}; needed here is" in str(result.exception)


@pytest.mark.parametrize(
    ("robot", "others"), [("nermo_lite", ["nermo"]), ("nermo", ["nermo_lite"]), ("my_own_mouse.yaml", [])]
)
def test_the_gaze_of_n_s_other_robot_stands_beside_one_of_n_s(robot: str, others: list[str]) -> None:
    assert suite.robots_beside(robot) == others


@pytest.mark.parametrize("workers", [1, 2])
def test_batch_returns_every_job_with_its_result(workers: int) -> None:
    assert dict(run_batch(abs, [-3, 2, -1], workers)) == {-3: 3, 2: 2, -1: 1}


def test_batch_lets_an_error_out() -> None:
    with pytest.raises(TypeError):
        list(run_batch(abs, ["a", "b"], 2))
