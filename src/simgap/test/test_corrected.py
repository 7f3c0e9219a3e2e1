"""A diagnosis that begins from a corrected model goes on where the first one ended."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import yaml
from numpy.typing import NDArray
from robots import MAPS, MODELS, simulate
from typer.testing import CliRunner

from simgap.analysis.diagnose import Diagnosis
from simgap.cli import app
from simgap.console import write_diagnosis
from simgap.correction.known_map import write_map
from simgap.data.corrected import as_read_by, original
from simgap.data.errors import GapInputError
from simgap.data.mapping import load_map
from simgap.data.plant import build_plant, load_spec
from simgap.data.recording import load_recording
from simgap.many import Wanted, diagnose_files
from simgap.report.sentences import sentences, title

Array = NDArray[np.float64]
LIBRARY = ("coulomb_friction", "viscous_friction", "servo_offset")
FAN = 7.3
"""[Hz]"""


def _rubbing(model: mujoco.MjModel) -> None:
    model.dof_frictionloss[1] += 0.1


def _dragging(model: mujoco.MjModel) -> None:
    _rubbing(model)
    model.dof_damping[0] += 0.3


def _blown(data: mujoco.MjData) -> None:
    data.qfrc_applied[0] = 0.1 * np.sin(2.0 * np.pi * FAN * data.time)


def _log(path: Path, change: Callable[[mujoco.MjModel], None], seed: int = 0, **how: Any) -> Path:
    table = simulate("arm", 8.0, seed, change=change, **how)
    np.savetxt(path, np.stack(list(table.values()), axis=1), delimiter=",", header=",".join(table), comments="")
    return path


def _diagnosed(log: Path, model: str = "new.xml", map_: str = "new_map.yaml") -> Diagnosis:
    folder = log.parent
    return diagnose_files(Wanted((log,), folder / model, folder / map_, only=LIBRARY, baselines=False, threads=2))


@pytest.fixture(scope="module")
def workshop(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with an arm's model, and what `simgap apply` makes of it after the first log: its elbow rubs."""
    folder = tmp_path_factory.mktemp("workshop")
    (folder / "robot.xml").write_text(MODELS["arm"])
    (folder / "map.yaml").write_text("# of the workshop\n" + yaml.safe_dump(MAPS["arm"]))
    found = _diagnosed(_log(folder / "first.csv", _rubbing), "robot.xml", "map.yaml")
    assert (found.verdict.kind, found.verdict.best.key) == ("effect", "coulomb_friction@elbow")
    assert found.report["corrects"] is None
    write_diagnosis(found, folder / "diagnosis", None)
    given = ["--model", str(folder / "robot.xml"), "--map", str(folder / "map.yaml"), "--out", str(folder / "new.xml")]
    result = CliRunner().invoke(app, ["apply", str(folder / "diagnosis"), *given])
    assert result.exit_code == 0, result.output
    bare = yaml.safe_load((folder / "new_map.yaml").read_text())
    assert bare.pop("corrects") == {"model": "robot.xml", "map": "map.yaml"}
    (folder / "bare_map.yaml").write_text(yaml.safe_dump(bare))
    return folder


def test_nothing_is_left_and_what_the_correction_is_worth_is_said(workshop: Path) -> None:
    found = _diagnosed(_log(workshop / "second.csv", _rubbing, 1))
    corrects = found.report["corrects"]
    assert (found.verdict.kind, found.report["effects"]) == ("no_gap", [])
    assert corrects["gap"]["before"] > 3.0 and corrects["gap"]["nuisances_only"] < 1.2
    assert corrects["explained"] > 0.9 and corrects["gain"] > 100.0
    assert any("an earlier diagnosis found is in the model" in s for s in sentences(found.report))


def test_a_new_fault_is_found_as_in_any_model(workshop: Path) -> None:
    found = _diagnosed(_log(workshop / "dragging.csv", _dragging, 3))
    assert (found.verdict.kind, found.verdict.best.key) == ("effect", "viscous_friction@shoulder")
    assert found.verdict.sure > 0.9


