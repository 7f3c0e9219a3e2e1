"""Do runs agree? What each says about the parameters of the causes that were found in all of them together."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2, norm

from simgap.inference.fit import Fitter
from simgap.inference.hypothesis import Fit
from simgap.simulation.windows import Windows

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

_FEW = 2
"""Windows that a part needs."""
_REACH = 3.0
"""Scaled steps by which a part may be away from the whole."""
LAW = 0.03
"""Standard error of a parameter as a share of its size, beside what the data say: a law of the library fits a robot
about, and elsewhere in its range a little differently."""
DISAGREE = 0.01
"""Probability of such a scatter by chance under which runs are said to disagree."""
_CI90 = float(norm.ppf(0.95))


@dataclass(frozen=True)
class Part:
    """A run, or half of a recording of fewer than two.

    Attributes:
        name: what it is called.
        values, deviation: (nx,) of the parameters, from its windows alone and the nominal numbers' priors.
    """

    name: str
    values: Array
    deviation: Array


def parts(fitter: Fitter, fit: Fit) -> list[Part]:
    """What each part says, by one Gauss-Newton step from what all say together; none where nothing was found."""
    if not len(fit.x):
        return []
    hypothesis, found = fit.hypothesis, []
    u, slope = hypothesis.scaled(fit.x), hypothesis.slope(fit.x)
    low, high = (hypothesis.scaled(hypothesis.vector(end)) for end in ("low", "high"))
    bounds = np.maximum(low - u, -_REACH), np.minimum(high - u, _REACH)
    ne = len(fit.x)
    for name, select in _divided(fitter).items():
        step, _, normal = fitter.solve(
            fit.residual[select], fit.effect_jacobian[:, select], fit.z, *bounds, select, tied=(u, hypothesis.pull())
        )
        own = np.sqrt(np.maximum(np.diag(np.linalg.inv(normal))[:ne], 0.0)) * np.abs(slope)
        law = LAW * np.minimum(np.abs(fit.x - hypothesis.vector("neutral")), np.abs(fit.x))
        found.append(Part(name, hypothesis.values(u + step), np.hypot(own, law)))
    return found


def _divided(fitter: Fitter) -> dict[str, Ints]:
    windows, runs = fitter.windows, fitter.residuals.replayer.aligned.runs
    label = np.array([_label(windows, fitter, w) for w in range(len(windows))])
    names = {run.label: f"run {run.name}" for run in runs}
    by_run = {name: np.flatnonzero(label == value) for value, name in names.items()}
    by_run = {name: rows for name, rows in by_run.items() if len(rows) >= _FEW}
    if len(by_run) > 1:
        return by_run
    half = np.arange(len(windows)) < len(windows) // 2
    return {"first half": np.flatnonzero(half), "second half": np.flatnonzero(~half)}


def _label(windows: Windows, fitter: Fitter, window: int) -> float:
    runs = fitter.residuals.replayer.aligned.runs
    return next(run.label for run in runs if run.start <= windows.start[window] < run.stop)


def agreement(fitter: Fitter, fit: Fit) -> dict[str, Any] | None:
    """``agreement`` of the report: values by part with 90 % intervals, and a test of their consistency; None without.

    An interval ends where the parameter's range does: that of a run that says nothing is the range.

    The test is chi-square of the values about their weighted mean; the odd part is the one furthest from it,
    and ``elsewhere`` the weighted mean of the others.
    """
    found = parts(fitter, fit)
    if not found:
        return None
    names = [(f"{e.name}@{e.site.name}", p.name, p.unit) for e in fit.hypothesis.effects for p in e.parameters]
    low, high = (fit.hypothesis.vector(end) for end in ("low", "high"))
    rows = []
    for i, (effect, parameter, unit) in enumerate(names):
        values, deviation = (np.array([getattr(p, field)[i] for p in found]) for field in ("values", "deviation"))
        ends = low[i], high[i]
        weight = 1.0 / np.maximum(deviation, 1e-300) ** 2
        mean = float((weight * values).sum() / weight.sum())
        away = (values - mean) / deviation
        odd = int(np.argmax(np.abs(away)))
        beside = np.arange(len(found)) != odd
        elsewhere = float((weight * values)[beside].sum() / weight[beside].sum())
        rows.append(
            {
                "effect": effect,
                "parameter": parameter,
                "unit": unit,
                "by_part": {
                    part.name: {"value": float(v), "ci90": np.clip((v - _CI90 * d, v + _CI90 * d), *ends).tolist()}
                    for part, v, d in zip(found, values, deviation, strict=True)
                },
                "mean": mean,
                "p": float(chi2.sf(float((away**2).sum()), len(found) - 1)),
                "odd": found[odd].name,
                "elsewhere": elsewhere,
            }
        )
    names_of_parts = [p.name for p in found]
    # Of many parameters one is off by chance now and then.
    limit = DISAGREE / len(rows)
    return {
        "parts": names_of_parts,
        "rows": rows,
        "disagree_below": limit,
        "sentence": _sentence(rows, names_of_parts, limit),
    }


def _sentence(rows: list[dict[str, Any]], names: list[str], limit: float) -> str:
    worst = min(rows, key=lambda row: float(row["p"]))
    what = "The runs" if names[0].startswith("run") else "The halves of the recording"
    if worst["p"] >= limit:
        return f"{what} agree about {'it' if len(rows) == 1 else 'all of it'} ({len(names)} looked at by themselves)."
    value, unit = worst["by_part"][worst["odd"]]["value"], "" if worst["unit"] in ("", "1") else f" {worst['unit']}"
    return (
        f"{what} do not agree: {worst['parameter'].replace('_', ' ')} of {worst['effect'].replace('_', ' ')} is "
        f"{value:.3g}{unit} in {worst['odd'].removeprefix('the ')} and {worst['elsewhere']:.3g}{unit} elsewhere "
        f"(p = {worst['p']:.1g})."
    )
