"""The fractional factorial design 2^(6-2) of resolution IV with which C screens the cell's parameters (C 4.2.2.1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pyDOE3 import fracfact, fracfact_aliasing

FACTORS = ("glue", "layers", "temperature", "shape", "length", "width")
"""The six factors in C's order A to F."""
GENERATORS = {"length": "glue * layers * temperature", "width": "layers * temperature * shape"}
"""How the last two columns come from the first four: E = ABC and F = BCD."""


@dataclass(frozen=True, slots=True)
class Design:
    """A coded two-level design and what it cannot tell apart."""

    factors: tuple[str, ...]
    runs: NDArray[np.float64]
    """Levels -1 and +1, one row a run, one column a factor."""
    aliases: tuple[tuple[str, ...], ...]
    """Groups of effects that this design cannot separate; an interaction is written `a * b`."""

    def aliased_with(self, effect: str) -> tuple[str, ...]:
        """Other effects that look exactly like `effect` here; names of an interaction may come in any order.

        Raises:
            ValueError: `effect` names no effect of this design.
        """
        wanted = frozenset(part.strip() for part in effect.split("*"))
        for group in self.aliases:
            for name in group:
                if frozenset(name.split(" * ")) == wanted:
                    return tuple(other for other in group if other != name)
        raise ValueError(f"effect: {effect!r} is not a product of the factors {', '.join(self.factors)}")


def screening_design() -> Design:
    """C's design: 16 runs for six factors; no main effect is aliased with an interaction of two (resolution IV)."""
    letters = dict(zip("abcdef", FACTORS, strict=True))
    runs = np.asarray(fracfact("a b c d abc bcd"), dtype=np.float64)
    groups, _ = fracfact_aliasing(runs)
    aliases = tuple(
        tuple(" * ".join(letters[letter] for letter in word) for word in group.split(" = ")) for group in groups
    )
    return Design(FACTORS, runs, aliases)
