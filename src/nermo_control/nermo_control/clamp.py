"""Shares of the largest: turn rate, flexion."""

from __future__ import annotations

import math


def within_one(share: float) -> float:
    """The share held within [-1, 1]; NaN becomes 0."""
    return 0.0 if math.isnan(share) else max(-1.0, min(share, 1.0))
