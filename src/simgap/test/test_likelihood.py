"""The one likelihood, and the probabilities that are made of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from robots import aligned_of, simulate

from simgap.effects.base import Context
from simgap.effects.library import enumerate_effects
from simgap.inference.decision import Class, by_block, probabilities
from simgap.inference.fit import Fitter
from simgap.inference.hypothesis import Fit, Hypothesis
from simgap.inference.likelihood import Likelihood
from simgap.inference.nuisance import enumerate_nuisances
from simgap.inference.residual import Residuals
from simgap.inference.scores import Scored
from simgap.inference.thresholds import TAIL
from simgap.inference.verdict import Verdict
from simgap.simulation.replay import Replayer
from simgap.simulation.scales import measure_scales
from simgap.simulation.variant import Variant
from simgap.simulation.windows import cut


def likelihood(windows: int, channels: int, independent: float = 8.0) -> Likelihood:
    return Likelihood(np.ones((windows, channels), bool), np.full(channels, independent))


def draws(windows: int, scales: list[float], n: int = 8, seed: int = 0) -> np.ndarray:
    """Mean squares of Student-t windows with given scales V."""
    rng = np.random.default_rng(seed)
    normal = rng.standard_normal((windows, len(scales), n))
    tail = rng.chisquare(TAIL, (windows, len(scales), 1)) / TAIL
    return (np.array(scales) * (normal**2 / tail).mean(axis=-1)).astype(float)


@pytest.mark.parametrize("scale", [1.0, 4.0, 400.0])
def test_the_scale_of_a_channel_is_found(scale: float) -> None:
    found = likelihood(400, 2).scale(draws(400, [scale, 50.0]))
    np.testing.assert_allclose(found, [scale, 50.0], rtol=0.15)


def test_a_channel_finer_than_its_noise_floor_has_no_discrepancy() -> None:
    assert likelihood(50, 1).scale(0.2 * draws(50, [1.0]))[0] == 1.0


def test_the_scale_is_the_likeliest() -> None:
    square = draws(40, [9.0, 2.0], seed=3)
    model = likelihood(40, 2)
    scale = model.scale(square)
    least = model.costs(square, scale).sum() + 0.5 * np.log(scale).sum()
    for factor in (0.8, 0.95, 1.05, 1.25):
        assert model.costs(square, scale * factor).sum() + 0.5 * np.log(scale * factor).sum() > least - 0.3


def test_the_density_is_one() -> None:
    """Of a single sample r: the integral of exp(-cost) does not depend on the scale."""
    r = np.linspace(-4000.0, 4000.0, 800_001)[:, None]
    model = likelihood(len(r), 1, independent=1.0)
    areas = [float(np.exp(-model.costs(r**2, np.array([v]))).sum() * (r[1, 0] - r[0, 0])) for v in (1.0, 5.0, 30.0)]
    np.testing.assert_allclose(areas, areas[0], rtol=1e-4)


@given(st.integers(0, 50))
def test_weights_are_the_slope_of_the_cost(seed: int) -> None:
    square, model = draws(12, [3.0, 30.0], seed=seed), likelihood(12, 2)
    step = 1e-4 * square[4, 1]
    up, down = square.copy(), square.copy()
    up[4, 1] += step
    down[4, 1] -= step
    scale = model.scale(square)
    slope = (model.costs(up, scale).sum() - model.costs(down, scale).sum()) / (2.0 * step)
    assert 2.0 * slope == pytest.approx(model.weights(square)[4, 1], rel=1e-3)


def test_a_held_out_window_has_no_say_in_its_own_scale() -> None:
    """One window that is far off costs the same whether its own fold is large or small, and more than in sample."""
    square, fold = draws(30, [1.0]), np.arange(30) % 3
    square[0, 0] = 1e4
    model = likelihood(30, 1)
    held = model.held_out(square, fold, np.repeat(square[None], 3, axis=0))
    others = model.scale(square, fold != 0)
    assert held[0] == pytest.approx(model.costs(square, others)[0, 0])
    assert np.isfinite(held).all()
    assert model.held_out(square, np.full(30, -1), np.zeros((0, 30, 1))).tolist() == pytest.approx(
        [np.nan] * 30, nan_ok=True
    )


def test_what_is_not_recorded_costs_nothing() -> None:
    square, model = draws(20, [4.0, 4.0]), likelihood(20, 2)
    model.recorded[:, 1] = False
    assert model.costs(square, model.scale(square))[:, 1].sum() == 0.0
    assert model.weights(square)[:, 1].sum() == 0.0


def test_probabilities_follow_held_out_costs_their_doubt_and_the_temperature() -> None:
    rng = np.random.default_rng(1)
    base = rng.uniform(1.0, 3.0, 30)
    blocks = np.arange(30) // 3
    costs = by_block(np.array([base, base + 0.4, base + 3.0]), blocks)
    sure = probabilities(costs, np.zeros(3), 1.0)
    assert sure.sum() == pytest.approx(1.0)
    assert sure[0] > 0.99
    assert probabilities(costs, np.zeros(3), 12.0)[1] > 0.2
    # The same lead from one block alone is less certain.
    lone = np.array([base, base])
    lone[1, :3] += 4.0
    assert 0.5 < probabilities(by_block(lone, blocks), np.zeros(2), 1.0)[0] < 0.999
    # What is dearer beforehand has to be better by that.
    np.testing.assert_allclose(
        probabilities(by_block(np.array([base, base]), blocks), np.array([0.0, np.log(3)]), 1.0), [0.75, 0.25]
    )


def test_the_probability_of_a_verdict_is_that_it_is_right() -> None:
    plant, aligned, floor = aligned_of("pendulum", simulate("pendulum", seconds=6.0))
    replayer = Replayer(plant, aligned, cut(aligned, 0.4, most=12), floor, 1)
    effects = enumerate_effects(Context(plant, measure_scales(replayer, Variant.nominal(plant))))
    kinds = {e.name: e for e in effects}
    none = np.zeros(0)
    one, two, three = (
        Fit(Hypothesis((kinds[name],)), none, none, 0.0, none, none)
        for name in ("coulomb_friction", "servo_gain", "armature")
    )
    found = [Class((fit,), p) for fit, p in ((one, 0.6), (two, 0.35), (three, 0.05))]
    best = Scored(one, 0.0, 1.0)
    verdict = Verdict("effect", best, probability=0.6, explained=0.5, classes=found, open=[one, two])
    assert verdict.sure == pytest.approx(0.6)
    assert replace(verdict, kind="ambiguous").sure == pytest.approx(0.95), "that it is one of the two named"
    assert replace(verdict, kind="unknown").sure == pytest.approx(0.7), "that what was found is not the whole"


def test_refreshing_sensitivities_leaves_those_alone_that_somebody_keeps() -> None:
    plant, aligned, floor = aligned_of("pendulum", simulate("pendulum", seconds=6.0))
    nominal = Variant.nominal(plant)
    replayer = Replayer(plant, aligned, cut(aligned, 0.4, most=12), floor, 1)
    size = np.sqrt((aligned.inputs**2).mean(axis=0))
    nuisances = enumerate_nuisances(plant, aligned.outputs.std(axis=0), size, aligned.period)
    fitter = Fitter(Residuals.build(replayer, nominal), nuisances)
    x, z = np.zeros(0), np.zeros(len(nuisances))
    residual = fitter.replay(Hypothesis(), [(x, z)])[0]
    kept, before = fitter.jacobian, fitter.jacobian.copy()
    fitter.refresh(Hypothesis(), x, z, residual)
    np.testing.assert_array_equal(kept, before)
    assert np.abs(fitter.jacobian).max() > 0.0
