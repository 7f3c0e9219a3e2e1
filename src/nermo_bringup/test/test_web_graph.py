"""`nermo up --web` as people use it: a real browser before a real graph."""

from __future__ import annotations

import io
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from playwright.sync_api import Browser, Page, sync_playwright
from rclpy.parameter_client import AsyncParameterClient
from sensor_msgs.msg import CompressedImage, Image
from std_msgs.msg import Bool

from nermo_interfaces.msg import ControlCommand
from nermo_node import qos
from nermo_node.recording_reader import Recording
from nermo_web.gap_colours import FAR, SAME, gaps_of

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
# Without a graphics card, and as root in a container.
OPTIONS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
PATIENCE_S = 90.0
GREEN, RED, SOME = 12, 40, 0.01
"""Levels of 255 by which a colour stands out (a mouse is pale pink itself), and the share of pixels that counts."""
SMALL = {"width": 800, "height": 420}
"""Drawn by the processor, a larger picture takes longer than the stick may be silent."""

pytestmark = [
    pytest.mark.skipif(not any(map(shutil.which, BROWSERS)), reason="no Chromium or Chrome"),
    pytest.mark.long,
]


class Graph:
    """What the graph says, beside what the page shows of it."""

    def __init__(self, bench, address: str) -> None:
        self.bench, self.address = bench, address
        self.commands: list[ControlCommand] = []
        self.stops: list[bool] = []
        self.place: tuple[float, float] = (0.0, 0.0)
        self.twin = ""
        self.gaps: dict[str, float] = {}
        """What `gap_monitor` said last, by part [sensor resolutions]."""
        node = bench.node
        node.create_subscription(ControlCommand, "/nermo/control_command", self.commands.append, 100)
        node.create_subscription(Bool, "/nermo/emergency_stop", lambda said: self.stops.append(said.data), qos.STATE)
        node.create_subscription(Odometry, "/nermo/truth/odom", self._on_odometry, qos.BEST_EFFORT)
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 50)

    def until(self, condition: Callable[[], bool], what: str) -> None:
        try:
            self.bench.until(condition, what, PATIENCE_S)
        except AssertionError as error:
            raise AssertionError(f"{error}; the twin says {self.twin!r}, stops {self.stops[-5:]}") from None

    @property
    def told(self) -> float | None:
        """The forward velocity that was commanded last [m/s]."""
        return self.commands[-1].forward_velocity if self.commands else None

    def walked(self, start: tuple[float, float]) -> float:
        return float(np.hypot(self.place[0] - start[0], self.place[1] - start[1]))

    def _on_odometry(self, message: Odometry) -> None:
        self.place = message.pose.pose.position.x, message.pose.pose.position.y

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == "nermo/mujoco_sim: twin":
                self.twin = status.message
            if status.name.endswith("gap_monitor: gap"):
                self.gaps = gaps_of({pair.key: pair.value for pair in status.values})


@pytest.fixture
def graph(graph, tmp_path: Path) -> Iterator[Graph]:
    log = tmp_path / "up.log"
    with log.open("wb") as file:
        command = [sys.executable, "-m", "nermo_bringup", "up", "--web", "--web-port", "0", "teleop:=none"]
        process = subprocess.Popen(
            command,
            cwd=tmp_path,
            stdin=subprocess.DEVNULL,
            stdout=file,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
    try:
        deadline = time.monotonic() + PATIENCE_S
        while (found := re.search(r"http://127\.0\.0\.1:\d+/", log.read_text(errors="replace"))) is None:
            assert process.poll() is None and time.monotonic() < deadline, log.read_text(errors="replace")[-2000:]
            time.sleep(0.1)
        made = Graph(graph, found[0])
        made.until(lambda: made.twin.startswith("following commands"), "the mouse stands and takes commands")
        yield made
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(PATIENCE_S)
    assert process.returncode in (0, 130) and "Traceback" not in log.read_text(errors="replace")


@pytest.fixture
def browser() -> Iterator[Browser]:
    path = next(found for name in BROWSERS if (found := shutil.which(name)))
    with sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=path, args=OPTIONS)
        yield opened
        opened.close()


def open_page(graph: Graph, browser: Browser, scene: bool = True) -> Page:
    """The page, connected and with its settings; without the scene where that is not looked at, which takes long."""
    page = browser.new_context(viewport=SMALL).new_page()
    page.set_default_timeout(1e3 * PATIENCE_S)
    if not scene:
        page.route("**/3d/", lambda route: route.abort())
    page.goto(graph.address)
    graph.until(lambda: page.locator("#gait option").count() > 1, "the page shows the gaits")
    return page


