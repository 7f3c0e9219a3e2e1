"""The cells' laws against C's numbers, against their inverses, and against what any such cell must do."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nermo_sensors.cells.piezoelectric import (
    ChargeResponse,
    PiezoelectricParameters,
    RateAccelerationResponse,
    RateResponse,
)
from nermo_sensors.cells.piezoresistive import (
    LinearConductance,
    PiezoresistiveParameters,
    Sigmoid,
    SigmoidPair,
    SoftConductance,
)
from nermo_sensors.identification.piezoresistive import reversal
from nermo_sensors.models.foot import TactileFeet
from nermo_sensors.models.hysteresis import Creep, LoopPlays, PlayHysteresis
from nermo_sensors.parameters import TactileParameters, load_tactile, tactile_names, tactile_of_robot

C_CELL = LinearConductance(1.01e-5, 4.14e-5, 4.14e-5 + 1.01e-5 * 31.5)
FORCES = st.floats(min_value=-5.0, max_value=40.0)


def test_linear_conductance_of_the_chosen_cell() -> None:
    assert C_CELL.saturation_force == pytest.approx(31.5)
    assert 1.0 / C_CELL.conductance(0.0) == pytest.approx(25e3, rel=0.05)
    assert C_CELL.conductance(100.0) == C_CELL.conductance(31.5)
    assert LinearConductance(1e-5, -2e-5, 1e-4).conductance(1.0) == 0.0


def test_linear_conductance_is_inverted_only_where_it_tells_the_force() -> None:
    assert C_CELL.force(C_CELL.conductance(12.0)) == pytest.approx(12.0)
    assert math.isnan(C_CELL.force(C_CELL.saturated))


@given(FORCES)
def test_soft_conductance_is_inverted(force: float) -> None:
    law = SoftConductance(2e-5, 4e-5, 10.0, 2.0)
    assert law.force(law.conductance(force)) == pytest.approx(force, abs=1e-4)


@given(FORCES)
def test_soft_conductance_has_the_slope_that_it_says(force: float) -> None:
    law, step = SoftConductance(2e-5, 4e-5, 10.0, 2.0), 1e-4
    difference = (law.conductance(force + step) - law.conductance(force - step)) / (2.0 * step)
    assert law.slope(force) == pytest.approx(difference, rel=1e-4, abs=1e-11)


def test_soft_conductance_is_the_linear_one_away_from_the_corner() -> None:
    soft, hard = SoftConductance(1.01e-5, 4.14e-5, 31.5, 0.5), C_CELL
    for force in (0.0, 10.0, 25.0, 40.0):
        assert soft.conductance(force) == pytest.approx(hard.conductance(force), rel=1e-5)
    assert math.isinf(soft.force(soft.saturated * 1.01))


@given(FORCES)
def test_sigmoid_is_inverted_and_has_its_slope(x: float) -> None:
    sigmoid, step = Sigmoid(4.0, -0.3, -6.0, 0.9), 1e-4
    assert sigmoid.inverse(sigmoid.value(x)) == pytest.approx(x, abs=1e-5)
    difference = (sigmoid.value(x + step) - sigmoid.value(x - step)) / (2.0 * step)
    assert sigmoid.slope(x) == pytest.approx(difference, rel=1e-4, abs=1e-9)


@given(FORCES, st.floats(min_value=-300.0, max_value=300.0))
def test_sigmoid_pair_has_the_gradient_that_it_says(force: float, rate: float) -> None:
    pair, step = SigmoidPair(Sigmoid(4.0, -0.6, -6.0, 0.9), Sigmoid(4.2, -0.5, -4.0, 0.8), -0.05), 1e-4
    by_force = (pair.voltage(force + step, rate) - pair.voltage(force - step, rate)) / (2.0 * step)
    by_rate = (pair.voltage(force, rate + step) - pair.voltage(force, rate - step)) / (2.0 * step)
    assert pair.gradient(force, rate) == (
        pytest.approx(by_force, rel=1e-4, abs=1e-8),
        pytest.approx(by_rate, rel=1e-4, abs=1e-8),
    )


def test_sigmoid_pair_takes_the_branch_of_the_rate() -> None:
    rising, falling = Sigmoid(4.0, -0.6, -6.0, 0.9), Sigmoid(4.0, -0.6, -4.0, 0.9)
    pair = SigmoidPair(rising, falling, -1.0)
    assert pair.voltage(5.0, 100.0) == pytest.approx(rising.value(5.0))
    assert pair.voltage(5.0, -100.0) == pytest.approx(falling.value(5.0))


def test_play_hysteresis_lags_by_the_sum_of_weight_times_slack() -> None:
    cell = PlayHysteresis([1.0, 2.0], [0.2, 0.3])
    up = [cell.step(force) for force in np.linspace(0.0, 20.0, 50)][-1]
    down = [cell.step(force) for force in (25.0, 20.0)][-1]
    assert up == pytest.approx(20.0 - 0.2 * 1.0 - 0.3 * 2.0)
    assert down == pytest.approx(20.0 + 0.2 * 1.0 + 0.3 * 2.0)


@given(st.lists(st.floats(min_value=0.0, max_value=30.0), min_size=2, max_size=20))
def test_play_hysteresis_does_not_depend_on_speed(path: list[float]) -> None:
    coarse, fine = PlayHysteresis([1.0, 3.0], [0.2, 0.2]), PlayHysteresis([1.0, 3.0], [0.2, 0.2])
    previous = 0.0
    for force in path:
        felt = coarse.step(force)
        for between in np.linspace(previous, force, 7)[1:]:
            last = fine.step(between)
        assert last == pytest.approx(felt, abs=1e-9)
        previous = force


def felt_by(plays: LoopPlays, path: list[float]) -> tuple[list[float], np.ndarray]:
    """What plays feel along forces [N], and where they end; rested at no load."""
    places, felt = np.zeros((1, len(plays.slacks))), []
    for force in path:
        places = plays.step(places, np.array([force]))
        felt.append(plays.elastic * force + plays.weight * float(places.sum()))
    return felt, places


@pytest.mark.parametrize("count", [4, 12])
def test_plays_have_the_loop_that_was_calibrated(count: int) -> None:
    """Between reversals far apart, Dahl's law of the same two numbers; nearer with more plays."""
    path = np.concatenate([np.linspace(0.0, 20.0, 800), np.linspace(20.0, 0.0, 800)])
    felt, _ = felt_by(LoopPlays.of_loop(0.8, 2.4, count), path.tolist())
    error = np.array(felt) - path - 0.8 * reversal(path, 2.4)
    assert np.abs(error[400:]).max() < 0.8 * 0.8 / count
    assert felt[-1] == pytest.approx(0.8, abs=1e-3)


