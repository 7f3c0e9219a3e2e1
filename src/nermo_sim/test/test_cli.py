"""The words `experiment` and `bench`: what they write, and how they refuse."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from nermo_description.results import CommandError
from nermo_sim import cli
from nermo_sim.batch import run_batch
from nermo_sim.bench import BenchSettings, bench_loop, bench_tick


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
    monkeypatch.setattr(cli, "run_bench", lambda name, robot, quick: {f"{name}_us": 1.0})
    result = CliRunner().invoke(cli.bench_app, ["tick", "loop", "--json", str(tmp_path / "bench.json")])
    assert result.exit_code == 0, result.output
    written = json.loads((tmp_path / "bench.json").read_text())
    assert written["tick_us"] == written["loop_us"] == 1.0
    assert written["schema"] == "nermo/bench/1"
    assert written["robot"] == "nermo_lite"


def test_unknown_bench_is_wrong_usage() -> None:
    with pytest.raises(CommandError, match="choose among tick, loop, graph") as caught:
        cli.run_bench("speed")
    assert caught.value.status == 2


def test_straight_line_writes_rows_and_pictures(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    from nermo_sim.experiments import straight_line

    monkeypatch.setattr(straight_line, "cases", lambda quick: [straight_line.Case("trot", 0.8, 0.06)])
    arguments = ["straight-line", "--repeats", "1", "--out", str(tmp_path), "--json", str(tmp_path / "rows.json")]
    result = CliRunner().invoke(cli.experiment_app, [*arguments, "--no-video", "--quick", "--seed", "3"])
    assert result.exit_code == 0, result.output
    written = json.loads((tmp_path / "rows.json").read_text())
    assert written["seed"] == 3
    assert written["rows"][0]["theory_m_s"] == pytest.approx(0.096)
    assert (tmp_path / "straight-line" / "trot.png").exists()
    assert "trot" in result.output


def test_unknown_robot_is_said(tmp_path: Path) -> None:
    result = CliRunner().invoke(cli.experiment_app, ["straight-line", "--robot", "elephant", "--out", str(tmp_path)])
    assert isinstance(result.exception, CommandError)
    assert result.exception.status == 2
    assert "elephant" in str(result.exception)


@pytest.mark.parametrize("workers", [1, 2])
def test_batch_returns_every_job_with_its_result(workers: int) -> None:
    assert dict(run_batch(abs, [-3, 2, -1], workers)) == {-3: 3, 2: 2, -1: 1}


def test_batch_lets_an_error_out() -> None:
    with pytest.raises(TypeError):
        list(run_batch(abs, ["a", "b"], 2))
