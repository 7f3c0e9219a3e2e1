"""The word `track`: help that comes at once."""

from __future__ import annotations

import subprocess
import sys

import pytest
from typer.testing import CliRunner

from nermo_track.cli import bench_app, track_app


def test_help_waits_for_nothing_heavy() -> None:
    program = (
        "import sys, typer; from nermo_track.cli import track_app\n"
        "try: typer.main.get_command(track_app)(['film', '--help'])\n"
        "except SystemExit: pass\n"
        "print(sorted({'cv2', 'matplotlib', 'mujoco', 'numpy', 'rosbags', 'scipy'} & set(sys.modules)))"
    )
    told = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert told.stdout.splitlines()[-1] == "[]"


@pytest.mark.parametrize("command", ["sheet", "calibrate", "film", "top", "live"])
def test_each_command_has_examples(command: str) -> None:
    told = CliRunner().invoke(track_app, [command, "--help"])
    assert told.exit_code == 0
    assert f"nermo track {command}" in told.output


def test_the_bench_is_a_word_of_its_own() -> None:
    told = CliRunner().invoke(bench_app, ["track", "--help"])
    assert told.exit_code == 0 and "nermo bench track" in told.output
