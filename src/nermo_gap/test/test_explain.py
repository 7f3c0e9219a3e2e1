"""Published tables: reading them, finding the effects behind them, and going on where it stopped."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from nermo_description.parameter_files import ParameterError
from nermo_description.robots import load_robot
from nermo_gap.cli import gap_app
from nermo_gap.explain.candidates import candidates
from nermo_gap.explain.evaluate import Evaluator, Point, Results
from nermo_gap.explain.posterior import held_out, of_effects, probabilities
from nermo_gap.explain.report import _SHIPPED
from nermo_gap.explain.search import explain
from nermo_gap.explain.sets import Explanation, judge, point_of
from nermo_gap.explain.summary import Cell, Run, Summary, load_summary

TROT = Run(experiment="straight_line")
ARC = Run(experiment="turning", strategy="spine")
LIFT = Run(experiment="balance", leg="rear_left")


KNOBS = {
    ("servo_gain", "front_left_hip"): 1.0,
    ("joint_stiffness", "spine_lateral_1_joint"): 1.0,
    ("mass", "torso"): 0.0,
}
"""What the robots of paper mind, and where it is neutral."""


def sizes(point: Point) -> dict[tuple[str, str], float]:
    """{(effect, first site): size} of a set of deviations."""
    return {(d.effect, d.sites[0]): next(iter(d.values.values())) for d in point}


def robot_of_paper(points: Sequence[Point], runs: Sequence[Run], progress: object = None) -> list[Results]:
    """Its speed falls with servo gain, its arc is lost with a soft spine, and its lift fails with mass."""
    found = []
    for point in points:
        values = sizes(point)
        gain, spine, mass = (values.get(key, neutral) for key, neutral in KNOBS.items())
        number = {
            TROT.key: 0.08 * (0.5 + 0.5 * gain),
            ARC.key: 13.0 / spine if spine > 0.35 else math.inf,
            LIFT.key: float(mass < 0.03),
        }
        found.append({run.key: number[run.key] for run in runs})
    return found


def test_two_effects_that_each_explain_a_part_are_found_together() -> None:
    summary = Summary(
        name="paper",
        robot="nermo_lite",
        cells=(
            Cell(name="speed", source="made up", run=TROT, relative=True, low=0.80, high=0.90),
            Cell(name="arc", source="made up", run=ARC, passed=False),
            Cell(name="lift", source="made up", run=LIFT, passed=True),
        ),
    )
    before, found = explain(summary, candidates(load_robot("nermo_lite")), robot_of_paper)  # type: ignore[arg-type]
    assert sum(before.met) == 1
    best = found[0]
    assert {p.candidate.key for p in best.parts} == {"servo_gain@all", "joint_stiffness@spine"}
    assert all(best.met) and best.distance == 0.0
    alone = [e for e in found if len(e.parts) == 1]
    assert max(sum(e.met) for e in alone) == 2


def test_the_thesis_table_is_whole() -> None:
    summary = load_summary(_SHIPPED / "thesis_robot.yaml")
    assert len(summary.cells) == 16 and len(summary.runs) == 14
    known = {c.key for c in candidates(load_robot(summary.robot))}
    assert set(summary.blamed) <= known


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("name: x\nrobot: nermo_lite\ncells: []\n", "cells"),
        (
            "name: x\nrobot: nermo_lite\ncells: [{name: a, source: b, run: {experiment: straight_line}}]\n",
            "give either passed, or low and high",
        ),
        ("name: x\nrobot: nermo_lite\ncells: [{name: a, source: b, run: {experiment: flying}}]\n", "flying"),
    ],
)
def test_a_table_that_makes_no_sense_is_refused(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "summary.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ParameterError, match=words):
        load_summary(path)
    answer = CliRunner().invoke(gap_app, ["explain", str(path), "--out", str(tmp_path / "out")])
    assert answer.exit_code == 2 and "summary.yaml" in answer.output


def test_what_has_been_run_is_not_run_again(tmp_path: Path) -> None:
    run = Run(experiment="balance", leg="front_left")
    heavy = next(c for c in candidates(load_robot("nermo_lite")) if c.key == "mass@torso").deviation(0.02)
    first = Evaluator("nermo_lite", tmp_path, 1)([(), (heavy,)], [run])
    assert first[0][run.key] == 1.0
    seen: list[tuple[int, int]] = []
    again = Evaluator("nermo_lite", tmp_path, 1)([(), (heavy,)], [run], lambda done, total: seen.append((done, total)))
    assert again == first and seen == [(2, 2)]


def four_at_once(points: Sequence[Point], runs: Sequence[Run], progress: object = None) -> list[Results]:
    """Its numbers need four effects, of which two weaken each other: no sum of single ones foretells them."""
    found = []
    for point in points:
        values = sizes(point)
        gain, spine, mass = (values.get(key, neutral) for key, neutral in KNOBS.items())
        friction = values.get(("ground_friction", "front_left_foot"), 1.0)
        number = {
            TROT.key: 0.08 * (1.0 - 0.5 * (1.0 - gain)) * (1.0 - 0.3 * (1.0 - friction) * gain),
            ARC.key: 13.0 / spine if spine > 0.35 else math.inf,
            LIFT.key: float(mass < 0.03),
            FAST.key: 0.1 * (1.0 - 0.6 * (1.0 - friction)),
        }
        found.append({run.key: number[run.key] for run in runs})
    return found


FAST = Run(experiment="straight_line", frequency_hz=0.8)
FOUR = Summary(
    name="four",
    robot="nermo_lite",
    cells=(
        Cell(name="speed", source="one", run=TROT, relative=True, low=0.66, high=0.72),
        Cell(name="fast", source="one", run=FAST, relative=True, low=0.65, high=0.75),
        Cell(name="arc", source="two", run=ARC, passed=False),
        Cell(name="lift", source="three", run=LIFT, passed=False),
    ),
)


@pytest.fixture(scope="module")
def four() -> tuple[Explanation, list[Explanation]]:
    return explain(FOUR, candidates(load_robot("nermo_lite")), four_at_once, largest=4)  # type: ignore[arg-type]


def test_four_effects_grow_out_of_three(four: tuple[Explanation, list[Explanation]]) -> None:
    _, found = four
    best = found[0]
    assert all(best.met)
    named = {p.candidate.key for p in best.parts}
    assert named == {"servo_gain@all", "joint_stiffness@spine", "mass@torso", "ground_friction@all"}
    # What is claimed was run: these effects at these sizes.
    (again,) = four_at_once([point_of(best.parts)], FOUR.runs)
    assert judge(FOUR.cells, again, again)[1][2:] == list(best.values[2:]) and again == best.results


def leaning(points: Sequence[Point], runs: Sequence[Run], progress: object = None) -> list[Results]:
    """A mass further forward makes it slower at one frequency, one further back at another."""
    found = []
    for point in points:
        shifts = [d.values["x"] for d in point if d.effect == "com_shift"]
        assert len(shifts) < 2
        forward, back = max([*shifts, 0.0]), max([*(-s for s in shifts), 0.0])
        number = {TROT.key: 0.08 * (1.0 - 30.0 * forward), FAST.key: 0.1 * (1.0 - 30.0 * back)}
        found.append({run.key: number[run.key] for run in runs})
    return found


def test_no_mass_is_further_forward_and_further_back() -> None:
    cells = tuple(Cell(name=run.key, source="one", run=run, relative=True, low=0.65, high=0.75) for run in (TROT, FAST))
    summary = Summary(name="leaning", robot="nermo_lite", cells=cells)
    _, found = explain(summary, candidates(load_robot("nermo_lite")), leaning, largest=3)  # type: ignore[arg-type]
    assert sum(found[0].met) == 1


def test_sets_that_explain_more_with_less_are_likelier(
    four: tuple[Explanation, list[Explanation]],
) -> None:
    before, found = four
    sets = [before, *found]
    chance = probabilities(FOUR.cells, sets)
    assert chance.sum() == pytest.approx(1.0)
    acts = of_effects(sets, chance)
    assert next(iter(acts)) in {p.candidate.key for p in found[0].parts}
    # Two numbers in the middle of their intervals against two that are not: an effect more must pay for itself.
    middle = Explanation((), (True,), (0.69,), 0.0)
    outside = Explanation((), (False,), (1.0,), 5.2)
    one_cell = FOUR.cells[:1]
    ratio = np.divide(*probabilities(one_cell, [middle, outside]))
    assert ratio == pytest.approx((1.0 + (0.31 / 0.03) ** 2 / 4.0) ** 2.5, rel=1e-6)
    dear = Explanation(found[0].parts, (True,), (0.69,), 0.0)
    assert np.divide(*probabilities(one_cell, [middle, dear])) == pytest.approx(9.0**4)


def test_a_table_that_is_left_out_does_not_count_for_itself(
    four: tuple[Explanation, list[Explanation]],
) -> None:
    before, found = four
    rows = {row.source: row for row in held_out(FOUR.cells, before, [before, *found])}
    assert set(rows) == {"one", "two", "three"} and rows["one"].cells == 2
    # Nothing but its own table asks for the soft spine, so it is not foretold.
    assert rows["two"].best == 0 and rows["two"].expected < 0.5


@given(position=st.floats(0.0, 3.0))
def test_a_size_and_its_position_say_the_same(position: float) -> None:
    for one in candidates(load_robot("nermo_lite")):
        at = min(position, len(one.sizes))
        assert one.position(one.size(at)) == pytest.approx(at, abs=2e-3)
