"""What the link carries, between whom, and how: a YAML list, validated."""

from __future__ import annotations

from collections.abc import Iterable
from enum import Enum
from importlib.resources import files
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from nermo_description.parameter_files import ParameterError, read_yaml, validate
from nermo_description.silence import HOLD
from nermo_hw.link.transports import words

DEFAULT = Path(str(files("nermo_hw"))) / "link" / "link.yaml"


class Side(Enum):
    """The two ends."""

    ROBOT = "robot"
    WORKSTATION = "workstation"

    @property
    def other(self) -> Side:
        """Who is at the far end."""
        return Side.WORKSTATION if self is Side.ROBOT else Side.ROBOT


Priority = Literal["real_time", "interactive_high", "interactive_low", "data_high", "data", "data_low", "background"]


class _Strict(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Topic(_Strict):
    """One topic that crosses the link."""

    name: str = Field(pattern=r"^/?[A-Za-z]\w*(/[A-Za-z]\w*)*$")
    """As ROS has it: relative to the namespace, or absolute with a leading slash."""
    type: str = Field(pattern=r"^\w+/msg/\w+$")
    to: Side
    """Whom it goes to."""
    kind: Literal["command", "sensor", "event"]
    """command: only the newest counts, and it must not be old. sensor: may get lost. event: a state that is repeated
    with every heartbeat, so that a loss does not matter; the far end gets it when it changes."""
    stamped: bool = True
    """Whether it begins with a std_msgs/Header, whose stamp then crosses from one clock to the other."""
    max_rate: float | None = Field(None, gt=0.0, le=10_000.0, json_schema_extra={"unit": "Hz"})
    """What comes faster is left out."""
    priority: Priority = "data"

    def ros_name(self, namespace: str) -> str:
        """Full name of the ROS topic."""
        if self.name.startswith("/"):
            return self.name
        return f"/{namespace}/{self.name}" if namespace else f"/{self.name}"

    def key(self, namespace: str) -> str:
        """Zenoh's key expression, as zenoh-plugin-ros2dds makes it: the ROS topic without its leading slash."""
        return self.ros_name(namespace).removeprefix("/")


class Peer(_Strict):
    """One end of the link."""

    name: str = Field(pattern=r"^[A-Za-z0-9][\w.-]*$")
    """Common name in its certificate."""
    endpoints: tuple[str, ...] = ()
    """Where the robot listens, or where the workstation finds it: `quic/HOST:PORT?rel=0`; `transports.py` has all
    words that it may begin with."""


class LinkConfig(_Strict):
    """The whole of `link.yaml`."""

    namespace: str = Field("nermo", pattern=r"^([A-Za-z]\w*(/[A-Za-z]\w*)*)?$")
    robot: Peer
    workstation: Peer
    observers: tuple[str, ...] = ()
    """Common names of those who may listen to sensor data, and do nothing else."""
    keys: Path | None = None
    """Folder with `ca.pem`, `<name>.pem` and `<name>.key`. None: no encryption, anybody may command the robot."""
    heartbeat_rate: float = Field(20.0, ge=1.0, le=200.0, json_schema_extra={"unit": "Hz"})
    max_command_age: float = Field(HOLD.after, ge=0.01, le=1.0, json_schema_extra={"unit": "s"})
    """Commands older than this are not even sent."""
    lease: float = Field(2.0, ge=0.2, le=60.0, json_schema_extra={"unit": "s"})
    """Silence after which a connection is given up and made anew."""
    topics: tuple[Topic, ...]

    @model_validator(mode="after")
    def _consistent(self) -> LinkConfig:
        names = [topic.name for topic in self.topics]
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise ValueError(f"topics: {', '.join(twice)} stands twice")
        for topic in self.topics:
            if topic.kind == "command" and (topic.to is not Side.ROBOT or not topic.stamped):
                raise ValueError(f"topics: the command {topic.name} must go to the robot and be stamped")
        for side in (self.robot, self.workstation):
            for endpoint in side.endpoints:
                known = words(encrypts=self.keys is not None)
                if endpoint.partition("/")[0] not in known:
                    allowed = " or ".join(f"{name}/" for name in known)
                    why = "encrypted" if self.keys is not None else "without keys"
                    raise ValueError(f"{side.name}.endpoints: {endpoint!r}: a link {why} is {allowed}")
        return self

    def peer(self, side: Side) -> Peer:
        """Who is at an end."""
        return self.robot if side is Side.ROBOT else self.workstation

    def endpoint(self, side: Side) -> str:
        """By which an end chooses its transport: its first, or else the far end's; QUIC where none is named."""
        return next(iter((*self.peer(side).endpoints, *self.peer(side.other).endpoints)), "quic/")

    def key_list(self, to: Side) -> list[str]:
        """Keys of all topics that go to an end, with that of the heartbeat."""
        return [topic.key(self.namespace) for topic in self.topics if topic.to is to] + [self.heartbeat_key(to)]

    def heartbeat_key(self, to: Side) -> str:
        """Key of the heartbeat to an end."""
        return self._own_key("ping" if to is Side.ROBOT else "pong")

    @property
    def release_key(self) -> str:
        """Key of the service that releases the robot."""
        return self._own_key("release", "safety")

    def _own_key(self, name: str, group: str = "link") -> str:
        return "/".join(part for part in (self.namespace, group, name) if part)


def load_link(path: str | Path = DEFAULT, overrides: Iterable[tuple[str, object]] = ()) -> LinkConfig:
    """The link from its YAML file; `overrides` replace fields, as in ("robot.endpoints", [...]).

    Raises ParameterError.
    """
    path = Path(path)
    data = read_yaml(path)
    if not isinstance(data, dict):
        raise ParameterError(f"{path}: the file: must be a mapping")
    for field, value in overrides:
        *way, last = field.split(".")
        place = data
        for part in way:
            place = place.setdefault(part, {})
        place[last] = value
    if data.get("keys") is not None:
        data["keys"] = str(path.parent / Path(str(data["keys"])).expanduser())
    return validate(data, path, LinkConfig)
