"""MAP.yaml: which column or message field of a recording is which actuator or sensor of the model, in which unit."""

from __future__ import annotations

import math
from collections.abc import Hashable
from pathlib import Path
from typing import Any, Literal, NamedTuple

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from simgap.data.errors import GapInputError, nearest
from simgap.data.faults import first_fault

Kind = Literal["position", "velocity", "torque", "voltage"]
Quantity = Literal["position", "velocity", "acceleration", "orientation", "angular_velocity", "torque", "force"]
Component = Literal["x", "y", "z", "w", "roll", "pitch", "yaw"]
BAG_TIME = "time"
"""Column [s] that a bag's stamps become."""

ALL = "all"
"""Key of `gains` for the actuators that have none of their own."""
LARGEST_MAP = 50_000
"""Bytes. A map of a hundred channels has 10 000; PyYAML takes seconds for this."""
DEEPEST = 20
"""Collections within collections; a map has three. Python recurses for each."""


class _Row(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class TimeRow(_Row):
    """The time column; ``offset`` is not needed, any origin will do. A bag brings its own."""

    column: str = BAG_TIME
    unit: str | None = None
    clock: Literal["header", "received"] | None = None
    """Of a bag: the stamps in the messages' headers, or when the recorder got them; by default the headers' where all
    messages of the map have one."""


class ChannelRow(_Row):
    """A column of a table, or a field of a bag's messages (``topic`` and ``field``): one of the two."""

    column: str
    """Of a field it is made up: topic, field and element, as reports show it."""
    topic: str | None = None
    field: str | None = None
    """Dotted, as in the message's definition: ``position``, ``pose.pose.position.x``, ``points.positions``."""
    index: int | None = Field(default=None, ge=0)
    """Which element of a field that is an array."""
    named: str | None = None
    """Which element, by the name that stands beside the array in the message (``name``, ``joint_names``); by default
    the row's joint."""

    @model_validator(mode="before")
    @classmethod
    def _source(cls, data: Any) -> Any:
        if not isinstance(data, dict):
            return data
        has_column, has_topic = data.get("column") is not None, data.get("topic") is not None
        if has_column == has_topic:
            raise ValueError("give column (of a table), or topic and field (of a bag)")
        if has_column:
            alone = [key for key in ("field", "index", "named") if data.get(key) is not None]
            if alone:
                raise ValueError(f"{alone[0]} goes with a topic, not with a column")
            return data
        if data.get("field") is None:
            raise ValueError(f"topic {data['topic']} needs a field, such as position or data")
        if data.get("index") is not None and data.get("named") is not None:
            raise ValueError("give index or named, not both")
        element = data.get("index") if data.get("index") is not None else data.get("named") or data.get("joint")
        parts = [str(e) for e in (element, data.get("component")) if e is not None]
        return {**data, "column": f"{data['topic']}.{data['field']}" + "".join(f"[{part}]" for part in parts)}

    @property
    def element(self) -> str | int | None:
        """Name or index of the element of an array, or None where the row says none."""
        return self.index if self.index is not None else self.named or getattr(self, "joint", None)


class InputRow(ChannelRow):
    """What the robot was told (actuator), or what was measured to act on it (joint, ``measured: true``)."""

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
        # In a bag's row, a joint beside an actuator says which element of the message.
        if self.topic is not None and self.actuator is not None:
            return self
        if (self.actuator is None) == (self.joint is None):
            raise ValueError("give exactly one of actuator and joint")
        if self.joint is not None and self.kind != "torque":
            raise ValueError("an input at a joint is a torque (a force at a slide joint); other kinds need an actuator")
        return self


class OutputRow(ChannelRow):
    """What was measured: a sensor of the model, or a quantity of a joint, body, site or tendon."""

    unit: str | None = None
    sensor: str | None = None
    joint: str | None = None
    body: str | None = None
    site: str | None = None
    tendon: str | None = None
    quantity: Quantity | None = None
    component: Component | None = None
    sign: Literal[-1, 1] = 1
    resolution: float | None = Field(default=None, gt=0.0)
    """What the sensor resolves, in the row's unit (one count of an encoder); otherwise it is found in the values."""

    @model_validator(mode="after")
    def _target(self) -> OutputRow:
        named = [n for n in ("sensor", "joint", "body", "site", "tendon") if getattr(self, n) is not None]
        if self.topic is not None and named == ["sensor", "joint"]:
            named.remove("joint")
        if len(named) != 1:
            raise ValueError("give exactly one of sensor, joint, body, site and tendon")
        if named != ["sensor"] and self.quantity is None:
            raise ValueError(f"a {named[0]} needs a quantity")
        return self


class GainRow(_Row):
    """The robot's own controller in front of a motor: torque = kp (u - q) - kd dq/dt."""

    kp: float = Field(ge=0.0)
    kd: float = Field(default=0.0, ge=0.0)


class PayloadRow(_Row):
    """What a run carries: a mass [kg] at a point [m] in the frame of a body."""

    body: str
    mass: float = Field(gt=0.0)
    pos: tuple[float, float, float] = (0.0, 0.0, 0.0)


class RunRow(_Row):
    """In what a run differs from the model: the gains of its controllers, what it carries, its supply [V]."""

    gains: dict[str, GainRow] = {}
    payload: PayloadRow | None = None
    supply: float | None = Field(default=None, gt=0.0)


class SegmentRow(ChannelRow):
    """A column that numbers or names the runs of a recording, those kept for scoring, and in what runs differ."""

    held_out: tuple[float | str, ...] = ()
    runs: dict[float | str, RunRow] = {}
    supply: float | None = Field(default=None, gt=0.0)
    """[V] for which the model's servos are given; by default the median of the runs'."""


class AuxiliaryRow(ChannelRow):
    """A channel that may explain or contradict an effect (supply voltage, temperature...)."""

    unit: str | None = None
    actuator: str | None = None
    """Whose motor's temperature it is."""


class EnabledRow(ChannelRow):
    """Whether the servos give torque: true or 1; while it is false or 0 they give none, whatever they are told."""


class Way(NamedTuple):
    """The field of a variant's path that holds a quantity, and its range, without ``low`` itself where ``open``."""

    field: str
    low: float = -math.inf
    high: float = math.inf
    open: bool = False


_INPUTS = {
    "scale": Way("scale"),
    "offset": Way("offset"),
    "delay": Way("delay"),
    "rate_limit": Way("rate_limit", 0.0, open=True),
    "play": Way("play", 0.0),
    "loss": Way("loss", 0.0, 0.99),
    "jitter": Way("jitter", 0.0),
    "update": Way("update", 0.0, open=True),
}
SIGNALS = {
    "command": _INPUTS,
    "recording": _INPUTS,
    "servo": {
        "dead_band": Way("dead_band", 0.0),
        "dead_band_in_part": Way("dead_band", 0.0),
        "backlash": Way("backlash", 0.0),
        "compliance": Way("compliance", 0.0),
        "ringing": Way("ringing", 0.0),
        "heat_loss": Way("heat_loss", 0.0),
        "heat_time": Way("heat_time", 0.0, open=True),
        "heat_reference": Way("heat_reference", 0.0, open=True),
        "temperature_loss": Way("temperature_loss", 0.0),
        "sag": Way("sag", 0.0),
        "sag_reference": Way("sag_reference", 0.0, open=True),
        "follows_voltage": Way("follows"),
    },
    "joint": {
        "stribeck": Way("stribeck"),
        "stribeck_speed": Way("stribeck_velocity", 0.0, open=True),
        "load_friction": Way("load", 0.0),
        "ripple": Way("ripple"),
        "ripple_period": Way("ripple_period", 0.0, open=True),
        "ripple_origin": Way("ripple_origin"),
    },
    "mount": {
        "compliance": Way("compliance", 0.0),
        "ringing": Way("ringing", 0.0),
        "inertia": Way("inertia", 0.0),
    },
    "sensor": {
        "scale": Way("scale"),
        "bias": Way("bias"),
        "delay": Way("delay"),
        "lead": Way("lead"),
        "lag": Way("lag", 0.0),
        "limit": Way("limit", 0.0, open=True),
        **{f"turned_about_{axis}": Way("turns", -1.0, 1.0) for axis in "xyz"},
    },
}
"""By `where` and `quantity`: what a signal may be. The words are those of `simgap.correction.signals`."""


class SignalRow(_Row):
    """What is known of the way of a signal beyond the model, in SI: `simgap apply --map` writes such rows."""

    where: Literal["command", "recording", "servo", "joint", "mount", "sensor"]
    name: str
    quantity: str
    value: float = Field(allow_inf_nan=False)

    @model_validator(mode="after")
    def _range(self) -> SignalRow:
        ways = SIGNALS[self.where]
        if self.quantity not in ways:
            raise ValueError(f"a {self.where} has no {self.quantity}; {nearest(self.quantity, ways, 'quantity')}")
        way = ways[self.quantity]
        if not way.low <= self.value <= way.high or (way.open and self.value == way.low):
            least = f"more than {way.low:g}" if way.open else f"at least {way.low:g}"
            most = f" and at most {way.high:g}" if math.isfinite(way.high) else ""
            raise ValueError(f"{self.quantity} must be {least}{most}, not {self.value:g}")
        if self.quantity == "scale" and self.value == 0.0:
            raise ValueError("scale must not be 0")
        return self


class CorrectsRow(_Row):
    """What a corrected model was made from, as `simgap apply --map` writes it: files, from the map's own folder."""

    model: str
    map: str


class Map(_Row):
    """A whole MAP.yaml (see docs/gap.md for an example)."""

    time: TimeRow = TimeRow()
    inputs: tuple[InputRow, ...] = ()
    outputs: tuple[OutputRow, ...] = ()
    gains: dict[str, GainRow] = {}
    segments: SegmentRow | None = None
    auxiliary: tuple[AuxiliaryRow, ...] = ()
    enabled: EnabledRow | None = None
    signals: tuple[SignalRow, ...] = ()
    corrects: CorrectsRow | None = None
    source: str = Field(default="map", exclude=True)

    @model_validator(mode="before")
    @classmethod
    def _gains_of_all(cls, data: Any) -> Any:
        """Gains under `all` are those of every actuator that is told a position and has none of its own."""
        gains, inputs = (data.get(key) if isinstance(data, dict) else None for key in ("gains", "inputs"))
        if not isinstance(gains, dict) or not isinstance(inputs, list | tuple) or ALL not in gains:
            return data
        rows = [row for row in inputs if isinstance(row, dict) and row.get("kind") == "position"]
        told = [row["actuator"] for row in rows if isinstance(row.get("actuator"), str)]
        own = {name: row for name, row in gains.items() if name != ALL}
        return data if ALL in told or not told else {**data, "gains": {**dict.fromkeys(told, gains[ALL]), **own}}

    @model_validator(mode="after")
    def _columns(self) -> Map:
        seen: dict[str, str] = {}
        for group in ("inputs", "outputs"):
            for i, row in enumerate(getattr(self, group)):
                where = f"{group}[{i}]"
                if row.column in seen and group == seen[row.column].split("[")[0]:
                    raise ValueError(f"{where}: column {row.column!r} is already used by {seen[row.column]}")
                seen[row.column] = where
        if len({row.topic is None for row in self.channels.values()}) > 1:
            raise ValueError("some rows name a column and some a topic; a map is for tables or for bags")
        if self.channels and not self.of_bag and "column" not in self.time.model_fields_set:
            raise ValueError("time is missing; it needs a column and a unit, such as {column: t, unit: s}")
        return self

    @property
    def channels(self) -> dict[str, ChannelRow]:
        """Every row that is read from the recording, by its place in the map; time is not among them."""
        rows: dict[str, ChannelRow] = {}
        for group in ("inputs", "outputs", "auxiliary"):
            rows |= {f"{group}[{i}]": row for i, row in enumerate(getattr(self, group))}
        return rows | {k: row for k in ("segments", "enabled") if (row := getattr(self, k)) is not None}

    @property
    def of_bag(self) -> bool:
        """Whether the rows name topics of a bag, not columns of a table."""
        return any(row.topic is not None for row in self.channels.values())


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
    return yaml.load(decoded, _Loader)


class _Loader(yaml.SafeLoader):
    """One that lets no key stand twice, of which YAML's would quietly take the last."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        known: set[str] = set()
        for key, _ in node.value:
            if str(key.value) in known:
                raise yaml.YAMLError(f"{key.value!r} stands twice, again in line {key.start_mark.line + 1}")
            known.add(str(key.value))
        return super().construct_mapping(node, deep)


def _line(event: yaml.Event) -> int:
    assert event.start_mark is not None, "events of a text have one"
    return event.start_mark.line + 1


def parse_map(data: dict[str, object], source: str = "map") -> Map:
    """Validate a map given as a dictionary; see load_map."""
    try:
        return Map.model_validate({**data, "source": source})
    except ValidationError as error:
        raise GapInputError(f"{source}: {first_fault(error, Map)}") from error
