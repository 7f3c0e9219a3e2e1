"""`nermo demo` from its start to its verdict."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import yaml
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from nermo_bringup.demo import evaluation, pictures
from nermo_bringup.demo.plan import LIFTED, WALK_SPEED_M_S, Plan, make_plan
from nermo_bringup.launch.description import load
from nermo_bringup.launch.executables import find_launch_file
from nermo_bringup.launch.running_graph import running_graph
from nermo_bringup.recording.errors import RecordingError
from nermo_bringup.recording.taps import dated_directory
from nermo_control.gait.knowledge_base import GaitParameters
from nermo_control.types import Posture
from nermo_description.parameters import RobotParameters
from nermo_description.results import CommandError, write_results
from nermo_description.robots import load_robot
from nermo_node.recording_reader import Recording

NAMESPACE = "nermo"
GAIT_FREQUENCY_HZ = 0.8
WALK_S, QUICK_WALK_S = 10.0, 4.0
TURN_S, QUICK_TURN_S = 5.0, 4.0
SLOWEST = 0.2
"""Share of the asked real-time factor below which the demo gives up waiting."""


@dataclass(frozen=True)
class Settings:
    """What was asked for."""

    robot: str = "nermo_lite"
    out: Path | None = None
    """Folder for everything; None: a new one in demo/."""
    quick: bool = False
    real_time_factor: float = 1.0
    stepped: bool = False
    """The twin waits for the command of every tick."""
    video: bool = True
    seed: int = 0


@dataclass(frozen=True)
class Show:
    """What is shown by whom, and where it is kept."""

    settings: Settings
    robot: RobotParameters
    plan: Plan
    out: Path
    """Folder for everything."""

    @property
    def bag(self) -> Path:
        """The recording."""
        return self.out / "recording"


@dataclass(frozen=True)
class Outcome:
    """What came of it."""

    walks: list[evaluation.Walk]
    turns: list[evaluation.Turn]
    spine_turn: evaluation.SpineTurn
    balance: evaluation.Balance
    nose_lift: float
    """[rad] by sitting."""
    health: evaluation.GraphHealth
    complaints: list[str]


def run_demo(settings: Settings, json: Path | None, console: Console) -> bool:
    """Run the demo; whether the mouse did what it was told.

    Raises:
        CommandError: the graph did not come up or broke down, or its recording cannot be judged.
    """
    started = time.monotonic()
    gaits = GaitParameters()
    walk_s, turn_s = (QUICK_WALK_S, QUICK_TURN_S) if settings.quick else (WALK_S, TURN_S)
    plan = make_plan(list(gaits.gaits), GAIT_FREQUENCY_HZ, walk_s, turn_s)
    out = (settings.out or dated_directory(Path("demo"))).absolute()
    show = Show(settings, load_robot(settings.robot), plan, out)
    if show.bag.exists():
        raise CommandError(
            f"{show.bag} exists already; a recording is never overwritten: name another --out.", status=2
        )
    out.mkdir(parents=True, exist_ok=True)
    nodes = _walk(show, console)
    try:
        outcome, track, start = _judge(Recording(show.bag), plan, gaits)
    except RecordingError as error:
        raise CommandError(f"the recording cannot be judged: {error}") from error
    _print(outcome, plan, console)
    drawn = _draw(show, track, start, console)
    wall = time.monotonic() - started
    if json is not None:
        facts = {**_facts(show, outcome, nodes), "pictures": drawn, "wall_s": wall}
        write_results(json, "demo", facts, robot=show.robot.name, seed=settings.seed)
    console.print(f"recording {show.bag}\npictures  {', '.join(str(path) for path in drawn) or 'none'}", soft_wrap=True)
    verdict = "The mouse did it" if not outcome.complaints else "The mouse did not do it"
    console.print(f"{verdict}, in {wall:.0f} s.", style="bold green" if not outcome.complaints else "bold red")
    for complaint in outcome.complaints:
        console.print(f"  {complaint}", highlight=False)
    return not outcome.complaints


@contextmanager
def _progress(console: Console, what: str) -> Iterator[Callable[[float, float], None]]:
    """A progress bar on a terminal; nothing elsewhere, where the lines before and after say enough."""
    if not console.is_terminal:
        yield lambda done, total: None
        return
    with Progress(TextColumn(what), BarColumn(), TimeRemainingColumn(), console=console) as bar:
        task = bar.add_task(what, total=None)
        yield lambda done, total: bar.update(task, completed=min(done, total), total=total)


def _walk(show: Show, console: Console) -> list[str]:
    """Bring the graph up, play the plan, bring the graph down. The names of the graph's nodes."""
    settings, plan, bag = show.settings, show.plan, show.bag
    script = show.out / "commands.yaml"
    script.write_text(yaml.safe_dump(plan.command_file, sort_keys=False), encoding="utf-8")
    arguments = {
        "robot": settings.robot,
        "namespace": NAMESPACE,
        "teleop": "none",
        "real_time_factor": f"{settings.real_time_factor}",
        "stepped": str(settings.stepped).lower(),
        "seed": f"{settings.seed}",
        "record": str(bag),
    }
    nodes = [node.full_name for node in load(find_launch_file("nermo_bringup", "nermo.launch.xml"), arguments).nodes]
    # A domain of its own, so that neither another graph on this machine nor this one is disturbed.
    domain = int(os.environ.get("ROS_DOMAIN_ID") or 1 + os.getpid() % 100)
    console.print(f"bringing up {len(nodes)} nodes on the twin of {settings.robot} (ROS_DOMAIN_ID={domain})")
    expected = plan.duration / settings.real_time_factor
    with running_graph(arguments, show.out / "graph.log", domain) as graph:
        graph.wait_until_alive(bag, settings.stepped)
        console.print(f"walking for {plan.duration:.0f} s of simulated time")
        begin = time.monotonic()
        with _progress(console, "walking") as advance:
            graph.play(
                script,
                NAMESPACE,
                settings.stepped,
                30.0 + expected / SLOWEST,
                lambda: advance(time.monotonic() - begin, expected),
            )
    return [*nodes, f"/{NAMESPACE}/command_player"]


