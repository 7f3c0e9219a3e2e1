"""A diagnosis watched in the browser: what is told, who may read it, and a real browser before a real diagnosis."""

from __future__ import annotations

import http.client
import json
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from robots import MAPS, MODELS, as_from_a_terminal, plant_of, simulate
from typer.testing import CliRunner
from yaml import safe_dump

from simgap.analysis.diagnose import diagnose
from simgap.analysis.experiment import Experiment
from simgap.analysis.options import Options
from simgap.analysis.stages import Checked, Decided, Leading, Located, Staged
from simgap.cli import app
from simgap.data.errors import GapInputError
from simgap.data.plant import Plant
from simgap.data.recording import recording_from_table
from simgap.live.player import Hand, Played, Tell
from simgap.live.server import PageServer
from simgap.live.story import STEPS, Story

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
PATIENCE_S = 240.0
WIDE, NARROW = {"width": 1200, "height": 900}, {"width": 390, "height": 844}


# What is told


@given(st.lists(st.tuples(st.sampled_from(["align", "screen", "fit", "new stage"]), st.floats(0.0, 1.0))), st.data())
def test_a_reader_that_was_cut_off_goes_on_where_it_was(told: list[tuple[str, float]], data: st.DataObject) -> None:
    story = Story()
    for stage, share in told:
        story.progress(stage, share)
    story.tell("finished", {"gap": float("nan")}, last=True)
    story.tell("failed", {})
    whole, ended = story.since(0, 0.0)
    assert ended and json.loads(whole[-1])["gap"] is None
    events = [json.loads(text) for text in whole]
    assert [e["kind"] for e in events] == ["progress"] * (len(events) - 1) + ["finished"]
    assert all(e["step"] in STEPS for e in events[:-1])
    at = data.draw(st.integers(0, len(whole)))
    assert story.since(at, 0.0) == (whole[at:], True)


def test_a_stage_that_nobody_has_listed_belongs_to_the_step_that_it_comes_in() -> None:
    story = Story()
    for stage in ("align", "reference: fit", "screen", "a new one", "decision", "long windows"):
        story.progress(stage, 0.0)
    steps = [json.loads(text)["step"] for text in story.since(0, 0.0)[0]]
    assert steps == ["checks", "checks", "screen", "screen", "decision", "decision"]


def test_what_is_known_is_told_in_order_and_changes_nothing() -> None:
    plant = plant_of("pendulum")

    def rubs(model: Any) -> None:
        model.dof_damping[0] += 0.3

    recording = recording_from_table(simulate("pendulum", seconds=6.0, change=rubs), plant)
    only, told = ("viscous_friction", "servo_gain"), list[Staged]()
    options = Options(only=only, baselines=False, threads=1)
    unseen = diagnose([recording], plant, options).report
    report = diagnose([recording], plant, replace(options, staged=told.append)).report
    assert report["effects"] == unseen["effects"] and report["gap"] == unseen["gap"]

    checked, located, *leading, decided = told
    assert isinstance(checked, Checked) and checked.channels == tuple(o.name for o in plant.outputs)
    assert isinstance(located, Located) and sum(located.shares.values()) == pytest.approx(1.0)
    assert leading and all(isinstance(one, Leading) for one in leading)
    assert leading[0].causes == () and leading[0].leaders == ()
    first = next(one for one in leading if one.promising)
    assert not first.leaders, "the first look comes before any fit"
    assert isinstance(decided, Decided) and decided.verdict == report["verdict"]
    assert [c.effect for c in leading[-1].causes] == [e["name"] for e in decided.effects] == ["viscous_friction"]
    assert leading[-1].after < leading[0].after and leading[-1].leaders[0].gain > 0.0


# Who may read it


@pytest.fixture
def story() -> Story:
    return Story()


def served(story: Story, host: str = "127.0.0.1") -> PageServer:
    return PageServer(story, "<!doctype html>page", host, 0)


def asked(server: PageServer, path: str, **headers: str) -> tuple[int, str, http.client.HTTPMessage]:
    line = http.client.HTTPConnection("127.0.0.1", server.port, timeout=10.0)
    line.request("GET", path, headers=headers)
    answer = line.getresponse()
    body = answer.read().decode()
    line.close()
    return answer.status, body, answer.headers


