"""The words `experiment` and `bench` of the `nermo` command."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from nermo_description.results import CommandError, write_results
from nermo_sim.console import cell, console, print_facts, print_rows, progress

Robot = Annotated[str, typer.Option(help="Name of a robot, or path of its parameter file.")]
Seed = Annotated[int, typer.Option(min=0, help="Seed of everything random.")]
Quick = Annotated[bool, typer.Option("--quick", help="Shorter and coarser, to see whether it works.")]
Json = Annotated[Path | None, typer.Option("--json", help="Write the results to this file.")]
Workers = Annotated[int | None, typer.Option(min=1, help="Processes; one a processor by default.")]
Repeats = Annotated[int | None, typer.Option(min=1, help="Runs a row; 3, or 1 with --quick.")]
Out = Annotated[
    Path, typer.Option(help="Folder for finished runs, pictures and the report; each experiment has one in it.")
]
RESULTS = Path("results")

_COLUMNS = {
    "straight-line": (
        *("gait", "frequency_hz", "stride_m", "spine", "offset_compensation", "speed_m_s", "speed_sd_m_s"),
        *("thesis_m_s", "theory_m_s", "roll_sd_deg", "pitch_sd_deg", "yaw_sd_deg", "fell"),
    ),
    "turning": (
        *("gait", "frequency_hz", "strategy", "path_radius_m", "time_s", "thesis_s", "radius_m", "thesis_radius_m"),
        *("theory_radius_m", "followed"),
    ),
    "balance": ("leg", "compensation", "passed", "thesis_passed", "foot_forces_n", "pitch_deg"),
    "maze": (
        *("spine", "time_s", "thesis_time_s", "speed_m_s", "thesis_speed_m_s", "pitch_sd_deg", "roll_sd_deg"),
        "finished",
    ),
    "coordination": (
        *("coordination", "loads", "compensation", "missing_leg", "speed_m_s", "speed_sd_m_s", "roll_sd_deg"),
        *("pitch_sd_deg", "step_m", "step_sd_m", "recovery_s", "recovered", "repeats", "fell"),
    ),
    "push": (*("coordination", "loads", "push_n", "runs", "survived", "recovered", "recovery_s", "largest_roll_deg"),),
    "footstep": ("controller", "delta_m", "step", "repeat", "displacement_m"),
    "gap-step": (
        *("controller", "change", "width_m", "runs", "crossed", "rate", "rate_low", "rate_high", "fell"),
        "largest_change_mm",
    ),
    "transition": (
        "compensation",
        "running_start",
        "repeat",
        "omega_rad_s",
        "excitation_hz",
        "stride_hz",
        "gait",
        "lags",
        "speed_m_s",
    ),
    "stability": (
        *(
            "model",
            "integrator",
            "stiffness_ratio",
            "toe_friction_ratio",
            "largest_step_s",
            "thesis_step_s",
            "step_cost_s",
        ),
        *("thesis_cost_s", "coordinates", "maximal_coordinates", "thesis_coordinates"),
    ),
    "gaze": (
        *("robot", "gaze", "head_yaw_sd_deg", "head_pitch_sd_deg", "head_pitch_mean_deg", "body_yaw_sd_deg"),
        *("body_pitch_sd_deg", "front_share", "fell"),
    ),
    "theory against twin": (
        *(
            "gait",
            "frequency_hz",
            "stride_m",
            "spine",
            "offset_compensation",
            "theory_m_s",
            "steering_m_s",
            "spine_m_s",
            "legs_m_s",
        ),
        *("pitch_m_s", "yaw_m_s", "slip_m_s", "contact_m_s", "reached_m_s"),
    ),
    "springs": (
        *("gait", "frequency_hz", "stride_m", "spine", "offset_compensation"),
        *(f"{joint}_yield_{kind}_deg" for joint in ("front_knee", "rear_knee") for kind in ("mean", "p95")),
        *(f"{joint}_yield_{kind}_deg" for joint in ("front_ankle", "rear_ankle") for kind in ("mean", "p95")),
    ),
    "ablation": ("off", "speed_m_s", "roll_sd_deg", "pitch_sd_deg", "radius_m", "arc_time_s", "lifts_passed"),
    "comparison": ("quantity", "theory", "twin", "robot", "ours", "ratio"),
    "summary": ("claim", "kind", "half", "thesis", "ours", "ratio", "band", "within"),
}

experiment_app = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode=None,
    add_completion=False,
    help="Run an experiment of the thesis; its table stands beside ours.",
)


@experiment_app.callback()
def experiment() -> None:
    """Run an experiment of the thesis; its table stands beside ours."""


@experiment_app.command("straight-line")
def straight_line(
    robot: Robot = "nermo_lite",
    seed: Seed = 0,
    quick: Quick = False,
    out: Out = RESULTS,
    json: Json = None,
    workers: Workers = None,
    repeats: Repeats = None,
    video: Annotated[bool, typer.Option(help="Also draw a video of the trot at 0.8 Hz.")] = True,
) -> None:
    """Speed and orientation noise by gait, frequency, stride length and spine (N 6.1.3, 6.2.1).

    A run that was stopped goes on where it was. Exit status 1 if the mouse fell.

    \b
    nermo experiment straight-line
    nermo experiment straight-line --quick --json straight.json
    nermo experiment straight-line --robot nermo --seed 7 --out /tmp/nermo
    """
    settings = _settings(robot, seed, quick, repeats)
    facts = _run("straight-line", settings, out, workers)
    print_rows("deflection of the springs in loaded stance", facts["rows"], _COLUMNS["springs"])
    pictures = _straight_line_pictures(settings, facts["rows"], out / "straight-line", video)
    _write(json, "straight-line", {**facts, "pictures": pictures}, settings)
    if any(row["fell"] for row in facts["rows"]):
        raise CommandError("the mouse fell: see the column `fell`")


@experiment_app.command("turning")
def turning(
    robot: Robot = "nermo_lite",
    seed: Seed = 0,
    quick: Quick = False,
    out: Out = RESULTS,
    json: Json = None,
    workers: Workers = None,
    repeats: Repeats = None,
) -> None:
    """Time on arcs of 1.0 and 0.5 m, and the smallest radius, by gait, frequency and strategy (N 6.1.4, 6.2.2).

    An arc that cannot be followed is a result (`followed`), not a failure.

    \b
    nermo experiment turning
    nermo experiment turning --quick --json turning.json
    """
    settings = _settings(robot, seed, quick, repeats)
    _write(json, "turning", _run("turning", settings, out, workers), settings)


@experiment_app.command("balance")
def balance(
    robot: Robot = "nermo_lite",
    seed: Seed = 0,
    quick: Quick = False,
    out: Out = RESULTS,
    json: Json = None,
    workers: Workers = None,
    repeats: Repeats = None,
) -> None:
    """Each leg lifted and swept, with and without balance compensation (N 6.1.5, 6.2.3).

    Also finds the interval of the fore-aft COM over which the table comes out as the thesis's.

    \b
    nermo experiment balance
    nermo experiment balance --json balance.json
    """
    settings = _settings(robot, seed, quick, repeats)
    facts = _run("balance", settings, out, workers)
    console.print(f"front COM from {cell(facts['com_interval_m'])} m ahead of base_link: the table holds")
    _write(json, "balance", facts, settings)


@experiment_app.command("maze")
def maze(
    robot: Robot = "nermo_lite",
    seed: Seed = 0,
    quick: Quick = False,
    out: Out = RESULTS,
    json: Json = None,
    workers: Workers = None,
    repeats: Repeats = None,
) -> None:
    """A path of 5 m through a maze, without the spine and with all of its functions (N 6.1.6, 6.2.4).

    Exit status 1 if the mouse did not come out.

    \b
    nermo experiment maze
    nermo experiment maze --quick --json maze.json
    """
    settings = _settings(robot, seed, quick, repeats)
    facts = _run("maze", settings, out, workers)
    _write(json, "maze", facts, settings)
    if not all(row["finished"] for row in facts["rows"]):
        raise CommandError("the mouse did not come out of the maze: see the column `ended` of the JSON file")


@experiment_app.command("gaze")
def gaze(
    robot: Robot = "nermo_lite",
    seed: Seed = 0,
    quick: Quick = False,
    out: Out = RESULTS,
    json: Json = None,
    workers: Workers = None,
    repeats: Repeats = None,
) -> None:
    """How much the head's cameras swing in a trot with the spine, with and without the neck against it (N 7.1.2).

    \b
    nermo experiment gaze
    nermo experiment gaze --robot nermo --json gaze.json
    """
    settings = _settings(robot, seed, quick, repeats)
    _write(json, "gaze", _run("gaze", settings, out, workers), settings)


@experiment_app.command("coordination")
def coordination(
    robot: Robot = "nermo_lite",
    seed: Seed = 0,
    quick: Quick = False,
    out: Out = RESULTS,
    json: Json = None,
    workers: Workers = None,
    repeats: Repeats = None,
) -> None:
    """The timed trot, coupled oscillators, and Tegotae on true and on estimated loads (C 3.3); a push, a leg lost.

    A fall is a result (`fell`), not a failure.

    \b
    nermo experiment coordination
    nermo experiment coordination --quick --json coordination.json
    """
    settings = _settings(robot, seed, quick, repeats)
    _write(json, "coordination", _run("coordination", settings, out, workers), settings)


@experiment_app.command("push")
def push(
    robot: Robot = "nermo_lite",
    seed: Seed = 0,
    quick: Quick = False,
    out: Out = RESULTS,
    json: Json = None,
    workers: Workers = None,
    repeats: Repeats = None,
) -> None:
    """How hard a push aside the timed trot and Tegotae take, and how soon they have recovered (C 3.3 on the mouse).

    A fall is a result (`survived`), not a failure.

    \b
    nermo experiment push
    nermo experiment push --quick --json push.json
    """
    from nermo_sim.report import modulation
    from nermo_sim.report.page import write_page

    settings = _settings(robot, seed, quick, repeats)
    facts = _run("push", settings, out, workers)
    pages = write_page(
        out / "push",
        "Pushes aside",
        f"Robot {robot}, seed {seed}{', quick' if quick else ''}.",
        [("pushes", "Survived, and recovered when", modulation.pushes(facts))],
        [("Pushes", facts["rows"])],
    )
    _write_with_pictures(json, "push", facts, pages, settings)


@experiment_app.command("footstep")
def footstep(
    robot: Robot = "nermo_lite",
    seed: Seed = 0,
    quick: Quick = False,
    out: Out = RESULTS,
    json: Json = None,
    workers: Workers = None,
) -> None:
    """How far footsteps move once the step length has changed: open-loop CPG and Tegotae (C 3.2.5, 3.3.3).

    \b
    nermo experiment footstep
    nermo experiment footstep --robot cheetah_cub
    nermo experiment footstep --quick --json footstep.json
    """
    from nermo_sim.report import modulation
    from nermo_sim.report.page import write_page

    settings = _settings(robot, seed, quick, repeats=1, pantographs=True)
    facts = _run("footstep", settings, out, workers)
    for name, values in facts["fit"].items():
        console.print(f"{name}: {cell(values)}")
    fit = [{"controller": name, **values} for name, values in facts["fit"].items()]
    pages = write_page(
        out / "footstep",
        "Footsteps after a change of the step length",
        f"Robot {robot}, C 3.2.5 and 3.3.3, seed {seed}{', quick' if quick else ''}.",
        [("footsteps", "Displacement (C figures 3.5, 3.8)", modulation.footsteps(facts))],
        [("Linear fit", fit), ("Footsteps", facts["rows"])],
    )
    _write_with_pictures(json, "footstep", facts, pages, settings)


@experiment_app.command("gap-step")
def gap_step(
    robot: Robot = "cheetah_cub",
    seed: Seed = 0,
    quick: Quick = False,
    out: Out = RESULTS,
    json: Json = None,
    workers: Workers = None,
    repeats: Annotated[int | None, typer.Option(min=1, help="Gaps a row; 20, or 3 with --quick.")] = None,
    disturbed: Annotated[bool, typer.Option(help="Random friction, first pose and pushes, as elsewhere.")] = False,
    video: Annotated[bool, typer.Option(help="Also draw a video of the first gap, each leg for itself.")] = True,
) -> None:
    """Steps over a trench that is seen ahead, at random distances: no change, all legs alike, each leg for itself.

    A foot in the trench is a result (`crossed`), not a failure.

    \b
    nermo experiment gap-step
    nermo experiment gap-step --repeats 50 --disturbed
    nermo experiment gap-step --quick --json gap.json
    """
    from dataclasses import replace

    from nermo_sim.disturbance import NO_DISTURBANCE
    from nermo_sim.experiments import gap_step as experiment
    from nermo_sim.experiments.stability import pantograph_robot
    from nermo_sim.report import modulation
    from nermo_sim.report.page import write_page

    repeats = repeats or (experiment.QUICK_REPEATS if quick else experiment.REPEATS)
    settings = _settings(robot, seed, quick, repeats, pantographs=True)
    pantograph_robot(robot)
    if not disturbed:
        settings = replace(settings, disturbance=NO_DISTURBANCE)
    facts = _run("gap-step", settings, out, workers)
    pages = write_page(
        out / "gap-step",
        "Steps over a gap that is seen ahead",
        f"Robot {robot}, C 3.2.5, seed {seed}{', disturbed' if disturbed else ''}{', quick' if quick else ''}.",
        [("gap_steps", "Gaps crossed, and footfalls against the gap", modulation.gap_crossings(facts))],
        [("Gaps", facts["rows"])],
    )
    if video:
        case = experiment.Case("cpg", "each", experiment.WIDTHS[1])
        pages += film(out / "gap-step" / "gap_step.mp4", *experiment.filmed(case, settings))
    _write_with_pictures(json, "gap-step", {**facts, "disturbed": disturbed}, pages, settings)


@experiment_app.command("transition")
def transition(
    robot: Robot = "nermo_lite",
    seed: Seed = 0,
    quick: Quick = False,
    out: Out = RESULTS,
    json: Json = None,
    workers: Workers = None,
    repeats: Repeats = None,
) -> None:
    """Which gait emerges as the excitation of the Tegotae rule is stepped up (C 3.3.2.3), named from the footfalls.

    \b
    nermo experiment transition
    nermo experiment transition --robot cheetah_cub --repeats 1
    nermo experiment transition --quick --json transition.json
    """
    from nermo_sim.report import modulation
    from nermo_sim.report.page import write_page

    settings = _settings(robot, seed, quick, repeats, pantographs=True)
    facts = _run("transition", settings, out, workers)
    pages = write_page(
        out / "transition",
        "Gaits as the excitation of the Tegotae rule rises",
        f"Robot {robot}, C 3.3.2.3, seed {seed}{', quick' if quick else ''}.",
        [("gaits", "Lags of the footfalls, and phases (C figure 3.7)", modulation.transitions(facts))],
        [("Gaits", facts["rows"])],
    )
    _write_with_pictures(json, "transition", facts, pages, settings)


@experiment_app.command("stability")
def stability(
    robot: Robot = "cheetah_cub",
    seed: Seed = 0,
    quick: Quick = False,
    out: Out = RESULTS,
    json: Json = None,
    workers: Workers = None,
) -> None:
    """The pantograph leg's dynamics three ways: largest stable step, its cost, cost of transport (C chapter 2).

    The times are measured: run it with one worker on a quiet machine for figures to compare.

    \b
    nermo experiment stability --workers 1
    nermo experiment stability --quick --json stability.json
    """
    from nermo_sim.experiments.stability import pantograph_robot
    from nermo_sim.report import legs
    from nermo_sim.report.page import write_page

    settings = _settings(robot, seed, quick, repeats=1, pantographs=True)
    pantograph_robot(robot)
    facts = _run("stability", settings, out, workers)
    force = {name: value for name, value in facts["leg_force"].items() if isinstance(value, float)}
    print_facts("leg force", force)
    if facts["transport"]:
        print_facts("cost of transport", {row["model"]: row for row in facts["transport"]})
    pages = write_page(
        out / "stability",
        "The dynamics of the pantograph leg three ways",
        f"Robot {robot}, C chapter 2{', quick' if quick else ''}.",
        [
            ("steps", "Largest stable step and its cost (C figures 2.5, 2.6, 2.10)", legs.largest_steps(facts)),
            ("leg_force", "Force of the leg (C figure 2.9)", legs.leg_force(facts)),
            ("energy", "Cost of transport", legs.energy(facts)),
        ],
        [("Steps", facts["rows"]), ("Cost of transport", facts["transport"])],
    )
    _write_with_pictures(json, "stability", facts, pages, settings)


@experiment_app.command("all")
def run_all(
    robot: Robot = "nermo_lite",
    seed: Seed = 0,
    quick: Quick = False,
    out: Out = RESULTS,
    json: Json = None,
    workers: Workers = None,
    repeats: Repeats = None,
) -> None:
    """All experiments, every claim of the thesis's chapter 6 beside ours, and one HTML report.

    What was already run goes in as it is; a run that was stopped goes on where it was. A claim that does not hold is
    a result, not a failure.

    \b
    nermo experiment all --json out.json
    nermo experiment all --quick --out /tmp/quick
    """
    import time

    from nermo_sim.experiments import suite
    from nermo_sim.report.html import write_report

    settings = _settings(robot, seed, quick, repeats)
    begin = time.monotonic()
    facts = suite.run_all(settings, out, workers, progress)
    for title, rows in (
        ("theory against twin", facts["theory_against_twin"]["rows"]),
        ("ablation", facts["ablation"]["rows"]),
        ("comparison", facts["comparison"]["rows"]),
        ("summary", facts["summary"]),
    ):
        print_rows(title, rows, _COLUMNS[title])
    report = write_report(out / "report.html", facts, settings)
    facts = {**facts, "report": report, "wall_s": time.monotonic() - begin}
    for group, count in facts["score"].items():
        console.print(f"{group}: {count['within']} of {count['of']} claims within their bands")
    console.print(f"report: {report}")
    _write(json, "all", facts, settings)


def _settings(robot: str, seed: int, quick: bool, repeats: int | None, pantographs: bool = False) -> Any:
    from nermo_sim.experiments.runs import REPEATS, Settings

    check_robot(robot, pantographs)
    if quick:
        return Settings(robot, distance=0.5, repeats=repeats or 1, seed=seed, quick=True)
    return Settings(robot, repeats=repeats or REPEATS, seed=seed)


def _run(name: str, settings: Any, out: Path, workers: int | None) -> dict[str, Any]:
    """Runs one experiment and prints its table."""
    from nermo_sim.experiments import suite

    with progress(name) as report:
        facts = suite.run_experiment(name, settings, out / name, workers, report)
    title = f"{name}, {settings.repeats} x each, {settings.robot}, seed {settings.seed}"
    print_rows(title, facts["rows"], _COLUMNS[name])
    return facts


def _write(json: Path | None, name: str, facts: dict[str, Any], settings: Any) -> None:
    if json is not None:
        write_results(json, name, facts, robot=settings.robot, seed=settings.seed)


def _write_with_pictures(
    json: Path | None, name: str, facts: dict[str, Any], pictures: Sequence[Path], settings: Any
) -> None:
    """Says where the pictures are, to the reader and in the file."""
    console.print(f"pictures: {', '.join(map(str, pictures))}")
    _write(json, name, {**facts, "pictures": pictures}, settings)


def _straight_line_pictures(settings: Any, rows: list[dict[str, Any]], out: Path, video: bool) -> list[Path]:
    from nermo_sim.experiments import straight_line as experiment
    from nermo_sim.experiments.runs import Job
    from nermo_sim.plots import plot_run, plot_speeds

    out.mkdir(parents=True, exist_ok=True)
    pictures = [out / "speed.png", out / "trot.png"]
    plot_speeds(rows, pictures[0])
    case = experiment.Case("trot", 0.8, experiment.STRIDE)
    recording, twin = experiment.walk(Job(case, 0, settings))
    plot_run(recording, pictures[1], case.key)
    if video:
        pictures += film(out / "trot.mp4", twin.model, recording.part(0.0, 10.0))
    console.print(f"pictures: {', '.join(map(str, pictures))}")
    return pictures


def film(path: Path, model: Any, recording: Any) -> list[Path]:
    """A video, where there is OpenGL to draw it with."""
    from nermo_sim.render import RenderingUnavailableError, save_video

    try:
        save_video(path, model, recording)
    except RenderingUnavailableError as error:
        console.print(f"no video: {error}")
        return []
    return [path]


bench_app = typer.Typer(
    rich_markup_mode=None,
    add_completion=False,
    subcommand_metavar="",
    context_settings={"allow_interspersed_args": True},
    help="Measure: the control tick, the in-process loop, the ROS graph.",
)
BENCHES = ("tick", "loop", "graph", "sensors", "loads")


@bench_app.callback(invoke_without_command=True)
def bench(
    what: Annotated[list[str] | None, typer.Argument(help="tick, loop, graph, sensors, loads; all by default.")] = None,
    robot: Robot = "nermo_lite",
    quick: Quick = False,
    json: Json = None,
) -> None:
    """Measure: the control tick, the in-process loop, the ROS graph.

    \b
    nermo bench
    nermo bench tick loop
    nermo bench graph --json graph.json
    """
    check_robot(robot)
    names = BENCHES if not what or "all" in what else tuple(what)
    facts: dict[str, Any] = {}
    for name in names:
        with console.status(f"measuring: {name}"):
            facts[name] = run_bench(name, robot, quick)
        print_facts(name, facts[name])
    if json is not None:
        write_results(
            json, "bench", {key: value for part in facts.values() for key, value in part.items()}, robot=robot
        )


def run_bench(name: str, robot: str = "nermo_lite", quick: bool = False) -> dict[str, Any]:
    """Runs one measurement.

    Raises CommandError with status 2 for an unknown name.
    """
    from nermo_sim.bench import BenchSettings, bench_loop, bench_tick

    settings = BenchSettings(robot, duration=4.0 if quick else 20.0)
    if name == "tick":
        return bench_tick(settings)
    if name == "loop":
        return bench_loop(settings)
    if name == "graph":
        from nermo_sim.nodes.bench_graph import bench_graph

        return bench_graph(robot, duration=5.0 if quick else 20.0)
    if name == "sensors":
        from nermo_sensors.bench.command import bench_sensors

        return bench_sensors(quick=quick, pictures=Path("results/sensors"))
    if name == "loads":
        from nermo_sim.bench_loads import bench_loads
        from nermo_sim.nodes.bench_loads_graph import bench_loads_graph

        duration = 6.0 if quick else 30.0
        alone, graph = bench_loads(robot, duration), bench_loads_graph(robot, duration)
        return {**alone, **graph, "loads": [*alone["loads"], *graph["loads"]]}
    raise CommandError(f"bench {name!r} is unknown: choose among {', '.join(BENCHES)} and all", status=2)


def check_robot(robot: str, pantographs: bool = False) -> None:
    """Nothing for a mouse that can be loaded, or any robot. Raises CommandError (status 2)."""
    from nermo_description.robots import ParameterError, load_any_robot, load_robot

    try:
        (load_any_robot if pantographs else load_robot)(robot)
    except ParameterError as error:
        raise CommandError(str(error), status=2) from error
