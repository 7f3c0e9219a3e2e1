"""Which parameters of the cell matter: C's sixteen fits (table 4.4) and their analysis of variance (table 4.5)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from itertools import combinations

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import f as f_distribution

RESPONSES = ("sensitivity_s_per_n", "base_conductance_s", "saturation_force_n")
"""a1 [S/N], a2 [S] and (a3 - a2) / a1 [N] of (4.4)-(4.5)."""

THESIS_TERMS: dict[str, tuple[str, ...]] = {
    "sensitivity_s_per_n": ("glue", "shape", "width", "glue * length"),
    "base_conductance_s": ("shape", "width", "length * width"),
    "saturation_force_n": ("layers", "shape", "length * width"),
}
"""The terms that C keeps in table 4.5, for each response."""

_CENTRE_AND_HALF_RANGE = {"layers": (4.0, 2.0), "length": (18.5, 10.5), "width": (17.0, 12.0)}
"""Of the two levels of table 4.3: 2 and 6 layers, 8 and 29 mm, 5 and 29 mm."""


@dataclass(frozen=True, slots=True)
class CellDesign:
    """A cell as one would build it (C figure 4.2)."""

    glue: bool
    layers: int
    shape: str
    """"A" (bands) or "B" (zebra)."""
    length_mm: float
    width_mm: float

    def coded(self) -> dict[str, float]:
        """Factor levels: -1 at the lower, +1 at the upper level of table 4.3.

        Raises:
            ValueError: the shape is neither A nor B, or a size is not positive.
        """
        if self.shape not in ("A", "B"):
            raise ValueError(f"shape: {self.shape!r} is not one of A, B")
        levels = {"glue": 1.0 if self.glue else -1.0, "shape": 1.0 if self.shape == "B" else -1.0}
        for name, value in (("layers", self.layers), ("length", self.length_mm), ("width", self.width_mm)):
            if not value > 0:
                raise ValueError(f"{name}: {value!r} is not above 0")
            centre, half_range = _CENTRE_AND_HALF_RANGE[name]
            levels[name] = (value - centre) / half_range
        return levels


@dataclass(frozen=True, slots=True)
class Term:
    """One line of table 4.5."""

    name: str
    coefficient: float
    sum_of_squares: float
    f: float
    p: float


@dataclass(frozen=True, slots=True)
class AdditiveModel:
    """Response = constant + sum of coefficient times coded term, with its analysis of variance."""

    response: str
    constant: float
    terms: tuple[Term, ...]
    error_sum_of_squares: float
    error_degrees_of_freedom: int
    p_against_constant: float

    def predict(self, cell: CellDesign) -> float:
        """The response of a cell, in the response's unit."""
        levels = cell.coded()
        return self.constant + sum(term.coefficient * _product(term.name, levels) for term in self.terms)


def load_table() -> pd.DataFrame:
    """The sixteen rows of table 4.4."""
    with files("nermo_sensors").joinpath("data/screening.csv").open() as file:
        return pd.read_csv(file)


def analyse(table: pd.DataFrame, response: str, terms: Sequence[str]) -> AdditiveModel:
    """Least-squares fit of the named terms and their analysis of variance.

    Raises:
        ValueError: a term is unknown, or two terms are aliased in this table (they cannot be told apart).
    """
    columns = [_column(table, term) for term in terms]
    for (first, x), (second, y) in combinations(zip(terms, columns, strict=True), 2):
        if abs(np.dot(x, y)) > 0.999 * len(table):
            raise ValueError(f"terms: {first!r} and {second!r} are aliased in this design")
    # Conductances are of the order 1e-5; unit scale keeps the fit well conditioned.
    values = table[response].to_numpy(dtype=np.float64)
    scale = float(np.abs(values).max())
    design = np.column_stack([np.ones(len(table)), *columns])
    coefficients = np.linalg.lstsq(design, values / scale, rcond=None)[0]
    residual = values / scale - design @ coefficients
    error, freedom = float(residual @ residual), len(table) - design.shape[1]
    mean_square = error / freedom
    # Of each coefficient: its square over its variance, which follows F(1, freedom) where the term does nothing.
    ratios = coefficients**2 / (mean_square * np.diag(np.linalg.inv(design.T @ design)))
    explained = float(((values / scale - np.mean(values / scale)) ** 2).sum()) - error
    return AdditiveModel(
        response=response,
        constant=float(coefficients[0]) * scale,
        terms=tuple(
            Term(
                name=name,
                coefficient=float(coefficients[i]) * scale,
                sum_of_squares=float(ratios[i] * mean_square) * scale**2,
                f=float(ratios[i]),
                p=float(f_distribution.sf(ratios[i], 1, freedom)),
            )
            for i, name in enumerate(terms, start=1)
        ),
        error_sum_of_squares=error * scale**2,
        error_degrees_of_freedom=freedom,
        p_against_constant=float(f_distribution.sf(explained / len(terms) / mean_square, len(terms), freedom)),
    )


def eliminate(table: pd.DataFrame, response: str, threshold: float = 0.105) -> AdditiveModel:
    """Backward elimination: start from every distinguishable term, drop the one with the highest p until all are below.

    Args:
        table: Rows as in table 4.4.
        response: One of RESPONSES.
        threshold: "p-value approximately under 10 %" (C 4.2.2.3); C keeps the layers at 0.1023.
    """
    kept = list(distinguishable_terms(table))
    while True:
        model = analyse(table, response, kept)
        worst = max(model.terms, key=lambda term: term.p)
        if worst.p < threshold or len(kept) == 1:
            return model
        kept.remove(worst.name)


def distinguishable_terms(table: pd.DataFrame) -> tuple[str, ...]:
    """Main effects and those interactions of two that this table can tell apart; of aliased ones, the likelier.

    C keeps the cell's area (length * width) and glue * length where their aliases would be shape with another factor.
    """
    preferred = ("length * width", "glue * length")
    factors = ["glue", "layers", "shape", "length", "width"]
    pairs = [f"{a} * {b}" for a, b in combinations(factors, 2)]
    pairs.sort(key=lambda term: term not in preferred)
    kept: list[str] = []
    columns: list[NDArray[np.float64]] = []
    for term in (*factors, *pairs):
        column = _column(table, term)
        if all(abs(np.dot(column, other)) < 0.999 * len(table) for other in columns):
            kept.append(term)
            columns.append(column)
    return tuple(kept)


def _column(table: pd.DataFrame, term: str) -> NDArray[np.float64]:
    coded = [
        CellDesign(row["glue"] == "+", row["layers"], row["shape"], row["length_mm"], row["width_mm"]).coded()
        for row in table.to_dict("records")
    ]
    return np.array([_product(term, levels) for levels in coded])


def _product(term: str, levels: dict[str, float]) -> float:
    value = 1.0
    for name in term.split(" * "):
        if name not in levels:
            raise ValueError(f"term: {name!r} is not one of {', '.join(sorted(levels))}")
        value *= levels[name]
    return value