def test_the_page_and_its_files_are_served_and_nothing_else(story: Story) -> None:
    server = served(story)
    try:
        assert asked(server, "/")[:2] == (200, "<!doctype html>page")
        assert "EventSource" in asked(server, "/live.js")[1]
        assert asked(server, "/live.css")[2]["Content-Type"].startswith("text/css")
        for path in ("/report.html", "/../server.py", "/%2e%2e/server.py", "/page/live.js", "/index.html", "/nothing"):
            assert asked(server, path)[0] == 404, path
        assert "script-src 'self'" in asked(server, "/")[2]["Content-Security-Policy"]
    finally:
        server.close(0.0)


def test_events_come_as_they_are_told_and_a_browser_that_comes_back_goes_on(story: Story) -> None:
    server = served(story)
    try:
        story.progress("align", 0.0)
        line = http.client.HTTPConnection("127.0.0.1", server.port, timeout=10.0)
        line.request("GET", "/events")
        answer = line.getresponse()
        assert answer.readline() == b"id: 0\n"
        assert json.loads(answer.readline().removeprefix(b"data: "))["stage"] == "align"
        story.tell("finished", {}, last=True)
        assert [answer.readline() for _ in range(2)] == [b"\n", b"id: 1\n"]
        # It holds the line until it has all that it needs: so long the command waits.
        assert json.loads(answer.readline().removeprefix(b"data: "))["kind"] == "finished"
        answer.close()
        line.close()
        again = http.client.HTTPConnection("127.0.0.1", server.port, timeout=10.0)
        again.request("GET", "/events", headers={"Last-Event-ID": "0"})
        assert again.getresponse().readline() == b"id: 1\n"
        again.close()
    finally:
        server.close(PATIENCE_S)


def test_pages_from_elsewhere_are_refused(story: Story) -> None:
    server = served(story)
    try:
        assert asked(server, "/events", Host="mouse.example")[0] == 403
        assert asked(server, "/", Host="[broken")[0] == 403
        assert asked(server, "/", Host=f"localhost:{server.port}")[0] == 200
    finally:
        server.close(0.0)


def test_open_to_others_it_asks_for_the_token(story: Story) -> None:
    server = served(story, "0.0.0.0")
    try:
        assert server.address.endswith(f"/?token={server.token}")
        for path in ("/", "/events", "/?token=", "/?token=wrong"):
            assert asked(server, path)[0] == 403, path
        status, _, headers = asked(server, f"/?token={server.token}")
        assert status == 200 and "HttpOnly" in headers["Set-Cookie"]
        cookie = headers["Set-Cookie"].split(";")[0]
        assert asked(server, "/live.js", Cookie=cookie)[0] == 200
        assert asked(server, "/live.js", Cookie=cookie[:-1])[0] == 403
    finally:
        server.close(0.0)


class Button:
    """A player that only notes what hands do."""

    robot, prepare = "nothing", ""

    def __init__(self) -> None:
        self.here: set[int] = set()
        self.hands: list[Hand] = []

    def join(self, viewer: int) -> None:
        self.here.add(viewer)

    def leave(self, viewer: int) -> None:
        self.here.discard(viewer)

    def hold(self, hand: Hand) -> str:
        self.hands.append(hand)
        return "" if hand.viewer in self.here else "who is that?"

    def held(self) -> bool:
        return False

    def play(self, experiment: Experiment, plant: Plant, tell: Tell) -> Played:
        raise NotImplementedError


def said(server: PageServer, body: str, **headers: str) -> tuple[int, str]:
    """The answer to what a browser says of its hand."""
    line = http.client.HTTPConnection("127.0.0.1", server.port, timeout=10.0)
    ours = {"Origin": f"http://127.0.0.1:{server.port}", "Content-Type": "application/json"}
    line.request("POST", "/hand", body, {**ours, **{k.replace("_", "-"): v for k, v in headers.items()}})
    answer = line.getresponse()
    text = answer.read().decode()
    line.close()
    return answer.status, text


