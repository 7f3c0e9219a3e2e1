"""The word `experiment` of the `nermo` command: a command for each record in the registry, and `all`."""

from __future__ import annotations

import inspect
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from nermo_description.results import CommandError, write_results
from nermo_sim.console import console, print_rows, progress
from nermo_sim.experiments import suite
from nermo_sim.experiments.experiment import Experiment, Facts, Outcome, Repeats, run_experiment
from nermo_sim.experiments.registry import EXPERIMENTS
from nermo_sim.experiments.runs import Settings
from nermo_sim.options import RESULTS, Json, Out, Quick, Robot, Seed, Workers, check_robot

experiment_app = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode=None,
    add_completion=False,
    help="Run an experiment of the thesis; its table stands beside ours.",
)


@experiment_app.callback()
def experiment() -> None:
    """Run an experiment of the thesis; its table stands beside ours."""


def offer(app: typer.Typer, experiment: Experiment[Any]) -> None:
    """Adds the command of an experiment, with the options that it has."""

    def command(**options: Any) -> None:
        # By name, so that what runs is what stands in the registry now.
        _run(EXPERIMENTS[experiment.name], _Options(**options))

    parameters = list(_options(experiment))
    command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    command.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    app.command(experiment.name, help=experiment.help)(command)


def _options(experiment: Experiment[Any]) -> list[inspect.Parameter]:
    options: list[tuple[str, Any, Any]] = [
        ("robot", Robot, experiment.robot),
        ("seed", Seed, 0),
        ("quick", Quick, False),
        ("out", Out, RESULTS),
        ("json", Json, None),
        ("workers", Workers, None),
    ]
    if experiment.repeats is not None:
        options.append(("repeats", _repeats(experiment.repeats), None))
    if not experiment.disturbed:
        told = typer.Option(help="Random friction, first pose and pushes, as elsewhere.")
        options.append(("disturbed", Annotated[bool, told], False))
    if experiment.video:
        options.append(("video", Annotated[bool, typer.Option(help=f"Also draw a video of {experiment.video}.")], True))
    keyword = inspect.Parameter.KEYWORD_ONLY
    return [inspect.Parameter(name, keyword, annotation=kind, default=value) for name, kind, value in options]


def _repeats(repeats: Repeats) -> Any:
    text = f"{repeats.what} a row; {repeats.usual}, or {repeats.quick} with --quick."
    return Annotated[int | None, typer.Option(min=1, help=text)]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Options:
    """What the user asks of an experiment; the last three are not options of every one."""

    robot: str
    seed: int
    quick: bool
    out: Path
    json: Path | None
    workers: int | None
    repeats: int | None = None
    disturbed: bool | None = None
    video: bool = False


def _run(experiment: Experiment[Any], asked: _Options) -> None:
    """Runs, prints, draws and writes; fails where the experiment says that it did."""
    check_robot(asked.robot, experiment.families)
    disturbed = experiment.disturbed or bool(asked.disturbed)
    settings = experiment.settings(asked.robot, asked.seed, asked.quick, asked.repeats, disturbed)
    folder = asked.out / experiment.name
    with progress(experiment.name) as report:
        facts = run_experiment(experiment, settings, folder, asked.workers, report)
    title = f"{experiment.name}, {settings.repeats} x each, {settings.robot}, seed {settings.seed}"
    print_rows(title, facts["rows"], experiment.columns)
    if experiment.notes is not None:
        experiment.notes(facts)
    if asked.disturbed is not None:
        facts["disturbed"] = asked.disturbed
    if pictures := experiment.draw(Outcome(facts, settings, folder, asked.video)):
        facts["pictures"] = pictures
        console.print(f"pictures: {', '.join(map(str, pictures))}")
    _write(asked.json, experiment.name, facts, settings)
    if (failure := experiment.failure(facts)) is not None:
        raise CommandError(failure)


for _experiment in EXPERIMENTS.values():
    offer(experiment_app, _experiment)


@experiment_app.command("all")
def run_all(
    robot: Robot = "nermo_lite",
    seed: Seed = 0,
    quick: Quick = False,
    out: Out = RESULTS,
    json: Json = None,
    workers: Workers = None,
    repeats: _repeats(Repeats()) = None,  # type: ignore[valid-type]
) -> None:
    """All experiments, every claim of the thesis's chapter 6 beside ours, and one HTML report.

    What was already run goes in as it is; a run that was stopped goes on where it was. A claim that does not hold is
    a result, not a failure.

    \b
    nermo experiment all --json out.json
    nermo experiment all --quick --out /tmp/quick
    """
    from nermo_sim.experiments.report import write_report

    check_robot(robot)
    settings = EXPERIMENTS["straight-line"].settings(robot, seed, quick, repeats)
    begin = time.monotonic()
    facts = suite.run_all(settings, out, workers, progress)
    for title, rows, columns in suite.tables(facts):
        print_rows(title, rows, columns)
    report = write_report(out / "report.html", facts, settings)
    facts = {**facts, "report": report, "wall_s": time.monotonic() - begin}
    for group, count in facts["score"].items():
        console.print(f"{group}: {count['within']} of {count['of']} claims within their bands")
    console.print(f"report: {report}")
    _write(json, "all", facts, settings)


def _write(json: Path | None, name: str, facts: Facts, settings: Settings) -> None:
    if json is not None:
        write_results(json, name, facts, robot=settings.robot, seed=settings.seed)