def hand_on_stick(page: Page) -> None:
    """Presses the stick and pushes it forward; `page.mouse.up()` lets it go."""
    box = page.locator("#stick").bounding_box()
    x, y = box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"]
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x, y - 0.48 * box["height"])


def picture(page: Page) -> np.ndarray:
    """What the scene shows, right of the stick."""
    shot = page.screenshot(clip={"x": 250.0, "y": 80.0, "width": 200.0, "height": 240.0})
    return imageio.imread(io.BytesIO(shot))[..., :3].astype(int)


def changed(before: np.ndarray, after: np.ndarray) -> float:
    """Share of the pixels that differ clearly."""
    return float(np.mean(np.abs(after - before).max(axis=-1) > 24))


def test_the_page_shows_the_mouse_and_the_stick_walks_it(graph: Graph, browser: Browser) -> None:
    page = open_page(graph, browser)
    errors: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    scene = page.frame_locator("#scene")
    graph.until(lambda: scene.locator("canvas").count() > 0, "the scene is there")
    graph.until(lambda: len(np.unique(picture(page).reshape(-1, 3), axis=0)) > 500, "the scene shows a mouse")
    standing, start = picture(page), graph.place
    page.locator("#pace").fill("10")
    hand_on_stick(page)
    graph.until(lambda: graph.walked(start) > 0.05, "the stick walks the mouse")
    graph.until(lambda: changed(standing, picture(page)) > 0.02, "the scene shows it walking")
    # A browser that a busy machine lets be silent for a moment commands nothing in between.
    graph.until(
        lambda: all(float(page.locator(name).inner_text()) > 1.0 for name in ("#speed", "#commanded")),
        "the page says how fast it is, and is to be",
    )
    page.mouse.up()
    graph.until(lambda: graph.told == 0.0, "the mouse is told to stop")
    graph.until(lambda: page.locator("#commanded").inner_text() == "0.0", "the page says so")
    loads = page.locator("#loads output").all_inner_texts()
    assert len(loads) == 4 and all(load.endswith(" N") for load in loads)
    assert errors == []


def test_what_a_program_tells_the_mouse_is_shown(graph: Graph, browser: Browser) -> None:
    page = open_page(graph, browser, scene=False)
    program = graph.bench.node.create_publisher(TwistStamped, "/nermo/cmd_vel", qos.COMMAND)
    walk = TwistStamped()
    walk.twist.linear.x = 0.04

    def shown() -> bool:
        program.publish(walk)
        return page.locator("#commanded").inner_text() == "4.0"

    graph.until(shown, "the page says what it is told on cmd_vel")
    graph.until(lambda: page.locator("#commanded").inner_text() == "0.0", "nothing is said any more")


def test_the_mouse_stops_when_the_hand_the_page_or_the_browser_goes(graph: Graph, browser: Browser) -> None:
    page = open_page(graph, browser, scene=False)
    hand_on_stick(page)
    graph.until(lambda: (graph.told or 0.0) > 0.0, "the mouse is told to walk")
    page.mouse.up()
    graph.until(lambda: graph.told == 0.0, "the hand has let go")

    hand_on_stick(page)
    graph.until(lambda: graph.told > 0.0, "it walks again")
    stalled = len(graph.commands)
    page.evaluate("{ const end = performance.now() + 2000; while (performance.now() < end) {} }")
    graph.until(lambda: any(c.forward_velocity == 0.0 for c in graph.commands[stalled:]), "the page has stalled")
    graph.until(lambda: graph.told > 0.0, "it is back, and the hand still there")

    page.close()
    graph.until(lambda: graph.told == 0.0, "the page is closed")
    page = open_page(graph, browser, scene=False)
    hand_on_stick(page)
    graph.until(lambda: graph.told > 0.0, "it walks a third time")
    browser.close()
    graph.until(lambda: graph.told == 0.0, "the browser is gone")


def test_one_drives_and_the_other_is_told(graph: Graph, browser: Browser) -> None:
    first, second = (open_page(graph, browser, scene=False) for _ in range(2))
    hand_on_stick(first)
    graph.until(lambda: (graph.told or 0.0) > 0.0, "the first drives")
    hand_on_stick(second)
    graph.until(lambda: second.locator("#said").is_visible(), "the second is told something")
    assert re.fullmatch(r"viewer \d+ drives: wait until .*", second.locator("#said").inner_text())
    graph.until(lambda: "You drive" in first.locator("#driver").inner_text(), "the first still drives")
    graph.until(lambda: "drives." in second.locator("#driver").inner_text(), "the second sees that")
    first.mouse.up()
    graph.until(lambda: graph.told == 0.0, "the first has let go, and the refused press does not take over")
    graph.until(lambda: "Press the stick" in second.locator("#driver").inner_text(), "nobody drives")
    second.mouse.up()
    hand_on_stick(second)
    graph.until(lambda: graph.told > 0.0, "the second drives")


