"""The report: one page that needs nothing beside it, says the verdict in plain words, and shows in a browser."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import mujoco
import numpy as np
import pytest
from robots import plant_of, simulate

from simgap.analysis.diagnose import Diagnosis, diagnose
from simgap.analysis.options import Options
from simgap.data.errors import GapInputError
from simgap.data.recording import recording_from_table
from simgap.report.drawing import draw_robot
from simgap.report.evidence import Evidence, gather
from simgap.report.glossary import GLOSSARY
from simgap.report.html import page, write_page
from simgap.report.progress import free_table
from simgap.report.runs import runs
from simgap.report.sentences import TITLES, amount, free, how_far, sentences, title, what, where
from simgap.report.style import BEFORE

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")


@pytest.fixture(scope="module")
def found() -> Diagnosis:
    plant = plant_of("arm")

    def softer(model: mujoco.MjModel) -> None:
        model.dof_damping[1] += 0.25

    table = simulate("arm", seconds=8.0, change=softer)
    only = ("viscous_friction", "servo_gain", "sensor_bias")
    return diagnose([recording_from_table(table, plant)], plant, Options(only=only, baselines=False, threads=1))


@pytest.fixture(scope="module")
def evidence(found: Diagnosis) -> Evidence:
    return gather(found)


@pytest.fixture(scope="module")
def html(found: Diagnosis, evidence: Evidence) -> str:
    return page(found.report, evidence)


def test_the_page_needs_nothing_beside_it(html: str) -> None:
    for tag in re.findall(r"<(?:script|link|img|iframe|object)\b[^>]*>", html):
        raise AssertionError(tag)
    addresses = set(re.findall(r"(?:href|src)=\"([^\"]*)\"", html))
    assert all(a.startswith("#") for a in addresses)
    assert "@import" not in html and "url(http" not in html
    assert html.count("<svg") >= 6


def test_the_page_says_what_was_found(html: str, found: Diagnosis) -> None:
    for sentence in sentences(found.report):
        assert sentence.split(",")[0].replace("'", "&#39;") in html
    assert "viscous friction" in html and "elbow" in html
    assert "In degrees" in html and "Noise floors" in html
    assert "Running free" in html and "Numbers of the model that moved" in html
    for word, _ in GLOSSARY:
        assert f"<dt>{word}</dt>" in html


def test_the_curves_are_of_held_out_windows_and_get_closer(found: Diagnosis, evidence: Evidence) -> None:
    folds = found.selector.fitter.windows.fold
    before, after = [], []
    for curves in evidence.curves.values():
        for curve in curves:
            assert folds[curve.window] >= 0
            before.append(np.sqrt(np.nanmean((curve.nominal - curve.measured) ** 2)))
            after.append(np.sqrt(np.nanmean((curve.after - curve.measured) ** 2)))
    assert np.mean(after) < 0.3 * np.mean(before)


def test_the_cause_is_shown_where_it_acts(found: Diagnosis, evidence: Evidence) -> None:
    (effect,) = found.report["effects"]
    shown = {evidence.model.body(b).name for b in evidence.causes}
    joints = range(evidence.model.njnt) if effect["site"] == "all" else [evidence.model.joint(effect["site"]).id]
    assert shown == {evidence.model.body(int(evidence.model.jnt_bodyid[j])).name for j in joints}


def test_the_ranking_has_intervals_and_marks_the_winner(evidence: Evidence) -> None:
    assert sum(r.chosen for r in evidence.ranking) == 1
    assert all(r.low <= r.high for r in evidence.ranking)
    assert evidence.ranking[0].low > 0


def test_every_verdict_has_its_sentences(found: Diagnosis) -> None:
    report = found.report
    for verdict, words in (
        ("no_gap", "No known effect"),
        ("calibration", "numbers of the model are a little off"),
        ("unknown", "What explains most is viscous friction at elbow"),
        ("unknown", "It is not settled: it moves."),
        ("partial", "Most of it is caused by viscous friction at elbow"),
        ("effect", "caused by"),
    ):
        assert words in what(report | {"verdict": verdict, "reasons": ["it moves"]})
    nothing = report | {"verdict": "unknown", "reasons": ["it moves", "it rests"], "effects": []}
    assert what(nothing) == "The cause is not settled: it moves; it rests."
    alike = report | {"verdict": "ambiguous", "equivalent": [["mass@upper", "inertia@fore + armature@elbow"]]}
    assert "inertia at fore, armature at elbow" in what(alike)
    gap = report["gap"]
    assert "grows by 20 %" in how_far(report | {"gap": gap | {"shrink": -0.2}})
    assert "1 is as good" in how_far(report)
    assert "every channel" in where(report | {"gap": gap | {"before": 1.1}})


def test_no_title_throws_a_right_diagnosis_away(found: Diagnosis) -> None:
    report = found.report | {"remainder": found.report["remainder"] | {"share": 0.15}}
    titles = {v: title(report | {"verdict": v}) for v in TITLES}
    assert len(set(titles.values())) == len(titles) == 6
    assert titles["partial"] == "Viscous friction at elbow explains most of it, 15 % stays unexplained"
    assert titles["unknown"] == "Not settled: viscous friction at elbow explains it best"
    little = report | {"verdict": "unknown", "remainder": report["remainder"] | {"share": 0.8}}
    assert title(little) == title(little | {"effects": []}) == "No cause explains a good share of it"


def test_a_number_at_its_limit_is_told_whatever_the_verdict(found: Diagnosis) -> None:
    row = {"name": "com x", "site": "torso", "nominal": 0.0, "value": 0.012, "unit": "m", "at_limit": True}
    for verdict in TITLES:
        told = sentences(found.report | {"verdict": verdict, "calibration": [row]})
        assert any("com x of torso 0.012 m instead of 0" in s and "limit" in s for s in told)
    assert not any("limit" in s for s in sentences(found.report | {"calibration": [row | {"at_limit": False}]}))


def test_free_runs_are_told_in_the_channels_unit(found: Diagnosis) -> None:
    report = found.report
    assert amount(0.0123, "rad") == "12.3 mrad" and amount(0.0004, "m") == "0.4 mm" and amount(2.0, "1") == "2"
    assert amount(None, "rad") == amount(float("nan"), "m") == "broke down"
    table = free_table(report)
    before, after = report["waterfall"][0]["free_running"], report["waterfall"][-1]["free_running"]
    for name, (values, unit) in table["channels"].items():
        assert unit == "rad" and values[0] == pytest.approx(before[name]) and values[2] == pytest.approx(after[name])
    name = report["where"][0]["channel"]
    assert f"falls from {amount(before[name], 'rad')} to {amount(after[name], 'rad')}" in free(report)
    lost = [*report["waterfall"][:-1], report["waterfall"][-1] | {"free_running": dict.fromkeys(after, float("nan"))}]
    assert "breaks down" in free(report | {"waterfall": lost})


SHAPES = """<mujoco><worldbody><geom type="plane" size="1 1 1"/><body name="a"><freejoint/>
<geom type="box" size=".1 .1 .1"/><geom type="sphere" size=".1" pos=".3 0 0"/><geom type="ellipsoid" size=".1 .05 .02"/>
<geom type="cylinder" size=".02 .1" pos="0 .3 0"/><geom type="capsule" size=".02 .1" pos="0 -.3 0"/>
<geom type="mesh" mesh="m"/></body></worldbody>
<asset><mesh name="m" vertex="0 0 0 .1 0 0 0 .1 0 0 0 .1"/></asset></mujoco>"""


def test_what_is_sure_is_told_apart_from_what_is_open(found: Diagnosis) -> None:
    value = {"value": 0.2, "unit": "N m", "ci90": [0.1, 0.3]}
    effects = [
        {"name": "coulomb_friction", "site": "all", "parameters": {"friction": value}},
        {"name": "armature", "site": "elbow", "parameters": {"inertia": value}},
    ]
    report = found.report | {"verdict": "ambiguous", "effects": effects}
    report |= {"equivalent": [["armature@elbow", "armature@all"], ["coulomb_friction@all", "dry@all"]]}
    assert title(report) == "Coulomb friction everywhere, and a further cause that is not settled"
    assert what(report).startswith("It is caused by coulomb friction everywhere (friction 0.2 N m")
    assert what(report).endswith("which this recording cannot tell apart from armature everywhere.")
    unsure = report | {"equivalent": [["armature@elbow"]]}
    assert what(unsure).endswith(" may act: this recording cannot tell whether it does.")
    whole = report | {"equivalent": [["armature@elbow + coulomb_friction@all", "viscous_friction@all"]]}
    assert title(whole) == "Several causes explain it equally well"
    assert what(whole).startswith("It looks like coulomb friction everywhere")


def polygons(picture: str) -> list[tuple[np.ndarray, str, str]]:
    """Corners (n, 2), fill and outline of every polygon of a picture."""
    found = re.findall(r'<polygon points="([^"]*)" fill="([^"]*)" stroke="([^"]*)"', picture)
    return [(np.array([p.split(",") for p in points.split()], float), fill, edge) for points, fill, edge in found]


def test_any_shape_is_drawn_and_coloured_by_its_gap() -> None:
    model = mujoco.MjModel.from_xml_string(SHAPES)
    qpos = np.array(model.qpos0)
    picture = draw_robot(model, qpos, {1: 1.0}, {1: "a part <1>"}).svg()
    assert "a part &lt;1&gt;" in picture
    hot, cold = polygons(picture), polygons(draw_robot(model, qpos, {}, {}).svg())
    assert len(hot) == len(cold) == 6
    assert {fill for _, fill, _ in hot}.isdisjoint({fill for _, fill, _ in cold})
    marked = polygons(draw_robot(model, qpos, {}, {}, [1]).svg())
    assert {edge for _, _, edge in marked}.isdisjoint({edge for _, _, edge in cold})


def test_a_model_without_its_meshes_is_drawn_as_bars() -> None:
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><body><joint axis="0 1 0"/><inertial pos="0 0 -.5" mass="1" diaginertia="1 1 1"/>
        <body pos="0 0 -1"><joint axis="0 1 0"/><inertial pos="0 0 -.5" mass="1" diaginertia="1 1 1"/></body>
        </body></worldbody></mujoco>"""
    )
    picture = draw_robot(model, np.array(model.qpos0), {2: 1.0}, {2: "lower link"}).svg()
    upper, lower = sorted((corners for corners, _, _ in polygons(picture)), key=lambda c: c.mean(axis=0)[1])
    # The upper one reaches to the lower one's joint, and that to its centre of mass: half as far.
    thick = float(np.ptp(upper[:, 0]))
    assert np.ptp(upper[:, 1]) - thick == pytest.approx(2.0 * (np.ptp(lower[:, 1]) - thick), rel=0.02)
    assert len({fill for _, fill, _ in polygons(picture)}) == 2