def _judge(recording: Recording, plan: Plan, gaits: GaitParameters) -> tuple[Outcome, evaluation.Track, int]:
    track, start = evaluation.read_track(recording, plan)
    walks, turns, nose_lift = [], [], 0.0
    spine, forces = evaluation.read_spine(recording, start), evaluation.read_foot_forces(recording, start)
    for scene in plan.scenes:
        if scene.kind == "walk":
            walks.append(evaluation.judge_walk(track, scene, plan.gait_frequency))
        elif scene.kind in ("turn_left", "turn_right"):
            turns.append(evaluation.judge_turn(track, scene))
        elif scene.kind == "turn_spine":
            spine_turn = evaluation.judge_spine_turn(track, scene, spine)
        elif scene.kind == "balance":
            wanted = Posture[f"LIFT_{LIFTED}".upper()]
            lift = evaluation.begun(scene, *evaluation.read_postures(recording, start), wanted)
            balance = evaluation.judge_balance(track, lift, forces, LIFTED)
        elif scene.kind == "sit":
            nose_lift = evaluation.sitting_pitch(track, scene)
    no_slip = {name: min(gaits.fastest(name, plan.gait_frequency), WALK_SPEED_M_S) for name in gaits.gaits}
    complaints = evaluation.complaints(walks, turns, spine_turn, balance, nose_lift, plan, no_slip)
    health = evaluation.read_health(recording)
    return Outcome(walks, turns, spine_turn, balance, nose_lift, health, complaints), track, start


