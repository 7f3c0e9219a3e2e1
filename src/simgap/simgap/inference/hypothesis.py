"""A hypothesis, which effects act together, and what fitting one gives."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from simgap.effects.base import Effect
from simgap.inference.nuisance import BOX

Array = NDArray[np.float64]

_STATED_TAIL = 2.0
"""Degrees of freedom of the prior of what somebody has stated."""
_SEVERAL = 2
"""One nominal number may be as far off as its prior lets it; of several, another effect may hide in them."""


@dataclass(frozen=True)
class Hypothesis:
    """A set of effects that act together; none of them is the nominal model with its nuisances."""

    effects: tuple[Effect, ...] = ()

    @property
    def key(self) -> str:
        """Names of the effects."""
        return " + ".join(sorted(repr(e) for e in self.effects)) or "nuisances only"

    @property
    def size(self) -> int:
        """Number of parameters of the effects."""
        return sum(len(e.parameters) for e in self.effects)

    @property
    def grows(self) -> bool:
        """Whether the model changes over the recording."""
        return any(e.grows for e in self.effects)

    def vector(self, attribute: str) -> Array:
        """An attribute of all parameters in order."""
        return np.array([getattr(p, attribute) for e in self.effects for p in e.parameters], float)

    def scaled(self, x: Array) -> Array:
        """Values (..., nx) in steps of their scales: what Gauss-Newton moves. Of factors the logarithm."""
        log, scale = self.vector("log") > 0, np.maximum(self.vector("scale"), 1e-300)
        found: Array = np.where(log, np.log(np.where(log, x, 1.0)), x) / scale
        return found

    def values(self, scaled: Array) -> Array:
        """`scaled` taken back, within the bounds."""
        log, steps = self.vector("log") > 0, scaled * np.maximum(self.vector("scale"), 1e-300)
        found = np.where(log, np.exp(np.where(log, steps, 0.0)), steps)
        return np.clip(found, self.vector("low"), self.vector("high"))

    def slope(self, x: Array) -> Array:
        """Change (nx,) of the values by one scaled step at x."""
        return np.where(self.vector("log") > 0, x, 1.0) * self.vector("scale")

    def away(self, x: Array) -> Array:
        """Distances (nx,) of values from neutral, in the logarithm of factors."""
        found: Array = (self.scaled(x) - self.scaled(self.vector("neutral"))) * self.vector("scale")
        return found

    def implausible(self, x: Array) -> float:
        """How far [nats] values are from what somebody has stated of them.

        What an effect's parts have in common may be far off, as a unit or a gear that was forgotten is (Student-t);
        what they differ by is not.
        """
        spread = self.vector("spread")
        if not np.isfinite(spread).any():
            return 0.0
        ends = np.cumsum([len(e.parameters) for e in self.effects])[:-1]
        stated, away = np.split(np.isfinite(spread), ends), np.split(self.away(x) / spread, ends)
        found = 0.0
        for told, part in zip(stated, away, strict=True):
            common = float(part[told].mean()) if told.any() else 0.0
            found += 0.5 * float(((part[told] - common) ** 2).sum())
            found += 0.5 * (_STATED_TAIL + 1.0) * math.log1p(common**2 / _STATED_TAIL)
        return found

    def pull(self) -> Array:
        """Normal matrix (nx, nx), in scaled steps, of the prior that ties values of like parts to each other."""
        found, scale, first = np.zeros((self.size, self.size)), self.vector("scale"), 0
        for effect in self.effects:
            own = slice(first, first := first + len(effect.parameters))
            if effect.tie:
                apart = (np.eye(len(scale[own])) - 1.0 / len(scale[own])) * scale[own] / effect.tie
                found[own, own] = apart.T @ apart
        return found

    def tied(self, x: Array) -> float:
        """Cost [nats] of how far values of like parts are from what they have in common."""
        if not any(e.tie for e in self.effects):
            return 0.0
        u = self.scaled(x)
        return 0.5 * float(u @ self.pull() @ u)

    def with_effect(self, effect: Effect) -> Hypothesis:
        """With one effect more."""
        return Hypothesis((*self.effects, effect))


@dataclass
class Fit:
    """A fitted hypothesis.

    Attributes:
        x: values of the effects' parameters.
        z: nuisances [standard deviations of their priors].
        cost: data term plus prior term over the fitted windows.
        residual: (nw, ns, nl) at (x, z).
        effect_jacobian: (ne, nw, ns, nl) by scaled parameter.
        held: (nw, nl) mean squares of each window under the fit that has not seen its fold; NaN where never held out.
        held_cost: (nw,) minus its log density under that fit and the scales of the windows that it has seen.
        fold_x, fold_z: (nf, ne) and (nf, nz) values of each fold's fit.
        covariance: of x.
        likelihood: (nw,) held-out cost [nats] of every window, of an effect that predicts its own scatter.
        hidden: of such an effect, what the data would gain if nominal numbers might be off twice as far, as a share of
            what the effect gains.
        polished: whether it went on from an end with sensitivities that were taken there.
    """

    hypothesis: Hypothesis
    x: Array
    z: Array
    cost: float
    residual: Array
    effect_jacobian: Array
    held: Array = field(default_factory=lambda: np.zeros((0, 0)))
    held_cost: Array = field(default_factory=lambda: np.zeros(0))
    fold_x: Array = field(default_factory=lambda: np.zeros((0, 0)))
    covariance: Array = field(default_factory=lambda: np.zeros((0, 0)))
    fold_z: Array = field(default_factory=lambda: np.zeros((0, 0)))
    likelihood: Array | None = None
    hidden: float = 0.0
    polished: bool = False

    @property
    def prior(self) -> float:
        """Cost of the nuisances, and of what is tied."""
        return 0.5 * float(self.z @ self.z) + self.hypothesis.tied(self.x)

    @property
    def strained(self) -> list[int]:
        """Nuisances at the end of their box; empty for fewer than two."""
        found = np.flatnonzero(np.abs(self.z) > 0.999 * BOX).tolist()
        return found if len(found) >= _SEVERAL else []