@given(st.floats(1.0, 8.0), st.lists(st.floats(0.0, 1.0), min_size=1, max_size=10))
def test_plays_come_back_after_smaller_loops(turn: float, inner: list[float]) -> None:
    """A bounce on the way leaves no trace: the load passes the turn again as if there had been none."""
    plays = LoopPlays.of_loop(0.8, 2.4, 4)
    plain, places = felt_by(plays, [10.0, turn])
    bounced, others = felt_by(plays, [10.0, turn, *(turn + share * (10.0 - turn) for share in inner), turn])
    assert bounced[-1] == pytest.approx(plain[-1], abs=1e-9)
    np.testing.assert_allclose(others, places, atol=1e-9)


@pytest.mark.parametrize("numbers", [(-0.1, 1.0, 4), (0.1, 0.0, 4), (0.1, 1.0, 0)])
def test_loops_that_are_none_are_refused(numbers: tuple[float, float, int]) -> None:
    with pytest.raises(ValueError, match="half_width"):
        LoopPlays.of_loop(*numbers)


def test_creep_builds_up_to_gain_times_load() -> None:
    creep = Creep([0.01], [40.0])
    levels = [creep.step(10.0, 1.0) for _ in range(400)]
    assert levels[39] == pytest.approx(0.1 * (1.0 - math.exp(-1.0)), rel=1e-6)
    assert levels[-1] == pytest.approx(0.1, rel=1e-3)


def test_rate_response_is_inverted() -> None:
    law = RateResponse(0.01, 0.2)
    assert law.rate(law.voltage(-35.0)) == pytest.approx(-35.0)


def test_thesis_gains_fall_to_1_over_e() -> None:
    law = RateAccelerationResponse(0.01, 20.0, -1e-4, 30.0)
    assert law.gains(20.0)[0] == pytest.approx(0.01 / math.e)
    assert law.gains(30.0)[1] == pytest.approx(-1e-4 / math.e)


