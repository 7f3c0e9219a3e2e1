"""``nermo gap``: the commands of simgap, and those of the mouse."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

import simgap.cli
from nermo_gap.blind.cli import mice_app
from nermo_gap.console import PROGRAM, refusals
from nermo_gap.explain.cli import explain_command, predict_command
from nermo_gap.protocol.cli import Calibration, Port, detectability_command, record_command, through_graph
from simgap.blind.cli import blind_app
from simgap.cli import Baselines, Budget, DiagnosisFile, Only, Out, OwnEffects, Reference, Seed
from simgap.console import HELP, called, fail, hurried, print_diagnosis, progress, silence, writable, write_diagnosis
from simgap.live.options import HERE, PORT, Web, WebHost, WebPort

if TYPE_CHECKING:
    from nermo_gap.protocol.next_experiment import HeldPlayer
    from nermo_sim.experiments.on_robot import Target
    from simgap.analysis.diagnose import Diagnosis
    from simgap.analysis.options import Options
    from simgap.live.watch import Live

# What does the work takes seconds to import, and help is asked for often: commands import it when they run.

gap_app = typer.Typer(
    name="gap",
    help="Diagnose the sim-to-real gap: where it lies, which effect causes it, how far it shrinks.",
    no_args_is_help=True,
    add_completion=False,
    context_settings=HELP,
)


gap_app.add_typer(blind_app)
gap_app.add_typer(mice_app)


@gap_app.callback()
def _gap() -> None:
    """Diagnose the sim-to-real gap: where it lies, which effect causes it, how far it shrinks."""


@gap_app.command("diagnose")
def diagnose_command(
    recordings: Annotated[
        list[Path], typer.Argument(help="MCAPs of this system; tables or bags of any robot with --model and --map.")
    ],
    robot: Annotated[
        str | None, typer.Option(help="nermo, nermo_lite or a parameter file; by default what the recording says.")
    ] = None,
    model: Annotated[Path | None, typer.Option(help="The nominal model, an MJCF.")] = None,
    map_: Annotated[Path | None, typer.Option("--map", help="YAML that maps columns to actuators and sensors.")] = None,
    out: Out = None,
    json_: DiagnosisFile = None,
    effects: OwnEffects = None,
    only: Only = None,
    seed: Seed = 0,
    baselines: Baselines = True,
    budget: Budget = None,
    reference: Reference = None,
    web: Web = False,
    web_host: WebHost = HERE,
    web_port: WebPort = PORT,
    target: Annotated[
        Literal["sim", "serial", "link"] | None,
        typer.Option(
            help="With --web: its button, while it is held, plays the next experiment on the twin, a robot at a cable, "
            "over Wi-Fi."
        ),
    ] = None,
    port: Port = "twin",
    calibration: Calibration = None,
) -> None:
    """Say where the gap of a recording lies, which effect causes it, and how far the effect shrinks it.

    \b
    Examples:
      nermo gap diagnose recordings/today --robot nermo --out diagnosis
      nermo gap diagnose recordings/today --reference recordings/yesterday
      nermo gap diagnose recordings/today --web
      nermo gap diagnose recordings/today --web --target serial --port /dev/ttyUSB0 --calibration my_robot.yaml
      nermo gap diagnose log.csv --model robot.xml --map map.yaml --json diagnosis.json
    """
    other = model is not None or map_ is not None
    if robot is not None and other:
        fail("--robot is a mouse with model and map of its own; --model and --map are for other robots", 2)
    mouse = robot is not None or (not other and any(r.suffix.lower() == ".mcap" or r.is_dir() for r in recordings))
    if not mouse and (model is None or map_ is None):
        fail("a table needs --model MODEL.xml and --map MAP.yaml, or --robot where it is one of the mouse", 2)
    if target is not None and not (web and mouse):
        fail("--target moves the mouse by a button of the page: it goes with --web, and with no other robot", 2)
    with refusals():
        from simgap.analysis.options import Options
        from simgap.effects.library import chosen_effects, load_effects
        from simgap.live.watch import watched

        writable(out or (None if json_ else Path("diagnosis")), json_)
        extra = tuple(c for path in effects or () for c in load_effects(path))
        chosen_effects(extra, only or ())
        options = Options(seed, None, extra, {}, baselines, tuple(only or ()), budget=budget)
        player = None if target is None else _player(target, port, calibration)
        with watched(web, web_host, web_port, player) as live:
            with silence() as terminal, hurried(terminal) as options.hurry, progress("align", terminal) as say:
                options.progress, options.staged = (live.beside(say), live.staged) if live else (say, None)
                if model is not None and map_ is not None:
                    found = _diagnosed(recordings, model, map_, options, reference or ())
                else:
                    # What knows the mouse is imported only for the mouse.
                    from nermo_gap.robots.diagnosis import diagnose_recordings

                    found = diagnose_recordings(recordings, robot, options, reference or ())
            found.report["command"] = called(PROGRAM, "diagnose")
            folder = out or (json_.parent if json_ else Path("diagnosis"))
            if mouse:
                from nermo_gap.robots.checks import what_to_do

                found.report["what_to_do"] = what_to_do(found.report, str(folder), [str(r) for r in recordings])
            written = write_diagnosis(found, None if json_ and not out else folder, json_, live)
            print_diagnosis(found, written)
            if live and player:
                _play_next(found, live, player, recordings, folder, robot is not None)


def _player(target: Target, port: str, calibration: Path | None) -> HeldPlayer:
    from nermo_gap.protocol.next_experiment import HeldPlayer

    return HeldPlayer(through_graph(), target, port, calibration)


def _play_next(
    found: Diagnosis, live: Live, player: HeldPlayer, recordings: Sequence[Path], folder: Path, named: bool
) -> None:
    from nermo_gap.protocol.next_experiment import Beside

    if found.proposal is None:
        typer.echo("no experiment is proposed, so that there is nothing to play", err=True)
        return
    player.beside = Beside(str(found.report["robot_file"]), recordings, folder, named)
    typer.echo("the page plays the next experiment while its button is held; Ctrl-C ends", err=True)
    live.play(found.proposal.experiment, found.plant)


def _diagnosed(
    recordings: Sequence[Path], model: Path, map_: Path, options: Options, reference: Sequence[Path]
) -> Diagnosis:
    """Of another robot than the mouse."""
    from simgap.analysis.diagnose import diagnose
    from simgap.data.corrected import original
    from simgap.data.mapping import load_map
    from simgap.data.plant import build_plant, load_spec
    from simgap.data.recording import load_recording

    plant = build_plant(load_spec(model), load_map(map_))
    options.corrects, options.reference = original(plant.map), [load_recording(r, plant) for r in reference]
    return diagnose([load_recording(r, plant) for r in recordings], plant, options)


gap_app.command("record")(record_command)


@gap_app.command("reveal")
def reveal_command(
    folder: Annotated[Path, typer.Argument(help="Recordings of a hidden mouse.")],
    diagnosis: Annotated[Path | None, typer.Argument(help="The diagnosis.json of these recordings.")] = None,
) -> None:
    """Open the seal of a hidden mouse, and say whether a diagnosis agrees with the truth.

    \b
    Example:
      nermo gap reveal mouse7 diagnosis/diagnosis.json
    """
    with refusals():
        from nermo_gap.blind.mice.seal import judge, open_seal
        from simgap.correction.apply import read_diagnosis

        answer = open_seal(folder)
        typer.echo(f"truth: {answer.sentence()}")
        if diagnosis is not None:
            typer.echo(f"diagnosis: {judge(answer, read_diagnosis(diagnosis, corrected=False))}")


gap_app.command("detectability")(detectability_command)


@gap_app.command("model")
def model_command(
    robot: Annotated[str, typer.Argument(help="nermo, nermo_lite or a parameter file.")],
    out: Annotated[Path, typer.Option(help="The MJCF to write.")],
) -> None:
    """Write the mouse's model as it is replayed into one MJCF, for `simgap` and whoever else has no Nermo.

    \b
    Examples:
      nermo gap model nermo_lite --out mouse.xml
      simgap map recordings/today --model mouse.xml --out mouse_map.yaml
      simgap diagnose recordings/today --model mouse.xml --map mouse_map.yaml
    """
    with refusals():
        from nermo_description.one_file import one_file
        from nermo_description.robots import load_robot
        from nermo_gap.robots.channels import Channels
        from nermo_gap.robots.diagnosis import replayed_spec
        from simgap.data.errors import GapInputError

        parameters = load_robot(robot)
        text = one_file(replayed_spec(parameters, Channels.of(parameters).servos))
        try:
            out.parent.mkdir(parents=True, exist_ok=True)
            out.write_text(text, encoding="utf-8")
        except OSError as error:
            raise GapInputError(f"{out}: cannot be written ({error.strerror})") from error
    typer.echo(out)


gap_app.command("effects")(simgap.cli.effects_command)
gap_app.command("check")(simgap.cli.check_command)
gap_app.command("map")(simgap.cli.map_command)
gap_app.command("monitor")(simgap.cli.monitor_command)
gap_app.command("example")(simgap.cli.example_command)


@gap_app.command("apply")
def apply_command(
    diagnosis: Annotated[Path, typer.Argument(help="The diagnosis.json of a recording.")],
    out: Annotated[
        Path, typer.Option(help="Robot file of the mouse (.yaml), or the corrected model (.xml), to write.")
    ],
    robot: Annotated[str | None, typer.Option(help="The mouse that was diagnosed; by default what it says.")] = None,
    model: Annotated[Path | None, typer.Option(help="Of another robot: the model that was diagnosed, an MJCF.")] = None,
    wrapper: Annotated[
        Path | None, typer.Option(help="With --model: Python file for what no MJCF can say; else OUT_signals.py.")
    ] = None,
    randomise: Annotated[
        Path | None, typer.Option(help="With --model: YAML file for ranges for domain randomisation.")
    ] = None,
    map_: Annotated[
        Path | None, typer.Option("--map", help="With --model: the map of the diagnosis; writes OUT_map.yaml.")
    ] = None,
) -> None:
    """Write the effects of a diagnosis: of the mouse as a robot to load, of any other into its model.

    \b
    Example:
      nermo gap apply diagnosis/diagnosis.json --out my_robot.yaml
      nermo experiment straight-line --quick --robot my_robot.yaml
      nermo gap apply diagnosis/diagnosis.json --model arm.xml --out arm_corrected.xml
    """
    if model is not None:
        if robot is not None:
            fail("--robot is a mouse, --model the MJCF of another robot; give one of them", 2)
        simgap.cli.apply_command(diagnosis, out, model, wrapper, randomise, map_)
        return
    if out.suffix == ".xml":
        fail("--out: a corrected model (.xml) needs --model, the MJCF that was diagnosed", 2)
    if out.suffix not in (".yaml", ".yml"):
        fail(f"--out: {out} must end in .yaml", 2)
    with refusals():
        from nermo_gap.robots.apply import deviations_of, write_robot
        from simgap.correction.apply import read_diagnosis

        report = read_diagnosis(diagnosis, corrected=False)
        base = robot or str(report.get("robot_file") or report["robot"])
        applied = deviations_of(report, base)
        if report["verdict"] != "effect":
            typer.echo(f"warning: the verdict was {report['verdict']}; the effects are its best guess", err=True)
        if not applied.deviations:
            fail(
                f"{diagnosis}: holds no effect that a robot file can hold ({'; '.join(applied.left_out) or 'none'})", 1
            )
        write_robot(applied.deviations, base, out)
    for deviation in applied.deviations:
        values = ", ".join(f"{n} {v:.4g}" for n, v in deviation.values.items())
        typer.echo(f"{deviation.effect} at {', '.join(deviation.sites) or 'the world'}: {values}")
    for line in applied.left_out:
        typer.echo(f"left out: {line}", err=True)
    typer.echo(f"written: {out}")


gap_app.command("explain")(explain_command)
gap_app.command("predict")(predict_command)


if __name__ == "__main__":
    typer.main.get_command(gap_app)()
