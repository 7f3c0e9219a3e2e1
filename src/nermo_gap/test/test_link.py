"""Links that lose and delay, against many simulated ones; and effects that grow with time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from robots import aligned_of, simulate

from nermo_gap.core.effects.base import Context, Effect
from nermo_gap.core.effects.growing import Growing
from nermo_gap.core.fit import Fitter, Hypothesis
from nermo_gap.core.library import enumerate_effects
from nermo_gap.core.replay import Replayer
from nermo_gap.core.residual import Residuals
from nermo_gap.core.scales import measure_scales
from nermo_gap.core.signal_path import shape_inputs
from nermo_gap.core.variant import Variant
from nermo_gap.core.windows import cut

Array = NDArray[np.float64]


def _effect(name: str, seconds: float = 6.0) -> tuple[Replayer, Effect]:
    plant, aligned, floor = aligned_of("pendulum", simulate("pendulum", seconds))
    replayer = Replayer(plant, aligned, cut(aligned), floor, 1)
    context = Context(plant, measure_scales(replayer, Variant.nominal(plant)))
    return replayer, enumerate_effects(context, only=(name,))[0]


def _acting(name: str, value: float) -> tuple[Array, Array, float]:
    """(recorded command, command that acts on average, period)."""
    replayer, effect = _effect(name)
    variant = Variant.nominal(replayer.plant)
    effect.apply(variant, (value,))
    return (
        replayer.aligned.inputs[:, 0],
        shape_inputs(replayer.aligned, [variant.inputs])[0, :, 0],
        replayer.aligned.period,
    )


def test_loss_is_the_mean_of_lossy_links() -> None:
    told, acting, _ = _acting("link_loss", 0.6)
    rng, runs = np.random.default_rng(0), np.empty((3000, len(told)))
    held = np.full(len(runs), told[0])
    for k, u in enumerate(told):
        held = np.where(rng.random(len(runs)) < 0.6, held, u)
        runs[:, k] = held
    error = np.abs(acting - runs.mean(axis=0))
    assert error.max() < 5 * (runs.std(axis=0) / np.sqrt(len(runs))).max()
    assert np.abs(told - acting).max() > 10 * error.max()


def test_jitter_is_the_mean_of_late_links() -> None:
    told, acting, period = _acting("link_jitter", 0.08)
    rows = np.arange(len(told), dtype=float)
    late = [np.interp(rows - d / period, rows, told) for d in np.linspace(0.0, 0.08, 200)]
    np.testing.assert_allclose(acting, np.mean(late, axis=0), atol=0.002 * np.ptp(told))


def test_growth_makes_the_model_change_over_the_recording() -> None:
    replayer, friction = _effect("coulomb_friction", 8.0)
    fitter = Fitter(Residuals.build(replayer, Variant.nominal(replayer.plant)), [])
    grown, none = Growing(friction, 8.0), np.zeros(0)
    plain, steady, growing = (
        fitter.replay(Hypothesis((effect,)), [(np.array(x), none)])[0]
        for effect, x in ((friction, [0.1]), (grown, [0.1, 0.0]), (grown, [0.1, 0.02]))
    )
    np.testing.assert_array_equal(plain, steady)
    moved = np.abs(growing - plain).mean(axis=(1, 2))
    assert moved[0] > 3 * moved[len(moved) // 2] and moved[-1] > 3 * moved[len(moved) // 2]
    # In a part of the windows it is what it is in all of them.
    select = np.array([0, 5, 7])
    some = fitter.replay(Hypothesis((grown,)), [(np.array([0.1, 0.02]), none)], select)[0]
    np.testing.assert_array_equal(some, growing[select])