HAND = '{"viewer": 1, "press": 2, "sent": 3.5}'


def test_a_hand_is_taken_from_the_page_itself_and_from_nobody_else(story: Story) -> None:
    button = Button()
    server = PageServer(story, "", "127.0.0.1", 0, button)
    try:
        line = http.client.HTTPConnection("127.0.0.1", server.port, timeout=10.0)
        line.request("GET", "/events")
        answer = line.getresponse()
        assert [answer.readline() for _ in range(3)] == [b"event: you\n", b"data: 1\n", b"\n"]
        assert said(server, HAND) == (200, "") and button.hands == [Hand(viewer=1, press=2, sent=3.5)]
        assert said(server, HAND.replace("1", "7", 1)) == (200, "who is that?")
        for elsewhere in ("http://mouse.example", f"http://localhost:{server.port}", "null", ""):
            status, why = said(server, HAND, Origin=elsewhere)
            assert status == 403 and "elsewhere" in why
        # What a form of another page may send without being asked.
        assert said(server, HAND, Content_Type="text/plain")[0] == 400
        assert said(server, HAND, Host="mouse.example", Origin="http://mouse.example")[0] == 403
        answer.close()
        line.close()
        until(lambda: not button.here, "whoever closes the page is gone")
        assert len(button.hands) == 2
    finally:
        server.close(0.0)


@pytest.mark.parametrize(
    ("body", "why"),
    [
        ("", "hand: Invalid JSON"),
        ("[1]", "hand: Input should be an object"),
        (HAND.replace("2", "-2"), "press: "),
        (HAND.replace("2", "true"), "press: "),
        (HAND.replace("3.5", "NaN"), "sent: "),
        (HAND.replace("1", '"1"', 1), "viewer: "),
        (HAND.replace("}", ', "more": 1}'), "more: "),
        (HAND + " " * 200, "at most 200 bytes"),
    ],
)
def test_what_is_no_hand_is_refused_in_words(story: Story, body: str, why: str) -> None:
    button = Button()
    server = PageServer(story, "", "127.0.0.1", 0, button)
    try:
        status, text = said(server, body)
        assert status == 400 and why in text and button.hands == []
    finally:
        server.close(0.0)


def test_a_hand_needs_the_token_and_without_a_player_there_is_no_button(story: Story) -> None:
    open_, none = PageServer(story, "", "0.0.0.0", 0, Button()), served(story)
    try:
        assert said(open_, HAND)[0] == 403
        assert said(open_, HAND, Cookie=f"simgap_{open_.port}={open_.token}")[0] == 200
        assert said(none, HAND)[0] == 404
    finally:
        open_.close(0.0)
        none.close(0.0)


def test_a_port_that_is_taken_is_said(story: Story) -> None:
    server = served(story)
    try:
        with pytest.raises(GapInputError, match=rf"--web: the page cannot be on 127.0.0.1:{server.port}: .*--web-port"):
            PageServer(Story(), "", "127.0.0.1", server.port)
    finally:
        server.close(0.0)


def test_each_has_no_page() -> None:
    answer = CliRunner().invoke(app, ["diagnose", "a.csv", "--model", "m", "--map", "m", "--each", "--web"])
    assert answer.exit_code == 2 and "--each" in answer.stderr


# A real browser before a real diagnosis