def test_a_stop_reaches_the_twin_and_only_a_release_ends_it(graph: Graph, browser: Browser) -> None:
    page = open_page(graph, browser, scene=False)
    hand_on_stick(page)
    graph.until(lambda: (graph.told or 0.0) > 0.0, "the mouse is told to walk")
    other = open_page(graph, browser, scene=False)
    other.locator("#stop").click()
    graph.until(lambda: graph.stops[-1:] == [True], "the stop is said")
    graph.until(lambda: graph.twin.startswith("limp: emergency_stop (/nermo/web says stop"), "the twin is limp")
    graph.until(lambda: page.locator("#stopped").is_visible(), "whoever drives sees it")
    graph.until(lambda: graph.commands[-1].posture == ControlCommand.POSTURE_STOP, "nothing is commanded any more")
    page.mouse.up()
    hand_on_stick(page)
    graph.until(lambda: "emergency stop" in page.locator("#said").inner_text(), "the stick is refused")
    page.mouse.up()
    page.close()
    other.close()

    page = open_page(graph, browser, scene=False)
    graph.until(lambda: page.locator("#release").is_visible(), "it is still stopped")
    page.locator("#release").click()
    said = len(graph.stops)
    graph.until(lambda: len(graph.stops) > said + 2, "the page has repeated what it says")
    assert graph.stops[-1] is True, "a tap is no release"
    page.locator("#release").click(delay=1500)
    graph.until(lambda: graph.stops[-1] is False, "the stop is taken back")
    graph.until(lambda: graph.twin.startswith("following commands"), "the servos have power")
    graph.until(lambda: page.locator("#stopped").is_hidden(), "the page says so")


def test_a_stop_that_is_pressed_while_the_line_is_down_arrives_later(graph: Graph, browser: Browser) -> None:
    page = open_page(graph, browser, scene=False)
    hand_on_stick(page)
    graph.until(lambda: (graph.told or 0.0) > 0.0, "the mouse is told to walk")
    page.evaluate("line.close()")
    graph.until(lambda: graph.told == 0.0, "the line is down, and the mouse stops")
    page.evaluate("line.close(); document.getElementById('stop').dispatchEvent(new PointerEvent('pointerdown'))")
    graph.until(lambda: graph.stops[-1:] == [True], "the stop is said by the next line")
    graph.until(lambda: graph.twin.startswith("limp: emergency_stop (/nermo/web says stop"), "the twin is limp")


def test_the_page_begins_and_ends_a_recording(graph: Graph, browser: Browser, tmp_path: Path) -> None:
    page = open_page(graph, browser, scene=False)
    button = page.locator("#record")
    graph.until(button.is_enabled, "the page knows of a recorder")
    assert button.inner_text() == "Record" and not (tmp_path / "recordings").exists()
    button.click()
    # The first topic that the recorder hears is not all of them.
    graph.until(lambda: re.match(r"\d{4,} ", page.locator("#recorded").inner_text()) is not None, "it is recorded")
    assert button.inner_text() == "End recording"
    button.click()
    graph.until(lambda: button.inner_text() == "Record", "the recording has ended")
    (folder,) = (tmp_path / "recordings").iterdir()
    assert Recording(folder).topics["/nermo/servo_command"].message_count > 0


def test_sliders_set_parameters_and_a_refusal_is_said(graph: Graph, browser: Browser) -> None:
    page = open_page(graph, browser, scene=False)
    name = "front.swing_amplitude"
    slider = page.locator(f'[data-slider="gait_knowledge_base/{name}"]')
    graph.until(lambda: slider.count() == 1, "the parameters are there")
    client = AsyncParameterClient(graph.bench.node, "/nermo/gait_knowledge_base")

    def value() -> float:
        answer = client.get_parameters([name])
        graph.until(answer.done, "the knowledge-base answers")
        return answer.result().values[0].double_value

    page.locator("#filter").fill("front.swing")
    slider.fill("0.012")
    graph.until(lambda: value() == pytest.approx(0.012), "the slider has set it")
    entry = page.locator(f'[data-parameter="gait_knowledge_base/{name}"]')
    entry.fill("1000")
    entry.press("Enter")
    graph.until(lambda: "1000" in page.locator("#said").inner_text(), "the refusal is said")
    assert name in page.locator("#said").inner_text()
    graph.until(lambda: entry.input_value() == "0.012", "what holds is shown again")
    assert value() == pytest.approx(0.012)

    page.locator("#gait").select_option("lateral_walk")
    page.locator("#spine input").first.check()
    hand_on_stick(page)
    graph.until(
        lambda: any(c.gait == "lateral_walk" and c.spine_modes.turning for c in graph.commands[-1:]),
        "commands name the gait and the spine function",
    )