def _draw(show: Show, track: evaluation.Track, start: int, console: Console) -> list[Path]:
    from nermo_sim.render import RenderingUnavailableError

    recording, plan, out = Recording(show.bag), show.plan, show.out
    drawn = [out / name for name in ("track.png", "gaits.png", "orientation.png", "balance.png")]
    pictures.draw_track(track, plan, drawn[0])
    pictures.draw_gaits(recording, start, plan, drawn[1])
    pictures.draw_orientation(track, plan, drawn[2])
    pictures.draw_balance(evaluation.read_foot_forces(recording, start), plan, drawn[3])
    if show.settings.video:
        try:
            with _progress(console, "drawing the video") as advance:
                pictures.render_video(recording, show.robot, out / "demo.mp4", advance)
            drawn.append(out / "demo.mp4")
        except RenderingUnavailableError as error:
            console.print(f"no video: {error}")
    return drawn


def _print(outcome: Outcome, plan: Plan, console: Console) -> None:
    table = Table(title=f"Straight walks at {plan.gait_frequency} Hz, spine off")
    for name in (
        "gait",
        "time [s]",
        "distance [m]",
        "speed [m/s]",
        "lateral drift [m]",
        "heading error [deg]",
        "stood [s]",
        "fell",
    ):
        table.add_column(name, justify="left" if name == "gait" else "right")
    for walk in outcome.walks:
        table.add_row(
            walk.gait.replace("_", " "),
            f"{walk.duration_s:.1f}",
            f"{walk.distance_m:.3f}",
            f"{walk.speed_m_s:.4f}",
            f"{walk.lateral_drift_m:+.3f}",
            f"{walk.heading_error_deg:+.1f}",
            f"{walk.stood_s:.1f}",
            "yes" if walk.fell else "no",
        )
    console.print(table)
    others = Table(title="Turns, balance, sitting and the graph", show_header=False)
    for turn in outcome.turns:
        others.add_row(f"turn {turn.direction}", f"{turn.turned_deg:+.0f} deg on a radius of {turn.radius_m:.2f} m")
    bent, lifted = outcome.spine_turn, outcome.balance
    others.add_row(
        "turn left with the spine",
        f"{bent.turned_deg:+.0f} deg on a radius of {bent.radius_m:.2f} m, spine servo at {bent.spine_rad:.2f} rad",
    )
    forces = ", ".join(f"{force:.2f}" for force in lifted.foot_forces_n)
    others.add_row(
        f"{lifted.leg.replace('_', ' ')} leg lifted, balance compensation",
        f"{'passed' if lifted.passed else 'failed'}, forces {forces} N, pitch {lifted.pitch_deg:+.1f} deg",
    )
    others.add_row("sit", f"nose up by {math.degrees(outcome.nose_lift):.1f} deg")
    age = outcome.health.command_age_ms
    ages = ", ".join(f"{name} {value:.2f} ms" for name, value in age.items())
    others.add_row("age of the servo commands at the twin", ages)
    others.add_row("ticks without a command", str(outcome.health.ticks_missed))
    others.add_row("simulated time over wall time", f"{outcome.health.real_time_factor:.2f}")
    console.print(others)


def _facts(show: Show, outcome: Outcome, nodes: list[str]) -> dict[str, Any]:
    return {
        "walks": [asdict(walk) for walk in outcome.walks],
        "turns": [asdict(turn) for turn in outcome.turns],
        "turn": asdict(outcome.spine_turn),
        "balance": asdict(outcome.balance),
        "sitting_nose_lift_deg": math.degrees(outcome.nose_lift),
        "graph": {
            "nodes": nodes,
            "command_age_ms": outcome.health.command_age_ms,
            "ticks_missed": outcome.health.ticks_missed,
            "real_time_factor": outcome.health.real_time_factor,
            "real_time_factor_asked": show.settings.real_time_factor,
            "stepped": show.settings.stepped,
        },
        "thresholds": {
            "speed_over_no_slip": evaluation.LEAST_SPEED,
            "drift_over_distance": evaluation.LARGEST_DRIFT,
            "heading_error_deg": evaluation.LARGEST_HEADING_ERROR_DEG,
            "turned_deg": evaluation.LEAST_TURN_DEG,
            "sitting_nose_lift_deg": evaluation.LEAST_SITTING_PITCH_DEG,
        },
        "simulated_s": show.plan.duration,
        "recording": show.bag,
        "complaints": outcome.complaints,
        "passed": not outcome.complaints,
    }