browsed = pytest.mark.skipif(not any(map(shutil.which, BROWSERS)), reason="no Chromium or Chrome")


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the log of an arm whose elbow rubs, its model and its map."""
    folder = tmp_path_factory.mktemp("arm")

    def rubs(model: Any) -> None:
        model.dof_damping[1] += 0.25

    table = simulate("arm", seconds=8.0, change=rubs)
    columns = np.stack(list(table.values()), 1)
    np.savetxt(folder / "log.csv", columns, delimiter=",", header=",".join(table), comments="")
    (folder / "arm.xml").write_text(MODELS["arm"])
    (folder / "map.yaml").write_text(safe_dump(MAPS["arm"]))
    return folder


class Diagnosis:
    """The command, as it is typed."""

    def __init__(self, arm: Path, out: Path, *words: str) -> None:
        self.told, self.out = out / "told.txt", out
        inputs = [str(arm / "log.csv"), "--model", str(arm / "arm.xml"), "--map", str(arm / "map.yaml")]
        effects = [w for name in ("viscous_friction", "servo_gain", "sensor_bias") for w in ("--only", name)]
        with self.told.open("wb") as file:
            self.process = subprocess.Popen(
                [
                    *(sys.executable, "-m", "simgap", "diagnose", *inputs, *effects, "--no-baselines", *words),
                    *("--out", str(out), "--web", "--web-port", "0"),
                ],
                stdout=file,
                stderr=subprocess.STDOUT,
                preexec_fn=as_from_a_terminal,
            )
        until(lambda: re.search(r"watch it at (http://127\.0\.0\.1:\d+/)", self.text) is not None, "the address")
        self.address = re.findall(r"http://127\.0\.0\.1:\d+/", self.text)[0]

    @property
    def text(self) -> str:
        return self.told.read_text(errors="replace")

    def ends(self) -> int:
        try:
            return self.process.wait(PATIENCE_S)
        finally:
            self.process.kill()


def until(condition: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline, f"waited in vain for {what}"
        time.sleep(0.05)


@pytest.fixture
def browser() -> Iterator[Any]:
    sync = pytest.importorskip("playwright.sync_api")
    path = next(found for name in BROWSERS if (found := shutil.which(name)))
    with sync.sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=path, args=["--no-sandbox", "--disable-gpu"])
        yield opened
        opened.close()


WATCH = """window.seen = []; document.addEventListener("DOMContentLoaded", () => new MutationObserver(() => {
  const now = document.querySelector("#steps .now");
  if (now && window.seen.at(-1) !== now.dataset.step) window.seen.push(now.dataset.step);
  const known = !document.getElementById("leading").hidden;
  if (known && !window.seen.includes("something known")) window.seen.push("something known");
}).observe(document.body, { subtree: true, attributes: true, childList: true }));"""


def opened(browser: Any, address: str, size: dict[str, int]) -> tuple[Any, list[str]]:
    """The page in a window of its own, and what goes wrong in it."""
    page = browser.new_context(viewport=size).new_page()
    page.set_default_timeout(1e3 * PATIENCE_S)
    errors: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.on("console", lambda said: errors.append(said.text) if said.type == "error" else None)
    page.add_init_script(WATCH)
    page.goto(address)
    return page, errors


def sticks_out(page: Any) -> float:
    """[px] by which the page is wider than its window."""
    return float(page.evaluate("document.documentElement.scrollWidth - innerWidth"))


def span(page: Any) -> float:
    """[s] that the plot shows."""
    low, high = map(float, page.locator("#plot").get_attribute("data-span").split())
    return high - low


@browsed
@pytest.mark.slow
def test_the_page_follows_a_diagnosis_to_its_end_and_keeps_all_of_it(browser: Any, arm: Path, tmp_path: Path) -> None:
    diagnosis = Diagnosis(arm, tmp_path)
    page, errors = opened(browser, diagnosis.address, WIDE)
    narrow, narrow_errors = opened(browser, diagnosis.address, NARROW)
    page.locator("#shares div").first.wait_for()
    assert page.locator("#verdict").is_hidden() and page.locator("#far").is_hidden()
    page.locator("#report").wait_for()
    narrow.locator("#report").wait_for()
    assert diagnosis.ends() == 0, diagnosis.text
    report = json.loads((tmp_path / "diagnosis.json").read_text())

    # From here on nobody serves the page any more.
    seen = page.evaluate("window.seen")
    known = seen.index("something known")
    assert [s for s in seen if s in STEPS][:3] == ["checks", "where", "screen"]
    assert {"leaders", "decision", "free runs"} <= set(seen) and known < seen.index("decision")
    assert page.locator("#verdict").inner_text() == report["verdict"].replace("_", " ")
    assert "viscous friction at elbow" in page.locator("#causes").inner_text()
    assert page.locator("#after").inner_text() == f"{report['gap']['after']:.1f}"
    for step in report["waterfall"][2:-1]:
        assert step["step"].split("@")[0].replace("_", " ") in page.locator("#waterfall svg").inner_html()
    assert page.locator("#waterfall svg").bounding_box()["height"] > 100.0
    assert page.locator("#steps .now").count() == 0 and page.locator("#lost").is_hidden()

    whole = span(page)
    canvas = page.locator("#plot")
    canvas.scroll_into_view_if_needed()
    box = canvas.bounding_box()
    page.mouse.move(box["x"] + 0.4 * box["width"], box["y"] + 100.0)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.6 * box["width"], box["y"] + 120.0)
    page.mouse.up()
    dragged = span(page)
    assert 0.1 * whole < dragged < 0.35 * whole
    page.mouse.wheel(0, -300)
    until(lambda: span(page) < 0.9 * dragged, "the wheel comes nearer")
    page.locator("#whole").click()
    assert span(page) == whole
    curve = canvas.evaluate("canvas => canvas.toDataURL()")
    page.locator("#channel").select_option(index=1)
    assert canvas.evaluate("canvas => canvas.toDataURL()") != curve

    for one in (page, narrow):
        assert sticks_out(one) <= 0.0
        with one.expect_popup() as popup:
            one.locator("#report").click()
        popup.value.locator("h1").wait_for()
        assert popup.value.locator("svg").count() >= 6
    assert errors == [] and narrow_errors == []


@browsed
@pytest.mark.slow
def test_nothing_is_lost_when_the_browser_closes(browser: Any, arm: Path, tmp_path: Path) -> None:
    diagnosis = Diagnosis(arm, tmp_path, "--budget", "5")
    page, _ = opened(browser, diagnosis.address, WIDE)
    page.locator("#shares div").first.wait_for()
    browser.close()
    assert diagnosis.ends() == 0, diagnosis.text
    assert (tmp_path / "report.html").is_file()
    assert json.loads((tmp_path / "diagnosis.json").read_text())["verdict"]


@browsed
@pytest.mark.slow
def test_an_end_by_a_second_ctrl_c_is_told(browser: Any, arm: Path, tmp_path: Path) -> None:
    diagnosis = Diagnosis(arm, tmp_path)
    page, _ = opened(browser, diagnosis.address, WIDE)
    page.locator("#shares div").first.wait_for()
    diagnosis.process.send_signal(signal.SIGINT)
    until(lambda: "Ctrl-C again" in diagnosis.text, "an answer to the first one")
    diagnosis.process.send_signal(signal.SIGINT)
    page.locator("#failure").wait_for()
    assert page.locator("#failure").inner_text() == "It was interrupted."
    assert diagnosis.ends() != 0 and "Traceback" not in diagnosis.text
    assert page.locator("#shares div").count() > 0, "what was known stays"


@browsed
@pytest.mark.slow
def test_a_first_ctrl_c_ends_with_an_answer_that_says_so(browser: Any, arm: Path, tmp_path: Path) -> None:
    diagnosis = Diagnosis(arm, tmp_path)
    page, _ = opened(browser, diagnosis.address, WIDE)
    page.locator("#shares div").first.wait_for()
    diagnosis.process.send_signal(signal.SIGINT)
    page.get_by_text("Ended by hand: ").first.wait_for()
    assert page.locator("#failure").is_hidden()
    assert diagnosis.ends() == 0 and (tmp_path / "diagnosis.json").exists()


@browsed
def test_a_page_without_an_answer_says_why(browser: Any, tmp_path: Path) -> None:
    from simgap.live.watch import Live

    live = Live("127.0.0.1", 0)
    page, _ = opened(browser, live.address, NARROW)
    live.beside(lambda stage, share: None)("align", 0.0)
    page.locator("#steps .now").wait_for()
    sentence = f"/home/{'long_path/' * 9}log.csv: column 'q9' is not there"
    live.failed(sentence)
    page.locator("#failure").wait_for()
    assert page.locator("#failure").inner_text() == sentence
    live.close()
    assert sticks_out(page) <= 0.0
