"""Whether probabilities mean what they say: of verdicts given with 0.9 or more, how many are right."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.stats import binomtest

EDGES = (0.0, 0.5, 0.7, 0.9, 0.97, 1.0)
"""Of the bins; the last holds its upper end."""


def reliability(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Bins of judged cases by the probability of their verdict: what was said on average, and how many are right.

    Args:
        rows: of `score.judged`; those without a verdict's probability (``sure``) are left out.

    Returns:
        For each bin its ends ``low`` and ``high``, ``said`` (mean), ``right`` (share; both None where it is empty),
        ``ci90`` (Clopper and Pearson) and ``n``.
    """
    told = [(float(r["sure"]), bool(r["correct"])) for r in rows if r.get("sure") is not None]
    bins: list[dict[str, Any]] = []
    for low, high in pairwise(EDGES):
        inside = [(p, c) for p, c in told if low <= p < high or (p >= high == EDGES[-1])]
        hits, n = sum(c for _, c in inside), len(inside)
        entry: dict[str, Any] = {"low": low, "high": high, "said": None, "right": None, "ci90": None, "n": n}
        if n:
            interval = binomtest(hits, n).proportion_ci(0.9)
            entry |= {
                "said": float(np.mean([p for p, _ in inside])),
                "right": hits / n,
                "ci90": [float(interval.low), float(interval.high)],
            }
        bins.append(entry)
    return bins


def table(bins: Sequence[dict[str, Any]]) -> list[str]:
    """The bins as lines of a Markdown table."""
    lines = ["| probability of the verdict | said | right | 90 % | n |", "|---|---|---|---|---|"]
    for b in bins:
        if b["n"]:
            low, high = b["ci90"]
            shares = f"{b['said']:.2f} | {b['right']:.2f} | {low:.2f} to {high:.2f}"
            lines.append(f"| {b['low']:g} to {b['high']:g} | {shares} | {b['n']} |")
    return lines
