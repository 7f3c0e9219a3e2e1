"""What a competition of hypotheses found."""

from __future__ import annotations

from dataclasses import dataclass, field

from simgap.inference.scores import Scored
from simgap.inference.screen import Screened


@dataclass
class Selection:
    """What the competition found.

    Attributes:
        reference: nuisances only.
        nominal_gap: held-out gap of the nominal model as it is.
        best: the winner, which is the reference where no effect earns its place.
        singles, rivals: scored fits, best first; rivals are those of the winner's size.
        gains: (mean, 5 %, 95 %) of the score that each accepted effect earned when it was added.
        unrivalled: further effects that took far more than any other would have in their place.
        before: the model that a corrected one came from, with its numbers fitted.
        rejected: (names of the effects, nats that it gained, nats that were asked) of the best further effect that was
            looked at and did not earn its place.
    """

    reference: Scored
    nominal_gap: float
    best: Scored
    singles: list[Scored] = field(default_factory=list)
    rivals: list[Scored] = field(default_factory=list)
    gains: list[tuple[float, float, float]] = field(default_factory=list)
    screened: list[Screened] = field(default_factory=list)
    unrivalled: set[str] = field(default_factory=set)
    before: Scored | None = None
    rejected: tuple[str, float, float] | None = None
