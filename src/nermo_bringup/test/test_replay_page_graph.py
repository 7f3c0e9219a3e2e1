"""`nermo replay --web`: what was recorded comes again in a real browser, and nothing drives."""

from __future__ import annotations

import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from nav_msgs.msg import Odometry
from playwright.sync_api import sync_playwright
from rclpy.serialization import serialize_message
from typer.testing import CliRunner

from nermo_bringup.cli import app
from nermo_bringup.recording.schema import ros2msg
from nermo_bringup.recording.writer import BagWriter, Topic
from nermo_interfaces.msg import ControlCommand
from nermo_node.time import to_message

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
PATIENCE_S = 120.0
SPEED, SECONDS = 0.1, 20.0
"""[m/s] of the recorded mouse, and for how long [s] it walks."""


@pytest.fixture
def walk(tmp_path: Path) -> Path:
    """A mouse that walks straight on, as the robot's tracker saw it, and what it was told."""
    bag = BagWriter(tmp_path / "walk")
    seen = Topic("/nermo/tracker/odom", "nav_msgs/msg/Odometry", ros2msg("nav_msgs/msg/Odometry"))
    kind = "nermo_interfaces/msg/ControlCommand"
    told = Topic("/nermo/control_command", kind, ros2msg(kind))
    for tick in range(round(SECONDS / 0.05)):
        now = 10**9 + tick * 50_000_000
        pose = Odometry()
        pose.header.stamp = to_message(now)
        pose.pose.pose.position.x, pose.pose.pose.orientation.w = SPEED * 0.05 * tick, 1.0
        command = ControlCommand(forward_velocity=0.08, gait="trot", gait_frequency=0.8)
        command.header.stamp = to_message(now)
        bag.write(seen, now, now, 0, serialize_message(pose))
        bag.write(told, now, now, 0, serialize_message(command))
    bag.close()
    return tmp_path / "walk"


@pytest.fixture
def address(walk: Path, tmp_path: Path) -> Iterator[str]:
    log = tmp_path / "told.txt"
    with log.open("w") as file:
        process = subprocess.Popen(
            [sys.executable, "-m", "nermo_bringup", "replay", str(walk), "--web", "--web-port", "0"],
            stdout=file,
            stderr=subprocess.STDOUT,
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
        )
    try:
        until(lambda: re.search(r"http://127\.0\.0\.1:\d+/", log.read_text()) is not None, "the page is there")
        yield re.findall(r"http://127\.0\.0\.1:\d+/", log.read_text())[0]
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE_S) == 0 and "Traceback" not in log.read_text()
    finally:
        process.kill()
        process.wait()


def until(condition: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline, f"waited in vain until {what}"
        time.sleep(0.05)


@pytest.mark.skipif(not any(map(shutil.which, BROWSERS)), reason="no Chromium or Chrome")
@pytest.mark.long
def test_a_recording_is_seen_in_the_browser_again_and_again(address: str, walk: Path) -> None:
    path = next(found for name in BROWSERS if (found := shutil.which(name)))
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=["--no-sandbox", "--disable-gpu"])
        page = browser.new_page()
        page.set_default_timeout(1e3 * PATIENCE_S)
        page.route("**/3d/", lambda route: route.abort())
        page.goto(address)

        def place() -> float:
            found = re.search(r"place\s+(-?\d+\.\d+),", page.locator("#facts").inner_text())
            return float(found[1]) if found else -1.0

        until(lambda: place() >= 0.0, "the mouse is somewhere")
        until(lambda: page.locator("#commanded").inner_text() == "8.0", "what it was told is shown")
        until(lambda: page.locator("#speed").inner_text() != "-", "and how fast it was")
        begin = place()
        until(lambda: place() > begin + 0.3, "it walks on")
        assert str(walk) in page.locator("#status").inner_text()
        for gone in ("#stick", "#stop", "#record", "#gait"):
            assert page.locator(gone).is_hidden(), gone
        page.evaluate('send({ kind: "stop" })')
        until(lambda: "nothing drives here" in page.locator("#said").inner_text(), "who drives all the same is told")
        until(lambda: place() < begin + 0.2, "it comes again from the beginning")
        browser.close()


@pytest.mark.parametrize(
    ("words", "why"), [(["--json", "a.json"], "leave --out and --json out"), ([], "does not exist")]
)
def test_what_cannot_be_shown_is_refused(words: list[str], why: str, tmp_path: Path) -> None:
    answer = CliRunner().invoke(app, ["replay", str(tmp_path / "nothing"), "--web", *words])
    assert answer.exit_code != 0 and why in str(answer.exception)
