"""Coupled oscillators and the Tegotae rule (C 3.2, 3.3), and the legs that they move."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nermo_control.gait.gaits import GaitDefinition
from nermo_control.gait.knowledge_base import GaitParameters
from nermo_control.gait.phase import LegStateMachine
from nermo_control.oscillators import tegotae
from nermo_control.oscillators.cpg import CoupledOscillators, phase_differences
from nermo_control.oscillators.legs import OscillatorLegs, OscillatorSettings
from nermo_control.oscillators.phase import TWO_PI
from nermo_control.pantograph_gaits import PANTOGRAPH_GAITS
from nermo_control.types import Phase

TICK = 5_000_000
WEIGHT = 2.7
GAITS = {**GaitParameters().gaits, **PANTOGRAPH_GAITS}
phases = st.floats(-math.pi, math.pi)


def run(oscillators: CoupledOscillators, gait: GaitDefinition, seconds: float) -> None:
    differences = phase_differences(gait.phase_offsets)
    for _ in range(round(seconds / 0.005)):
        oscillators.step(0.005, TWO_PI, differences)


@pytest.mark.parametrize("name", GAITS)
def test_every_gait_is_reached_from_anywhere(name: str) -> None:
    random = np.random.default_rng(3)
    differences = phase_differences(GAITS[name].phase_offsets)
    for _ in range(5):
        oscillators = CoupledOscillators(4.0, random.uniform(-math.pi, math.pi, 4).tolist())
        run(oscillators, GAITS[name], 6.0)
        assert oscillators.disorder(differences) < 1e-3


def test_locked_legs_turn_at_the_pulsation() -> None:
    gait = GAITS["trot"]
    oscillators = CoupledOscillators(4.0, [TWO_PI * offset for offset in gait.phase_offsets])
    assert oscillators.rates(5.0, phase_differences(gait.phase_offsets)) == pytest.approx([5.0] * 4)


def test_gait_changes_without_a_jump() -> None:
    oscillators = CoupledOscillators(4.0, [TWO_PI * offset for offset in GAITS["trot"].phase_offsets])
    for _ in range(400):
        before = list(oscillators.phases)
        oscillators.step(0.005, TWO_PI, phase_differences(GAITS["pace"].phase_offsets))
        steps = np.subtract(oscillators.phases, before)
        assert np.all(np.abs(steps) <= 0.005 * (TWO_PI + 3 * 4.0) + 1e-12)


@pytest.mark.parametrize(("coupling", "start"), [(-1.0, 0.0), (math.nan, 0.0), (1.0, math.inf)])
def test_bad_oscillators_are_refused(coupling: float, start: float) -> None:
    with pytest.raises(ValueError, match="must be finite"):
        CoupledOscillators(coupling, [start] * 4)


# Tegotae


@given(phases, st.floats(0.0, 5.0), st.floats(0.1, 10.0))
def test_rule_descends_the_discrepancy(phase: float, load: float, feedback: float) -> None:
    """(3.4) is omega - dI/dtheta of (3.3)."""
    step = 1e-6
    slope = (tegotae.discrepancy(phase + step, load, feedback) - tegotae.discrepancy(phase - step, load, feedback)) / (
        2.0 * step
    )
    assert tegotae.rate(phase, load, feedback, 3.0, False) == pytest.approx(3.0 - slope, abs=1e-6)


@given(st.floats(0.5, 3.0), st.floats(1.1, 5.0))
def test_held_leg_comes_to_its_fixed_point(load: float, held: float) -> None:
    omega = 4.0
    feedback = held * omega / load
    point = tegotae.fixed_point(load, feedback, omega)
    assert point is not None and -math.pi / 2 <= point <= 0.0
    assert tegotae.rate(point, load, feedback, omega, False) == pytest.approx(0.0, abs=1e-9)
    assert tegotae.rate(point - 0.01, load, feedback, omega, False) > 0.0
    assert tegotae.rate(point + 0.01, load, feedback, omega, False) < 0.0


@given(st.floats(0.5, 3.0), st.floats(1.1, 50.0))
def test_compensation_holds_the_leg_at_mid_stance(load: float, held: float) -> None:
    omega = 4.0
    feedback = held * omega / load
    middle = -math.pi / 2
    assert tegotae.rate(middle, load, feedback, omega, True) == pytest.approx(0.0, abs=1e-9)
    assert tegotae.rate(middle - 0.01, load, feedback, omega, True) > 0.0
    assert tegotae.rate(middle + 0.01, load, feedback, omega, True) < 0.0


def test_leg_without_load_follows_its_excitation() -> None:
    for compensated in (False, True):
        assert tegotae.rate(1.0, 0.0, 3.0, 5.0, compensated) == 5.0
    assert tegotae.fixed_point(1.0, 3.0, 5.0) is None


@given(phases, st.floats(0.0, 5.0), st.floats(0.01, 10.0))
def test_compensation_is_continuous_where_the_fixed_point_appears(phase: float, load: float, omega: float) -> None:
    feedback = 2.0
    load_at = omega / feedback
    low, high = (tegotae.rate(phase, load_at * share, feedback, omega, True) for share in (1 - 1e-9, 1 + 1e-9))
    assert low == pytest.approx(high, abs=1e-3 * omega + 1e-6)


# Legs


def legs(kind: str, **settings: object) -> OscillatorLegs:
    return OscillatorLegs(TICK, kind, OscillatorSettings(**settings), WEIGHT)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["trot", "walking_trot", "lateral_walk"])
def test_cpg_in_a_steady_gait_is_the_timed_state_machine(name: str) -> None:
    gait, cpg, timed = GAITS[name], legs("cpg"), LegStateMachine(TICK)
    cpg.start(0, gait, 0.8)
    timed.start(0, gait, 0.8)
    for tick in range(1, 600):
        cpg.step(tick * TICK, gait, 0.8)
        timed.step(tick * TICK, gait, 0.8)
        apart = [
            (a - b) % 1.0
            for a, b in zip(
                (f + p for f, p in zip(cpg.next.fractions, cpg.next.phases, strict=True)),
                (f + p for f, p in zip(timed.next.fractions, timed.next.phases, strict=True)),
                strict=True,
            )
        ]
        assert all(min(difference, 1.0 - difference) < 0.02 for difference in apart)


def test_loaded_leg_of_tegotae_waits_and_goes_on_when_it_is_free() -> None:
    gait, oscillators = GAITS["trot"], legs("tegotae", feedback=40.0)
    oscillators.start(0, gait, 0.8)
    heavy = (WEIGHT,) * 4
    for tick in range(1, 800):
        oscillators.step(tick * TICK, gait, 0.8, heavy)
    assert oscillators.now.phases == (Phase.STANCE,) * 4
    assert oscillators.now.fractions == pytest.approx((0.5,) * 4, abs=0.02)
    swung = set()
    for tick in range(800, 1200):
        oscillators.step(tick * TICK, gait, 0.8, (0.0, WEIGHT, WEIGHT, WEIGHT))
        swung |= {leg for leg, phase in enumerate(oscillators.now.phases) if phase is Phase.SWING}
    assert swung == {0}


def test_without_compensation_it_waits_near_take_off() -> None:
    gait, oscillators = GAITS["trot"], legs("tegotae", feedback=40.0, fixed_point_compensation=False)
    oscillators.start(0, gait, 0.8)
    for tick in range(1, 1200):
        oscillators.step(tick * TICK, gait, 0.8, (0.3 * WEIGHT,) * 4)
    point = tegotae.fixed_point(0.3 * WEIGHT, 40.0 / WEIGHT, TWO_PI * 0.8)
    assert point is not None
    standing = [f for f, p in zip(oscillators.now.fractions, oscillators.now.phases, strict=True) if p is Phase.STANCE]
    assert standing and standing == pytest.approx([(point + math.pi) / math.pi] * len(standing), abs=0.01)


def test_leg_that_cannot_lift_off_stands_again() -> None:
    gait, oscillators = GAITS["trot"], legs("tegotae", feedback=100.0, fixed_point_compensation=False)
    oscillators.start(0, gait, 0.8)
    oscillators.step(TICK, gait, 0.8)
    assert oscillators.next.phases[0] is Phase.SWING
    for tick in range(2, 6):
        oscillators.step(tick * TICK, gait, 0.8, (WEIGHT, 0.0, 0.0, WEIGHT))
    assert oscillators.next.phases[0] is Phase.STANCE
    assert oscillators.next.phases[1] is Phase.STANCE


def test_every_change_of_phase_is_flagged_one_tick_ahead() -> None:
    oscillators, random = legs("tegotae"), np.random.default_rng(0)
    oscillators.start(0, GAITS["trot"], 1.0)
    for tick in range(1, 1000):
        oscillators.step(tick * TICK, GAITS["trot"], 1.0, tuple(random.uniform(0.0, 2.0, 4)))
        changed = tuple(a is not b for a, b in zip(oscillators.now.phases, oscillators.next.phases, strict=True))
        assert oscillators.requested == changed or tick == 1
        assert all(0.0 <= fraction < 1.0 for fraction in oscillators.next.fractions)
        assert all(remaining > 0.0 for remaining in oscillators.next.remaining)


@pytest.mark.parametrize("weight", [0.0, -1.0, math.nan, math.inf])
def test_body_without_weight_is_refused(weight: float) -> None:
    with pytest.raises(ValueError, match="weight"):
        OscillatorLegs(TICK, "tegotae", OscillatorSettings(), weight)
