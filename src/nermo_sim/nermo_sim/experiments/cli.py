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
from nermo_sim.experiments.on_robot import LONGEST, SHORTEST, TWIN, DeadMan, OnTheRobot, RobotRequest, Target
from nermo_sim.experiments.registry import EXPERIMENTS, ON_ROBOT
from nermo_sim.experiments.runs import Settings
from nermo_sim.options import RESULTS, Json, Out, Quick, Robot, Seed, Workers, check_robot

experiment_app = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode=None,
    add_completion=False,
    help="Run an experiment of the thesis; its table stands beside ours.",
)


_on_the_robot: list[OnTheRobot] = []


def hand_in(on_the_robot: OnTheRobot) -> None:
    """Who has a graph and a tracker hands in what does an experiment on the real mouse."""
    _on_the_robot[:] = [on_the_robot]


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
    if experiment.name in ON_ROBOT:
        options += _ROBOT_OPTIONS
    keyword = inspect.Parameter.KEYWORD_ONLY
    return [inspect.Parameter(name, keyword, annotation=kind, default=value) for name, kind, value in options]


def _repeats(repeats: Repeats) -> Any:
    text = f"{repeats.what} a row; {repeats.usual}, or {repeats.quick} with --quick."
    return Annotated[int | None, typer.Option(min=1, help=text)]


def _option(kind: Any, text: str, **how: Any) -> Any:
    return Annotated[kind, typer.Option(help=text, **how)]


_ROBOT_OPTIONS: list[tuple[str, Any, Any]] = [
    (
        "target",
        _option(Target | None, "Play N's runs on the real mouse: at a cable, or over Wi-Fi; sim: on the twin's graph."),
        None,
    ),
    (
        "film",
        _option(list[Path], "Film of a run, named by its number (01.mp4), or a folder of them; may come later."),
        [],
    ),
    ("camera", _option(list[Path], "File of nermo track calibrate; of several, left.yaml took 01_left.mp4."), []),
    ("tags", _option(Path | None, "With --film: where tags sit, as for nermo track."), None),
    ("fps", _option(float | None, "With --film: pictures a second, where the file does not tell the true rate."), None),
    ("distance", _option(float | None, "On the real mouse: of a run [m].", min=SHORTEST, max=LONGEST), None),
    ("port", _option(str, "With --target: where the robot is; twin is an emulated device with the twin behind."), TWIN),
    ("calibration", _option(Path | None, "With --target serial: the file that nermo hw calibrate wrote."), None),
    ("dead_man", _option(DeadMan | None, "Held while the mouse moves. Default: space; nothing on the twin."), None),
    ("pad", _option(str, "With --dead-man pad: which gamepad it is."), "xbox"),
    ("yes", _option(bool, "Ask nothing: begin each run at once and keep it.", is_flag=True), False),
]
_OF_ROBOT = tuple(name for name, _, _ in _ROBOT_OPTIONS)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Options:
    """What the user asks of an experiment; those below `workers` are not options of every one."""

    robot: str
    seed: int
    quick: bool
    out: Path
    json: Path | None
    workers: int | None
    repeats: int | None = None
    disturbed: bool | None = None
    video: bool = False
    target: Target | None = None
    film: tuple[Path, ...] = ()
    camera: tuple[Path, ...] = ()
    tags: Path | None = None
    fps: float | None = None
    distance: float | None = None
    port: str = TWIN
    calibration: Path | None = None
    dead_man: DeadMan | None = None
    pad: str = "xbox"
    yes: bool = False

    @property
    def on_the_robot(self) -> bool:
        """Whether it is asked for on the real mouse. Raises CommandError for its other options alone."""
        if self.target is not None or self.film:
            return True
        for name, _, default in _ROBOT_OPTIONS:
            if (list(self.camera) if name == "camera" else getattr(self, name)) not in (default, ()):
                raise CommandError(f"--{name.replace('_', '-')} goes with --target or --film", status=2)
        return False


def _on_robot(name: str, asked: _Options) -> None:
    """Hands on what is asked of the real mouse."""
    if not _on_the_robot:
        raise CommandError(f"--target and --film need the graph: call this as nermo experiment {name}", status=2)
    robot = None if asked.robot == EXPERIMENTS[name].robot else asked.robot
    of_robot = {option: getattr(asked, option) for option in _OF_ROBOT}
    kept = {option: getattr(asked, option) for option in ("json", "seed", "quick", "repeats", "workers")}
    _on_the_robot[0](RobotRequest(name=name, folder=asked.out / name, robot=robot, **kept, **of_robot))


def _run(experiment: Experiment[Any], asked: _Options) -> None:
    """Runs, prints, draws and writes; fails where the experiment says that it did."""
    check_robot(asked.robot, experiment.families)
    if asked.on_the_robot:
        _on_robot(experiment.name, asked)
        return
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
