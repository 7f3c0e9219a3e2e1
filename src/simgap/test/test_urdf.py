"""What a diagnosis has found, written into a URDF: its numbers, in its own text."""

from __future__ import annotations

import json
import re
from pathlib import Path

import mujoco
import numpy as np
import pytest
from typer.testing import CliRunner

from simgap.cli import app
from simgap.correction.changes import Change, Correction, Signal, differences
from simgap.correction.urdf import write_urdf
from simgap.data.errors import GapInputError

URDF = """<?xml version="1.0"?>
<robot name="arm">  <!-- of a workshop -->
  <link name="base"/>
  <link name="upper">
    <inertial>
      <origin xyz="0 0 -0.1" rpy="0 0 0.3"/><mass value="0.5"/>
      <inertia ixx="0.004" ixy="0.0001" ixz="0" iyy="0.0035" iyz="0" izz="0.001"/>
    </inertial>
  </link>
  <link name="fore">
    <inertial><mass value="0.3"/><inertia ixx="0.002" ixy="0" ixz="0" iyy="0.002" iyz="0" izz="0.0005"/></inertial>
  </link>
  <joint name="shoulder" type="revolute">
    <parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="2" effort="5" velocity="3"/>
    <dynamics damping="0.1"/>  <!-- guessed -->
  </joint>
  <joint name="elbow" type="continuous">
    <parent link="upper"/><child link="fore"/><origin xyz="0 0 -0.2"/><axis xyz="0 1 0"/>
  </joint>
</robot>
"""


def _found() -> tuple[mujoco.MjModel, Correction]:
    """A model that differs from the URDF's, and how."""
    nominal, changed = (mujoco.MjModel.from_xml_string(URDF) for _ in range(2))
    upper, fore = changed.body("upper").id, changed.body("fore").id
    changed.dof_damping[:] = 0.3, 0.05
    changed.dof_frictionloss[:] = 0.0, 0.12
    changed.jnt_range[0] = -0.9, 1.8
    changed.body_mass[upper] *= 1.1
    changed.body_inertia[upper] *= 1.1
    changed.body_ipos[fore] = 0.01, 0.0, -0.02
    return changed, Correction(tuple(differences(nominal, changed)), ())


def test_a_urdf_takes_what_it_has_words_for_and_keeps_its_text(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(URDF)
    changed, found = _found()
    written = write_urdf(tmp_path / "arm.urdf", found, tmp_path / "new.urdf")
    assert written.notes == () and len(written.written) == len(found.changes) == 7
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "new.urdf"))
    for field in ("dof_damping", "dof_frictionloss", "jnt_range", "body_mass", "body_inertia", "body_ipos"):
        assert np.allclose(getattr(model, field), getattr(changed, field), rtol=1e-5, atol=1e-9), field
    kept, text = URDF.splitlines(), (tmp_path / "new.urdf").read_text()
    assert all(comment in text for comment in re.findall(r"<!--.*?-->", URDF))
    same = [line for line in kept if line in text.splitlines()]
    assert len(same) >= len(kept) - 6


def test_what_a_urdf_cannot_say_is_listed_with_its_number(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(URDF)
    changes = (
        Change("joint", "shoulder", 0, "damping", (0.1,), (0.2,), "N m s/rad"),
        Change("joint", "shoulder", 0, "armature", (0.0,), (0.004,), "kg m^2"),
        Change("joint", "elbow", 1, "range", (0.0, 0.0), (-1.0, 1.0), "rad"),
        Change("body", "upper", 1, "mass", (0.9,), (1.0,), "kg"),
        Change("body", "hand", 3, "mass", (0.1,), (0.2,), "kg"),
    )
    signal = Signal("servo", "elbow_servo", "backlash", 0.03, "rad")
    written = write_urdf(tmp_path / "arm.urdf", Correction(changes, (signal,)), tmp_path / "new.urdf")
    assert [c.attribute for c in written.written] == ["damping"]
    reasons = "\n".join(written.notes)
    for words in ("armature 0 -> 0.004 kg m^2", "type continuous has no limits", "another mass [kg]: 0.5", "0.03 rad"):
        assert words in reasons
    assert len(written.notes) == 5


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<mujoco/>", "for an MJCF use --model"),
        ("<robot", "is not XML"),
        ('<robot xmlns:xacro="x"><xacro:include filename="a"/></robot>', "expand it first"),
        (URDF.replace("shoulder", "schulter").replace("elbow", "ellbogen"), "did you mean schulter"),
    ],
)
def test_another_file_is_refused(text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(text)
    change = Change("joint", "shoulder", 0, "damping", (0.1,), (0.2,), "N m s/rad")
    with pytest.raises(GapInputError, match=re.escape(message)):
        write_urdf(tmp_path / "arm.urdf", Correction((change,), ()), tmp_path / "new.urdf")


def test_the_command_says_what_it_wrote_and_what_not(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(URDF)
    found = Correction(_found()[1].changes, (Signal("servo", "s", "dead_band", 0.01, "rad"),))
    report = {"schema": "nermo_gap/diagnosis/2", "verdict": "effect", "correction": found.report()}
    (tmp_path / "diagnosis.json").write_text(json.dumps(report))
    words = ["apply", str(tmp_path / "diagnosis.json"), "--urdf", str(tmp_path / "arm.urdf")]
    answer = CliRunner().invoke(app, [*words, "--out", str(tmp_path / "new.urdf")])
    assert answer.exit_code == 0 and answer.stdout.splitlines()[-1] == str(tmp_path / "new.urdf")
    assert "joint elbow: frictionloss 0 -> 0.12 N m" in answer.stdout
    assert "not written: servo s: dead band 0.01 rad" in answer.stderr
    for more, message in (([], "the model itself"), (["--model", "m.xml"], "or --urdf")):
        refused = CliRunner().invoke(app, [*words, *more, "--out", str(tmp_path / "arm.urdf")])
        assert refused.exit_code == 2 and message in refused.stderr
