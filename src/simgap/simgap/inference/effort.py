"""How much a search looks at, and whom it tells how far it is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from simgap.inference.model_selection import FINALISTS

Progress = Callable[[str, float], None]

SURVIVORS = 10
PARTNERS = 6
LEADERS = 2
"""Kinds of effects about which, beside the nominal model, errors of the windows' start are computed, at most."""
MAX_EFFECTS = 3


@dataclass(frozen=True)
class Effort:
    """How much is looked at; a model whose steps cost more gets less."""

    hopeful: int | None = 30
    """Candidates that are screened thoroughly, after a glance at all; None: all of them."""
    survivors: int = SURVIVORS
    """Candidates that are fitted."""
    finalists: int = FINALISTS
    """Candidates that are refitted with sensitivities of their own."""
    leaders: int = LEADERS
    """Kinds of effects about which errors of the windows' start are computed."""
    rounds: int = 3
    """How often the winner is."""
    partners: int = PARTNERS
    """Candidates that are fitted as one effect more."""
    swapped: int = 3
    """Candidates that take the place of each older effect."""
    max_effects: int = MAX_EFFECTS
    sought: int = 200
    """Replays in search of a law with more parameters."""
    twice: bool = False
    """Whether candidates are screened about the nominal numbers' best fit too, and what promises most either way, of
    each kind too, is compared by a few steps of a fit: where many numbers are off, what a change shows beside wrong
    ones says little."""