def test_a_name_hangs_at_the_middle_of_its_part_wherever_its_mass_lies() -> None:
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><body><joint axis="0 1 0"/><inertial pos="0 0 -1" mass="1" diaginertia="1 1 1"/>
        <geom type="capsule" fromto="0 0 0 0 0 -1" size="0.05"/></body></worldbody></mujoco>"""
    )
    picture = draw_robot(model, np.array(model.qpos0), {}, {1: "link"}).svg()
    ((corners, _, _),) = polygons(picture)
    (begin,) = re.findall(r'<path d="M([\d.]+) ([\d.]+)L', picture)
    assert np.allclose(np.array(begin, float), 0.5 * (corners.min(axis=0) + corners.max(axis=0)), atol=0.02)


def test_names_do_not_cover_each_other_and_stay_in_the_picture() -> None:
    bodies = "".join(f'<body name="b{i}"><freejoint/><geom size=".1" pos="0 0 {0.01 * i}"/></body>' for i in range(6))
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{bodies}</worldbody></mujoco>")
    labels = {b: f"part {b}\nand more" for b in range(1, 7)}
    drawing = draw_robot(model, np.array(model.qpos0), {}, labels)
    texts = re.findall(r'<text x="([-\d.]+)" y="([-\d.]+)" text-anchor="(\w+)"', drawing.svg())
    assert len(texts) == 12
    for anchor in ("start", "end"):
        heights = sorted(float(y) for _, y, a in texts if a == anchor)
        assert np.all(np.diff(heights) > 13.0) and heights[0] > 10.0 and heights[-1] < drawing.height


def test_a_page_that_cannot_be_written_is_said(found: Diagnosis, evidence: Evidence, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(GapInputError, match="cannot be written"):
        write_page(found.report, evidence, tmp_path / "file" / "report.html")
    path = write_page(found.report, evidence, tmp_path / "deep" / "report.html")
    assert path.read_text().startswith("<!doctype html>")
    assert [p.name for p in path.parent.iterdir()] == ["report.html"]


@pytest.mark.skipif(not any(map(shutil.which, BROWSERS)), reason="no Chromium or Chrome")
def test_a_browser_shows_it(html: str, tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    # What a reader would notice: boxes that stick out of the page, drawings without size, text without letters.
    probe = """<script>addEventListener('load', () => {
      const wide = document.documentElement.scrollWidth - innerWidth;
      const flat = [...document.querySelectorAll('svg')].filter(s => s.getBoundingClientRect().height < 20).length;
      document.title = `probe ${wide} ${flat} ${document.querySelectorAll('section').length}`;
    });</script></body>"""
    path.write_text(html.replace("</body>", probe))
    browser = next(b for b in BROWSERS if shutil.which(b))
    options = [
        "--headless=new",
        "--no-sandbox",
        "--disable-gpu",
        "--window-size=900,1200",
        f"--user-data-dir={tmp_path}/u",
    ]
    command = [browser, *options, "--virtual-time-budget=3000", "--dump-dom", path.as_uri()]
    shown = subprocess.run(command, capture_output=True, text=True, timeout=120).stdout
    measured = re.search(r"<title>probe (-?\d+) (\d+) (\d+)</title>", shown)
    assert measured, shown[:500]
    wide, flat, parts = map(int, measured.groups())
    assert wide <= 0 and flat == 0 and parts >= 5


@pytest.mark.parametrize(("cut_short", "said"), [(True, "for the first 31.7 s of a run"), (False, "to its end")])
def test_a_free_run_says_how_far_it_went(cut_short: bool, said: str) -> None:
    run = {"model": "diagnosed", "unit": {"q": "rad"}, "stretch_s": None, "duration_s": 31.74, "fitted_on_it": False}
    steps = [{"free_running": {"q": value}} for value in (0.2, 0.1)]
    report = {"verdict": "effect", "waterfall": steps, "where": [{"channel": "q"}]}
    assert said in free({**report, "free_running": [{**run, "cut_short": cut_short}]})


def _said(p: float, values: dict[str, tuple[float, float]], parameter: str = "friction") -> dict[str, object]:
    """A row of ``agreement``: value and half interval of each run; the last is the odd one."""
    by_part = {name: {"value": v, "ci90": [v - half, v + half]} for name, (v, half) in values.items()}
    row = {"effect": "coulomb_friction@elbow", "parameter": parameter, "unit": "N m", "by_part": by_part}
    return row | {"mean": 0.1, "p": p, "odd": list(values)[-1]}


def _drawn(*rows: dict[str, object]) -> str:
    parts = list(rows[0]["by_part"])  # type: ignore[call-overload]
    drawing = runs({"agreement": {"parts": parts, "rows": rows, "disagree_below": 0.01, "sentence": ""}})
    assert drawing is not None
    return drawing.svg()


def test_each_run_is_drawn_and_only_one_that_disagrees_stands_out() -> None:
    assert runs({}) is None and runs({"agreement": None}) is None
    agree = _drawn(_said(0.4, {"run 0": (0.1, 0.02), "run 1": (0.11, 0.02)}))
    differ = _drawn(_said(1e-4, {"run 0": (0.1, 0.02), "run 1": (0.2, 0.02)}))
    assert agree.count("<circle") == 2 and BEFORE not in agree and ">run 1<" in agree and "p = 0.4" in agree
    assert differ.count(BEFORE) == 2  # its interval and its dot


def test_a_run_that_says_nothing_does_not_hide_the_others() -> None:
    plain = {"run 0": (0.1, 0.02), "run 1": (0.11, 0.02), "run 2": (0.12, 0.02)}
    said, vague = (_drawn(_said(0.4, values)) for values in (plain, plain | {"run 2": (0.12, 900.0)}))
    places = [[float(x) for x in re.findall(r'<circle cx="([-\d.]+)"', picture)] for picture in (said, vague)]
    apart = [abs(p[1] - p[0]) for p in places]
    assert apart[1] > 0.25 * apart[0] > 0.0
    assert max(places[1]) < 900.0 and min(places[1]) > 0.0


def test_of_many_runs_and_numbers_the_furthest_are_drawn() -> None:
    values = {f"run {i}": (0.1 + 1e-4 * i, 0.02) for i in range(39)} | {"run 39": (0.3, 0.02)}
    picture = _drawn(*(_said(0.5 / (i + 1), values, f"friction_{i}") for i in range(20)))
    assert picture.count("<circle") == 12 * 16 and ">run 39<" in picture and ">run 19<" not in picture
    assert "friction 19 (p" in picture and "friction 0 (p" not in picture
