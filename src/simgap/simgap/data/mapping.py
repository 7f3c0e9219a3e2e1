"""MAP.yaml: which column of a recording is which actuator or sensor of the model, in which unit."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from simgap.data.errors import GapInputError

Kind = Literal["position", "velocity", "torque", "voltage"]
Quantity = Literal["position", "velocity", "acceleration", "orientation", "angular_velocity", "torque", "force"]
Component = Literal["x", "y", "z", "w", "roll", "pitch", "yaw"]

LARGEST_MAP = 50_000
"""Bytes. A map of a hundred channels has 10 000; PyYAML takes seconds for this."""
DEEPEST = 20
"""Collections within collections; a map has three. Python recurses for each."""


class _Row(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class TimeRow(_Row):
    """The time column; ``offset`` is not needed, any origin will do."""

    column: str
    unit: str | None = None


class InputRow(_Row):
    """What the robot was told (actuator), or what was measured to act on it (joint, ``measured: true``)."""

    column: str
    unit: str | None = None
    actuator: str | None = None
    joint: str | None = None
    kind: Kind
    measured: bool = False
    sign: Literal[-1, 1] = 1
    hold: Literal["zero", "linear"] | None = None
    """How the input goes on between two samples; by default a command is held and a measurement is interpolated."""

    @model_validator(mode="after")
    def _target(self) -> InputRow:
        if (self.actuator is None) == (self.joint is None):
            raise ValueError("give exactly one of actuator and joint")
        if self.joint is not None and self.kind != "torque":
            raise ValueError("an input at a joint is a torque (a force at a slide joint); other kinds need an actuator")
        return self


class OutputRow(_Row):
    """What was measured: a sensor of the model, or a quantity of a joint, body, site or tendon."""

    column: str
    unit: str | None = None
    sensor: str | None = None
    joint: str | None = None
    body: str | None = None
    site: str | None = None
    tendon: str | None = None
    quantity: Quantity | None = None
    component: Component | None = None
    sign: Literal[-1, 1] = 1

    @model_validator(mode="after")
    def _target(self) -> OutputRow:
        named = [n for n in ("sensor", "joint", "body", "site", "tendon") if getattr(self, n) is not None]
        if len(named) != 1:
            raise ValueError("give exactly one of sensor, joint, body, site and tendon")
        if named != ["sensor"] and self.quantity is None:
            raise ValueError(f"a {named[0]} needs a quantity")
        return self


class GainRow(_Row):
    """The robot's own controller in front of a motor: torque = kp (u - q) - kd dq/dt."""

    kp: float = Field(ge=0.0)
    kd: float = Field(default=0.0, ge=0.0)


class SegmentRow(_Row):
    """A column that numbers the runs of a recording, and the runs that are kept for scoring."""

    column: str
    held_out: tuple[float, ...] = ()


class AuxiliaryRow(_Row):
    """A channel that may explain or contradict an effect (supply voltage, temperature...)."""

    column: str
    unit: str | None = None


class Map(_Row):
    """A whole MAP.yaml (see docs/gap.md for an example)."""

    time: TimeRow
    inputs: tuple[InputRow, ...] = ()
    outputs: tuple[OutputRow, ...] = ()
    gains: dict[str, GainRow] = {}
    segments: SegmentRow | None = None
    auxiliary: tuple[AuxiliaryRow, ...] = ()
    source: str = Field(default="map", exclude=True)

    @model_validator(mode="after")
    def _columns(self) -> Map:
        seen: dict[str, str] = {}
        for group in ("inputs", "outputs"):
            for i, row in enumerate(getattr(self, group)):
                where = f"{group}[{i}]"
                if row.column in seen and group == seen[row.column].split("[")[0]:
                    raise ValueError(f"{where}: column {row.column!r} is already used by {seen[row.column]}")
                seen[row.column] = where
        return self


def load_map(path: str | Path) -> Map:
    """Read and validate a map.

    Raises:
        GapInputError: the file is missing, is not YAML, or a row is wrong; the message names file and row.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            data = _parse(file.read(LARGEST_MAP + 1))
    except OSError as error:
        raise GapInputError(f"{path}: cannot read the map ({error.strerror})") from error
    except (yaml.YAMLError, ValueError) as error:  # a ValueError comes of text, dates and numbers that cannot be
        raise GapInputError(f"{path}: cannot be read as a map ({' '.join(str(error).split())})") from error
    if not isinstance(data, dict):
        raise GapInputError(f"{path}: a map needs the keys time, inputs and outputs")
    return parse_map(data, str(path))


def _parse(text: bytes) -> object:
    """Plain data of a YAML text of a map's measure. Raises yaml.YAMLError and ValueError."""
    if len(text) > LARGEST_MAP:
        raise yaml.YAMLError(f"longer than {LARGEST_MAP} bytes")
    decoded, depth = text.decode("utf-8"), 0
    for event in yaml.parse(decoded, yaml.SafeLoader):
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > DEEPEST:
            raise yaml.YAMLError(f"nested more than {DEEPEST} deep in line {_line(event)}")
        if isinstance(event, yaml.AliasEvent):
            raise yaml.YAMLError(f"the alias *{event.anchor} in line {_line(event)}: a map is written without")
    return yaml.safe_load(decoded)


def _line(event: yaml.Event) -> int:
    assert event.start_mark is not None, "events of a text have one"
    return event.start_mark.line + 1


def parse_map(data: dict[str, object], source: str = "map") -> Map:
    """Validate a map given as a dictionary; see load_map."""
    try:
        return Map.model_validate({**data, "source": source})
    except ValidationError as error:
        first = error.errors()[0]
        row = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in first["loc"]).lstrip(".")
        value = first.get("input")
        shown = f", got {value!r}" if isinstance(value, str | int | float | bool) else ""
        raise GapInputError(f"{source}: {row or 'map'}: {first['msg'].removeprefix('Value error, ')}{shown}") from error
