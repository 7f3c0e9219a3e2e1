"""How soft the knees may be: what is changed, what is not, and what the rows say of it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nermo_control.types import Phase
from nermo_description.blocks.leg import knee_angle
from nermo_description.parameters import RobotParameters
from nermo_description.robots import load_robot
from nermo_sim.calibrate.numbers import variant
from nermo_sim.disturbance import NO_DISTURBANCE
from nermo_sim.experiments import compliance, straight_line
from nermo_sim.experiments.compliance import PAIRS, Case, cases, changed_claims, run, softer, table
from nermo_sim.experiments.runs import Job, Settings
from nermo_sim.experiments.springs import stance_shares
from nermo_sim.experiments.straight_line import STRIDE

ROBOT = load_robot("nermo_lite")
STIFF = variant(ROBOT, {"front_knee_rest": 0.40, "rear_knee_rest": 1.50})
"""So pretensioned that no load of a walk takes its knees over: the robot as it was."""


@given(st.floats(0.0, 1.0))
def test_only_the_rest_angles_move_and_never_past_the_neutral_stance(share: float) -> None:
    changed = softer(ROBOT, share)
    for pair in PAIRS:
        own, new = (getattr(robot, f"{pair}_leg_dynamics") for robot in (ROBOT, changed))
        neutral = knee_angle(getattr(ROBOT, f"{pair}_leg"), ROBOT.servos[f"{pair}_left_knee"].neutral)
        assert own.knee.rest - 1e-12 <= new.knee.rest <= neutral + 1e-12
        assert new.knee.model_copy(update={"rest": own.knee.rest}) == own.knee
        assert new.ankle == own.ankle
    assert (
        changed.model_copy(update={f"{pair}_leg_dynamics": getattr(ROBOT, f"{pair}_leg_dynamics") for pair in PAIRS})
        == ROBOT
    )
    assert softer(ROBOT, 0.0) == ROBOT


def test_every_share_is_asked_the_same() -> None:
    for quick in (False, True):
        each = {share: [case.part for case in cases(quick) if case.share == share] for share in compliance.SHARES}
        asked = [parts for parts in each.values() if parts]
        assert len(asked) >= 2
        assert all(parts == asked[0] for parts in asked)
        assert {case.share for case in cases(quick)} >= {0.0, 1.0}


@pytest.fixture(scope="module")
def ran() -> tuple[list[Case], Settings, list[list[dict]]]:
    settings = Settings(distance=0.3, repeats=1, disturbance=NO_DISTURBANCE, tail="rigid", variant=STIFF)
    walks = [straight_line.Case("trot", 0.8, STRIDE, spine, spine) for spine in (False, True)]
    chosen = [Case(share, "straight-line", walk) for share in (0.0, 0.5, 1.0) for walk in walks]
    return chosen, settings, [[run(Job(case, 0, settings))] for case in chosen]


def test_knees_that_rest_in_the_stance_give_way_and_pretensioned_ones_do_not(ran, robot: RobotParameters) -> None:
    stiff, _, soft = table(ran[0], ran[1], robot, ran[2])
    assert (stiff["share"], soft["share"]) == (0.0, 1.0)
    for pair in PAIRS:
        assert stiff[f"{pair}_knee_yield_p95_deg"] < 0.5
        assert soft[f"{pair}_knee_yield_p95_deg"] > 3.0
    assert soft["speed_m_s"] < stiff["speed_m_s"]
    for half in ("fitted", "checked"):
        assert 0 < stiff[f"{half}_within"] <= stiff[half]


def test_front_knees_give_way_at_touch_down_and_rear_ones_at_lift_off(ran, robot: RobotParameters) -> None:
    """N 7.1.2: rear leg compression at lift-off."""
    half = table(ran[0], ran[1], robot, ran[2])[1]
    assert half["front_knee_yield_touch_down_deg"] > 2.0 * half["front_knee_yield_lift_off_deg"]
    assert half["rear_knee_yield_lift_off_deg"] > 2.0 * half["rear_knee_yield_touch_down_deg"]


def test_the_knees_of_the_robot_give_way_in_stance() -> None:
    """N 4.2, 7.2.1: its legs are compliant, ankle and knee store energy in stance."""
    settings = Settings(distance=0.3, repeats=1, disturbance=NO_DISTURBANCE, tail="rigid")
    found = straight_line.run(Job(straight_line.Case("trot", 0.8, STRIDE), 0, settings))
    for pair in PAIRS:
        assert found[f"{pair}_knee_yield_p95_deg"] > 3.0


@given(st.lists(st.tuples(st.sampled_from([Phase.SWING, Phase.STANCE]), st.integers(1, 9)), max_size=6))
def test_a_stance_passes_from_its_first_tick_to_its_last(parts: list[tuple[Phase, int]]) -> None:
    phases = np.array([int(phase) for phase, ticks in parts for _ in range(ticks)], dtype=np.int8)
    shares = stance_shares(phases)
    assert (np.isnan(shares) == (phases != int(Phase.STANCE))).all()
    inside = shares[~np.isnan(shares)]
    assert ((inside >= 0.0) & (inside < 1.0)).all()
    for tick in range(1, len(phases)):
        if phases[tick - 1] == phases[tick] == int(Phase.STANCE):
            assert shares[tick] > shares[tick - 1]
        elif phases[tick] == int(Phase.STANCE):
            assert shares[tick] == 0.0


def test_a_changed_claim_holds_with_some_knees_and_not_with_others(ran) -> None:
    claims = changed_claims(*ran)
    assert claims
    for claim in claims:
        assert len(claim["ours"]) == len(claim["within"]) == 3
        assert set(claim["within"]) == {True, False}
        assert claim["half"] in ("fitted", "checked")
