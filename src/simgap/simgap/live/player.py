"""What plays the next experiment on a robot while a hand holds the page's button; it is handed in: here is no robot."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from pydantic import BaseModel, ConfigDict, Field

from simgap.analysis.experiment import Experiment
from simgap.data.plant import Plant

Tell = Callable[[str], None]
"""Gets a sentence for whoever holds the button."""


class Hand(BaseModel):
    """That a hand presses the button, 20 times a second while it does; or that there is none, twice a second."""

    model_config = ConfigDict(strict=True, frozen=True, extra="forbid", allow_inf_nan=False)

    viewer: int = Field(ge=1, le=2**53)
    """The number that the page was given."""
    press: int = Field(ge=0, le=2**53)
    """Counts the times that it was pressed; 0: it is not."""
    sent: float = Field(ge=0.0, le=1e12)
    """[ms] of the browser's own clock, which only runs forward."""


@dataclass(frozen=True)
class Played:
    """How an experiment ended, in a sentence; and where it was played to its end, the command that diagnoses both."""

    sentence: str
    folder: str = ""
    command: str = ""


class Player(Protocol):
    """Plays an experiment on a robot. It is held from threads of the server, and plays in that of the command."""

    robot: str
    """What it would move, in words: "the twin"."""
    prepare: str
    """What is to be done before it moves."""

    def join(self, viewer: int) -> None:
        """Somebody opens the page."""
        ...

    def leave(self, viewer: int) -> None:
        """Somebody closes it: what they held is let go."""
        ...

    def hold(self, hand: Hand) -> str:
        """Takes a sign of a hand; why it does not count, in words, empty where nobody need be told."""
        ...

    def held(self) -> bool:
        """Whether the button is held."""
        ...

    def play(self, experiment: Experiment, plant: Plant, tell: Tell) -> Played:
        """Play it, and record it, while the button is held."""
        ...
