"""The search for gait parameters: its space, its costs, what it keeps, and how it goes on."""

from __future__ import annotations

import json
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from nermo_control.gait.knowledge_base import GaitKnowledgeBase, GaitParameters
from nermo_control.types import ControlCommand, TrajectoryMode
from nermo_description.results import CommandError
from nermo_description.robots import load_robot
from nermo_sim.experiments.result_log import ResultLog
from nermo_sim.loop import Loop, constant
from nermo_sim.optimize import search
from nermo_sim.optimize.cli import optimize_app
from nermo_sim.optimize.costs import WORST, Objective, parts, weights_of
from nermo_sim.optimize.evaluator import Evaluator, open_executor
from nermo_sim.optimize.rollout import FAILED, Metrics, Trial, Walk
from nermo_sim.optimize.search import Budget, Candidate, Search, front
from nermo_sim.optimize.space import Space

BASE = GaitParameters()
SPACE = Space(BASE, "trot", spine=True)
USUAL: Metrics = {
    "speed_m_s": 0.1,
    "roll_sd_deg": 8.0,
    "pitch_sd_deg": 2.0,
    "cost_of_transport": 4.0,
    "fell": False,
}


def test_the_thesis_s_own_set_is_a_point_of_the_space() -> None:
    assert SPACE.parameters(SPACE.point(BASE)) == BASE
    assert SPACE.values(BASE)["duty_factor"] == 0.5
    assert SPACE.values(BASE)["phase_lag"] == 0.0


@given(st.lists(st.floats(-0.5, 1.5), min_size=len(SPACE), max_size=len(SPACE)))
def test_every_point_is_a_valid_set_and_found_again(point: list[float]) -> None:
    found = SPACE.parameters(point)
    assert found.front.max_stride_length == found.rear.max_stride_length
    assert found.gaits["lateral_walk"] == BASE.gaits["lateral_walk"]
    for variable in SPACE.variables:
        value = SPACE.values(found)[f"{variable.name}{'' if variable.unit == '1' else f'_{variable.unit}'}"]
        assert variable.low - 1e-6 <= value <= variable.high + 1e-6
    assert SPACE.parameters(SPACE.point(found)).rear == found.rear


def test_a_phase_that_is_nearly_a_whole_cycle_is_none() -> None:
    lag = next(i for i, variable in enumerate(SPACE.variables) if variable.name == "phase_lag")
    point = SPACE.point(BASE)
    point[lag] -= 4e-7 / (SPACE.variables[lag].high - SPACE.variables[lag].low)
    assert SPACE.parameters(point).gaits["trot"].phase_offsets == BASE.gaits["trot"].phase_offsets


def test_costs_are_ratios_to_the_baseline() -> None:
    faster = {**USUAL, "speed_m_s": 0.125, "roll_sd_deg": 6.0}
    assert parts(faster, USUAL) == {"speed": 0.8, "roll": 0.75, "cot": 1.0}
    assert parts(FAILED, USUAL) == dict.fromkeys(("speed", "roll", "cot"), WORST)
    assert Objective({"roll": 1.0})(faster, USUAL) == pytest.approx(0.75)
    assert Objective(weights_of("mix", "speed=1, roll=3"))(faster, USUAL) == pytest.approx(0.7625)
    # A mouse that hardly moves does not roll: that is no solution.
    assert Objective({"roll": 1.0})({**USUAL, "speed_m_s": 0.05, "roll_sd_deg": 0.1}, USUAL) > 5.0


@pytest.mark.parametrize(
    ("cost", "weights", "complaint"),
    [
        ("height", "", "choose among speed, roll, cot, mix"),
        ("speed", "roll=1", "belong to --cost mix"),
        ("mix", "speed=1,yaw=2", "'yaw=2'"),
        ("mix", "speed=1,speed=2", "'speed=2'"),
        ("mix", "speed=-1", "0 to 1000"),
        ("mix", "speed=nan", "0 to 1000"),
        ("mix", "speed=0", "above 0"),
    ],
)
def test_costs_that_make_no_sense_are_wrong_usage(cost: str, weights: str, complaint: str) -> None:
    with pytest.raises(CommandError, match=complaint) as caught:
        weights_of(cost, weights)
    assert caught.value.status == 2


def test_the_front_is_beaten_by_nobody() -> None:
    values = [(0.10, 8.0), (0.12, 9.0), (0.11, 9.5), (0.09, 7.0), (0.08, 7.5), (0.0, 1.0)]
    tried = [Candidate(BASE, {**USUAL, "speed_m_s": speed, "roll_sd_deg": roll}) for speed, roll in values]
    tried[-1].metrics["fell"] = True
    assert [one.metrics["speed_m_s"] for one in front(tried)] == [0.09, 0.10, 0.12]


class Bowl:
    """An evaluator of a made-up mouse: fastest with half the duty factor's range, calmest with the least stance arc."""

    def evaluate(self, candidates: Sequence[GaitParameters], trials: Sequence[Trial]) -> list[Metrics]:
        found = []
        for one in candidates:
            away = (one.gaits["trot"].duty_factor - 0.6) / 0.15
            roll = 4.0 + 800.0 * one.front.stance_amplitude
            found.append({**USUAL, "speed_m_s": 0.12 - 0.03 * away**2, "roll_sd_deg": roll})
        return found


