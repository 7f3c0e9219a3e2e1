import json
from datetime import datetime

import numpy as np
import pytest

from nermo_description.results import CommandError, write_results


def test_head_and_facts_are_written(tmp_path):
    path = tmp_path / "new" / "out.json"
    write_results(path, "straight-line", {"rows": [{"speed_m_s": 0.1}]}, robot="nermo", seed=7)
    written = json.loads(path.read_text(encoding="utf-8"))
    assert list(written) == ["schema", "created", "command", "seed", "robot", "versions", "rows"]
    assert written["schema"] == "nermo/straight-line/1"
    assert written["rows"] == [{"speed_m_s": 0.1}]
    assert (written["robot"], written["seed"]) == ("nermo", 7)
    assert written["versions"]["numpy"] == np.__version__
    assert datetime.fromisoformat(written["created"]).tzinfo is not None


def test_numpy_and_non_finite_values_become_valid_json(tmp_path):
    path = tmp_path / "out.json"
    facts = {"array": np.array([[1.0, np.nan]]), "flag": np.bool_(True), "count": np.int64(3), "worst": float("inf")}
    write_results(path, "x", facts)
    written = json.loads(path.read_text(encoding="utf-8"))
    assert written["array"] == [[1.0, None]]
    assert written["flag"] is True
    assert written["count"] == 3
    assert written["worst"] is None


def test_file_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(CommandError, match="out.json"):
        write_results(tmp_path / "file" / "out.json", "x", {})


def test_failed_write_leaves_the_old_file(tmp_path):
    path = tmp_path / "out.json"
    write_results(path, "x", {"value": 1})
    with pytest.raises(TypeError):
        write_results(path, "x", {"value": object()})
    assert json.loads(path.read_text(encoding="utf-8"))["value"] == 1
    assert list(tmp_path.iterdir()) == [path]
