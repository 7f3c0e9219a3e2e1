"""Non-linear least squares with confidence intervals, and a refusal where the data say nothing about a parameter."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import norm

Array = NDArray[np.float64]


class UnidentifiableError(ValueError):
    """The recording cannot tell a parameter; the message names it and what to record."""


@dataclass(frozen=True, slots=True)
class Unknown:
    """One parameter to find."""

    start: float
    lower: float
    upper: float
    needs: str
    """What a recording must hold for it to be found."""
    open_ended: bool = False
    """Whether a limit, or an interval as wide as the limits, is an answer too: so sharp that it does not matter."""


@dataclass(frozen=True, slots=True)
class Fit:
    """Estimates with what is left over."""

    values: dict[str, float]
    interval: dict[str, tuple[float, float]]
    """95 % confidence intervals. Residuals that hang together in time are accounted for (Newey and West)."""
    predicted: Array
    residuals: Array
    """Measured minus predicted [V], shape (n,)."""
    r_squared: float

    @property
    def residual_deviation(self) -> float:
        """Standard deviation of the residuals [V]."""
        return float(np.std(self.residuals))


def fit(
    unknowns: Mapping[str, Unknown],
    predict: Callable[[dict[str, float]], Array],
    measured: Array,
    correlated_samples: int,
    weight: Array | None = None,
) -> Fit:
    """Finds the parameters with which `predict` comes closest to `measured` [V].

    Args:
        unknowns: Parameters by name.
        predict: The model; shape (n,) [V].
        measured: Shape (n,) [V].
        correlated_samples: Over how many samples residuals may hang together, for the confidence intervals.
        weight: Of each sample's residual, shape (n,); all alike where not given.

    Raises:
        UnidentifiableError: The data say nothing about a parameter, or about it apart from another one.
    """
    names = list(unknowns)
    start = np.array([unknowns[name].start for name in names])
    lower = np.array([unknowns[name].lower for name in names])
    upper = np.array([unknowns[name].upper for name in names])
    scale = np.maximum(np.abs(start), 1e-3 * (upper - lower))

    weighing = np.ones_like(measured) if weight is None else weight

    def residuals(values: Array) -> Array:
        return weighing * (predict(dict(zip(names, values.tolist(), strict=True))) - measured)

    found = least_squares(residuals, np.clip(start, lower, upper), bounds=(lower, upper), x_scale=scale)
    jacobian = found.jac * scale
    _refuse_blind(names, unknowns, jacobian, float(np.std(weighing * measured)))
    covariance = _covariance(jacobian, found.fun, correlated_samples) * np.outer(scale, scale)
    deviation = np.sqrt(np.diag(covariance))
    width = norm.ppf(0.975) * deviation
    _refuse_vague(names, unknowns, found.x, width, lower, upper)
    middle = np.average(measured, weights=weighing**2)
    return Fit(
        values=dict(zip(names, found.x.tolist(), strict=True)),
        interval={
            name: (float(max(value - w, low)), float(min(value + w, high)))
            for name, value, w, low, high in zip(names, found.x, width, lower, upper, strict=True)
        },
        predicted=measured + found.fun / weighing,
        residuals=-found.fun / weighing,
        r_squared=1.0 - float(np.sum(found.fun**2) / np.sum((weighing * (measured - middle)) ** 2)),
    )


def _covariance(jacobian: Array, residuals: Array, lags: int) -> Array:
    """Newey and West's: valid also where neighbouring residuals are alike."""
    scores = jacobian * residuals[:, None]
    middle = scores.T @ scores
    for lag in range(1, min(lags, len(residuals) - 1) + 1):
        cross = scores[lag:].T @ scores[:-lag]
        middle += (1.0 - lag / (lags + 1.0)) * (cross + cross.T)
    inverse = np.linalg.pinv(jacobian.T @ jacobian)
    return np.asarray(inverse @ middle @ inverse)


def _refuse_blind(names: list[str], unknowns: Mapping[str, Unknown], jacobian: Array, spread: float) -> None:
    """Refuses where a change of the parameters, alone or together, changes nothing that was measured."""
    if not spread > 0.0:
        raise UnidentifiableError("the voltage never changes: nothing can be identified")
    effect = np.sqrt(np.mean(jacobian**2, axis=0)) / spread
    for name, size in zip(names, effect, strict=True):
        if size < 1e-6:
            raise UnidentifiableError(f"{name}: the recording says nothing about it; it needs {unknowns[name].needs}")
    _, singular, directions = np.linalg.svd(jacobian / np.linalg.norm(jacobian, axis=0), full_matrices=False)
    if singular[-1] < 1e-5 * singular[0]:
        mixed = [name for name, share in zip(names, directions[-1], strict=True) if abs(share) > 0.2]
        needs = "; ".join(dict.fromkeys(unknowns[name].needs for name in mixed))
        raise UnidentifiableError(f"{', '.join(mixed)}: the recording cannot tell them apart; it needs {needs}")


def _refuse_vague(
    names: list[str], unknowns: Mapping[str, Unknown], values: Array, width: Array, lower: Array, upper: Array
) -> None:
    """Refuses where an interval is as wide as all that is allowed, or the estimate ran into its limit."""
    for name, value, w, low, high in zip(names, values, width, lower, upper, strict=True):
        if unknowns[name].open_ended:
            continue
        at_limit = min(value - low, high - value) < 1e-6 * (high - low) and low != 0.0
        if not np.isfinite(w) or 2.0 * w > high - low or at_limit:
            raise UnidentifiableError(
                f"{name}: {value:.3g} +- {w:.2g} is no estimate (allowed {low:.3g} to {high:.3g}); "
                f"it needs {unknowns[name].needs}"
            )
