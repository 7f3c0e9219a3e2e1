"""`nermo bench web`: real nodes, the page, and a viewer that takes what comes."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from nermo_bringup.web_bench.viewer import Viewer


@pytest.mark.long
def test_what_a_viewer_costs_is_measured_in_a_graph_that_walks(tmp_path: Path) -> None:
    file = tmp_path / "web.json"
    words = ["bench", "web", "--viewers", "1", "--viewers", "0", "--seconds", "3", "--json", str(file)]
    done = subprocess.run(
        [sys.executable, "-m", "nermo_bringup", *words], capture_output=True, text=True, timeout=240.0
    )
    assert done.returncode == 0, done.stderr
    without, watched, unwatched = json.loads(file.read_text(encoding="utf-8"))["rows"]
    assert without["viewers"] is None and without["web_percent"] is None
    assert (watched["viewers"], unwatched["viewers"]) == (1, 0)
    for row in (without, watched, unwatched):
        assert row["rate_hz"] > 0.0
        assert 0.0 < row["age_ms"]["p50"] <= row["age_ms"]["p99"] <= row["age_ms"]["max"]
    # The figures alone are 7 kB/s; the rest is the mouse that moves, which is drawn for who looks alone.
    assert watched["kb_s"] > 20.0 and unwatched["kb_s"] is None
    assert watched["web_percent"] > 0.0 and unwatched["web_percent"] > 0.0
    assert watched["web_mb"][0] > 10.0
    assert "no page" in done.stdout


def test_a_viewer_of_no_page_goes() -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    viewer = Viewer(port)
    try:
        viewer._process.join(60.0)
        assert not viewer.watches and viewer.received == 0
    finally:
        viewer.close()
