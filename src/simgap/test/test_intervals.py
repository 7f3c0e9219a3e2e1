"""The intervals of a fit: a parameter's deviation is what its fits scatter by."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from robots import aligned_of, simulate
from scipy.stats import truncnorm

from simgap.effects.base import Context
from simgap.effects.library import enumerate_effects
from simgap.inference.deviations import LAW, parameter_deviation
from simgap.inference.fit import Fitter
from simgap.inference.hypothesis import Fit, Hypothesis
from simgap.inference.nuisance import BOX, enumerate_nuisances
from simgap.inference.residual import Residuals
from simgap.simulation.replay import Replayer
from simgap.simulation.scales import measure_scales
from simgap.simulation.variant import Variant
from simgap.simulation.windows import cut

Array = NDArray[np.float64]

BLOCKS = 8
"""Independent pieces of noise in a window."""


@pytest.fixture(scope="module")
def about_nominal() -> tuple[Fitter, Fit]:
    """A pendulum's fitter with all sensitivities about the nominal model, and the fit there of friction and damping."""
    plant, aligned, floor = aligned_of("pendulum", simulate("pendulum", seconds=8.0))
    nominal = Variant.nominal(plant)
    replayer = Replayer(plant, aligned, cut(aligned, 0.4, most=16), floor, 1)
    swing, size = aligned.outputs.std(axis=0), np.sqrt((aligned.inputs**2).mean(axis=0))
    fitter = Fitter(Residuals.build(replayer, nominal), enumerate_nuisances(plant, swing, size, aligned.period))
    context = Context(plant, measure_scales(replayer, nominal), {})
    effects = enumerate_effects(context, (), ("coulomb_friction", "viscous_friction"))
    hypothesis = Hypothesis(tuple(e for e in effects if e.site.name == "hinge"))
    x, z = hypothesis.vector("neutral") + 0.5 * hypothesis.vector("scale"), np.zeros(len(fitter.nuisances))
    residual = fitter.replay(hypothesis, [(x, z)])[0]
    fitter.refresh(hypothesis, x, z, residual)
    fitter.likelihood.independent[:] = BLOCKS
    return fitter, Fit(hypothesis, x, z, 0.0, residual, fitter.sensitivities(hypothesis, x, z, residual))


@pytest.mark.parametrize("size", [0.7, 1.0, 3.0])
def test_covariance_is_that_of_fits_to_noise_and_random_nominal_numbers(
    about_nominal: tuple[Fitter, Fit], size: float
) -> None:
    """Fits to recordings that are linear in everything scatter as said, whatever the noise is in noise floors."""
    fitter, fit = about_nominal
    assert _said_over_scatter(fitter, fit, size) == pytest.approx(1.0, abs=0.12)


