"""What an experiment is: one record, of which its file gives all, and the command line, tables and pages are made."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic

from nermo_description.parameters import TailModel
from nermo_sim.disturbance import NO_DISTURBANCE
from nermo_sim.experiments.result_log import ResultLog
from nermo_sim.experiments.runs import REPEATS, CaseType, Job, Progress, Result, Settings, run_cases

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Facts = dict[str, Any]
"""What an experiment found: `rows`, and what else it says; the keys of its JSON file."""
Row = dict[str, Any]
Figures = list[tuple[str, str, "Figure | None"]]
"""Name of the file, heading, and figure; None where there is nothing to draw."""
Tables = list[tuple[str, list[Row]]]
"""Heading and rows."""
QUICK_DISTANCE = 0.5
"""Of the straight line [m], with --quick."""


@dataclass(frozen=True, slots=True)
class Repeats:
    """How often each row is run where the user does not say."""

    usual: int = REPEATS
    quick: int = 1
    what: str = "Runs"
    """What is repeated, in the help."""


@dataclass(frozen=True, slots=True)
class Finished(Generic[CaseType]):
    """All runs of an experiment, and its table."""

    cases: Sequence[CaseType]
    settings: Settings
    results: list[list[Result]]
    """Of each case's repeats, case by case."""
    rows: list[Row]
    log: ResultLog
    workers: int | None


@dataclass(frozen=True, slots=True)
class Outcome:
    """What there is to draw and to write of an experiment."""

    facts: Facts
    settings: Settings
    folder: Path
    video: bool

    def about(self, source: str) -> str:
        """The line below the page's title; source: the place in a thesis."""
        settings = self.settings
        words = (f"Robot {settings.robot}", source, f"seed {settings.seed}")
        conditions = {"disturbed": self.facts.get("disturbed", False), "quick": settings.quick}
        return ", ".join([word for word in words if word] + [word for word, so in conditions.items() if so]) + "."


@dataclass(frozen=True, slots=True, kw_only=True)
class Experiment(Generic[CaseType]):
    """One experiment. To add one, write a file with such a record and name it in `registry.py`."""

    name: str
    """Its word on the command line, and its folder."""
    title: str
    """Of its table in the report, or of its page."""
    help: str
    """What the command line says of it, with examples."""
    columns: tuple[str, ...]
    """Of the rows, those that the terminal shows."""
    cases: Callable[[bool], Sequence[CaseType]]
    """Its cases; fewer where the argument, `quick`, is true."""
    run: Callable[[Job[CaseType]], Result]
    """One run of one case, in whichever process."""
    table: Callable[[Sequence[CaseType], Settings, Any, list[list[Result]]], list[Row]]
    """The rows, from cases, settings, the robot's parameters and the results of each case's repeats."""
    families: tuple[str, ...] = ("mouse",)
    """Families of robots that it can be done with."""
    robot: str = "nermo_lite"
    """Whose it is where the user names none."""
    repeats: Repeats | None = Repeats()
    """None: each row is run once."""
    tail: TailModel = "chain"
    """How a mouse's tail is simulated. Where it is rigid, a test has the bands within which the chain gives the same.
    The chain takes 1.5 times as long."""
    disturbed: bool = True
    """Whether it runs under disturbances without being told to; otherwise there is the option --disturbed."""
    video: str = ""
    """What its video shows; without one there is no option --video."""
    further: Callable[[Finished[CaseType]], Facts] | None = None
    """What there is to say beside the rows."""
    notes: Callable[[Facts], None] | None = None
    """Prints what the terminal shows below the table."""
    source: str = ""
    """The place in a thesis, below its page's title."""
    figures: Callable[[Facts], Figures] | None = None
    """What its page shows; without figures there is no page."""
    tables: Callable[[Facts], Tables] = lambda facts: []
    """The tables of its page."""
    pictures: Callable[[Outcome], list[Path]] | None = None
    """Draws what else there is to see; returns the files."""
    failure: Callable[[Facts], str | None] = lambda facts: None
    """Why the command fails on what was found, or None."""

    def draw(self, done: Outcome) -> list[Path]:
        """Writes its page, if it has one, and its pictures; returns the files. Raises CommandError."""
        written: list[Path] = []
        if self.figures is not None:
            from nermo_sim.report.page import write_page

            about = done.about(self.source)
            written += write_page(done.folder, self.title, about, self.figures(done.facts), self.tables(done.facts))
        return written if self.pictures is None else [*written, *self.pictures(done)]

    def settings(
        self, robot: str, seed: int = 0, quick: bool = False, repeats: int | None = None, disturbed: bool = True
    ) -> Settings:
        """Settings of all of its runs, where None stands for its own number of repeats."""
        if self.repeats is not None:
            repeats = repeats or (self.repeats.quick if quick else self.repeats.usual)
        settings = Settings(robot, repeats=repeats or 1, seed=seed, quick=quick)
        if quick:
            settings = replace(settings, distance=QUICK_DISTANCE)
        return settings if disturbed else replace(settings, disturbance=NO_DISTURBANCE)


def run_experiment(
    experiment: Experiment[Any],
    settings: Settings,
    folder: Path,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Facts:
    """Runs what is not yet in the folder and returns `rows`, and what else the experiment has to say.

    Raises ParameterError for an unusable robot and SimulationDivergedError.
    """
    settings = replace(settings, tail=experiment.tail) if experiment.tail != "chain" else settings
    cases, log_file = experiment.cases(settings.quick), folder / "runs.jsonl"
    results = run_cases(experiment.run, cases, settings, experiment.name, log_file, workers, progress)
    rows = experiment.table(cases, settings, settings.parameters, results)
    if experiment.further is None:
        return {"rows": rows}
    log = ResultLog(log_file, settings.digest(experiment.name))
    return {"rows": rows, **experiment.further(Finished(cases, settings, results, rows, log, workers))}
