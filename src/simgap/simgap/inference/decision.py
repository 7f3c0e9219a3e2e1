"""From fitted hypotheses to probabilities: which of them, given what they predict of data that they have not seen.

Let E_h be the cost of hypothesis h: minus its held-out log density (`likelihood.py`), its nuisances' prior, its own,

    E_h = sum_w -log p(window w | fit without w) + z'z / 2 + sum over effects of log(kinds x sites of the kind) + ...

Then p(h) is proportional to exp(-E_h / L), averaged over Bayesian bootstraps of blocks of windows (pseudo-BMA+: Yao,
Vehtari, Simpson, Gelman 2018), so that what a few windows say is not taken for certain. L is the temperature: no law of
a library is quite what a robot has, and the wrong one may bend a little better; a share `thresholds.LAW_ERROR` of what
the weakest effect of the winner earns is counted as one nat, and never less than one.

Of a robot that lands valleys are rough, and where a fold's fit ends is chance (`Scores.roughness`). All share their
nominal numbers, so the cost in sample, which is less a matter of chance, stands for the held-out one, with a nat for
each parameter that learned of it; and L is never less than what of that is chance.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simgap.inference.hypothesis import Fit
from simgap.inference.model_selection import only_larger_group, special_case, surprise
from simgap.inference.scores import Scored, Scores, temperature
from simgap.inference.thresholds import LAW_ERROR, SPARSITY

Array = NDArray[np.float64]

_DRAWS = 400


@dataclass(frozen=True)
class Class:
    """Hypotheses that are the same answer: the same effects at the same sites, whatever their form.

    Or a law and its special case, or an effect at a part and at a group that adds nothing.

    Attributes:
        fits: the likeliest first.
        probability: of all of them together.
    """

    fits: tuple[Fit, ...]
    probability: float

    @property
    def names(self) -> frozenset[str]:
        """name@site of its effects; empty for nominal numbers alone."""
        return names(self.fits[0])

    def holds(self, named: frozenset[str]) -> bool:
        """Whether one of its hypotheses names exactly these effects."""
        return any(names(fit) == named for fit in self.fits)


def names(fit: Fit) -> frozenset[str]:
    """name@site of the effects of a fit."""
    return frozenset(e.key for e in fit.hypothesis.effects)


@dataclass(frozen=True)
class Evidence:
    """What the probabilities are computed from: all of it is told, so that others can weigh it anew.

    Attributes:
        answers: (nh,) number of the class that a hypothesis belongs to.
        costs: (nh, nb) cost of each block of windows, as `Scores.telling` has it [nats].
        prior: (nh,) cost of nominal numbers and parameters [nats].
        kinds: (nh,) cost of the effects' number, kinds and places [nats].
        stated: (nh,) cost of being far from what somebody has stated [nats].
        gain: what the weakest effect of the winner earns [nats].
        roughness: how much of a cost is chance, of a robot that lands (`Scores.roughness`) [nats].
    """

    answers: NDArray[np.int64]
    costs: Array
    prior: Array
    kinds: Array
    stated: Array
    gain: float
    roughness: float = 0.0

    def weights(self, law_error: float = LAW_ERROR, sparsity: float = SPARSITY, seed: int = 0) -> Array:
        """Probability (nh,) of each hypothesis."""
        heat = max(temperature(self.gain, law_error), self.roughness)
        # What somebody has stated is no law's matter: the temperature leaves it as it is.
        prior = self.prior + sparsity * self.kinds + heat * self.stated
        return probabilities(self.costs, prior, heat, seed)

    def told(self) -> dict[str, Any]:
        """``evidence`` of the report."""
        return {
            "answers": self.answers.tolist(),
            "costs": np.round(self.costs - self.costs.min(axis=0), 3).tolist(),
            "prior": np.round(self.prior, 3).tolist(),
            "kinds": np.round(self.kinds, 3).tolist(),
            "stated": np.round(self.stated, 3).tolist(),
            "gain": float(self.gain),
            "roughness": float(self.roughness),
            "unit": "nats",
        }

    @classmethod
    def of(cls, told: dict[str, Any]) -> Evidence:
        """From a report."""
        costs, prior, kinds, stated = (np.array(told[k], float) for k in ("costs", "prior", "kinds", "stated"))
        gain, roughness = float(told["gain"]), float(told.get("roughness", 0.0))
        return cls(np.array(told["answers"], np.int64), costs, prior, kinds, stated, gain, roughness)


def classes(
    pool: Sequence[Scored],
    reference: Scored,
    gain: float,
    sites: Counter[str],
    scores: Scores,
    blocks: NDArray[np.int64],
    seed: int,
) -> tuple[list[Class], Evidence]:
    """Hypotheses of a pool in classes, the likeliest first, and what their probabilities rest on.

    Args:
        pool: what was fitted, the winner of the search first; the same hypothesis may come twice.
        reference: nuisances only.
        gain: what the weakest effect of the winner earns [nats].
        sites: at how many sites each kind of effect can act.
        scores: what tells how well a fit predicts.
        blocks: (nw,) block of each window.
        seed: of the bootstrap.
    """
    fits = list({s.fit.hypothesis.key: s.fit for s in [*reversed(pool), reference, pool[0]]}.values())
    fits = [f for f in fits if (f.likelihood is None) == (pool[0].fit.likelihood is None)]
    costs = np.array([scores.telling(f) for f in fits])
    prior = np.array([f.prior + f.hypothesis.size for f in fits])
    if scores.missed_anyway:
        # The data tell nothing then: hypotheses are as likely as they were before.
        costs, prior = np.where(np.isfinite(costs), 0.0, costs), np.array([f.hypothesis.size for f in fits])
    number = np.array([len(f.hypothesis.effects) for f in fits])
    evidence = Evidence(
        np.zeros(len(fits), np.int64),
        by_block(costs, blocks),
        prior,
        np.array([surprise(f, sites) for f in fits]) + np.log(max(len(sites), 1)) * number,
        np.array([f.hypothesis.implausible(f.x) for f in fits]),
        gain,
        scores.roughness,
    )
    weight = evidence.weights(seed=seed)
    groups: list[list[int]] = []
    for i in np.argsort(-weight):
        own = next((g for g in groups if _same(fits[g[0]], fits[i])), None)
        if own is None:
            groups.append([int(i)])
        else:
            own.append(int(i))
    groups.sort(key=lambda g: -float(weight[g].sum()))
    answers = np.zeros(len(fits), np.int64)
    for k, group in enumerate(groups):
        answers[group] = k
    found = [Class(tuple(fits[i] for i in g), float(weight[g].sum())) for g in groups]
    return found, replace(evidence, answers=answers)


def by_block(costs: Array, blocks: NDArray[np.int64]) -> Array:
    """Costs (nh, nb) of blocks from those (nh, nw) of windows; of the windows that all were scored in."""
    held = np.isfinite(costs).all(axis=0)
    number = np.unique(blocks[held], return_inverse=True)[1]
    count = int(number.max(initial=0)) + 1
    return np.stack([np.bincount(number, row[held], minlength=count) for row in costs])


def probabilities(costs: Array, prior: Array, temperature: float, seed: int = 0) -> Array:
    """Probability (nh,) of hypotheses from held-out costs (nh, nb) of blocks and prior costs (nh,), both [nats]."""
    count = costs.shape[1]
    draws = count * np.random.default_rng(seed).dirichlet(np.ones(count), _DRAWS)
    energy = (costs @ draws.T + prior[:, None]) / temperature
    weight = np.exp(energy.min(axis=0) - energy)
    mean: Array = (weight / weight.sum(axis=0)).mean(axis=1)
    return mean


def _same(one: Fit, two: Fit) -> bool:
    """Whether two fits are the same answer."""
    return names(one) == names(two) or any(
        special_case(a, b) or only_larger_group(a, b) for a, b in ((one, two), (two, one))
    )
