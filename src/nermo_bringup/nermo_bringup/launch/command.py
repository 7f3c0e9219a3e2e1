"""`nermo launch` and `nermo up`: from words on a command line to running nodes."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Literal

from nermo_bringup.launch.claim import claimed
from nermo_bringup.launch.description import load, load_arguments
from nermo_bringup.launch.executables import find_executable, find_launch_file
from nermo_bringup.launch.runner import launch
from nermo_bringup.network import use_network
from nermo_description.invocation import run_line
from nermo_description.results import CommandError
from nermo_description.robots import MOUSE, ParameterError, family_of

MAIN_FILE = "nermo.launch.xml"
TARGETS = ("sim", "serial", "link")
# What must be installed for a target that is not the twin.
_TARGET_EXECUTABLES = {"serial": ("nermo_hw", "serial_driver"), "link": ("nermo_hw", "zenoh_link")}


def launch_words(package: str, words: Sequence[str], *, show_args: bool) -> int:
    """Runs `nermo launch PACKAGE FILE [NAME:=VALUE]...` or `nermo launch PATH [NAME:=VALUE]...`.

    Args:
        package: A package, or the path of a launch file.
        words: The other words.
        show_args: Only print what the file takes.

    Returns:
        The exit status.

    Raises:
        CommandError: What is wrong with the words, the file or a node.
    """
    if "/" in package or package.endswith(".xml"):
        file = Path(package)
        if not file.is_file():
            raise CommandError(f"the launch file {file} does not exist.", status=2)
    elif words and ":=" not in words[0]:
        name, *words = words
        if not name.endswith(".xml"):
            raise CommandError(f"{name} is not an XML launch file; only `ros2 launch` reads the others.", status=2)
        file = find_launch_file(package, name)
    else:
        raise CommandError("which launch file? nermo launch PACKAGE FILE [NAME:=VALUE]...", status=2)
    if show_args:
        for argument in load_arguments(file):
            default = "must be given" if argument.default is None else f"default {argument.default!r}"
            choices = f", one of {', '.join(argument.choices)}" if argument.choices else ""
            print(f"{argument.name}: {argument.description or '-'} ({default}{choices})")
        return 0
    nodes = load(file, read_arguments(words)).nodes
    with claimed(nodes) if file.name == MAIN_FILE else nullcontext():
        return launch(nodes)


def bring_up(
    robot: str, target: str, record: str, words: Sequence[str], network: Literal["localhost", "subnet"] | None = None
) -> int:
    """Runs `nermo up`.

    Args:
        robot: Name or parameter file of the robot.
        target: One of `TARGETS`.
        record: Folder to record into, or an empty string.
        words: Further arguments of the launch file.
        network: Who may take part; None leaves it to the environment.

    Raises:
        CommandError: An option is wrong, the robot is not known, what the target needs is not installed, or a graph of
            these names is up on this machine.
    """
    arguments = {"robot": robot, "target": target, **({"record": str(Path(record).absolute())} if record else {})}
    arguments |= read_arguments(words)
    robot, target, record = arguments["robot"], arguments["target"], arguments.get("record", "none")
    if target not in TARGETS:
        raise CommandError(f"--target {target} is not one of: {', '.join(TARGETS)}.", status=2)
    if check_robot(robot) != MOUSE and target != "sim":
        raise CommandError(
            f"--target {target}: there are no electronics for {robot}; --target sim walks its twin.", status=2
        )
    if target in _TARGET_EXECUTABLES:
        try:
            find_executable(*_TARGET_EXECUTABLES[target])
        except CommandError as error:
            package, executable = _TARGET_EXECUTABLES[target]
            raise CommandError(
                f"--target {target} needs {executable} of the hardware package {package}, which is not installed; "
                "--target sim walks the twin."
            ) from error
    if record != "none" and Path(record).exists():
        raise CommandError(f"--record {record} exists already; name a new folder.", status=2)
    if target == "link" and arguments.get("port", "twin") == "twin":
        make_missing_keys()
    nodes = load(find_launch_file("nermo_bringup", MAIN_FILE), arguments).nodes
    use_network(network)
    namespace = arguments.get("namespace", "nermo")
    with claimed(nodes):
        print(
            "Drive it with a gamepad, or from a second terminal: "
            f"{run_line('nermo_bringup', 'keyboard_teleop')} --ros-args -r __ns:=/{namespace}\nCtrl-C ends all.",
            flush=True,
        )
        return launch(nodes)


def check_robot(robot: str) -> str:
    """The robot's family. Raises CommandError where there is no such robot, before any node is started for it."""
    try:
        return family_of(robot)
    except ParameterError as error:
        raise CommandError(f"--robot: {error}", status=2) from error


def make_missing_keys() -> None:
    """For an emulated robot: both ends are on this machine, so nobody has to carry a key anywhere.

    Raises CommandError.
    """
    from nermo_hw.link.config import load_link
    from nermo_hw.link.keys import KeysError, make_keys

    link = load_link()
    assert link.keys is not None, "the list that comes along is encrypted"
    try:
        make_keys(link.keys, [link.robot.name, link.workstation.name])
    except KeysError as error:
        raise CommandError(f"{error}.") from error


def read_arguments(words: Sequence[str]) -> dict[str, str]:
    """Reads `NAME:=VALUE` words.

    Raises:
        CommandError: A word is not of that form, or a name comes twice.
    """
    arguments: dict[str, str] = {}
    for word in words:
        name, separator, value = word.partition(":=")
        if not separator or not name:
            raise CommandError(f"{word!r} is not an argument; write NAME:=VALUE.", status=2)
        if name in arguments:
            raise CommandError(f"the argument {name} is given twice.", status=2)
        arguments[name] = value
    return arguments
