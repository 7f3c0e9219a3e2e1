"""Live changes of the gait: kept for one session, and never in the way of a start."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from nermo_control.gait.kept_changes import KeptChanges
from nermo_control.gait.knowledge_base import GaitParameters
from nermo_description.parameter_files import ParameterError

CHANGED = GaitParameters(settle_duration=0.11)


def test_changes_count_in_the_session_in_which_they_were_made(tmp_path: Path) -> None:
    file = tmp_path / "gait.yaml"
    assert KeptChanges(file).kept() is None
    KeptChanges(file).keep(CHANGED)
    assert KeptChanges(file).kept() == CHANGED
    assert KeptChanges(file, "another launch").kept() is None
    KeptChanges(file).keep(GaitParameters())
    assert KeptChanges(file).kept() == GaitParameters()


def test_a_session_is_that_of_the_process_that_starts_the_node(tmp_path: Path) -> None:
    code = "from nermo_control.gait.kept_changes import launched_by; print(launched_by())"
    first, second = (subprocess.check_output([sys.executable, "-c", code], text=True) for _ in range(2))
    assert first == second
    shell = f"import subprocess, sys; print(subprocess.check_output([sys.executable, '-c', {code!r}], text=True))"
    assert subprocess.check_output([sys.executable, "-c", shell], text=True).strip() != first.strip()


@pytest.mark.parametrize("text", ["a: [", "session: 1", "session: x\ngait_parameters: {settle_duration: -1.0}"])
def test_a_file_that_cannot_be_used_is_said(tmp_path: Path, text: str) -> None:
    file = tmp_path / "gait.yaml"
    file.write_text(text)
    with pytest.raises(ParameterError, match="gait.yaml"):
        KeptChanges(file).kept()
