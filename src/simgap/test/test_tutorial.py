"""The tutorial: its commands, in their order, do what the page says; and the page of effects is that of the code."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner

import simgap
from simgap.catalogue import as_markdown
from simgap.cli import app

DOCS = Path(simgap.__file__).resolve().parents[3] / "docs"


def _commands() -> list[tuple[str, list[str]]]:
    """(command, lines that the page says it prints)."""
    text = (DOCS / "tutorial.md").read_text(encoding="utf-8")
    found: list[tuple[str, list[str]]] = []
    for block in re.findall(r"```console\n(.*?)```", text, re.DOTALL):
        for line in block.splitlines():
            if line.startswith("$ "):
                found.append((line[2:], []))
            else:
                found[-1][1].append(line)
    return found


@pytest.mark.slow
def test_the_commands_of_the_tutorial_do_what_it_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    commands = _commands()
    assert [shlex.split(c)[1] for c, _ in commands] == ["example", "map", "check", "diagnose", "apply", "monitor"]
    for command, printed in commands:
        program, *words = shlex.split(command)
        assert program == "simgap"
        answer = CliRunner().invoke(app, words)
        assert answer.exit_code == 0, f"{command}: {answer.output}"
        for line in printed:
            assert line in answer.stdout, f"{command} does not print {line!r} but {answer.stdout}"
    for file in ("diagnosis/report.html", "example/corrected.xml", "ranges.yaml", "map.yaml"):
        assert (tmp_path / file).is_file()


def test_the_page_of_effects_is_that_of_the_code() -> None:
    assert (DOCS / "simgap" / "effects.md").read_text(encoding="utf-8") == as_markdown(), "simgap effects --markdown"
