"""Reads ROS 2 XML launch files, the part of them that this project uses; anything else in them is an error.

Understood are `arg` (with `choice`), `let`, `node` (with `param`, `remap`, `env`), `group`, `push_ros_namespace` and
`include`. The meaning is that of ROS's own launch, so that the same file serves `ros2 launch`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from nermo_bringup.launch.substitution import Substituter, SubstitutionError, truth
from nermo_bringup.launch.xml import Element, LaunchError, read
from nermo_description.parameter_files import ParameterError, parse_yaml

ParameterValue = bool | int | float | str | list[bool] | list[int] | list[float] | list[str]

_CONDITIONS = {"if", "unless"}
_ACTIONS = {"arg", "let", "node", "group", "push_ros_namespace", "include"}
# tag: attributes that must be there, attributes that may be there, elements that may stand within
_GRAMMAR: dict[str, tuple[set[str], set[str], set[str]]] = {
    "launch": (set(), {"version"}, _ACTIONS),
    "arg": ({"name"}, {"default", "description"} | _CONDITIONS, {"choice"}),
    "choice": ({"value"}, set(), set()),
    "let": ({"name", "value"}, _CONDITIONS, set()),
    "node": (
        {"pkg", "exec"},
        {"name", "namespace", "args", "respawn", "respawn_delay", "output"} | _CONDITIONS,
        {"param", "remap", "env"},
    ),
    "param": (set(), {"name", "value", "from"}, set()),
    "remap": ({"from", "to"}, set(), set()),
    "env": ({"name", "value"}, set(), set()),
    "group": (set(), _CONDITIONS, _ACTIONS),
    "push_ros_namespace": ({"namespace"}, _CONDITIONS, set()),
    "include": ({"file"}, _CONDITIONS, {"arg"}),
    "include/arg": ({"name", "value"}, set(), set()),
}
_OUTPUTS = ("screen", "both", "log")
_DEEPEST_INCLUDE = 20


@dataclass(frozen=True)
class Argument:
    """An argument that a launch file takes.

    Attributes:
        name: As in `name:=value`.
        default: Its value where none is given, or None where one must be.
        description: What it is for.
        choices: The values that it may have; any where empty.
    """

    name: str
    default: str | None
    description: str
    choices: tuple[str, ...]


@dataclass(frozen=True)
class NodeAction:
    """A node to start.

    Attributes:
        package: Package of its executable.
        executable: Name of its executable.
        name: Its name in the graph, or None for the one that it gives itself.
        namespace: Its absolute namespace, or an empty string for the root.
        parameters: Values by name, and files of values, in the order in which they apply.
        remappings: (from, to).
        arguments: Its own command line, before the ROS arguments.
        environment: Variables added to its environment.
        respawn: Whether it is started again when it ends.
        respawn_delay: Time between [s].
        output: `screen` or `both` shows all that it prints, `log` only its stderr.
        origin: File and line that ask for it.
    """

    package: str
    executable: str
    name: str | None
    namespace: str
    parameters: tuple[tuple[str, ParameterValue] | Path, ...]
    remappings: tuple[tuple[str, str], ...]
    arguments: tuple[str, ...]
    environment: Mapping[str, str]
    respawn: bool
    respawn_delay: float
    output: str
    origin: str

    @property
    def full_name(self) -> str:
        """Namespace and name, as the graph shows it."""
        return f"{self.namespace}/{self.name or self.executable}"


@dataclass
class LaunchDescription:
    """What a launch file says, for given arguments.

    Attributes:
        arguments: The arguments that it and the files that it includes take.
        nodes: The nodes to start.
    """

    arguments: dict[str, Argument] = field(default_factory=dict)
    nodes: list[NodeAction] = field(default_factory=list)


@dataclass(frozen=True)
class _Scope:
    """What holds at one place of a file: a group has its own."""

    variables: dict[str, str]
    namespace: str
    folder: Path
    depth: int = 0

    def inner(self) -> _Scope:
        return replace(self, variables=dict(self.variables))


def load(file: Path, arguments: Mapping[str, str]) -> LaunchDescription:
    """Reads a launch file.

    Args:
        file: The file.
        arguments: Values of its arguments.

    Raises:
        LaunchError: What is wrong, with file and line; or an argument that the file does not take, or lacks.
    """
    description = LaunchDescription()
    _read_file(file, _Scope(dict(arguments), "", file.parent), description)
    for name in arguments:
        if name not in description.arguments:
            known = ", ".join(description.arguments) or "none"
            raise LaunchError(f"{file} takes no argument {name!r}; it takes: {known}", status=2)
    return description


def load_arguments(file: Path) -> list[Argument]:
    """The arguments that a launch file itself takes, with their defaults as they are written."""
    root = read(file)
    _check(root, "launch")
    return [
        Argument(
            name=child.attributes["name"],
            default=child.attributes.get("default"),
            description=child.attributes.get("description", ""),
            choices=tuple(choice.attributes["value"] for choice in child.children),
        )
        for child in root.children
        if child.tag == "arg"
    ]


def _read_file(file: Path, scope: _Scope, description: LaunchDescription) -> None:
    root = read(file)
    if root.tag != "launch":
        raise root.error(f"the root must be <launch>, not <{root.tag}>")
    _check(root, "launch")
    _read_actions(root, scope, description)


def _check(element: Element, rule: str) -> None:
    """Holds an element and all within it to the grammar."""
    required, optional, children = _GRAMMAR[rule]
    for name in element.attributes:
        if name not in required | optional:
            known = ", ".join(sorted(required | optional))
            raise element.error(f"<{element.tag}> with attribute {name!r} is not supported; supported are: {known}")
    for name in sorted(required):
        if name not in element.attributes:
            raise element.error(f"<{element.tag}> lacks the attribute {name!r}")
    for child in element.children:
        if child.tag not in children:
            known = ", ".join(sorted(children)) or "nothing"
            raise child.error(f"<{child.tag}> within <{element.tag}> is not supported; supported are: {known}")
        nested = f"{rule}/{child.tag}"
        _check(child, nested if nested in _GRAMMAR else child.tag)


def _get(element: Element, name: str, scope: _Scope, default: str = "") -> str:
    """An attribute with its substitutions made."""
    if name not in element.attributes:
        return default
    try:
        return Substituter(scope.variables, scope.folder)(element.attributes[name])
    except SubstitutionError as error:
        raise element.error(f"{name}: {error}") from error


def _truth(element: Element, name: str, scope: _Scope, default: bool) -> bool:
    if name not in element.attributes:
        return default
    try:
        return truth(_get(element, name, scope))
    except SubstitutionError as error:
        raise element.error(f"{name}: {error}") from error


def _read_actions(parent: Element, scope: _Scope, description: LaunchDescription) -> None:
    for element in parent.children:
        if not _truth(element, "if", scope, True) or _truth(element, "unless", scope, False):
            continue
        if element.tag == "arg":
            _declare(element, scope, description)
        elif element.tag == "let":
            scope.variables[_get(element, "name", scope)] = _get(element, "value", scope)
        elif element.tag == "push_ros_namespace":
            scope = replace(scope, namespace=_join(scope.namespace, _get(element, "namespace", scope)))
        elif element.tag == "group":
            _read_actions(element, scope.inner(), description)
        elif element.tag == "include":
            _include(element, scope, description)
        else:
            description.nodes.append(_node(element, scope))


def _argument(element: Element, scope: _Scope) -> Argument:
    return Argument(
        name=_get(element, "name", scope),
        default=_get(element, "default", scope) if "default" in element.attributes else None,
        description=_get(element, "description", scope),
        choices=tuple(_get(choice, "value", scope) for choice in element.children),
    )


def _declare(element: Element, scope: _Scope, description: LaunchDescription) -> None:
    argument = _argument(element, scope)
    description.arguments.setdefault(argument.name, argument)
    if argument.name not in scope.variables:
        if argument.default is None:
            about = f" ({argument.description})" if argument.description else ""
            problem = element.error(f"the argument {argument.name!r}{about} must be given: {argument.name}:=...")
            problem.status = 2
            raise problem
        scope.variables[argument.name] = argument.default
    value = scope.variables[argument.name]
    if argument.choices and value not in argument.choices:
        problem = element.error(f"{argument.name}:={value} is not one of: {', '.join(argument.choices)}")
        problem.status = 2
        raise problem


def _include(element: Element, scope: _Scope, description: LaunchDescription) -> None:
    if scope.depth >= _DEEPEST_INCLUDE:
        raise element.error(f"more than {_DEEPEST_INCLUDE} files include each other")
    file = Path(_get(element, "file", scope))
    if not file.is_file():
        raise element.error(f"the file {file} does not exist")
    variables = dict(scope.variables)
    for child in element.children:
        variables[_get(child, "name", scope)] = _get(child, "value", scope)
    _read_file(file, _Scope(variables, scope.namespace, file.parent, scope.depth + 1), description)


def _node(element: Element, scope: _Scope) -> NodeAction:
    output = _get(element, "output", scope, "log")
    if output not in _OUTPUTS:
        raise element.error(f"output={output!r} is not supported; supported are: {', '.join(_OUTPUTS)}")
    delay = _get(element, "respawn_delay", scope, "0")
    try:
        respawn_delay = float(delay)
    except ValueError:
        respawn_delay = -1.0
    if not 0.0 <= respawn_delay < float("inf"):
        raise element.error(f"respawn_delay={delay!r} is not a time in seconds")
    children = {tag: [child for child in element.children if child.tag == tag] for tag in ("param", "remap", "env")}
    return NodeAction(
        package=_get(element, "pkg", scope),
        executable=_get(element, "exec", scope),
        name=_get(element, "name", scope) or None,
        namespace=_join(scope.namespace, _get(element, "namespace", scope)),
        parameters=tuple(_parameter(child, scope) for child in children["param"]),
        remappings=tuple((_get(child, "from", scope), _get(child, "to", scope)) for child in children["remap"]),
        arguments=tuple(_get(element, "args", scope).split()),
        environment={_get(child, "name", scope): _get(child, "value", scope) for child in children["env"]},
        respawn=_truth(element, "respawn", scope, False),
        respawn_delay=respawn_delay,
        output=output,
        origin=f"{element.file}:{element.line}",
    )


def _parameter(element: Element, scope: _Scope) -> tuple[str, ParameterValue] | Path:
    given = set(element.attributes)
    if given == {"from"}:
        file = Path(_get(element, "from", scope))
        if not file.is_file():
            raise element.error(f"the parameter file {file} does not exist")
        return file
    if given == {"name", "value"}:
        return _get(element, "name", scope), _value(element, _get(element, "value", scope))
    raise element.error("<param> takes name and value, or from")


def _value(element: Element, text: str) -> ParameterValue:
    """A parameter's value: its type is what YAML makes of the text, as in ROS's own launch."""
    try:
        value = parse_yaml(text, "value")
    except ParameterError:
        return text
    if isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, list):
        kinds = {type(item) for item in value}
        if len(kinds) <= 1 and kinds <= {bool, int, float, str}:
            return value
        raise element.error(f"the list {text!r} must hold numbers, texts or truths, all of one type")
    return text


def _join(outer: str, inner: str) -> str:
    """A namespace within a namespace; always absolute, empty for the root."""
    if not inner:
        return outer
    joined = inner if inner.startswith("/") else f"{outer}/{inner}"
    return joined.rstrip("/")