@pytest.mark.parametrize("hertz", [0.5, 2.0, 4.0])
def test_charge_amplifier_answers_to_rate_and_acceleration(hertz: float) -> None:
    """For a sine, gain leak / (1 + w^2 leak^2) times (F' - leak F''): both gains fall with w, as C finds."""
    law, period, w = ChargeResponse(0.1, 0.08), 1e-4, 2.0 * math.pi * hertz
    time = np.arange(0.0, 2.0, period)
    force, charge, voltage = np.sin(w * time), 0.0, []
    for change in np.diff(force, prepend=force[0]):
        charge = law.advance(charge, change, period)
        voltage.append(law.voltage(charge, 0.0))
    expected = 0.1 * 0.08 / (1.0 + (w * 0.08) ** 2) * (w * np.cos(w * time) + 0.08 * w * w * np.sin(w * time))
    np.testing.assert_allclose(voltage[15000:], expected[15000:], atol=2e-3 * np.max(expected))


@pytest.mark.parametrize("name", tactile_names())
def test_feet_saturate_with_hysteresis_and_noise(name: str) -> None:
    parameters = load_tactile(name)
    full = 2.8 * parameters.cell(PiezoresistiveParameters).saturation_force
    feet = TactileFeet(parameters, feet=1, seed=3)
    ramp = np.concatenate([np.linspace(0.0, full, 400), np.linspace(full, 0.0, 400)])
    static = np.array([feet.read([force], 0.005)["piezoresistive"][0] for force in ramp])
    rising, falling = static[:400], static[:399:-1]
    low = slice(40, 120)
    assert np.mean(falling[low] - rising[low]) > 10.0 * parameters.cell(PiezoresistiveParameters).noise
    assert np.std(np.diff(rising[300:])) > 0.0
    assert abs(rising[390:].mean() - rising[300:310].mean()) < 0.05


def test_feet_are_repeatable_and_forget_when_cleared() -> None:
    feet = TactileFeet(seed=5)
    first = [feet.read([0.1, 0.2, 0.3, 1.0 + 0.1 * k], 0.005) for k in range(5)]
    feet.clear()
    assert [feet.read([0.1, 0.2, 0.3, 1.0 + 0.1 * k], 0.005) for k in range(5)] == first


def test_dynamic_cell_without_preload_misses_light_touches() -> None:
    """C 4.3.2.2: before preload, no simple relation could be found."""
    parameters = load_tactile("cheetah_cub")
    cell = parameters.cell(PiezoelectricParameters).model_copy(update={"preload": 0.0, "noise": 0.0, "bias": 0.0})
    loose = parameters.model_copy(update={"cells": parameters.cells.model_copy(update={"piezoelectric": cell})})
    reading = {}
    for name, p in (("loose", loose), ("preloaded", parameters)):
        feet = TactileFeet(p, feet=1)
        feet.read([0.0], 0.005)
        reading[name] = feet.read([0.9], 0.005)["piezoelectric"][0]
    assert abs(reading["loose"]) < 1e-3 < 0.05 < reading["preloaded"]


def test_warmth_raises_the_static_reading() -> None:
    cold, warm = TactileFeet(feet=1), TactileFeet(feet=1)
    warm.temperature += 20.0
    assert warm.read([1.0], 0.005)["piezoresistive"][0] > cold.read([1.0], 0.005)["piezoresistive"][0] + 0.05


@pytest.mark.parametrize("period", [0.0, -1.0, math.nan])
def test_feet_refuse_a_period_that_is_not_positive(period: float) -> None:
    with pytest.raises(ValueError, match="above 0"):
        TactileFeet().read([0.0] * 4, period)


@pytest.mark.parametrize("forces", [[0.0] * 3, [0.0, 1.0, math.nan, 0.0]])
def test_feet_refuse_forces_that_are_no_numbers(forces: list[float]) -> None:
    with pytest.raises(ValueError, match="4 finite numbers"):
        TactileFeet().read(forces, 0.005)


def test_robots_without_own_feet_have_the_default_ones() -> None:
    assert tactile_of_robot("somebody's").name == "nermo_lite"
    assert tactile_of_robot("nermo").cells == load_tactile("nermo_lite").cells


def test_bad_parameter_is_named() -> None:
    from nermo_sensors.parameters import ParameterError

    with pytest.raises(ParameterError, match="'mickey' are unknown; known are cheetah_cub"):
        load_tactile("mickey")
    data = load_tactile("nermo_lite").model_dump()
    data["noises"]["f1"]["force"] = -1.0
    with pytest.raises(ValueError, match="force"):
        TactileParameters.model_validate(data)
