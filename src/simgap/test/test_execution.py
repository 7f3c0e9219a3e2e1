"""Many jobs over processes or Dask, and many recordings each by itself."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest
from robots import MAPS, MODELS, simulate
from typer.testing import CliRunner
from yaml import safe_dump

from simgap.cli import app
from simgap.data.errors import GapInputError
from simgap.execution.batch import run_batch
from simgap.execution.executors import open_pool


@pytest.mark.parametrize("workers", [1, 2])
@pytest.mark.parametrize("light", [False, True])
def test_every_job_comes_with_its_result(workers: int, light: bool) -> None:
    assert dict(run_batch(abs, [-3, 2, -1, 7], workers, light=light)) == {-3: 3, 2: 2, -1: 1, 7: 7}
    assert list(run_batch(abs, [], workers, light=light)) == []


def test_an_error_comes_out() -> None:
    with pytest.raises(TypeError):
        list(run_batch(abs, ["a", "b"], 2))


def test_a_job_is_drawn_when_there_is_a_worker_for_it() -> None:
    drawn = []

    def jobs() -> object:
        for job in range(50):
            drawn.append(job)
            yield job

    batch = run_batch(abs, jobs(), 2, light=True)  # type: ignore[type-var,arg-type]
    next(batch)
    assert len(drawn) <= 4
    batch.close()
    assert len(drawn) <= 5


@pytest.mark.parametrize("place", ["cluster", "dask", "dask:", "tcp://here:1"])
def test_an_unknown_place_says_what_to_type(place: str) -> None:
    with pytest.raises(GapInputError, match="type processes, dask:local, or dask:tcp://HOST:PORT"), open_pool(place):
        pass


def test_without_dask_it_is_said_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "distributed", None)
    with pytest.raises(GapInputError, match="pip install distributed"), open_pool("dask:tcp://127.0.0.1:1"):
        pass


def test_a_scheduler_that_is_not_there_and_one_that_is() -> None:
    pytest.importorskip("distributed")
    with pytest.raises(GapInputError, match="start one there: dask scheduler"), open_pool("dask:tcp://127.0.0.1:1"):
        pass
    found = dict(run_batch(os.path.basename, ["a/b", "c/d", "e/f"], 2, "dask:local"))
    assert found == {"a/b": "b", "c/d": "d", "e/f": "f"}


def _files(folder: Path) -> list[str]:
    """Two recordings of an arm, one of them with friction at the elbow, and one that is none."""
    (folder / "arm.xml").write_text(MODELS["arm"])
    (folder / "map.yaml").write_text(safe_dump(MAPS["arm"]))
    for name, friction in (("well", 0.0), ("stiff", 0.3)):

        def change(model: object, friction: float = friction) -> None:
            model.dof_damping[1] += friction  # type: ignore[attr-defined]

        table = simulate("arm", seconds=8.0, change=change)
        rows = np.stack(list(table.values()), 1)
        np.savetxt(folder / f"{name}.csv", rows, delimiter=",", header=",".join(table), comments="")
    (folder / "none.csv").write_text("t,q0\n")
    return ["--model", str(folder / "arm.xml"), "--map", str(folder / "map.yaml"), "--only", "viscous_friction"]


@pytest.mark.long
def test_each_recording_is_diagnosed_by_itself(tmp_path: Path) -> None:
    words = ["diagnose", *(str(tmp_path / f"{n}.csv") for n in ("well", "stiff", "none")), "--each", "--no-baselines"]
    answer = CliRunner().invoke(app, [*words, *_files(tmp_path), "--workers", "2", "--out", str(tmp_path / "each")])
    assert answer.exit_code == 2 and "none.csv" in answer.stderr.strip().splitlines()[-1]
    assert answer.stdout.splitlines()[-1] == str(tmp_path / "each" / "summary.json")
    none, stiff, well = json.loads((tmp_path / "each" / "summary.json").read_text())["rows"]
    assert "none.csv" in none["error"]
    assert stiff["verdict"] in ("effect", "ambiguous") and stiff["effects"][0]["name"] == "viscous_friction"
    assert well["verdict"] == "no_gap"
    for row in (stiff, well):
        assert {p.name for p in Path(row["folder"]).iterdir()} >= {"diagnosis.json", "report.html"}


def test_an_executor_is_for_many(tmp_path: Path) -> None:
    words = ["diagnose", "a.csv", "--model", "m.xml", "--map", "m.yaml", "--executor", "dask:local"]
    answer = CliRunner().invoke(app, words)
    assert answer.exit_code == 2 and "need --each" in answer.stderr
