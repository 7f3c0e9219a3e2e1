"""The button of the gap page: a real browser, and the twin in a real graph that moves only while it is held."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Browser, Page, sync_playwright
from terminal import left_running

from nermo_bringup.launch.runner import lead_own_life
from nermo_description.robots import load_robot
from nermo_gap.protocol.recorded import read
from nermo_gap.protocol.scene import scene_of, segments
from nermo_interfaces.msg import ControlCommand
from nermo_node import qos

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
PATIENCE_S = 120.0
ROBOT = load_robot("nermo_lite")
PLAY = """
import sys
from pathlib import Path
import numpy as np
import nermo_bringup.protocol.cli
from nermo_description.robots import load_robot
from nermo_gap.protocol.cli import through_graph
from nermo_gap.protocol.next_experiment import Beside, HeldPlayer
from nermo_gap.robots.channels import TRACKER, command
from nermo_gap.robots.diagnosis import robot_plant
from simgap.analysis.experiment import Experiment
from simgap.live.watch import watched

robot = load_robot("nermo_lite")
plant = robot_plant(robot, [*map(command, robot.servos), *TRACKER])
t = np.arange(0.0, 4.0, 0.005)
squat = np.tile([robot.servos[c.name].neutral for c in plant.inputs], (len(t), 1))
knee = [c.name for c in plant.inputs].index("front_left_knee")
squat[:, knee] -= 0.3 * np.sin(np.pi * np.clip(t - 1.0, 0.0, 2.0)) ** 2
player = HeldPlayer(through_graph(), "sim", patience=float(sys.argv[1]))
player.beside = Beside("nermo_lite", [Path("before")], Path("diagnosis"), False)
with watched(True, "127.0.0.1", 0, player) as live:
    live.play(Experiment("squat", "squat with one knee", 0.005, squat), plant)
