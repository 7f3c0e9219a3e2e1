"""Whether runs agree about what was found in all of them together."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray
from robots import plant_of, simulate

from simgap.analysis.diagnose import diagnose
from simgap.analysis.options import Options
from simgap.data.recording import recording_from_table

Array = NDArray[np.float64]

pytestmark = pytest.mark.long


def _report(frictions: list[float]) -> dict[str, object]:
    """Of an arm whose elbow rubs so much in one run after the other."""
    tables = []
    for run, friction in enumerate(frictions):

        def rubbing(model: mujoco.MjModel, friction: float = friction) -> None:
            model.dof_frictionloss[1] += friction

        made = simulate("arm", 6.0, run, change=rubbing)
        tables.append(made | {"run": np.full(len(made["t"]), float(run))})
    table = {k: np.concatenate([t[k] for t in tables]) for k in tables[0]}
    plant = plant_of("arm", lambda data: data.update(segments={"column": "run"}))
    options = Options(only=("coulomb_friction",), threads=1, baselines=False, keep=lambda e: e.site.name == "elbow")
    return diagnose([recording_from_table(table, plant)], plant, options).report


def test_runs_of_one_robot_agree() -> None:
    agreement = _report([0.1, 0.1, 0.1])["agreement"]
    assert agreement["parts"] == ["run 0", "run 1", "run 2"]  # type: ignore[index]
    (row,) = agreement["rows"]  # type: ignore[index]
    assert row["p"] > 0.01
    assert all(b["ci90"][0] <= 0.105 and b["ci90"][1] >= 0.095 for b in row["by_part"].values())
    assert all(0.0 <= b["ci90"][0] <= b["ci90"][1] for b in row["by_part"].values())
    assert "agree about it" in agreement["sentence"]  # type: ignore[index]


def test_the_odd_run_is_named_with_its_value() -> None:
    agreement = _report([0.1, 0.1, 0.18, 0.1])["agreement"]
    (row,) = agreement["rows"]  # type: ignore[index]
    assert row["odd"] == "run 2" and row["p"] < 1e-3
    assert row["by_part"]["run 2"]["value"] == pytest.approx(0.18, rel=0.25)
    assert row["elsewhere"] == pytest.approx(0.1, rel=0.1) and row["p"] < agreement["disagree_below"]  # type: ignore[index]
    assert "do not agree" in agreement["sentence"] and "in run 2" in agreement["sentence"]  # type: ignore[index]
