"""The robot as it was when it was well: what a fault is looked for beside.

A robot's difference from its model is mostly constant. What nominal numbers, constant causes and the discrepancy of
each channel are is learnt from recordings of the healthy robot; what is new since then is the fault.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simgap.data.plant import Plant
from simgap.inference.budget import NUISANCES, Budget
from simgap.inference.familiar import Motion
from simgap.inference.fit import Fitter
from simgap.inference.hypothesis import Fit
from simgap.inference.nuisance import Nuisance
from simgap.inference.residual import Residuals
from simgap.inference.scores import Scored
from simgap.simulation.replay import Replayer
from simgap.simulation.variant import Variant

Array = NDArray[np.float64]

_LEAST = 0.1
"""Share of its prior's width that a nominal number keeps, however well the healthy robot tells it: it drifts."""
_OF_A_LOG = ("timing", "zero")
"""First words of nominal numbers that belong to a log (its clock, its sensors' zeros at power-up), not to the robot."""


@dataclass(frozen=True)
class Healthy:
    """What was learnt.

    Attributes:
        base: the model of the healthy robot, with all that was found constant.
        known: standard error of each nominal number, by name, in standard deviations of its prior.
        scale: (no,) how many noise floors the healthy robot leaves in each output where the model has not been
            fitted to it, at least 1.
        motion: where it has been.
        score: how well that predicts it, smaller is better [nats].
        report: for `reference` of the report.
    """

    base: Variant
    known: dict[str, float]
    scale: Array
    motion: Motion
    score: float
    report: dict[str, Any]

    def narrowed(self, nuisance: Nuisance) -> Nuisance:
        """A nominal number about what it was, as well as it is known."""
        if nuisance.name.split()[0] in _OF_A_LOG:
            return nuisance
        share = float(np.clip(np.sqrt(2.0) * self.known.get(nuisance.name, 1.0), _LEAST, 1.0))
        return nuisance.scaled(share)


def healthy(fitter: Fitter, scored: Scored, report: dict[str, Any]) -> Healthy:
    """What a cross-validated fit to the healthy robot says; ``report`` is passed on."""
    fit = scored.fit
    base = fitter.variant(fit.hypothesis, fit.x, fit.z)
    plant = replace(base.plant, model=base.model)
    scale = np.ones(len(plant.outputs))
    held = fitter.windows.fold >= 0
    scale[fitter.residuals.live] = np.sqrt(fitter.likelihood.scale(np.nan_to_num(fit.held), held))
    deviation = np.sqrt(np.diag(_covariance(fitter, fit)))
    known = {n.name: float(sd) for n, sd in zip(fitter.nuisances, deviation, strict=True)}
    base = replace(base, plant=plant)
    return Healthy(base, known, scale, Motion.of(fitter.residuals.replayer, base), scored.score, report)


def fitting(
    bases: Sequence[Healthy], replayer: Replayer, nuisances: Callable[[Plant], list[Nuisance]], budget: Budget
) -> Healthy:
    """Of what explains the healthy robot nearly as well, that which explains it and a new recording best.

    Args:
        bases: the best first.
        replayer: of the new recording, with the floor of its own noise.
        nuisances: what may be off about a model.
        budget: where the time for nominal numbers is spent, those that were not looked at are passed over.
    """
    if len(bases) == 1:
        return bases[0]
    costs: list[float] = []
    likelihood = None
    for base in bases:
        if costs and budget.spent(NUISANCES):
            break
        plant = base.base.plant
        own = Replayer(plant, replayer.aligned, replayer.windows, replayer.floor, replayer.threads)
        fitter = Fitter(Residuals.build(own, base.base), [base.narrowed(n) for n in nuisances(plant)], base.base)
        fit = fitter.fit_nuisances()
        # One count of independent samples for all.
        likelihood = likelihood or fitter.likelihood
        costs.append(base.score + float(likelihood.cost(fitter.mean_square(fit.residual))) + fit.prior)
    return bases[int(np.argmin(costs))]


def _covariance(fitter: Fitter, fit: Fit) -> Array:
    """Of the nominal numbers (nn, nn), beside the effects."""
    ne = len(fit.x)
    weights = fitter.weights(fitter.mean_square(fit.residual))
    root = np.broadcast_to(np.sqrt(weights)[:, None, :], fit.residual.shape).reshape(-1)
    rows = np.concatenate([fit.effect_jacobian, fitter.jacobian]).reshape(ne + len(fit.z), -1) * root
    normal = rows @ rows.T + np.diag(np.r_[np.full(ne, 1e-6), np.ones(len(fit.z))])
    found: Array = np.linalg.inv(normal)[ne:, ne:]
    return found
