"""The documentation as a site, built strictly; and what stands beside the code for others' machines is well formed."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import yaml

from nermo_bringup.environment.checkout import checkout_root

ROOT = checkout_root()
UV = Path(sys.executable).parent / "uv"


def _run(*words: object, cwd: Path) -> subprocess.CompletedProcess[str]:
    bare = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "VIRTUAL_ENV"))}
    bare |= {"UV_SYSTEM_CERTS": "true", "UV_NATIVE_TLS": "true"}
    if "PIP_INDEX_URL" in bare:
        bare.setdefault("UV_DEFAULT_INDEX", bare["PIP_INDEX_URL"])
    return subprocess.run([str(w) for w in words], cwd=cwd, env=bare, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def zensical(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site's builder, in an environment of its own: it is large, and nothing else needs it."""
    environment = tmp_path_factory.mktemp("zensical") / "venv"
    for words in (
        ("venv", "--quiet", "--python", sys.executable, environment),
        ("pip", "install", "--quiet", "--python", environment / "bin/python", "-r", ROOT / "docs/requirements.lock"),
    ):
        done = _run(UV, *words, cwd=ROOT)
        assert done.returncode == 0, done.stderr
    return environment / "bin" / "zensical"


def _copy(folder: Path) -> Path:
    shutil.copy(ROOT / "zensical.toml", folder)
    shutil.copytree(ROOT / "docs", folder / "docs")
    shutil.copytree(ROOT / "src/simgap/simgap", folder / "src/simgap/simgap", ignore=shutil.ignore_patterns("*.pyc"))
    return folder


@pytest.mark.long
def test_the_site_builds_strictly(zensical: Path, tmp_path: Path) -> None:
    built = _run(zensical, "build", "--strict", "--clean", cwd=_copy(tmp_path))
    assert built.returncode == 0, built.stdout + built.stderr
    page = (tmp_path / "site" / "tutorial" / "index.html").read_text(encoding="utf-8")
    assert "From your log to a cause in 15 minutes" in page and 'href="../simgap/monitor/"' in page
    reference = (tmp_path / "site" / "api" / "analysis" / "index.html").read_text(encoding="utf-8")
    assert 'id="simgap.analysis.diagnose.diagnose"' in reference and "_report(" not in reference


def test_every_public_module_of_simgap_is_in_the_reference_once() -> None:
    source = ROOT / "src/simgap/simgap"
    modules = [p.relative_to(source.parent).with_suffix("") for p in source.rglob("*.py") if not p.stem.startswith("_")]
    named = [
        name
        for page in (ROOT / "docs/api").glob("*.md")
        for name in re.findall(r"^::: (\S+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    ]
    missing, gone = {".".join(m.parts) for m in modules} - set(named), set(named) - {".".join(m.parts) for m in modules}
    assert not missing and not gone, f"docs/api: lacks {sorted(missing)}, and has {sorted(gone)} that are not there"
    assert len(named) == len(set(named))


@pytest.mark.long
def test_a_link_to_nowhere_is_no_site(zensical: Path, tmp_path: Path) -> None:
    with (_copy(tmp_path) / "docs" / "tutorial.md").open("a", encoding="utf-8") as page:
        page.write("\n[nowhere](nowhere.md)\n")
    assert _run(zensical, "build", "--strict", "--clean", cwd=tmp_path).returncode != 0


def test_every_page_is_in_the_site_s_menu_once() -> None:
    menu = tomllib.loads((ROOT / "zensical.toml").read_text(encoding="utf-8"))["project"]["nav"]
    named = re.findall(r"'([\w/]+\.md)'", str(menu))
    pages = [str(path.relative_to(ROOT / "docs")) for path in (ROOT / "docs").rglob("*.md")]
    assert sorted(named) == sorted(pages)


def test_the_citation_file_says_what_the_packages_say() -> None:
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert {"cff-version", "message", "title", "authors"} <= set(cited)
    assert cited["license"] == "Apache-2.0"
    assert f"<version>{cited['version']}</version>" in (ROOT / "src/simgap/package.xml").read_text(encoding="utf-8")


def test_the_workflow_runs_continuous_integration_on_both_releases() -> None:
    flow = yaml.safe_load((ROOT / ".github/workflows/ci.yml").read_text(encoding="utf-8"))
    # YAML 1.1 reads the key `on` as true.
    assert set(flow[True]) == {"push", "pull_request"}
    test = flow["jobs"]["test"]
    assert test["strategy"]["matrix"]["ros"] == ["jazzy", "kilted"]
    assert test["container"].startswith("ros:${{ matrix.ros }}")
    for job in flow["jobs"].values():
        assert any(".ci/run" in step.get("run", "") for step in job["steps"]) and "timeout-minutes" in job
    assert os.access(ROOT / ".ci" / "run", os.X_OK)


def test_the_container_s_steps_name_what_is_there() -> None:
    text = (ROOT / "Dockerfile").read_text(encoding="utf-8")
    steps = re.sub(r"\\\n", " ", text).splitlines()
    kinds = [line.split()[0] for line in steps if line and not line.startswith("#")]
    assert kinds[:2] == ["ARG", "FROM"] and set(kinds) <= {
        *("ARG", "FROM", "SHELL", "WORKDIR", "COPY", "RUN", "ENTRYPOINT", "CMD")
    }
    for line in steps:
        if line.startswith(("ENTRYPOINT", "CMD", "SHELL")):
            assert all(isinstance(word, str) for word in json.loads(line.split(maxsplit=1)[1]))
        if line.startswith("RUN"):
            command = line.split(maxsplit=1)[1]
            assert shlex.split(command)
            assert _run("bash", "-n", "-c", command, cwd=ROOT).returncode == 0, command
    assert "nermo_bringup.environment.doctor --missing-apt" in text and "./nermo --help" in text
    dev = json.loads((ROOT / ".devcontainer/devcontainer.json").read_text(encoding="utf-8"))
    assert (ROOT / ".devcontainer" / dev["build"]["dockerfile"]).resolve() == ROOT / "Dockerfile"
