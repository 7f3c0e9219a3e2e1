"""The calibration: its numbers, what it makes of claims, how well it knows, and how it goes on after a kill."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from rows_of_ones import rows_of_ones

from nermo_description.parameters import RobotParameters
from nermo_description.robots import load_robot
from nermo_sim.calibrate.command import before_and_after
from nermo_sim.calibrate.determined import determined
from nermo_sim.calibrate.numbers import NUMBERS, differences, values_of, variant
from nermo_sim.calibrate.search import Candidate, Found
from nermo_sim.calibrate.trials import (
    WORDS_MISSED,
    WORST,
    Trial,
    all_cases,
    cheap_cases,
    claims_of,
    cost,
    miss,
    run,
    tables,
)
from nermo_sim.disturbance import NO_DISTURBANCE
from nermo_sim.experiments import maze, turning
from nermo_sim.experiments.runs import Settings

FIRST, SECOND = NUMBERS[0].name, NUMBERS[1].name


@pytest.mark.parametrize("name", ["nermo_lite", "nermo"])
def test_the_robots_own_numbers_lie_between_the_bounds_and_are_found_again(name: str) -> None:
    robot = load_robot(name)
    own = values_of(robot)
    for number in NUMBERS:
        assert number.low <= own[number.name] <= number.high, number.name
        assert number.value(number.share(own[number.name])) == pytest.approx(own[number.name], rel=1e-5)
    assert values_of(variant(robot, own)) == own


def test_a_number_is_set_at_all_its_places_and_nowhere_else(robot: RobotParameters) -> None:
    changed = variant(robot, {"ankle_stiffness": 0.3, "front_com": 0.025})
    assert changed.front_leg_dynamics.ankle.stiffness == changed.rear_leg_dynamics.ankle.stiffness == 0.3
    assert changed.masses.front_com == (0.025, *robot.masses.front_com[1:])
    assert changed.front_leg_dynamics.knee == robot.front_leg_dynamics.knee


def test_what_was_found_is_a_robot_file_like_any_other(robot: RobotParameters, tmp_path: Path) -> None:
    values = {number.name: number.value(0.4) for number in NUMBERS}
    file = tmp_path / "found.yaml"
    file.write_text(yaml.safe_dump({"name": "found", "base": "nermo_lite", **differences(values, robot)}))
    assert values_of(load_robot(file)) == pytest.approx(values)


def row(claim: str, thesis: float, ours: float, band: tuple[float, float]) -> dict:
    ratio = ours / thesis
    return {"claim": claim, "thesis": thesis, "ratio": ratio, "band": list(band), "within": band[0] <= ratio <= band[1]}


def test_a_miss_is_one_at_the_edge_of_the_band() -> None:
    assert miss(row("a", 2.0, 2.0, (0.8, 1.25))) == 0.0
    assert miss(row("a", 2.0, 2.5, (0.8, 1.25))) == pytest.approx(1.0)
    assert miss(row("a", 2.0, 1.6, (0.8, 1.25))) == pytest.approx(-1.0)
    assert miss(row("a", 2.0, 200.0, (0.8, 1.25))) == WORST
    assert miss(row("pitch", 0.5, -1.0, (-2.0, 4.0))) == pytest.approx(-1.0)  # a band of our value itself
    words = {"ratio": None, "within": False}
    assert miss(words) == WORDS_MISSED
    assert miss({**words, "within": True}) == 0.0


def test_a_claim_that_cannot_be_answered_any_more_counts_as_worst() -> None:
    assert cost({"a": 1.0}, ["a"]) == 1.0
    assert cost({"a": 1.0}, ["a", "b"]) == (1.0 + WORST**2) / 2.0


def test_a_claim_that_the_found_robot_cannot_answer_counts_as_lost() -> None:
    kept = {"kind": "twin", "half": "checked"}
    before = [{**row(name, 1.0, 1.0, (0.8, 1.2)), **kept, "ours": 1.0} for name in "ab"]
    rows = before_and_after(before, before[:1])
    assert [(each["claim"], each["within_before"], each["within"]) for each in rows] == [
        ("a", True, True),
        ("b", True, False),
    ]


def found_with(slopes: np.ndarray) -> Found:
    """A made-up calibration: two claims whose misses are linear in the numbers."""
    random = np.random.default_rng(1)
    points = random.random((200, len(NUMBERS)))
    best = np.full(len(NUMBERS), 0.5)
    tried = [Candidate(point, dict(zip("ab", slopes @ (point - best), strict=True)), 0.0) for point in (*points, best)]
    rows = [row(claim, 1.0, 1.0, (0.8, 1.2)) for claim in "ab"]
    values = {number.name: number.value(0.5) for number in NUMBERS}
    return Found(values, ["a", "b"], tried[-1], tried[-1], tried, rows, rows)


def test_a_number_is_known_as_well_as_the_claims_that_it_moves_say() -> None:
    slopes = np.zeros((2, len(NUMBERS)))
    slopes[0, 0] = 20.0
    rows = {each["name"]: each for each in determined(found_with(slopes))}
    assert rows[FIRST]["share_of_bounds"] < 0.15  # its claim's band is a tenth of the bounds wide
    assert rows[FIRST]["moves"] == ["a"]
    assert rows[SECOND]["share_of_bounds"] > 0.9
    assert rows[SECOND]["moves"] == rows[SECOND]["confounded_with"] == []


def test_two_numbers_that_do_the_same_are_confounded() -> None:
    slopes = np.zeros((2, len(NUMBERS)))
    slopes[0, :2] = 20.0
    rows = {each["name"]: each for each in determined(found_with(slopes))}
    assert rows[FIRST]["confounded_with"] == [SECOND]
    assert rows[FIRST]["share_of_bounds"] > 0.5


def test_the_search_is_asked_every_claim_of_the_fitted_half() -> None:
    """Of rows of ones, which have a value for every claim."""

    def fitted(cases: list[tuple[str, Any]]) -> set[str]:
        return {each["claim"] for each in claims_of(rows_of_ones(cases)) if each["half"] == "fitted"}

    assert fitted(cheap_cases()) == fitted(all_cases())


def test_every_arc_and_every_lock_of_the_search_can_break_the_claim_about_all_of_them() -> None:
    cases = cheap_cases()
    facts = rows_of_ones(cases)
    for each in facts["turning"]["rows"]:
        each |= {"time_s": 1.0 / each["frequency_hz"] + ("spine", "mix", "leg").index(each["strategy"])}
        each |= {"radius_m": float(("mix", "leg", "spine").index(each["strategy"]))}
        each["followed"] = (each["gait"], each["strategy"], each["path_radius_m"]) != ("lateral_walk", "spine", 0.5)
    about_all = (
        "the only failed arc is spine, lateral walk, 0.8 Hz, 0.5 m",
        "spine turning fastest, then mix, then leg, on every arc that is followed",
        "turning is faster at a higher frequency",
        "mix turns most tightly and the spine least, in every gait and at every frequency",
    )

    def held() -> list[bool]:
        found = {each["claim"]: each["within"] for each in claims_of(facts)}
        return [found[claim] for claim in about_all]

    assert held() == [True] * 4
    for each in facts["turning"]["rows"]:
        if (each["gait"], each["frequency_hz"], each["path_radius_m"]) == ("lateral_walk", 0.5, turning.FULL_LOCK):
            continue  # it is asked for its own radius
        was = dict(each)
        each |= {"time_s": 10.0, "radius_m": 10.0 if each["strategy"] != "spine" else -1.0}
        each["followed"] = not was["followed"]
        assert held() != [True] * 4, was
        each |= was


def test_half_a_maze_takes_the_time_of_the_whole_at_its_speed() -> None:
    settings = Settings(repeats=1, disturbance=NO_DISTURBANCE, tail="rigid", quick=True)
    case = maze.Case(spine=True)
    result = run(Trial("maze", case, settings))
    facts = tables([("maze", case), ("maze", maze.Case(spine=False))], settings, [[result], [result]])
    found = {each["claim"]: each["ours"] for each in claims_of(facts)}
    whole = maze.maze_path((0.0, 0.0, 0.0)).length
    assert found["maze time, spine [s]"] * found["maze speed, spine [m/s]"] == pytest.approx(whole)
    assert found["maze: share of time that the spine saves [1]"] == 0.0


KILLED = """
import json, os, signal, sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from nermo_sim.calibrate import search
from nermo_sim.calibrate.trials import run
from nermo_sim.disturbance import NO_DISTURBANCE
from nermo_sim.experiments.result_log import ResultLog
from nermo_sim.experiments.runs import Settings
from nermo_sim.experiments.straight_line import Case
from nermo_sim.optimize.rollouts import Rollouts

