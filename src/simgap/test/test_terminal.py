"""The commands as they are typed: help at once and everywhere, and nothing on the terminal that is not ours."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from simgap.catalogue import catalogue
from simgap.cli import app
from simgap.console import print_check
from simgap.effects.library import effect_classes
from simgap.preparation.check import Check, JointMotion

HEAVY = ("numpy", "scipy", "mujoco", "pydantic", "pint", "pyarrow", "rosbags", "jinja2", "yaml")


def _run(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)


def test_help_imports_nothing_heavy() -> None:
    done = _run(f"import sys, simgap.cli; print([m for m in {HEAVY!r} if m in sys.modules])")
    assert done.stdout.strip() == "[]", done.stderr


def _commands(command: Any, words: tuple[str, ...] = ()) -> list[tuple[str, ...]]:
    found = [words]
    for name, inner in getattr(command, "commands", {}).items():
        found += _commands(inner, (*words, name))
    return found


@pytest.mark.parametrize("words", _commands(typer.main.get_command(app)), ids=" ".join)
def test_every_command_has_a_short_help(words: tuple[str, ...]) -> None:
    answer = CliRunner().invoke(app, [*words, "-h"])
    assert answer.exit_code == 0 and "Usage" in answer.stdout


def test_what_other_libraries_print_reaches_nobody() -> None:
    code = """
import os, sys, warnings
import numpy as np
from simgap.console import progress, silence
with silence() as terminal, progress("align", terminal) as say:
    print("python"); os.write(1, b"c library"); os.write(2, b"c error"); warnings.warn("careful")
    np.array([1.0]) / np.array([0.0])
    say("fit", 0.5)
print("result")
os.write(2, b"ours")
"""
    done = _run(code)
    assert done.returncode == 0
    assert done.stdout == "result\n"
    assert done.stderr == "fit: 50 %\nours"


def test_an_unforeseen_error_is_one_sentence() -> None:
    code = """
import typer
from simgap.console import guarded
app = typer.Typer()
@app.command()
def broken() -> None:
    raise RuntimeError("no such luck")
guarded(app, "simgap")
"""
    done = _run(code)
    assert done.returncode == 1
    (line,) = done.stderr.strip().splitlines()
    assert "RuntimeError: no such luck" in line and "SIMGAP_TRACEBACK=1" in line


def test_every_effect_is_listed_with_its_sentence_and_units() -> None:
    entries = {entry.name: entry for entry in catalogue()}
    assert set(entries) == set(effect_classes())
    for entry in entries.values():
        assert entry.sentence.endswith((".", ".)")) and len(entry.sentence) > 20, entry.name
        assert "[" in entry.parameters, entry.name
    assert entries["link_latency"].parameters == "delay [s]"
    assert "N m" in entries["coulomb_friction"].parameters
    one = CliRunner().invoke(app, ["effects", "servo_delay"])
    assert one.exit_code == 0 and len(one.stdout.splitlines()) == 3
    wrong = CliRunner().invoke(app, ["effects", "servo_dely"])
    assert wrong.exit_code == 2 and "did you mean servo_delay" in wrong.stderr


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["diagnose", "none.csv", "--model", "none.xml", "--map", "none.yaml"], "none.xml: no such model file"),
        (["diagnose", "none.csv", "--model", "{model}", "--map", "none.yaml"], "none.yaml: cannot read the map"),
        (["diagnose", "none.csv", "--model", "{model}", "--map", "{map}"], "none.csv: no such recording"),
        (["diagnose", "{map}", "--model", "{model}", "--map", "{map}"], "a recording is a table"),
        # Told before anything is read.
        (["diagnose", "none.csv", "--model", "none.xml", "--map", "none.yaml", "--only", "dely"], "no effect 'dely'"),
    ],
)
def test_bad_input_is_one_sentence_and_status_2(words: list[str], message: str, tmp_path: Path) -> None:
    from robots import MAPS, MODELS
    from yaml import safe_dump

    (tmp_path / "arm.xml").write_text(MODELS["arm"])
    (tmp_path / "map.yaml").write_text(safe_dump(MAPS["arm"]))
    files = {"model": str(tmp_path / "arm.xml"), "map": str(tmp_path / "map.yaml")}
    answer = CliRunner().invoke(app, [w.format(**files) for w in words])
    assert answer.exit_code == 2 and answer.stdout == ""
    (line,) = answer.stderr.strip().splitlines()
    assert message in line


def test_names_with_brackets_are_printed_whole(capsys: pytest.CaptureFixture[str]) -> None:
    """As a bag's channels have them."""
    joint = JointMotion("knee[0]", 0.0, 1.0, 1.0, 4, 0.1, False)
    print_check(Check(0.01, 2.0, 1, [joint], warnings=["a[left] is late"], advice=["move b[bold]"]))
    told = capsys.readouterr().out
    assert all(name in told for name in ("knee[0]", "a[left] is late", "move b[bold]"))
