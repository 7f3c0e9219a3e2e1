"""Gamepads as data: one YAML a pad gives its axes and buttons names and says what each does."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Self

from ament_index_python.packages import PackageNotFoundError, get_package_share_directory
from pydantic import BaseModel, ConfigDict, Field, NonNegativeInt, create_model, model_validator

from nermo_control.spine.functions import SPINE_FUNCTIONS
from nermo_description.parameter_files import ParameterError, read_yaml, validate

DIRECTION_THRESHOLD = 0.5
"""How far an axis must be pushed to count as a pressed button."""


class _Controls(BaseModel):
    """What each axis and button does. A button may also be a direction of an axis, such as `dpad_y+`.

    `forward` and `turn` are axes: forward and left are positive, as ROS's joy has them.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    forward: str
    turn: str
    dead_man: str = Field(description="held while driving; the mouse stops when it is released")
    emergency_stop: str
    stand: str | None = Field(None, description="stand on four feet; takes back this pad's stop, asks for the release")
    sit: str | None = None
    crouch: str | None = None
    freeze: str | None = Field(None, description="freeze every servo until another posture is asked for")
    straight_line: str | None = Field(None, description="held: the mouse holds its line by itself")
    lift_leg: str | None = Field(None, description="stand with a leg lifted, the next one with each press")
    next_gait: str | None = None
    faster: str | None = None
    slower: str | None = None
    higher_frequency: str | None = None
    lower_frequency: str | None = None
    trim_left: str | None = None
    trim_right: str | None = None


_SPINE: dict[str, Any] = {f"spine_{name}": (str | None, None) for name in SPINE_FUNCTIONS}
Controls = create_model("Controls", __base__=_Controls, __doc__=_Controls.__doc__, **_SPINE)
"""The same, with a button for each spine function."""
AXES = ("forward", "turn")
BUTTONS = tuple(name for name in Controls.model_fields if name not in AXES)


class Pad(BaseModel):
    """One kind of gamepad: places of its axes and buttons in the joy message, and what they do."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    description: str
    axes: dict[str, NonNegativeInt]
    buttons: dict[str, NonNegativeInt]
    controls: Controls

    @model_validator(mode="after")
    def _controls_name_what_is_there(self) -> Self:
        used: dict[str, str] = {}
        for control, name in self.controls:
            if name is None:
                continue
            is_axis = control in AXES
            known = (
                [*self.axes] if is_axis else [*self.buttons, *(f"{axis}{sign}" for axis in self.axes for sign in "+-")]
            )
            if name not in known:
                kind = "axis" if is_axis else "button"
                raise ValueError(f"controls.{control}: there is no {kind} {name!r}; {_suggestion(name, known)}")
            if name in used:
                raise ValueError(f"controls.{control}: {name!r} already does {used[name]}")
            used[name] = control
        return self

    @property
    def axis_count(self) -> int:
        """Axes that a joy message of this pad has at least."""
        return max(self.axes.values(), default=-1) + 1

    @property
    def button_count(self) -> int:
        """Buttons that a joy message of this pad has at least."""
        return max(self.buttons.values(), default=-1) + 1

    def read(self, control: str, axes: list[float], buttons: list[int]) -> float | bool:
        """Value of a control in one joy message: an axis in [-1, 1], or whether a button is pressed."""
        name = getattr(self.controls, control)
        if control in AXES:
            return axes[self.axes[name]]
        if name is None:
            return False
        if name in self.buttons:
            return bool(buttons[self.buttons[name]])
        value = axes[self.axes[name[:-1]]]
        return (value if name[-1] == "+" else -value) > DIRECTION_THRESHOLD


def pads_directory() -> Path:
    """Where the pads that come with this package are.

    Raises:
        ParameterError: the package is not installed.
    """
    try:
        return Path(get_package_share_directory("nermo_bringup")) / "config" / "pads"
    except PackageNotFoundError:
        raise ParameterError("the package nermo_bringup is not installed; build and source the workspace") from None


def load_pad(name: str, directory: Path | None = None) -> Pad:
    """Read a pad by its name (`xbox`, `playstation`, ...) or the path of its YAML.

    Raises:
        ParameterError: there is no such pad, or its file is wrong.
    """
    if name.endswith((".yaml", ".yml")):
        return _read(Path(name))
    folder = directory or pads_directory()
    known = sorted(path.stem for path in folder.glob("*.yaml"))
    if name not in known:
        raise ParameterError(f"there is no pad {name!r} in {folder}; {_suggestion(name, known)}")
    return _read(folder / f"{name}.yaml")


def _read(path: Path) -> Pad:
    return validate(read_yaml(path), path, Pad)


def _suggestion(name: str, known: Sequence[str]) -> str:
    """Words that point from a name that is not known to the nearest that is, or to all of them."""
    nearest = difflib.get_close_matches(name, known, n=1)
    return f"did you mean {nearest[0]}?" if nearest else f"known are {', '.join(known)}"
