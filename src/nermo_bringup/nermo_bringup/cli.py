"""The `nermo` command: one word for each thing that a user does. Each word imports what it needs when it is called."""

from __future__ import annotations

import functools
import importlib
import importlib.util
import os
import signal
import sys
import traceback
from pathlib import Path
from typing import Annotated, Any

import typer

from nermo_bringup.demo.cli import demo
from nermo_bringup.drive.cli import drive
from nermo_bringup.launch.cli import launch_file, up
from nermo_bringup.network import NetworkOption, use_network
from nermo_bringup.recording.cli import repair, replay
from nermo_bringup.teleop.cli import play
from nermo_description import invocation
from nermo_description.results import CommandError

_HELP_NAMES = {"help_option_names": ["-h", "--help"]}
_PASS_ON = {**_HELP_NAMES, "ignore_unknown_options": True, "allow_extra_args": True}

app = typer.Typer(
    name="nermo",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings=_HELP_NAMES,
)


@app.callback()
def nermo() -> None:
    """Walk a robot mouse: on its MuJoCo twin, or the real one."""


@app.command("test", context_settings=_PASS_ON)
def run_tests(
    context: typer.Context,
    quick: Annotated[bool, typer.Option("--quick", help="Leave out the tests marked slow.")] = False,
) -> None:
    """Check style and types, then run every test.

    Other arguments go to pytest, and then only the tests run.

    \b
    nermo test
    nermo test --quick
    nermo test -k launch -x
    nermo test src/nermo_control
    """
    from nermo_bringup import testing

    raise typer.Exit(testing.run_all(_root(), quick=quick, pytest_arguments=context.args))


@app.command(context_settings={**_PASS_ON, "allow_interspersed_args": False})
def run(context: typer.Context, package: str, executable: str, network: NetworkOption = None) -> None:
    """Run one executable of a package, as `ros2 run` does.

    \b
    nermo run nermo_sim mujoco_sim --ros-args -p robot:=nermo
    nermo run nermo_bringup keyboard_teleop --ros-args -r __ns:=/nermo
    """
    from nermo_bringup.launch.executables import find_executable

    path = find_executable(package, executable)
    use_network(network)
    # A shell in the background hands on an ignored SIGINT, which Python would never notice.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    os.execv(path, [str(path), *context.args])


app.command("launch")(launch_file)
app.command()(up)


@app.command(context_settings=_PASS_ON, add_help_option=False)
def doctor(context: typer.Context) -> None:
    """Say what is installed, what is missing, and what to do about it."""
    from nermo_bringup.environment import doctor

    raise typer.Exit(doctor.main(context.args))


for word in (drive, demo, play, replay, repair):
    app.command()(word)


# Words that packages bring along: where each lives, and its line in the help. They are offered once they exist, and
# imported when they are called.
_WORDS = {
    "experiment": (
        "nermo_bringup.experiment.cli:experiment_app",
        "Run an experiment of the theses; its table stands beside theirs.",
    ),
    "bench": (
        "nermo_sim.bench.cli:bench_app",
        "Measure: tick, loop, graph, sensors, serial, link, faults, firmware, fuzz, track, film, web.",
    ),
    "optimize": ("nermo_sim.optimize.cli:optimize_app", "Search for better parameters."),
    "calibrate": ("nermo_sim.calibrate.cli:calibrate_app", "Fit the physical numbers that the thesis does not print."),
    "sensors": ("nermo_sensors.cli:sensors_app", "Calibrate and judge tactile sensors."),
    "hw": ("nermo_hw.cli:hw_app", "The real robot: look at it, emulate it, test its lines."),
    "track": ("nermo_track.cli:track_app", "The pose of the mouse out of film."),
    "gap": ("nermo_bringup.protocol.cli:gap_app", "Say why robot and twin differ."),
}


