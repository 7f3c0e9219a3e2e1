"""The scoreboard: rows of claims, of which kind they are, in which half, and how many hold.

A number is within its band where the ratio ours / thesis is (`band` is a pair); a claim in words is either true of ours
or not (`thesis` is true, `band` null). A claim whose data a quick run does not have is left out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any, Literal

from nermo_sim.experiments.claims.halves import half_of
from nermo_sim.experiments.lookup import Row

Kind = Literal["twin", "robot", "theory", "own"]
"""Who claims it: N's twin, N's real robot, N's formulas, or nobody but we. The first two are what has to be met."""
COUNTED: tuple[Kind, ...] = ("twin", "robot")

Band = tuple[float, float]
SPEEDS: Band = (0.85, 1.15)
RADII_AND_TIMES: Band = (0.8, 1.25)
DEVIATIONS: Band = (1.0 / 1.5, 1.5)
THEORY: Band = (0.95, 1.05)
FORCES: Band = (1.0 / 1.5, 1.5)
"""N says nothing of the spread of forces and shares: the band of the deviations."""


class Claims:
    """Collects the rows; a claim of which a part is missing is left out."""

    def __init__(self) -> None:
        self.rows: list[Row] = []

    def about(self, topic: str, kind: Kind = "twin") -> Topic:
        """Takes claims of one topic: those that follow from the same quantity, and so stand in the same half."""
        return Topic(self.rows, topic, kind)


class Topic:
    """Takes the claims of one topic."""

    def __init__(self, rows: list[Row], topic: str, kind: Kind) -> None:
        self._rows = rows
        self._about = {"kind": kind, "topic": topic, "half": half_of(topic) if kind == "twin" else None}

    def number(self, claim: str, thesis: float, ours: float | None, band: Band, of_ours: Band | None = None) -> None:
        """A number of N. of_ours: a band for our value itself, where that is how the target is set."""
        if ours is None or math.isnan(ours):
            return
        ratio = ours / thesis
        within = of_ours[0] <= ours <= of_ours[1] if of_ours else band[0] <= ratio <= band[1]
        shown = [of_ours[0] / thesis, of_ours[1] / thesis] if of_ours else list(band)
        self._add(claim, thesis, float(ours), float(ratio), shown, within)

    def words(self, claim: str, holds: Callable[[], bool | None], ours: Any = None) -> None:
        """A claim in words. `holds` may fail for want of rows, then there is no row."""
        try:
            within = holds()
        except (TypeError, KeyError):
            return
        if within is not None:
            self._add(claim, True, bool(within) if ours is None else ours, None, None, bool(within))

    def _add(self, claim: str, thesis: Any, ours: Any, ratio: float | None, band: Any, within: bool) -> None:
        values = {"thesis": thesis, "ours": ours, "ratio": ratio, "band": band, "within": within}
        self._rows.append({"claim": claim, **self._about, **values})


def score(rows: Iterable[Row]) -> dict[str, dict[str, int]]:
    """How many claims hold, of how many: in all that counts, by kind, and of the twin's by half."""
    rows = list(rows)
    groups = {
        "headline": [row for row in rows if row["kind"] in COUNTED],
        "twin, fitted": [row for row in rows if row["half"] == "fitted"],
        "twin, checked": [row for row in rows if row["half"] == "checked"],
        "robot": [row for row in rows if row["kind"] == "robot"],
        "theory": [row for row in rows if row["kind"] == "theory"],
        "own": [row for row in rows if row["kind"] == "own"],
    }
    return {name: {"within": sum(row["within"] for row in each), "of": len(each)} for name, each in groups.items()}
