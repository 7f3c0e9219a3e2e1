"""How far a fit leaves the robot where its start is not forgiven, and what it gains without its best block."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from robots import aligned_of, simulate

from simgap.effects.base import Context
from simgap.effects.library import enumerate_effects
from simgap.inference.fit import Fitter
from simgap.inference.hypothesis import Fit, Hypothesis
from simgap.inference.residual import Residuals
from simgap.inference.scores import Scores
from simgap.inference.stretches import STRETCH, Stretches
from simgap.simulation.replay import Replayer
from simgap.simulation.scales import measure_scales
from simgap.simulation.variant import Variant
from simgap.simulation.windows import cut

FRICTION, WINDOW = 0.12, 0.2


@pytest.fixture(scope="module")
def fitted() -> tuple[Fitter, Scores, Fit, Fit]:
    """Of an arm whose elbow rubs: the nominal model, and the truth, in windows shorter than a stretch."""

    def rubbing(model: mujoco.MjModel) -> None:
        model.dof_frictionloss[1] += FRICTION

    plant, aligned, floor = aligned_of("arm", simulate("arm", 8.0, change=rubbing))
    replayer = Replayer(plant, aligned, cut(aligned, WINDOW), floor, 1)
    fitter = Fitter(Residuals.build(replayer, Variant.nominal(plant)), [])
    context = Context(plant, measure_scales(replayer, Variant.nominal(plant)))
    known = {e.key: e for e in enumerate_effects(context, (), ("coulomb_friction",)) if not e.form}
    truth = Hypothesis((known["coulomb_friction@elbow"],))
    nominal, true = (
        fitter.cross_validate(fitter.fit(h, np.full(h.size, 0.05), np.zeros(0), 8)) for h in (Hypothesis(), truth)
    )
    return fitter, Scores(fitter), nominal, true


def test_a_stretch_is_left_alone_longer_than_a_window_and_errors_of_its_start_count(
    fitted: tuple[Fitter, Scores, Fit, Fit],
) -> None:
    fitter, scores, nominal, true = fitted
    replayer = fitter.residuals.replayer
    # By hand: where the nominal model is half a second after each window's start.
    floor, aligned = replayer.floor, replayer.aligned
    long = Replayer(replayer.plant, aligned, cut(aligned, STRETCH), floor, 1)
    simulated = long.run([Variant.nominal(replayer.plant)])[0]
    raw = (aligned.outputs[long.windows.rows()] - simulated) / floor
    assert scores.free_error(nominal) == pytest.approx(np.sqrt(np.expm1(np.log1p((raw**2).mean(1)).mean())), rel=0.25)
    assert scores.free_error(true) < 0.25 * scores.free_error(nominal)


def test_every_stretch_is_predicted_by_the_fit_that_has_not_seen_it(fitted: tuple[Fitter, Scores, Fit, Fit]) -> None:
    fitter, _, _, true = fitted
    error = Stretches(fitter).error(true)
    spoiled = Fit(**{f: getattr(true, f) for f in true.__dataclass_fields__})
    spoiled.x = 5.0 * true.x
    assert Stretches(fitter).error(spoiled) == error
    spoiled.fold_x = 5.0 * true.fold_x
    assert Stretches(fitter).error(spoiled) > 2.0 * error
    spoiled.fold_x = np.zeros((0, 1))
    assert np.isnan(Stretches(fitter).error(spoiled)), "nothing is known of one that was never held out"


def test_without_its_best_block_a_cause_gains_what_the_others_say(fitted: tuple[Fitter, Scores, Fit, Fit]) -> None:
    fitter, scores, nominal, true = fitted
    blocks = fitter.windows.block
    gains = [float((nominal.held_cost - true.held_cost)[blocks == b].sum()) for b in np.unique(blocks)]
    total = scores.difference(nominal, true)[0]
    assert scores.without_best(nominal, true) == pytest.approx(total - max(gains))
    assert 0.0 < scores.without_best(nominal, true) < total