# Things whose bench lives in another package than the others'.
_BENCHES = {
    **dict.fromkeys(("serial", "link", "faults"), "nermo_hw.bench.cli:bench_app"),
    "firmware": "nermo_hw.firmware.cli:bench_app",
    "fuzz": "nermo_bringup.fuzz.cli:bench_app",
    "track": "nermo_track.cli:bench_app",
    "film": "nermo_bringup.film_bench.cli:bench_app",
    "web": "nermo_bringup.web_bench.cli:bench_app",
}


def _offer_word(word: str, place: str, help_text: str) -> None:
    """Adds a word whose typer app lives in another module, if that module has it."""
    module, attribute = place.split(":")
    try:
        spec = importlib.util.find_spec(module)
    except ModuleNotFoundError:
        return
    if spec is None or spec.origin is None or f"{attribute} =" not in Path(spec.origin).read_text(encoding="utf-8"):
        return

    def call(context: typer.Context) -> None:
        bench = next((name for name in context.args if name in _BENCHES), None) if word == "bench" else None
        args = context.args if bench is None else [bench, *(arg for arg in context.args if arg != bench)]
        module, attribute = (place if bench is None else _BENCHES[bench]).split(":")
        try:
            there = getattr(importlib.import_module(module), attribute)
        except ImportError as error:
            raise CommandError(f"nermo {word} cannot start, a part of it is missing: {error}.") from error
        command = _as_called(there)
        if word == "bench" and bench is None:
            command.epilog = _spelled(
                f"Each with a help of its own: {', '.join(f'nermo bench {w}' for w in _BENCHES)}."
            )
        command(args=args, prog_name=f"{invocation.called()} {word}")

    settings = {**_PASS_ON, "allow_interspersed_args": False}
    app.command(word, help=help_text, context_settings=settings, add_help_option=False)(call)


for _word, (_place, _help) in _WORDS.items():
    _offer_word(_word, _place, _help)


def _root() -> Path:
    """The checkout that this command belongs to."""
    from nermo_bringup.environment.checkout import checkout_root

    try:
        return checkout_root()
    except FileNotFoundError as error:
        raise CommandError(f"{error}.") from error


def main() -> None:
    """Runs the command. A failure ends with one sentence on stderr and exit status 1, wrong usage with 2."""
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, _end)
    try:
        _as_called(app)(prog_name=os.environ.setdefault(invocation.VARIABLE, invocation.called()))
    except CommandError as error:
        print(f"nermo: {_spelled(str(error))}", file=sys.stderr)
        sys.exit(error.status)
    except Exception as error:
        if os.environ.get("NERMO_DEBUG"):
            traceback.print_exc()
        print(f"nermo: {_spelled(_sentence(error))}", file=sys.stderr)
        sys.exit(1)


def _spelled(text: str) -> str:
    """A text about our words, with the command as this person calls it."""
    return invocation.spelled(text, _words())


@functools.cache
def _words() -> tuple[str, ...]:
    """All words of the command. Making a group reads the types of all its options: 50 ms."""
    return tuple(typer.main.get_group(app).commands)


def _as_called(part: typer.Typer) -> Any:
    """The command of a typer app whose help can be typed as it stands."""

    def respell(command: Any) -> None:
        for text in ("help", "epilog", "short_help"):
            setattr(command, text, _spelled(getattr(command, text) or "") or None)
        for parameter in command.params:
            if said := getattr(parameter, "help", None):
                setattr(parameter, "help", _spelled(said))  # noqa: B010 - only options have it
        for inner in getattr(command, "commands", {}).values():
            respell(inner)

    command = typer.main.get_command(part)
    respell(command)
    return command


def _end(number: int, frame: object) -> None:
    """Ends the command such that whatever it started is ended too."""
    sys.exit(128 + number)


def _sentence(error: Exception) -> str:
    """An unforeseen error in one line; what the parameter files' validation says is meant for users as it is."""
    text = " ".join(str(error).split())
    if isinstance(error, ValueError | OSError):
        return text
    return f"{type(error).__name__}: {text} (NERMO_DEBUG=1 shows where)"


if __name__ == "__main__":
    main()