def test_a_number_that_was_left_out_may_be_off_all_the_same(
    about_nominal: tuple[Fitter, Fit], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The servo's rate gain, which works like the drag that is sought, and in the fit counts for nothing."""
    fitter, fit = about_nominal
    nuisances, jacobian = fitter.nuisances, fitter.jacobian
    which = np.array([n.name == "rate gain servo" for n in nuisances])
    left = jacobian[which].copy()
    try:
        fitter.left_out = [n for n, out in zip(nuisances, which, strict=True) if out]
        fitter.nuisances = [n for n, out in zip(nuisances, which, strict=True) if not out]
        fitter.jacobian = jacobian[~which]
        less = Fit(fit.hypothesis, fit.x, fit.z[~which], 0.0, fit.residual, fit.effect_jacobian)
        np.testing.assert_allclose(fitter._left_out_jacobian(less), left, atol=1e-3 * np.abs(left).max())
        assert len(fitter.nuisances) == len(nuisances) - 1
        ratio = np.sqrt(np.diag(fitter.covariance(less)) / np.diag(fitter.covariance(less, thorough=True)))
        assert ratio.min() < 0.8, "what is said without it is too narrow"
        # Of residuals that are drawn no replay knows.
        monkeypatch.setattr(fitter, "_left_out_jacobian", lambda fit: left)
        assert _said_over_scatter(fitter, less, 1.0, left) == pytest.approx(1.0, abs=0.12)
    finally:
        fitter.left_out, fitter.nuisances, fitter.jacobian = [], nuisances, jacobian


def _said_over_scatter(fitter: Fitter, fit: Fit, size: float, left: Array | None = None) -> Array:
    """Deviations (nx,) as the covariance has them, over what fits to noise of a ``size`` in noise floors scatter by.

    ``left`` are sensitivities to numbers that are random, too, but not fitted.
    """
    rng = np.random.default_rng(5)
    nx, nz = len(fit.x), len(fit.z)
    windows, samples, channels = fit.residual.shape
    scale, wide = fit.hypothesis.vector("scale"), np.full(nx, 1e3)
    errors, said = [], []
    for _ in range(300):
        noise = size * rng.standard_normal((windows, BLOCKS, channels))
        noise = noise.repeat(-(-samples // BLOCKS), axis=1)[:, :samples]
        truth = truncnorm.rvs(-BOX, BOX, size=nz, random_state=rng)
        if left is not None:
            noise = noise + np.tensordot(truncnorm.rvs(-BOX, BOX, size=len(left), random_state=rng), left, 1)
        dx, z = np.zeros(nx), np.zeros(nz)
        for _ in range(6):
            residual = noise + np.tensordot(dx, fit.effect_jacobian, 1) + np.tensordot(z - truth, fitter.jacobian, 1)
            step_x, step_z, _ = fitter.solve(residual, fit.effect_jacobian, z, -wide, wide)
            dx, z = dx + step_x, z + step_z
        errors.append(dx)
        made = Fit(fit.hypothesis, fit.x, z, 0.0, residual, fit.effect_jacobian)
        said.append(np.diag(fitter.covariance(made, thorough=left is not None)) / scale**2)
    ratio: Array = np.sqrt(np.mean(said, axis=0)) / np.sqrt(np.mean(np.square(errors), axis=0))
    return ratio


def test_deviation_knows_folds_laws_and_the_time_step(about_nominal: tuple[Fitter, Fit]) -> None:
    """The larger of the fit's own and the folds' scatter; a share of the size for every effect beside it."""
    hypothesis = about_nominal[1].hypothesis
    x = hypothesis.vector("neutral") + 4.0 * hypothesis.vector("scale")
    fit = Fit(hypothesis, x, np.zeros(0), 0.0, np.zeros(0), np.zeros(0))
    fit.covariance = np.diag([(0.3 * x[0]) ** 2, 0.0])
    fit.fold_x = np.array([[x[0], 0.9 * x[1]], [x[0], 1.1 * x[1]]])
    law = LAW * 2
    assert parameter_deviation(fit) / x == pytest.approx([np.hypot(0.3, law), np.hypot(0.1, law)])
    fit.fold_x = fit.fold_x[:0]
    assert parameter_deviation(fit, timestep=0.5)[1] / x[1] == pytest.approx(law), "damping is no time"
    rough = np.sqrt(1.0 + 8.0)
    fit.fold_x = np.array([[x[0], 0.9 * x[1]], [x[0], 1.1 * x[1]]])
    assert parameter_deviation(fit, roughness=8.0) / x == pytest.approx(
        [np.hypot(rough * 0.3, law), np.hypot(rough * 0.1, law)]
    ), "the law's share is no matter of the data"


@pytest.mark.parametrize("roughness", [1.0, 2.0, 4.0, 8.0])
def test_the_least_of_twenty_points_on_rough_ground_lies_so_far_beside_the_truth(roughness: float) -> None:
    """A parabola of deviation 1 about a guess of deviation 1; points scatter twice as much as the least of twenty."""
    rng = np.random.default_rng(0)
    spread = np.sqrt(1.0 + roughness)
    guesses = rng.standard_normal(4000)
    points = 2.0 * spread * rng.standard_normal((4000, 20))
    costs = 0.5 * (points - guesses[:, None]) ** 2 + 2.0 * roughness * rng.standard_normal(points.shape)
    found = points[np.arange(4000), costs.argmin(axis=1)]
    assert np.sqrt(np.mean(found**2)) == pytest.approx(spread, rel=0.12)