def test_what_nothing_explains_is_what_is_left_of_an_answer(workshop: Path) -> None:
    """The same log, with the way that the model came and without it."""
    log = _log(workshop / "blown.csv", _rubbing, 4, push=_blown)
    known, bare = _diagnosed(log), _diagnosed(log, map_="bare_map.yaml")
    assert (known.verdict.kind, bare.verdict.kind) == ("partial", "unknown")
    assert known.report["gap"] == bare.report["gap"] and bare.report["corrects"] is None
    assert title(known.report).startswith("What the model was corrected for explains ")
    for found in (known, bare):
        assert any(f"comes back about {FAN:.2g} times a second" in reason for reason in found.verdict.reasons)


def test_it_is_found_from_elsewhere_and_after_a_second_correction(workshop: Path, tmp_path: Path) -> None:
    moved = tmp_path / "moved"
    shutil.copytree(workshop, moved)
    (moved / "below").mkdir()
    for out in ("newer_map.yaml", "below/newest_map.yaml"):
        write_map(moved / "new_map.yaml", [], moved / out, moved / "new.xml", moved / "new.xml")
    for path, expected in (("newer_map.yaml", "map.yaml"), ("below/newest_map.yaml", "../map.yaml")):
        mapping = load_map(moved / path)
        assert mapping.corrects is not None and mapping.corrects.map == expected
        plant = original(mapping)
        assert plant is not None and plant.model.dof_frictionloss[1] == 0.0
    assert (moved / "newer_map.yaml").read_text().startswith("# of the workshop\n")


def test_a_motor_that_was_corrected_is_told_the_forces_of_the_log_as_it_was_taken_to_be(tmp_path: Path) -> None:
    motor = '<mujoco><worldbody><body><joint name="j" axis="0 1 0"/><geom size="0.1"/></body></worldbody><actuator>'
    motor += '<motor name="m" joint="j" gear="{}"/></actuator></mujoco>'
    rows = {
        "time": {"column": "t", "unit": "s"},
        "inputs": [{"column": "u", "unit": "N m", "actuator": "m", "kind": "torque"}],
        "outputs": [{"column": "q", "unit": "rad", "joint": "j", "quantity": "position"}],
    }
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(rows))
    plants = []
    for gear in (2.0, 2.5):
        (tmp_path / "robot.xml").write_text(motor.format(gear))
        plants.append(build_plant(load_spec(tmp_path / "robot.xml"), load_map(tmp_path / "map.yaml")))
    (tmp_path / "log.csv").write_text("t,u,q\n" + "".join(f"{0.01 * i},{i % 3},{i % 5}\n" for i in range(50)))
    old, new = (load_recording(tmp_path / "log.csv", plant) for plant in plants)
    assert not np.allclose(old.inputs, new.inputs)
    assert as_read_by(plants[0], new, plants[1]).inputs == pytest.approx(old.inputs)


@pytest.mark.parametrize(
    ("corrects", "message"),
    [
        ({"model": "gone.xml", "map": "map.yaml"}, r"corrects.model: no such file as .*gone.xml; bring it back, or"),
        ({"model": "robot.xml", "map": "gone.yaml"}, r"corrects.map: no such file as .*gone.yaml; bring it back, or"),
        ({"model": "robot.xml", "map": "own_map.yaml"}, r"corrects.map: .*own_map.yaml corrects itself"),
        ({"model": "robot.xml"}, r"corrects.map: is missing"),
        ({"model": "robot.xml", "map": "map.yaml", "by": 1}, r"corrects.by: there is no such key"),
    ],
)
def test_wrong_origins_are_refused(corrects: dict[str, Any], message: str, tmp_path: Path) -> None:
    (tmp_path / "robot.xml").write_text(MODELS["arm"])
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(MAPS["arm"]))
    (tmp_path / "own_map.yaml").write_text(yaml.safe_dump({**MAPS["arm"], "corrects": corrects}))
    with pytest.raises(GapInputError, match=message):
        original(load_map(tmp_path / "own_map.yaml"))
