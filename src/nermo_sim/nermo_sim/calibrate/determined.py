"""How well the claims determine each number: a linear model of the misses around the best point, from all points tried.

A claim's band counts as its 90 % interval, the bounds as what is known without any claim (uniform). So the interval of
a number that no claim moves is that of its bounds.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from nermo_sim.calibrate.numbers import NUMBERS, Array
from nermo_sim.calibrate.search import Found
from nermo_sim.calibrate.trials import WORST

NEAR = 0.35
"""Distance in the unit cube at which a tried point's weight has fallen to 0.6 for each number."""
RIDGE = 1e-3
"""Keeps the slopes finite where fewer points than numbers are near."""
Z90 = 1.645
CONFOUNDED = 0.5
"""Correlation from which two numbers count as confounded."""
MOVED = 0.5
"""A claim is moved by a number that changes its miss by so many half bands over its whole range."""


def slopes(found: Found) -> tuple[list[str], Array, Array]:
    """The numeric claims, how each number changes their misses (claims, n), and what the model leaves (claims,)."""
    numeric = {row["claim"] for row in (*found.before, *found.after) if row["ratio"] is not None}
    claims = [claim for claim in found.wanted if claim in numeric]
    tried = [one for one in found.tried if all(claim in one.misses for claim in claims)]
    offsets = np.array([one.point - found.best.point for one in tried])
    weights = np.exp(-0.5 * (offsets**2).sum(axis=1) / (NEAR**2 * len(NUMBERS)))
    values = np.array([[one.misses[claim] for claim in claims] for one in tried])
    system = np.column_stack([np.ones(len(tried)), offsets])
    weighted = system * weights[:, None]
    penalty = np.diag([0.0] + [RIDGE * float(weights.sum())] * len(NUMBERS))
    coefficients = np.linalg.solve(weighted.T @ system + penalty, weighted.T @ values)
    left = np.sqrt((weights[:, None] * (values - system @ coefficients) ** 2).sum(axis=0) / weights.sum())
    return claims, coefficients[1:].T, left


def determined(found: Found) -> list[dict[str, Any]]:
    """One row a number: value, 90 % interval, what it is confounded with, which claims it moves."""
    claims, gradient, left = slopes(found)
    deviation = np.sqrt((1.0 / Z90) ** 2 + left**2)
    information = (gradient / deviation[:, None]).T @ (gradient / deviation[:, None])
    covariance = np.linalg.inv(information + 12.0 * np.eye(len(NUMBERS)))
    spread = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(spread, spread)
    rows = []
    for index, number in enumerate(NUMBERS):
        centre, width = float(found.best.point[index]), Z90 * float(spread[index])
        rows.append(
            {
                "name": number.name,
                "value": found.values[number.name],
                "unit": number.unit,
                "ci90": [number.value(centre - width), number.value(centre + width)],
                "bounds": [number.low, number.high],
                "share_of_bounds": min(2.0 * width, 1.0),
                "confounded_with": _others(correlation[index], index),
                "moves": _moved(claims, gradient[:, index]),
                "reason": number.reason,
            }
        )
    return rows


def _others(correlation: Array, own: int) -> list[str]:
    return [n.name for i, n in enumerate(NUMBERS) if i != own and abs(correlation[i]) >= CONFOUNDED]


def _moved(claims: Sequence[str], gradient: Array) -> list[str]:
    order = np.argsort(-np.abs(gradient))[:3]
    return [claims[i] for i in order if MOVED <= abs(gradient[i]) < 10.0 * WORST]