def test_the_search_finds_the_best_of_a_made_up_mouse_and_is_repeatable() -> None:
    def run(seed: int) -> search.Found:
        return Search(SPACE, BASE, Bowl(), Objective({"speed": 1.0}), seed).run(Budget())  # type: ignore[arg-type]

    found = run(3)
    assert found.best.metrics["speed_m_s"] == pytest.approx(0.12, abs=0.002)
    assert found.history == sorted(found.history, reverse=True)
    calmest = min(one.metrics["roll_sd_deg"] for one in found.front)
    assert calmest < 5.0  # the base has 8.0
    assert [row["ground"] for row in found.unseen] == [1.0, 0.5]
    assert run(3).best == found.best
    assert run(4).best != found.best
    assert run(0).best == run(0).best


def test_any_executor_will_do_and_nothing_is_run_twice(tmp_path: Path) -> None:
    walk = Walk(cycles=2)
    trials = [Trial(1), Trial(1, ground=0.5)]
    with ThreadPoolExecutor(2) as executor:
        evaluator = Evaluator(executor, ResultLog(tmp_path / "log", walk.digest()), walk)
        (first,) = evaluator.evaluate([BASE], trials)
        again = Evaluator(executor, ResultLog(tmp_path / "log", walk.digest()), walk)
        assert again.evaluate([BASE, BASE], trials) == [first, first]
    assert (evaluator.rollouts.count, evaluator.rollouts.run_now) == (2, 2)
    assert (again.rollouts.count, again.rollouts.run_now) == (2, 0)
    assert 0.05 < first["speed_m_s"] < 0.15
    assert first["cost_of_transport"] > 0.0
    assert first["fell"] is False


def test_unknown_executors_are_wrong_usage() -> None:
    with pytest.raises(CommandError, match="dask:local") as caught, open_executor("cluster", 2):
        pass
    assert caught.value.status == 2


def test_a_search_that_was_killed_goes_on_to_the_same_end_and_its_set_can_be_loaded(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(search, "QUICK", Budget(4, 1, 4, 1, trials=1, finalists=1, final_trials=1, unseen_trials=1))
    arguments = [
        "--quick",
        "--workers",
        "1",
        "--seed",
        "5",
        "--frequency",
        "1.2",
        "--json",
        str(tmp_path / "found.json"),
    ]
    arguments += ["--out", str(tmp_path), "--sets-folder", str(tmp_path / "sets")]
    log = tmp_path / "optimize" / "rollouts.jsonl"

    def run() -> dict:
        result = CliRunner().invoke(optimize_app, arguments)
        assert result.exit_code == 0, result.output
        return json.loads((tmp_path / "found.json").read_text())

    whole = run()
    assert {"best", "front", "rollouts", "rollouts_per_s", "baseline", "unseen"} <= set(whole)
    lines = log.read_text().splitlines(keepends=True)
    assert whole["rollouts"] == whole["rollouts_now"] == len(lines)
    log.write_text("".join(lines[:-3])[:-20])  # as a kill leaves it: some are missing, the last one is cut off
    resumed = run()
    assert resumed["rollouts_now"] == 4
    for key in ("best", "front", "baseline", "unseen", "history", "rollouts"):
        assert resumed[key] == whole[key]
    loaded = GaitKnowledgeBase(tmp_path / "sets").load("optimized_speed")
    space = Space(BASE, "trot", spine=True)
    assert space.values(loaded) == whole["best"]["parameters"]
    assert np.isfinite(whole["unseen"]["gain"]["speed_m_s"])


def test_the_set_that_comes_with_the_package_rocks_less_than_half_as_much(tmp_path: Path) -> None:
    walk = ControlCommand(0, forward_velocity=0.09, gait_frequency=0.8, trajectory_mode=TrajectoryMode.STRAIGHT_LINE)
    sets = GaitKnowledgeBase(tmp_path)

    def roll(name: str) -> float:
        recording = Loop.build(load_robot("nermo_lite"), sets.load(name)).run(constant(walk), 8.0)
        return float(recording.roll_pitch_yaw[800:, 0].std())

    assert roll("optimized_roll") < 0.5 * roll("thesis")


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["--gait", "gallop"], "choose among trot"),
        (["--frequency", "9"], "allowed 0.1 to 3.0 Hz"),
        (["--name", "a/b"], "letters, digits"),
        (["--name", "taken"], "exists already"),
        (["--robot", "elephant"], "elephant"),
    ],
)
def test_bad_input_is_refused_before_any_work(arguments: list[str], complaint: str, tmp_path: Path) -> None:
    GaitKnowledgeBase(tmp_path).save("taken")
    result = CliRunner().invoke(optimize_app, [*arguments, "--sets-folder", str(tmp_path), "--out", str(tmp_path)])
    assert isinstance(result.exception, CommandError), result.output
    assert complaint in str(result.exception)
    assert result.exception.status == 2
    assert not (tmp_path / "optimize").exists()
