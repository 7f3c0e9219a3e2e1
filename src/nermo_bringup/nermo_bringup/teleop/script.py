"""Timed commands from a file or a recording: what is to be commanded at each moment since the start."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, FiniteFloat, create_model, model_validator

from nermo_bringup.recording.errors import RecordingError
from nermo_control.spine.functions import SPINE_FUNCTIONS
from nermo_control.types import ControlCommand, Posture, SpineModes, TrajectoryMode
from nermo_description.parameter_files import read_yaml, validate
from nermo_node.recording_reader import Recording, TopicData

ServoPositions = Mapping[str, float]
"""Target of each servo, rad."""

PostureName = Literal[
    "walk",
    "stand",
    "sit",
    "crouch",
    "stop",
    "lift_front_left",
    "lift_front_right",
    "lift_rear_left",
    "lift_rear_right",
]
SECOND = 10**9
DIRECT = ControlCommand(stamp=0, posture=Posture.DIRECT)
CONTROL_TOPIC = "control_command"
SERVO_TOPIC = "servo_command"


def _frequency(value: float) -> float:
    if value != 0.0 and not 0.1 <= value <= 3.0:
        raise ValueError("must be 0 (the knowledge-base's default) or 0.1 to 3.0 Hz")
    return value


_SPINE: dict[str, Any] = dict.fromkeys(SPINE_FUNCTIONS, (bool, False))
SpineEntry = create_model("SpineEntry", __config__=ConfigDict(extra="forbid", frozen=True), **_SPINE)
"""Spine functions of an entry; those not named are off."""


class Entry(BaseModel):
    """One line of a command file. A field that is not given keeps the value it had before."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    at: FiniteFloat = Field(ge=0.0, description="[s] since the start")
    forward_velocity: FiniteFloat | None = Field(None, ge=-1.0, le=1.0, description="[m/s]")
    turn_rate: FiniteFloat | None = Field(None, ge=-10.0, le=10.0, description="[rad/s]")
    posture: PostureName | None = None
    trajectory_mode: Literal["external", "straight_line"] | None = None
    gait: str | None = None
    gait_frequency: Annotated[FiniteFloat, AfterValidator(_frequency)] | None = None
    turning_strategy: Literal["leg", "spine", "mix", ""] | None = None
    spine_modes: SpineEntry | None = None
    servos: dict[str, FiniteFloat] | None = Field(None, description="[rad] by servo name")

    def apply(self, before: ControlCommand) -> ControlCommand:
        """The command of this entry, after the one before it."""
        changes = self.model_dump(exclude_none=True, exclude={"at", "servos"})
        if "posture" in changes:
            changes["posture"] = Posture[changes["posture"].upper()]
        if "trajectory_mode" in changes:
            changes["trajectory_mode"] = TrajectoryMode[changes["trajectory_mode"].upper()]
        if "spine_modes" in changes:
            changes["spine_modes"] = SpineModes(**changes["spine_modes"])
        return replace(before, **changes)