"""
"""What `nermo gap diagnose --web --target sim` does when it has its answer."""

DIES_WITH_US = lead_own_life(os.getpid())

pytestmark = [
    pytest.mark.skipif(not any(map(shutil.which, BROWSERS)), reason="no Chromium or Chrome"),
    pytest.mark.long,
]


class Playing:
    """The command, and what the graph says of the mouse that it moves."""

    def __init__(self, bench, folder: Path, patience: float) -> None:
        self.bench, self.folder, self.told = bench, folder, folder / "told.txt"
        self.commands: list[ControlCommand] = []
        bench.node.create_subscription(ControlCommand, "/nermo/control_command", self.commands.append, qos.COMMAND)
        with self.told.open("w") as file:
            self.process = subprocess.Popen(
                [sys.executable, "-c", PLAY, str(patience)],
                cwd=folder,
                stdout=file,
                stderr=subprocess.STDOUT,
                preexec_fn=_as_typed,
            )
        self.until(lambda: self.address is not None, "the page is there")

    @property
    def text(self) -> str:
        return self.told.read_text(errors="replace")

    @property
    def address(self) -> str | None:
        found = re.search(r"http://127\.0\.0\.1:\d+/", self.text)
        return None if found is None else found[0]

    @property
    def moves(self) -> bool:
        """Whether the mouse is told to go where the experiment has it."""
        return bool(self.commands) and self.commands[-1].posture == ControlCommand.POSTURE_DIRECT

    def until(self, condition: Callable[[], bool], what: str) -> None:
        try:
            self.bench.until(condition, what, PATIENCE_S)
        except AssertionError as error:
            raise AssertionError(f"{error}\n{self.text[-2000:]}") from None


def _as_typed() -> None:
    DIES_WITH_US()
    # What a shell starts in the background is deaf to Ctrl-C.
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@pytest.fixture
def playing(graph, tmp_path: Path, request) -> Iterator[Playing]:
    """Whose graph waits for a hand for so long [s]."""
    made = Playing(graph, tmp_path, request.param)
    try:
        yield made
    finally:
        made.process.kill()
        made.process.wait()


@pytest.fixture
def browser() -> Iterator[Browser]:
    path = next(found for name in BROWSERS if (found := shutil.which(name)))
    with sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=path, args=["--no-sandbox", "--disable-gpu"])
        yield opened
        opened.close()


def opened(playing: Playing, browser: Browser) -> Page:
    page = browser.new_context(viewport={"width": 500, "height": 900}).new_page()
    page.set_default_timeout(1e3 * PATIENCE_S)
    page.goto(str(playing.address))
    page.locator("#hold").wait_for()
    return page


def press(page: Page) -> None:
    page.locator("#hold").hover()  # Which waits until it stays where it is.
    page.mouse.down()


def told(page: Page) -> str:
    return str(page.locator("#told").inner_text())


@pytest.mark.parametrize("playing", [60.0], indirect=True)
def test_the_twin_plays_while_the_button_is_held_and_what_it_did_can_be_diagnosed(
    playing: Playing, browser: Browser
) -> None:
    page, other = opened(playing, browser), opened(playing, browser)
    assert page.locator("#robot").inner_text() == "the twin" and page.locator("#norobot").is_hidden()
    press(page)
    playing.until(lambda: playing.moves, "it moves while the button is held")
    other.locator("#hold").focus()
    other.keyboard.down("Enter")
    playing.until(lambda: "drives" in other.locator("#refused").inner_text(), "somebody else is refused")
    page.mouse.up()
    playing.until(lambda: "let go: 'squat' is broken off" in told(page), "it is broken off")
    playing.until(lambda: playing.commands[-1].posture == ControlCommand.POSTURE_STAND, "it stands")
    other.keyboard.up("Enter")

    # By the space bar, as whoever has no pointer does.
    page.locator("#hold").focus()
    page.keyboard.down("Space")
    page.locator("#played code").first.wait_for()
    page.keyboard.up("Space")
    folder, command = page.locator("#played code").all_inner_texts()
    assert folder == "diagnosis/next_experiment_1"
    assert command == "nermo gap diagnose before diagnosis/next_experiment_1"
    assert other.locator("#played").inner_text() == page.locator("#played").inner_text()

    folders = segments(playing.folder / folder)
    recorded = read(folders, [scene_of(path) for path in folders], ROBOT)
    (table,) = recorded.tables
    assert recorded.looks[0.0] == pytest.approx((0.85, 2.05)) and recorded.stands == [None]
    assert np.ptp(table["t"]) == pytest.approx(4.0, abs=0.05)
    knee = table["front_left_knee_command"]
    assert np.nanmax(knee) - np.nanmin(knee) == pytest.approx(0.3, abs=0.02)
    assert np.isfinite(table["base_z"]).any()

    # Nothing begins anew by itself, and Ctrl-C ends it and is no failure.
    assert page.locator("#played li").count() == 1
    playing.process.send_signal(signal.SIGINT)
    page.locator("#hold[disabled]").wait_for()
    other.locator("#hold[disabled]").wait_for()
    playing.until(lambda: playing.process.poll() is not None, "it ends")
    assert playing.process.returncode == 0 and "Traceback" not in playing.text
    assert not left_running(os.environ["ROS_DOMAIN_ID"])


@pytest.mark.parametrize("playing", [20.0], indirect=True)
def test_a_page_that_closes_lets_go_and_a_line_that_stalls_too(playing: Playing, browser: Browser) -> None:
    page = opened(playing, browser)
    press(page)
    playing.until(lambda: playing.moves, "it moves while the button is held")
    page.context.set_offline(True)
    playing.until(lambda: "let go: 'squat' is broken off" in playing.text, "the line is down")
    playing.until(lambda: not playing.moves, "it stands")
    page.context.set_offline(False)
    page.mouse.up()

    page.reload()
    page.locator("#hold").wait_for()
    press(page)

    def moves_again() -> bool:
        # While the page that is gone may still hold it, another press is refused, and has to be made again.
        if page.locator("#refused").is_visible():
            page.mouse.up()
            press(page)
        return playing.moves

    playing.until(moves_again, "it moves again")
    page.close()
    playing.until(lambda: playing.text.count("is broken off") == 2, "the page is closed")
    playing.until(lambda: not playing.moves, "it stands")
    # Nobody comes back: the graph goes down, and then the command ends.
    playing.until(lambda: playing.process.poll() is not None, "it ends")
    assert playing.process.returncode == 0 and "Traceback" not in playing.text
    assert not left_running(os.environ["ROS_DOMAIN_ID"])
