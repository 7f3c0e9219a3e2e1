"""simgap alone: its wheel, installed in an environment that has nothing else, no ROS and no workspace."""

from __future__ import annotations

import os
import subprocess
import sys
import zipfile
from email.parser import Parser
from pathlib import Path

import numpy as np
import pytest
from robots import MAPS, MODELS, simulate
from yaml import safe_dump

import simgap

MOST_PACKAGES, MOST_MB = 40, 350
UV = Path(sys.executable).parent / "uv"


def _source() -> Path:
    """The package's folder in the checkout; what is imported may be a link to it."""
    return Path(simgap.__file__).resolve().parents[1]


def _run(*words: object, cwd: Path) -> str:
    bare = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "AMENT", "COLCON", "VIRTUAL_ENV"))}
    # As the workspace's set-up calls uv: behind a company's proxy it needs the system's certificates and index.
    bare |= {"UV_SYSTEM_CERTS": "true", "UV_NATIVE_TLS": "true"}
    if "PIP_INDEX_URL" in bare:
        bare.setdefault("UV_DEFAULT_INDEX", bare["PIP_INDEX_URL"])
    done = subprocess.run([str(w) for w in words], cwd=cwd, env=bare, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    _run(UV, "build", "--quiet", "--wheel", "--out-dir", folder, _source(), cwd=folder)
    (found,) = folder.glob("*.whl")
    return found


def test_the_wheel_holds_all_it_needs_and_asks_for_little(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        (metadata,) = (name for name in names if name.endswith("METADATA"))
        asked = Parser().parsestr(archive.read(metadata).decode()).get_all("Requires-Dist", [])
    own = {str(f.relative_to(_source())) for f in (_source() / "simgap").rglob("*.py")}
    assert own <= set(names)
    for data in (
        "py.typed",
        "report/report.html.j2",
        "report/colours.css.j2",
        "live/page/live.js",
        "examples/double_pendulum/excerpt.csv",
    ):
        assert f"simgap/{data}" in names
    always = [line for line in asked if "extra ==" not in line]
    assert not [line for line in always if line.startswith(("pyarrow", "rosbags", "matplotlib", "pandas"))]
    extras = {name: [line for line in asked if f'extra == "{name}"' in line] for name in ("bags", "parquet")}
    for extra, package in (("bags", "rosbags"), ("bags", "mcap"), ("parquet", "pyarrow")):
        assert any(line.startswith(package) for line in extras[extra]), package


@pytest.mark.long
def test_a_bare_environment_has_all_commands(wheel: Path, tmp_path: Path) -> None:
    environment, python = tmp_path / "bare", tmp_path / "bare" / "bin" / "python"
    _run(UV, "venv", "--quiet", "--python", sys.executable, environment, cwd=tmp_path)
    _run(UV, "pip", "install", "--quiet", "--compile-bytecode", "--python", python, wheel, cwd=tmp_path)
    packages = _run(UV, "pip", "list", "--quiet", "--format", "freeze", "--python", python, cwd=tmp_path)
    assert len(packages.splitlines()) <= MOST_PACKAGES
    size = sum(f.stat().st_size for f in environment.rglob("*") if f.is_file() and not f.is_symlink()) / 2**20
    assert size <= MOST_MB
    command = environment / "bin" / "simgap"
    assert "Usage" in _run(command, "-h", cwd=tmp_path)
    table = simulate("pendulum", 8.0, noise=1e-3)
    np.savetxt(
        tmp_path / "log.csv", np.stack(list(table.values()), 1), delimiter=",", header=",".join(table), comments=""
    )
    (tmp_path / "pendulum.xml").write_text(MODELS["pendulum"])
    (tmp_path / "map.yaml").write_text(safe_dump(MAPS["pendulum"]))
    words = ["--model", "pendulum.xml", "--map", "map.yaml"]
    assert _run(command, "check", "log.csv", *words, cwd=tmp_path).splitlines()[-1] == "usable"
    assert "servo_gain" in _run(command, "effects", cwd=tmp_path)
    example = _run(command, "example", "--out", "example", cwd=tmp_path)
    assert example.splitlines()[-1] == "example/diagnosis/report.html"
    assert (tmp_path / "example/diagnosis/report.html").read_text(encoding="utf-8").count("<svg") >= 8
    # What an extra brings is asked for in one sentence.
    for name, extra in (("log.parquet", "parquet"), ("log.mcap", "bags")):
        (tmp_path / name).write_bytes(b"")
        done = subprocess.run(
            [command, "check", name, *words], cwd=tmp_path, capture_output=True, text=True, check=False
        )
        assert done.returncode == 2
        if extra == "parquet":
            assert done.stderr.strip().splitlines()[-1].endswith("pip install 'simgap[parquet]'")
        else:
            assert "rows name topic" in done.stderr
