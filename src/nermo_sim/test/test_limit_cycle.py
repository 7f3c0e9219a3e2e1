"""Staged fitness and swarm for Cheetah-Cub (C 3.2.4)."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from nermo_sim.experiments.result_log import ResultLog
from nermo_sim.optimize import limit_cycle
from nermo_sim.optimize.limit_cycle import BOUNDS, Rollout, Swarm, Trot, cost, default_values, run, stage_and_value

GOOD = {"survived": 1.0, "speed_m_s": 0.5, "mismatch": 0.1, "slip": 0.02, "pitch_rad": 0.02, "roll_rad": 0.02}


def test_stages_order_before_values_do():
    """Who falls is worse than who stands with the wrong feet down, and so on, however fast it was."""
    ladder = [
        {**GOOD, "speed_m_s": -1.0},
        {**GOOD, "survived": 0.3, "speed_m_s": 3.0},
        {**GOOD, "mismatch": 0.5, "speed_m_s": 0.1},
        {**GOOD, "slip": 0.4, "speed_m_s": 0.1},
        {**GOOD, "speed_m_s": 0.1},
        GOOD,
    ]
    assert [stage_and_value(metrics)[0] for metrics in ladder] == [0, 0, 1, 2, 3, 3]
    costs = [cost(metrics) for metrics in ladder]
    assert costs == sorted(costs, reverse=True)
    assert len(set(costs)) == len(costs)


@pytest.mark.parametrize("worse", ["mismatch", "slip", "pitch_rad", "roll_rad"])
def test_within_the_last_stage_everything_counts(worse):
    assert cost({**GOOD, worse: GOOD[worse] + 0.03}) > cost(GOOD)


def test_a_trot_is_told_from_a_fall():
    values = list(default_values())
    trot = Trot(duration=1.5)
    walks = run(Rollout(trot, tuple(values), 1))
    values[list(BOUNDS).index("front.offset")], values[list(BOUNDS).index("rear.offset")] = -0.045, -0.045
    values[list(BOUNDS).index("frequency_hz")] = 1.5
    falls = run(Rollout(trot, tuple(values), 1))
    assert walks["survived"] == pytest.approx(1.0, abs=0.01)
    assert walks["speed_m_s"] > 0.1
    assert cost(walks) < cost(falls)


def test_a_search_that_was_stopped_ends_as_it_would_have(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Deterministic for a seed, and no rollout is done twice."""
    calls = []

    def quick(rollout: Rollout) -> dict[str, float]:
        calls.append(rollout.key)
        if len(calls) == 9 and not (tmp_path / "stopped").exists():
            (tmp_path / "stopped").touch()
            raise KeyboardInterrupt
        share = dict(zip(BOUNDS, rollout.values, strict=True))
        return {**GOOD, "speed_m_s": share["step_length_m"], "roll_rad": share["front.height"]}

    monkeypatch.setattr(limit_cycle, "run", quick)

    def search(name: str) -> limit_cycle.Found:
        with ThreadPoolExecutor(1) as pool:
            return Swarm(pool, ResultLog(tmp_path / name, "x"), Trot(), 3).search(4, 4, unseen=1)

    with pytest.raises(KeyboardInterrupt):
        search("first")
    before = len(calls)
    resumed = search("first")
    again = len(calls) - before
    whole = search("second")
    assert resumed.best == whole.best
    assert resumed.history == whole.history == sorted(whole.history, reverse=True)
    assert resumed.rollouts_now == again < whole.rollouts_now == whole.rollouts


def test_a_gait_that_falls_under_other_disturbances_is_not_taken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The longest steps win the search and fall in every other trial."""
    seen: set[int] = set()
    searched: list[float] = []

    def quick(rollout: Rollout) -> dict[str, float]:
        length = dict(zip(BOUNDS, rollout.values, strict=True))["step_length_m"]
        seen.add(rollout.trial)
        if len(seen) == 1:
            searched.append(length)
        falls = len(seen) > 1 and length == max(searched)
        return {**GOOD, "speed_m_s": length, "survived": 0.5 if falls else 1.0}

    monkeypatch.setattr(limit_cycle, "run", quick)
    with ThreadPoolExecutor(1) as pool:
        found = Swarm(pool, ResultLog(tmp_path / "log", "x"), Trot(), 1).search(6, 3, unseen=2)
    assert found.unseen["best"]["survived"] == 1.0
    assert found.best_metrics["speed_m_s"] < max(searched)
