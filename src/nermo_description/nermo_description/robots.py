"""The robots' parameter files: found by name, read, validated. No mujoco here.

A file says its `family`, which decides on its fields, its model and its controller; a robot that names another one as
`base` has that one's family. A file that says neither is a mouse's.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any, TypeVar

from nermo_description.pantograph import PantographParameters
from nermo_description.parameter_files import ParameterError, merged, read_yaml, validate
from nermo_description.parameters import RobotDescription, RobotParameters

__all__ = [
    "FAMILIES",
    "MOUSE",
    "AnyRobot",
    "ParameterError",
    "family_of",
    "load_any_robot",
    "load_robot",
    "robot_names",
]

AnyRobot = RobotParameters | PantographParameters
"""A robot of any family."""
Robot = TypeVar("Robot", bound=RobotDescription)

FAMILIES: dict[str, type[AnyRobot]] = {kind.family: kind for kind in (RobotParameters, PantographParameters)}
"""The parameters that a robot of each family has."""
MOUSE = RobotParameters.family
_FOLDER = Path(str(files("nermo_description"))) / "robots"


def robot_names(families: Sequence[str] = (MOUSE,)) -> tuple[str, ...]:
    """Robots of these families that come with the package."""
    return tuple(name for name, family in _known().items() if family in families)


def family_of(name_or_path: str | Path, families: Sequence[str] = tuple(FAMILIES)) -> str:
    """Family of a robot, by name or from a YAML file. Raises ParameterError, also where it is none of these."""
    path = _find(name_or_path, families)
    family = _family(_with_base(read_yaml(path), path), path)
    if family not in families:
        raise _wrong_family(name_or_path, family, families)
    return family


def load_any_robot(name_or_path: str | Path, families: Sequence[str] = tuple(FAMILIES)) -> AnyRobot:
    """Parameters of a robot of one of these families, by name or from a YAML file. Raises ParameterError."""
    return load_of_family(FAMILIES[family_of(name_or_path, families)], name_or_path)


def load_robot(name_or_path: str | Path) -> RobotParameters:
    """Parameters of a mouse, by its name (`nermo`, `nermo_lite`) or from a YAML file. Raises ParameterError."""
    return load_of_family(RobotParameters, name_or_path)


def load_of_family(kind: type[Robot], name_or_path: str | Path) -> Robot:
    """Parameters of a robot of one family, by name or from a YAML file. Raises ParameterError."""
    family_of(name_or_path, (kind.family,))
    path = _find(name_or_path, (kind.family,))
    data = _with_base(read_yaml(path), path)
    if isinstance(data, dict):
        data = {field: value for field, value in data.items() if field != "family"}
    return validate(data, path, kind)


@functools.lru_cache(maxsize=1)
def _known() -> dict[str, str]:
    """Family of each robot that comes with the package."""
    return {path.stem: _family(_with_base(read_yaml(path), path), path) for path in sorted(_FOLDER.glob("*.yaml"))}


def _family(data: Any, path: Path) -> str:
    family = data.get("family", MOUSE) if isinstance(data, dict) else MOUSE
    if family not in FAMILIES:
        raise ParameterError(f"{path}: family: is {family!r}; it must be one of {', '.join(FAMILIES)}")
    return str(family)


def _wrong_family(robot: str | Path, family: str, wanted: Sequence[str]) -> ParameterError:
    known = ", ".join(robot_names(wanted))
    needed = " or ".join(wanted)
    return ParameterError(f"robot {str(robot)!r} is of the family {family}; needed here is {needed}: {known}")


def _with_base(data: Any, path: Path) -> Any:
    """A robot that names another one as `base` takes from it what it does not say itself."""
    if not isinstance(data, dict) or "base" not in data:
        return data
    base, names = data["base"], sorted(other.stem for other in _FOLDER.glob("*.yaml"))
    if base not in names or base == path.stem:
        others = [name for name in names if name != path.stem]
        raise ParameterError(f"{path}: base: is {base!r}; it must be one of {', '.join(others)}")
    own = {field: value for field, value in data.items() if field != "base"}
    return merged(_with_base(read_yaml(_FOLDER / f"{base}.yaml"), path), own)


def _find(name_or_path: str | Path, families: Sequence[str]) -> Path:
    path, name = Path(name_or_path), str(name_or_path)
    if path.suffix in (".yaml", ".yml"):
        return path
    if (family := _known().get(name)) is None:
        known = ", ".join(robot_names(families))
        raise ParameterError(f"robot {name!r} does not exist; known are {known}, or give a .yaml file")
    if family not in families:
        raise _wrong_family(name, family, families)
    return _FOLDER / f"{name}.yaml"