search.cheap_cases = lambda: [("straight-line", Case("trot", 0.8, 0.06))]
done = 0

def die():
    global done
    done += 1
    if done == int(sys.argv[2]):
        os.kill(os.getpid(), signal.SIGKILL)

if __name__ == "__main__":
    settings = Settings(repeats=1, disturbance=NO_DISTURBANCE)
    with ThreadPoolExecutor(1) as pool:
        rollouts = Rollouts(run, pool, ResultLog(Path(sys.argv[1]), "trials"), die)
        budget = search.Budget(design=2, population=2, generations=1, distance=0.3, judged=False)
        found = search.Calibration(settings, rollouts).run(budget)
    print(json.dumps([found.values, found.best.cost, found.baseline.cost, rollouts.run_now]))
"""


def test_a_calibration_killed_in_the_middle_goes_on_to_the_same_end(tmp_path: Path) -> None:
    """SIGKILL for real: what was tried is not tried again, and the end is that of one left in peace."""

    def run(log: str, die_after: int) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-c", KILLED, str(tmp_path / log), str(die_after)]
        return subprocess.run(command, capture_output=True, text=True, check=False)

    assert run("killed.jsonl", 3).returncode == -signal.SIGKILL
    before = (tmp_path / "killed.jsonl").read_bytes()
    resumed, whole = run("killed.jsonl", -1), run("whole.jsonl", -1)
    assert resumed.returncode == whole.returncode == 0, resumed.stderr + whole.stderr
    *end, again = json.loads(resumed.stdout)
    *undisturbed, trials = json.loads(whole.stdout)
    assert end == undisturbed
    assert before.count(b"\n") == 3
    assert again == trials - 3
    assert end[1] <= end[2]