class CommandFile(BaseModel):
    """A command file: entries in the order of time, each of a control command or of servo positions."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    description: str = ""
    duration: FiniteFloat | None = Field(None, gt=0.0, description="[s]; default: until the last entry")
    commands: list[Entry] = Field(min_length=1)

    @model_validator(mode="after")
    def _entries_fit_together(self) -> Self:
        for number, (earlier, later) in enumerate(pairwise(self.commands), start=1):
            if later.at <= earlier.at:
                raise ValueError(f"commands.{number}.at: {later.at:g} s does not come after {earlier.at:g} s")
        for number, entry in enumerate(self.commands):
            if entry.servos is not None and (more := entry.model_fields_set - {"at", "servos"}):
                raise ValueError(
                    f"commands.{number}: has servos and {', '.join(sorted(more))}; an entry with servos has no other "
                    "field than `at`"
                )
            if entry.servos is not None and not entry.servos:
                raise ValueError(f"commands.{number}.servos: names no servo")
        if self.duration is not None and self.duration < self.commands[-1].at:
            raise ValueError(f"duration: {self.duration:g} s ends before commands.{len(self.commands) - 1}.at")
        return self


@dataclass(frozen=True)
class Script:
    """Commands by time since the start."""

    times: Sequence[int]
    """[ns] since the start, ascending: when each command begins to hold."""
    duration: int
    """[ns]"""
    controls: Sequence[ControlCommand]
    """Where servo positions hold, in the posture DIRECT."""
    servos: Sequence[ServoPositions | None] = ()
    """None where they do not hold; empty where they never do."""

    def control_at(self, elapsed: int, stamp: int) -> ControlCommand | None:
        """The control command that holds `elapsed` ns after the start, stamped; None outside the script."""
        place = self._place(elapsed)
        return None if place is None else replace(self.controls[place], stamp=stamp)

    def servos_at(self, elapsed: int) -> ServoPositions | None:
        """The servo positions that hold `elapsed` ns after the start; None where there are none."""
        place = self._place(elapsed)
        return None if place is None or not self.servos else self.servos[place]

    def last(self, stamp: int) -> ControlCommand:
        """The command that stops the mouse when the script is over, stamped; after servo positions it stands."""
        last = replace(self.controls[-1], stamp=stamp, forward_velocity=0.0, turn_rate=0.0)
        return replace(last, posture=Posture.STAND) if last.posture is Posture.DIRECT else last

    def _place(self, elapsed: int) -> int | None:
        if elapsed > self.duration or elapsed < self.times[0]:
            return None
        return bisect_right(self.times, elapsed) - 1


def load_script(path: Path, commands: Literal["control", "servo"] = "control") -> Script:
    """Read a command file (`.yaml`), or the commands of a recording (its directory or `.mcap` file).

    Args:
        path: the file or recording.
        commands: which commands of a recording; a file says it itself.

    Raises:
        ParameterError: a command file is wrong.
        RecordingError: a recording cannot be read or has no such commands.
    """
    if path.is_dir() or path.suffix == ".mcap":
        return recorded_script(Recording(path), commands)
    return file_script(validate(read_yaml(path), path, CommandFile))


def file_script(file: CommandFile) -> Script:
    """The script of a command file."""
    times = [round(entry.at * SECOND) for entry in file.commands]
    duration = times[-1] if file.duration is None else round(file.duration * SECOND)
    controls: list[ControlCommand] = []
    servos: list[ServoPositions | None] = []
    command = ControlCommand(stamp=0)
    for entry in file.commands:
        if entry.servos is None:
            command = entry.apply(command)
            controls.append(command)
            servos.append(None)
        else:
            before = servos[-1] if servos else None
            controls.append(DIRECT)
            servos.append({**(before or {}), **entry.servos})
    return Script(times, duration, controls, servos if any(servos) else ())


def recorded_script(recording: Recording, commands: Literal["control", "servo"]) -> Script:
    """The commands of a recording, timed by their stamps.

    Raises:
        RecordingError: it has none, or they are malformed.
    """
    topic = recording.topic_ending(CONTROL_TOPIC if commands == "control" else SERVO_TOPIC)
    data = recording.read([topic])[topic]
    order = data.stamp.argsort(kind="stable")
    times = [int(data.stamp[row] - data.stamp[order[0]]) for row in order]
    try:
        if commands == "control":
            return Script(times, times[-1], controls=[_control(data, int(row)) for row in order])
        return Script(times, times[-1], [DIRECT] * len(times), [_servos(data, int(row)) for row in order])
    except ValueError as error:
        raise RecordingError(f"{recording.path}: {topic}: {error}") from None


def _control(data: TopicData, row: int) -> ControlCommand:
    # A function that did not exist when this was recorded was off.
    recorded = {name: data.columns.get(f"spine_modes.{name}") for name in SPINE_FUNCTIONS}
    spine = SpineModes(**{name: values is not None and bool(values[row]) for name, values in recorded.items()})
    return ControlCommand(
        stamp=0,
        forward_velocity=float(data["forward_velocity"][row]),
        turn_rate=float(data["turn_rate"][row]),
        posture=Posture(int(data["posture"][row])),
        trajectory_mode=TrajectoryMode(int(data["trajectory_mode"][row])),
        gait=str(data["gait"][row]),
        gait_frequency=float(data["gait_frequency"][row]),
        turning_strategy=str(data["turning_strategy"][row]),
        spine_modes=spine,
    )


def _servos(data: TopicData, row: int) -> ServoPositions:
    names, positions = data["name"][row], data["position"][row]
    if len(names) != len(positions) or not all(math.isfinite(position) for position in positions):
        raise ValueError(f"message {row} has {len(names)} names and {len(positions)} positions, or one is not finite")
    return {str(name): float(position) for name, position in zip(names, positions, strict=True)}
