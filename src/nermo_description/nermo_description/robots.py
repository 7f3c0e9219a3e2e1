"""The robots' parameter files: found by name, read, validated. No mujoco here."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from typing import Any

from nermo_description.pantograph import PantographParameters
from nermo_description.parameter_files import ParameterError, read_yaml, validate
from nermo_description.parameters import RobotParameters

__all__ = ["AnyRobot", "ParameterError", "load_any_robot", "load_robot", "pantograph_names", "robot_names"]

AnyRobot = RobotParameters | PantographParameters
"""A mouse, or a robot with pantograph legs."""

_FOLDER = Path(str(files("nermo_description"))) / "robots"


def robot_names() -> tuple[str, ...]:
    """Robots that come with the package."""
    return tuple(sorted(path.stem for path in _FOLDER.glob("*.yaml")))


def pantograph_names() -> tuple[str, ...]:
    """Robots with pantograph legs that come with the package."""
    return tuple(sorted(path.stem for path in (_FOLDER / "pantograph").glob("*.yaml")))


def load_any_robot(name_or_path: str | Path) -> AnyRobot:
    """Parameters of a mouse or of a robot with pantograph legs, by name or from a YAML file. Raises ParameterError.

    A file with a field `leg` is one of a robot with pantograph legs.
    """
    path = _find(name_or_path, pantographs=True)
    data = read_yaml(path)
    if path.parent == _FOLDER / "pantograph" or (isinstance(data, dict) and "leg" in data):
        return validate(data, path, PantographParameters)
    return load_robot(path)


def load_robot(name_or_path: str | Path) -> RobotParameters:
    """Parameters of a mouse, by its name (`nermo`, `nermo_lite`) or from a YAML file. Raises ParameterError."""
    path = _find(name_or_path)
    return validate(_with_base(read_yaml(path), path), path, RobotParameters)


def _with_base(data: Any, path: Path) -> Any:
    """A robot that names another one as `base` takes from it what it does not say itself."""
    if not isinstance(data, dict) or "base" not in data:
        return data
    base = data["base"]
    if base not in robot_names() or base == path.stem:
        others = [name for name in robot_names() if name != path.stem]
        raise ParameterError(f"{path}: base: is {base!r}; it must be one of {', '.join(others)}")
    own = {field: value for field, value in data.items() if field != "base"}
    return _merged(_with_base(read_yaml(_find(base)), path), own)


def _merged(base: dict[str, Any], own: dict[str, Any]) -> dict[str, Any]:
    """`base` with what `own` says otherwise, mapping by mapping."""
    result = dict(base)
    for field, value in own.items():
        inherited = result.get(field)
        result[field] = _merged(inherited, value) if isinstance(inherited, dict) and isinstance(value, dict) else value
    return result


def _find(name_or_path: str | Path, pantographs: bool = False) -> Path:
    path, name = Path(name_or_path), str(name_or_path)
    if path.suffix in (".yaml", ".yml"):
        return path
    if name in robot_names():
        return _FOLDER / f"{name}.yaml"
    if name in pantograph_names():
        if pantographs:
            return _FOLDER / "pantograph" / f"{name}.yaml"
        raise ParameterError(f"robot {name!r} has pantograph legs; here a mouse is needed: {', '.join(robot_names())}")
    known = (*robot_names(), *pantograph_names()) if pantographs else robot_names()
    raise ParameterError(f"robot {name!r} does not exist; known are {', '.join(known)}, or give a .yaml file")