def test_pictures_of_cameras_are_shown_while_they_come(graph: Graph, browser: Browser) -> None:
    page = open_page(graph, browser, scene=False)
    assert page.locator("#cameras figure").count() == 0
    node, at = graph.bench.node, {"red": 220}
    raw = node.create_publisher(Image, "/nermo/camera", qos.SENSOR)
    small = node.create_publisher(CompressedImage, "/top/compressed", qos.SENSOR)
    broken = node.create_publisher(CompressedImage, "/broken/compressed", qos.SENSOR)

    def film() -> None:
        row = bytes((at["red"], 30, 40)) * 64
        raw.publish(Image(encoding="rgb8", width=64, height=48, step=192, data=row * 48))
        picture = imageio.imwrite("<bytes>", np.full((24, 32, 3), 90, np.uint8), extension=".png")
        small.publish(CompressedImage(format="png", data=picture))
        broken.publish(CompressedImage(format="png", data=b"<svg/>"))

    def sizes() -> list[int]:
        return page.locator("#cameras img").evaluate_all("images => images.map(one => one.naturalWidth)")

    def red() -> int:
        """Of the raw picture's first pixel."""
        look = """image => { const pen = document.createElement("canvas").getContext("2d");
          pen.drawImage(image, 0, 0); return pen.getImageData(5, 5, 1, 1).data[0]; }"""
        return int(page.locator("#cameras img").first.evaluate(look))

    timer = node.create_timer(0.1, film)
    graph.until(lambda: sizes() == [64, 32], "both are shown, and what is no picture is not")
    assert page.locator("#cameras figcaption").all_inner_texts() == ["/nermo/camera", "/top/compressed"]
    graph.until(lambda: abs(red() - 220) < 12, "in its colours")
    at["red"] = 60
    graph.until(lambda: abs(red() - 60) < 12, "and they move")
    node.destroy_timer(timer)
    graph.until(lambda: page.locator("#cameras figure").count() == 0, "a camera that says nothing more goes")


WEAK = """name: weak
base: nermo_lite
deviations:
- {effect: servo_gain, sites: [front_right_hip, front_right_knee], values: {factor: 0.15}}
"""
"""The leg that is nearest in the picture."""


def tinted(page: Page) -> tuple[float, float]:
    """Shares of the scene's pixels that are clearly green, and clearly red: a mouse by itself is neither."""
    red, green, blue = np.moveaxis(picture(page), -1, 0)
    greener, redder = green - np.maximum(red, blue), red - np.maximum(green, blue)
    return float(np.mean(greener > GREEN)), float(np.mean(redder > RED))


def test_the_twin_is_a_ghost_whose_colour_follows_the_gap(graph: Graph, browser: Browser, tmp_path: Path) -> None:
    page = open_page(graph, browser)
    scene = page.frame_locator("#scene")
    graph.until(lambda: scene.locator("canvas").count() > 0, "the scene is there")
    graph.until(lambda: len(np.unique(picture(page).reshape(-1, 3), axis=0)) > 500, "the scene shows a mouse")
    nothing, arrows = tinted(page)
    assert nothing < SOME, "nothing is green where there is no ghost"

    # Its twin is the same mouse, and stands as it does.
    namespace = ("-r", "__ns:=/nermo")
    monitor = graph.bench.start("nermo_gap.nodes.gap_monitor", *namespace)
    graph.until(lambda: bool(graph.gaps) and max(graph.gaps.values()) < SAME, "robot and twin agree")
    graph.until(lambda: tinted(page)[0] > 5.0 * SOME, "a green ghost appears")
    assert tinted(page)[1] < arrows + SOME, "and nothing of it is red"
    graph.bench.stop(monitor)
    graph.until(lambda: tinted(page)[0] < SOME, "where there is no twin any more, there is no ghost")

    # This twin has a weak leg, which gives way: of that leg the two differ.
    (tmp_path / "weak.yaml").write_text(WEAK, encoding="utf-8")
    graph.gaps = {}
    graph.bench.start("nermo_gap.nodes.gap_monitor", *namespace, "-p", f"robot:={tmp_path / 'weak.yaml'}")
    graph.until(lambda: graph.gaps.get("front_right_leg", 0.0) > FAR, "the monitor says so")
    graph.until(lambda: tinted(page)[1] > arrows + SOME, "the leg is drawn red")
