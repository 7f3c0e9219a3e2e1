"""The commands, from files to files, and how they fail."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from nermo_description.results import CommandError
from nermo_sensors.bench.command import bench_sensors
from nermo_sensors.bench.figure import figure_rows
from nermo_sensors.bench.table import BenchRecording
from nermo_sensors.cli import sensors_app
from nermo_sensors.parameters import load_tactile


def call(*words: object) -> str:
    result = CliRunner().invoke(sensors_app, [str(word) for word in words], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.output


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bench") / "run.csv"
    call("simulate", path, "--quick", "--seed", 7)
    return path


def test_fit_saves_a_file_that_can_be_read(run: Path, tmp_path: Path) -> None:
    saved, facts = tmp_path / "foot.yaml", tmp_path / "fit.json"
    call("fit", run, "--save", saved, "--json", facts, "--out", tmp_path / "pictures")
    assert load_tactile(saved).calibration.charge.leak == pytest.approx(0.08, rel=0.05)
    told = json.loads(facts.read_text())
    assert told["schema"] == "nermo/sensors-fit/1"
    assert all(row["low"] <= row["value"] <= row["high"] for row in told["parameters"])
    assert (tmp_path / "pictures" / "residuals.png").stat().st_size > 1000


def test_tune_lowers_the_cost_and_saves(run: Path, tmp_path: Path) -> None:
    short = tmp_path / "short.csv"
    BenchRecording.load(run).part(slice(0, 900)).save(short)
    saved, facts = tmp_path / "foot.yaml", tmp_path / "tune.json"
    call(
        *("tune", short, "--estimator", "f1", "--objective", "thesis", "--particles", 6, "--generations", 3),
        *("--save", saved, "--json", facts),
    )
    told = json.loads(facts.read_text())
    assert told["cost"] <= told["cost_before"]
    assert told["history"] == sorted(told["history"], reverse=True)
    assert load_tactile(saved).noises.f1 != load_tactile("cheetah_cub").noises.f1


def test_doe_tells_all_of_it(tmp_path: Path) -> None:
    facts = tmp_path / "doe.json"
    output = call("doe", "--json", facts)
    told = json.loads(facts.read_text())
    assert {"aliases", "terms", "elimination", "feasibility", "requirements"} <= set(told)
    assert "glue * length" in output
    assert all(abs(row["ours"] / row["thesis"] - 1.0) < 1e-3 for row in told["terms"])


@pytest.mark.parametrize(
    ("words", "message", "status"),
    [
        (("fit", "none.csv"), "none.csv: cannot be read", 2),
        (("fit", "RUN", "--robot", "mickey"), "'mickey' are unknown", 2),
        (("doe", "--shape", "C"), "shape: 'C' is not one of A, B", 2),
    ],
)
def test_bad_input_is_one_sentence(run: Path, words: tuple[str, ...], message: str, status: int) -> None:
    result = CliRunner().invoke(sensors_app, [str(run) if word == "RUN" else word for word in words])
    assert isinstance(result.exception, CommandError)
    assert message in str(result.exception) and result.exception.status == status


def test_data_that_say_too_little_are_refused_with_status_1(run: Path, tmp_path: Path) -> None:
    recording = BenchRecording.load(run)
    ramp = tmp_path / "ramp.csv"
    up = np.linspace(0.0, 28.0, len(recording.time))
    BenchRecording(recording.time, up, 1.0 + 0.1 * up, np.zeros_like(up), recording.frequency).save(ramp)
    result = CliRunner().invoke(sensors_app, ["fit", str(ramp)])
    assert isinstance(result.exception, CommandError) and result.exception.status == 1
    assert "unloading ramp" in str(result.exception)


@pytest.mark.slow
def test_only_the_fused_estimate_does_not_drift() -> None:
    """C figure 4.8, shorter."""
    rows = {row.cells: row for row in figure_rows(seeds=2, seconds=4.0)}
    assert rows["fused"].rmse_n < 0.5 * min(rows["piezoresistive"].rmse_n, rows["piezoelectric"].rmse_n)
    assert rows["fused"].offset_end_n < 0.5 * rows["piezoelectric"].offset_end_n


@pytest.mark.slow
def test_bench_has_the_keys_that_others_rely_on(tmp_path: Path) -> None:
    facts = bench_sensors(quick=True, pictures=tmp_path)
    assert {"update_us", "filterpy_update_us", "rows"} <= set(facts)
    for row in facts["rows"]:
        assert {"frequency_hz", "estimator", "rmse_n", "peak_error_n", "within_3_sigma", "nees"} <= set(row)
    assert {row["estimator"] for row in facts["rows"]} >= {"f1", "f2", "memory", "best_single"}
    assert {row["cells"] for row in facts["figure_4_8"]} == {"fused", "piezoresistive", "piezoelectric"}
    assert len(facts["requirements"]) == 3
    assert len(list(tmp_path.glob("*.png"))) == 3
