"""SUMMARY.yaml: the cells of a published table, and the experiments of the twin that each of them is a result of."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from nermo_description.parameter_files import read_yaml, validate
from nermo_sim.experiments import balance, straight_line, turning

Experiment = Literal["straight_line", "turning", "balance"]
QUANTITY = {"straight_line": "speed_m_s", "turning": "time_s", "balance": "passed"}
"""What a cell may ask of each experiment; an arc that is lost takes infinitely long."""


class _Strict(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Run(_Strict):
    """One experiment of the twin."""

    experiment: Experiment
    gait: str = "trot"
    frequency_hz: float = Field(0.67, gt=0.0, le=5.0)
    spine: bool = False
    """Stride extension with offset compensation; of the straight line."""
    strategy: Literal["leg", "spine", "mix"] = "leg"
    """Of turning, on the arc of 0.5 m."""
    leg: str = "front_left"
    compensation: bool = False
    """Leg and compensation: of balance."""

    @property
    def case(self) -> straight_line.Case | turning.Case | balance.Case:
        """The case of the experiment."""
        if self.experiment == "straight_line":
            return straight_line.Case(self.gait, self.frequency_hz, straight_line.STRIDE, self.spine, self.spine)
        if self.experiment == "turning":
            return turning.Case(self.gait, self.frequency_hz, self.strategy, 0.5)
        return balance.Case(self.leg, self.compensation)

    @property
    def key(self) -> str:
        """Its name."""
        return f"{self.experiment}: {self.case.key}"


class Cell(_Strict):
    """One published number: what `run` gives, over what `over` gives where that is there, lies within [low, high].

    ``relative`` cells are divided by the same number of the nominal twin: the table compares a robot with its twin.
    ``passed`` is for runs that pass or fail instead.
    """

    name: str
    source: str
    run: Run
    over: Run | None = None
    relative: bool = False
    low: float | None = None
    high: float | None = None
    passed: bool | None = None

    @model_validator(mode="after")
    def _complete(self) -> Cell:
        if (self.passed is None) == (self.low is None or self.high is None):
            raise ValueError("give either passed, or low and high")
        if self.low is not None and self.high is not None and not 0.0 < self.low < self.high:
            raise ValueError(f"low {self.low} must be positive and below high {self.high}")
        return self

    @property
    def runs(self) -> tuple[Run, ...]:
        """Everything that has to be run for it."""
        return (self.run,) if self.over is None else (self.run, self.over)


class Summary(_Strict):
    """A whole table."""

    name: str
    robot: str
    """The twin that the numbers are compared with."""
    cells: tuple[Cell, ...] = Field(min_length=1)
    blamed: tuple[str, ...] = ()
    """name@site of the effects that the table's author blames, for comparison."""

    @property
    def runs(self) -> list[Run]:
        """Every run that some cell needs, once."""
        return list({run.key: run for cell in self.cells for run in cell.runs}.values())


def load_summary(path: Path) -> Summary:
    """Read a summary. Raises ParameterError with file, field, value and what is allowed."""
    return validate(read_yaml(path), path, Summary)
