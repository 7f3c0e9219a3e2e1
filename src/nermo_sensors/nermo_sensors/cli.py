"""The word `sensors` of the `nermo` command: calibrate, tune and judge tactile feet."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from nermo_description.parameter_files import ParameterError, write_yaml
from nermo_description.results import CommandError, write_results

_console = Console(markup=False)

Robot = Annotated[str, typer.Option(help="Whose feet: a robot's name, or the path of a tactile parameter file.")]
Seed = Annotated[int, typer.Option(min=0, help="Seed of everything random.")]
Json = Annotated[Path | None, typer.Option("--json", help="Write the results to this file.")]
Save = Annotated[Path | None, typer.Option("--save", help="Write a parameter file with the result.")]
Recording = Annotated[Path, typer.Argument(help="A table with time_s, force_n, piezoresistive_v, piezoelectric_v.")]


class Estimator(StrEnum):
    """Which filter."""

    F1 = "f1"
    F2 = "f2"
    MEMORY = "memory"


class Objective(StrEnum):
    """What a tuned filter is to be good at."""

    THESIS = "thesis"
    LIKELIHOOD = "likelihood"


sensors_app = typer.Typer(
    no_args_is_help=True, rich_markup_mode=None, help="Calibrate, tune and judge the tactile feet."
)


@sensors_app.callback()
def sensors() -> None:
    """Calibrate, tune and judge the tactile feet."""


@sensors_app.command()
def simulate(
    file: Annotated[Path, typer.Argument(help="The .csv to write.")],
    robot: Robot = "cheetah_cub",
    seed: Seed = 1,
    quick: Annotated[bool, typer.Option("--quick", help="Fewer turns at each frequency.")] = False,
) -> None:
    """Record a run of the simulated test bench (C 4.3.2), in the format that `fit` and `tune` read.

    \b
    nermo sensors simulate run1.csv --seed 1
    """
    from nermo_sensors.bench.rig import Rig
    from nermo_sensors.cells.piezoresistive import PiezoresistiveParameters
    from nermo_sensors.parameters import load_tactile

    with _told():
        parameters = load_tactile(robot)
        peak = 2.8 * parameters.cell(PiezoresistiveParameters).saturation_force
        rig = Rig(peak=peak, periods=3, seconds=2.0) if quick else Rig(peak=peak)
        recording = rig.run(parameters, seed)
        recording.save(file)
    _console.print(f"{file}: {len(recording.time)} samples, seed {seed}")


@sensors_app.command()
def fit(
    recording: Recording,
    robot: Robot = "cheetah_cub",
    out: Annotated[Path | None, typer.Option(help="Folder for the residual plots.")] = None,
    json: Json = None,
    save: Save = None,
) -> None:
    """Identify both cells from a bench recording, with 95 % confidence intervals.

    Refuses, with exit status 1, where the recording says nothing about a parameter.

    \b
    nermo sensors fit run1.csv
    nermo sensors fit run1.csv --out pictures --json fit.json --save my_foot.yaml
    """
    from nermo_sensors.bench.table import BenchRecording
    from nermo_sensors.identification.calibrate import calibrate
    from nermo_sensors.parameters import load_tactile

    with _told():
        parameters = load_tactile(robot)
        found = calibrate(BenchRecording.load(recording), parameters)
    rows = [
        {
            "law": law,
            "parameter": name,
            "value": value,
            "low": result.interval[name][0],
            "high": result.interval[name][1],
        }
        for law, result in found.fits.items()
        for name, value in result.values.items()
    ]
    _print_rows(f"{recording}: identified parameters, 95 % confidence", rows)
    laws = [
        {"law": law, "r_squared": result.r_squared, "residual_sd_v": result.residual_deviation}
        for law, result in found.fits.items()
    ]
    _print_rows("How well each law fits", laws)
    _console.print(f"the memory filter uses the law {found.calibration.law!r} for the piezoelectric cell")
    if out is not None:
        from nermo_sensors.plots import plot_fits

        out.mkdir(parents=True, exist_ok=True)
        plot_fits(found.fits, out / "residuals.png")
    tuned = parameters.model_copy(update={"calibration": found.calibration})
    _save(tuned, save)
    if json is not None:
        write_results(
            json, "sensors-fit", {"parameters": rows, "laws": laws, "law": found.calibration.law}, robot=robot
        )


@sensors_app.command()
def tune(
    recording: Recording,
    estimator: Annotated[Estimator, typer.Option(help="Which filter.")] = Estimator.MEMORY,
    objective: Annotated[
        Objective, typer.Option(help="thesis: (4.19). likelihood: small errors and honest variances together.")
    ] = Objective.LIKELIHOOD,
    robot: Robot = "cheetah_cub",
    particles: Annotated[int, typer.Option(min=4, max=500)] = 24,
    generations: Annotated[int, typer.Option(min=1, max=1000)] = 25,
    seed: Seed = 0,
    json: Json = None,
    save: Save = None,
) -> None:
    """Search the covariances of a filter by particle swarm (C 4.3.1.3).

    Tune on another recording than the one that was identified, and judge on a third.

    \b
    nermo sensors tune run2.csv --estimator f1 --objective thesis
    nermo sensors tune run2.csv --robot my_foot.yaml --save my_foot.yaml
    """
    from nermo_sensors.bench.table import BenchRecording
    from nermo_sensors.parameters import load_tactile
    from nermo_sensors.tuning import Swarm
    from nermo_sensors.tuning import tune as search

    with _told():
        parameters = load_tactile(robot)
        table = BenchRecording.load(recording)
        with _progress("generations") as progress:
            swarm = Swarm(objective.value, particles, generations, seed)
            found = search(estimator.value, parameters.calibration, parameters.noises, table, swarm, progress)
    before, after = (getattr(noises, estimator.value).model_dump() for noises in (parameters.noises, found.noises))
    rows = [{"covariance": name, "before": before[name], "after": after[name]} for name in after]
    _print_rows(f"{estimator.value}, {objective.value}: cost {found.cost_before:.4g} -> {found.cost:.4g}", rows)
    _save(parameters.model_copy(update={"noises": found.noises}), save)
    if json is not None:
        facts = {
            "covariances": rows,
            "cost_before": found.cost_before,
            "cost": found.cost,
            "history": found.history,
            "estimator": estimator.value,
            "objective": objective.value,
        }
        write_results(json, "sensors-tune", facts, robot=robot, seed=seed)


@sensors_app.command()
def doe(
    shape: Annotated[str, typer.Option(help="Electrodes: A (bands) or B (zebra).")] = "B",
    layers: Annotated[int, typer.Option(min=1)] = 2,
    length_mm: Annotated[float, typer.Option(min=0.1)] = 20.0,
    width_mm: Annotated[float, typer.Option(min=0.1)] = 30.0,
    glue: bool = True,
    json: Json = None,
) -> None:
    """The screening of C 4.2: design, aliases, table 4.5 out of table 4.4, and whether a given foot is feasible.

    \b
    nermo sensors doe
    nermo sensors doe --length-mm 20 --width-mm 25 --json doe.json
    """
    from nermo_sensors.doe.report import report

    with _told():
        facts = report(shape, layers, length_mm, width_mm, glue)
    _print_rows("Aliases of design 2^(6-2), E = ABC, F = BCD", facts["aliases"])
    _print_rows("Table 4.5 out of table 4.4, beside the printed values", facts["terms"])
    _print_rows("Backward elimination at p < 0.105 keeps", facts["elimination"])
    _print_rows("Feasibility (C 4.2.3)", facts["feasibility"])
    _print_rows("Requirements of table 4.1", facts["requirements"])
    if json is not None:
        write_results(json, "sensors-doe", facts)


@sensors_app.command()
def figure48(
    seeds: Annotated[int, typer.Option(min=1, max=1000, help="How many runs.")] = 20,
    seconds: Annotated[float, typer.Option(min=3.0, max=3600.0, help="Length of each, in seconds.")] = 60.0,
    seed: Annotated[int, typer.Option(min=0, help="Seed of everything random.")] = 0,
    json: Json = None,
) -> None:
    """C figure 4.8: F1 on a 2 Hz bump with both cells and with each alone. Only the fused estimate does not drift.

    Exit status 1 where that is not what comes out.

    \b
    nermo sensors figure48
    nermo sensors figure48 --seeds 2 --seconds 10 --json figure48.json
    """
    from nermo_sensors.bench.figure import figure_facts

    with _console.status("filtering"):
        rows = figure_facts(seeds, seconds, seed)
    _print_rows(f"C figure 4.8: {seeds} seeds, {seconds:g} s, hysteresis, saturation, 0.5 % rate bias, noise", rows)
    if json is not None:
        write_results(json, "sensors-figure48", {"rows": rows, "seeds": seeds, "duration_s": seconds}, seed=seed)
    if rows[0]["drifts"] or not all(row["drifts"] for row in rows[1:]):
        raise CommandError("the fused estimate should be the only one that does not drift: see the table")


def _save(parameters: Any, path: Path | None) -> None:
    if path is not None:
        with _told():
            write_yaml(parameters.model_dump(mode="json"), path)
        _console.print(f"saved: {path}")


@contextlib.contextmanager
def _told() -> Iterator[None]:
    """Bad input ends the command with its own words: 2 where it cannot be used, 1 where it says too little."""
    from nermo_sensors.bench.table import RecordingError
    from nermo_sensors.identification.fit import UnidentifiableError

    try:
        yield
    except UnidentifiableError as error:
        raise CommandError(f"not identifiable: {error}") from error
    except (ParameterError, RecordingError, ValueError, OSError) as error:
        raise CommandError(str(error), status=2) from error


@contextlib.contextmanager
def _progress(what: str) -> Iterator[Callable[[int, int], None]]:
    """A progress bar on a terminal, nothing elsewhere."""
    columns = (TextColumn(what), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=_console, disable=not _console.is_terminal) as bar:
        task = bar.add_task(what, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


def _print_rows(title: str, rows: Sequence[dict[str, Any]]) -> None:
    table = Table(title=title)
    for name, value in rows[0].items():
        table.add_column(name.replace("_", " "), justify="left" if isinstance(value, str) else "right")
    for row in rows:
        table.add_row(*(_cell(value) for value in row.values()))
    _console.print(table)


def _cell(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
