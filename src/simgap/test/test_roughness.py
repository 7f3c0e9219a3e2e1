"""How much of a score is chance, what stands for it then, and how sure that leaves an answer."""

from __future__ import annotations

import json

import numpy as np
import pytest
from robots import aligned_of, simulate

from simgap.effects.base import Context
from simgap.effects.library import enumerate_effects
from simgap.inference.decision import Evidence
from simgap.inference.fit import Fitter
from simgap.inference.hypothesis import Fit, Hypothesis
from simgap.inference.residual import Residuals
from simgap.inference.scores import Scores
from simgap.simulation.replay import Replayer
from simgap.simulation.scales import measure_scales
from simgap.simulation.variant import Variant
from simgap.simulation.windows import cut


@pytest.fixture(scope="module")
def made() -> tuple[Fitter, Scores, Fit, Fit]:
    """Of an arm: the nominal model, and friction at its elbow, both cross-validated."""
    plant, aligned, floor = aligned_of("arm", simulate("arm", 6.0))
    replayer = Replayer(plant, aligned, cut(aligned), floor, 1)
    fitter = Fitter(Residuals.build(replayer, Variant.nominal(plant)), [])
    context = Context(plant, measure_scales(replayer, Variant.nominal(plant)))
    (friction,) = (e for e in enumerate_effects(context, (), ("coulomb_friction",)) if e.key.endswith("@elbow"))
    nothing, rubbing = (
        fitter.cross_validate(fitter.fit(h, np.full(h.size, 0.05), np.zeros(0), 2))
        for h in (Hypothesis(), Hypothesis((friction,)))
    )
    return fitter, Scores(fitter), nothing, rubbing


def _make_rough(fitter: Fitter, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fitter, "lands", True)
    monkeypatch.setattr(fitter, "lost", [2.0, 5.0, 12.0, 30.0, 45.0])


def test_scores_are_as_rough_as_what_fits_lose_by_not_seeing_scatters(
    made: tuple[Fitter, Scores, Fit, Fit], monkeypatch: pytest.MonkeyPatch
) -> None:
    fitter, scores, *fits = made
    lost = [float(f.held_cost.sum() - fitter.seen(f).sum()) for f in fits]
    assert fitter.lost == pytest.approx(lost), "every cross-validated fit, in turn"
    monkeypatch.setattr(fitter, "lost", [2.0, 5.0, 12.0, 30.0, 45.0])
    assert scores.roughness == 0.0, "of a robot that touches nothing it is a law's fault"
    monkeypatch.setattr(fitter, "lands", True)
    # The median distance from the median, 12, is 10; of a normal distribution 0.6745 standard deviations.
    assert scores.roughness == pytest.approx(0.5 * 10.0 / 0.6745, rel=1e-3)
    monkeypatch.setattr(fitter, "lost", [7.0] * 5)
    assert scores.roughness == 0.0
    monkeypatch.setattr(fitter, "lost", [2.0, 5.0, 12.0])
    assert scores.roughness == 0.0, "three are too few"


def test_where_scores_are_rough_a_fit_is_told_by_what_it_saw_at_a_price_for_each_parameter(
    made: tuple[Fitter, Scores, Fit, Fit], monkeypatch: pytest.MonkeyPatch
) -> None:
    fitter, scores, *fits = made
    for fit in fits:
        np.testing.assert_array_equal(scores.telling(fit), fit.held_cost)
    _make_rough(fitter, monkeypatch)
    for fit in fits:
        by_hand = float(fitter.data_cost(fitter.mean_square(fit.residual))) + fit.hypothesis.size
        assert scores.telling(fit).sum() == pytest.approx(by_hand), "here every window was held out once"


def test_fits_that_ended_twice_say_how_rough_it_is(
    made: tuple[Fitter, Scores, Fit, Fit], monkeypatch: pytest.MonkeyPatch
) -> None:
    fitter, scores, *_ = made
    _make_rough(fitter, monkeypatch)
    by_folds = scores.roughness
    # The size of the difference of two normal variables is 0.6745 sqrt(2) standard deviations in the median.
    drawn = np.random.default_rng(0).normal(0.0, 3.0, (2, 4000))
    monkeypatch.setattr(scores, "ends", np.abs(drawn[0] - drawn[1]).tolist())
    assert scores.roughness == pytest.approx(3.0, rel=0.05)
    monkeypatch.setattr(scores, "ends", [0.1, 0.2, 0.3])
    assert scores.roughness == by_folds, "three are too few"
    monkeypatch.setattr(fitter, "lands", False)
    assert scores.roughness == 0.0


def test_where_fits_are_ranked_in_sample_the_score_is_what_is_told(
    made: tuple[Fitter, Scores, Fit, Fit],
) -> None:
    fitter, held_out, *fits = made
    in_sample = Scores(fitter, in_sample=True)
    for fit in fits:
        seen = float(fitter.data_cost(fitter.mean_square(fit.residual)))
        assert in_sample.costs(fit)[0] == pytest.approx(seen + fit.prior + 2 * fit.hypothesis.size)
        by_hand = float(np.nansum(fit.held_cost)) + fit.prior + fit.hypothesis.size
        assert held_out.costs(fit)[0] == pytest.approx(by_hand)


def test_where_scores_are_rough_what_is_left_is_what_a_fit_leaves_in_sample(
    made: tuple[Fitter, Scores, Fit, Fit], monkeypatch: pytest.MonkeyPatch
) -> None:
    fitter, scores, *fits = made
    for fit in fits:
        np.testing.assert_array_equal(scores.left(fit), fit.held)
    _make_rough(fitter, monkeypatch)
    for fit in fits:
        np.testing.assert_allclose(scores.left(fit), fitter.mean_square(fit.residual))
    assert scores.gap(scores.left(fits[1])) < scores.gap(fits[1].held), "friction was fitted to what it saw"
    # A window that no fold holds out is judged by neither.
    fits[0].held[0] = np.nan
    assert np.isnan(scores.left(fits[0])[0]).all()
    assert np.isfinite(scores.left(fits[0])[1:]).all()


@pytest.mark.parametrize(("roughness", "odds"), [(0.0, np.exp(-8.0)), (4.0, np.exp(-2.0)), (16.0, np.exp(-0.5))])
def test_nobody_is_surer_than_chance_allows(roughness: float, odds: float) -> None:
    # Eight nats in front, equally in all blocks; the gain is so small that a nat counts as one.
    costs, none = np.tile([[1.0], [3.0]], 4), np.zeros(2)
    evidence = Evidence(np.arange(2), costs, none, none, none, 1.0, roughness)
    first, second = Evidence.of(json.loads(json.dumps(evidence.told()))).weights()
    assert second / first == pytest.approx(odds, rel=0.05)
