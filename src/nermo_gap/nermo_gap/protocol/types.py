"""A protocol as data: segments, each in a scene, of pieces that begin and end in the stand."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

from nermo_control.driver import Steering
from nermo_control.types import ControlCommand
from nermo_description.parameters import RobotParameters

Scene = Literal["hung", "floor"]
"""In a stand, feet in the air; or on the flat floor."""

REST = 0.5
"""[s] of the stand at a piece's beginning and end: replays start from there."""
EASE = 0.3
"""[s] in which a wave swells and dies down."""


@dataclass(frozen=True)
class Wave:
    """One servo's motion about its neutral angle.

    Attributes:
        size: [rad]; a wave of one way goes from neutral to it, any other to both sides.
        frequency: [Hz].
        until: [Hz] at the end, where the wave gets faster.
        shape: a sine, or steps: half of the time at ``size``, half at its negative.
        begin, end: [s] from the piece's first motion; end None is the piece's own.
    """

    servo: str
    size: float
    frequency: float = 1.0
    until: float | None = None
    shape: Literal["sine", "steps"] = "sine"
    one_way: bool = False
    begin: float = 0.0
    end: float | None = None

    def value(self, t: float, length: float) -> float:
        """[rad] from neutral, ``t`` [s] after the piece's first motion, which lasts ``length`` [s]."""
        end = length if self.end is None else self.end
        if not self.begin < t < end:
            return 0.0
        span, t = end - self.begin, t - self.begin
        if self.shape == "steps":
            return self.size if t < 0.5 * span else 0.0 if self.one_way else -self.size
        faster = 0.0 if self.until is None else 0.5 * (self.until - self.frequency) / span
        angle = 2.0 * math.pi * (self.frequency * t + faster * t * t)
        ease = min(1.0, t / EASE, (span - t) / EASE)
        return ease * self.size * (0.5 * (1.0 - math.cos(angle)) if self.one_way else math.sin(angle))


@dataclass(frozen=True)
class Piece:
    """Some seconds of one kind of motion: waves of the servos, or what an operator would say.

    Attributes:
        tell: what the person beside the mouse is told.
        seconds: rests included.
        waves: servos that are not named keep their neutral angle.
        looks: [s] from the piece's beginning where a diagnosis begins to look, for half a second: what moves there
            tells most, and a replay can begin there.
        commands: (time [s] from the piece's first motion, command), in rising order; then there are no waves.
        steering: how whoever watches the mouse steers it meanwhile; None where nobody does.
    """

    name: str
    tell: str
    seconds: float
    waves: tuple[Wave, ...] = ()
    commands: tuple[tuple[float, ControlCommand], ...] = ()
    looks: tuple[float, ...] = ()
    steering: Steering | None = None

    def said(self, t: float, turn: float) -> ControlCommand | None:
        """What an operator says ``t`` [s] from the begin, with the stick at ``turn``: in [-1, 1], left positive.

        None where nothing is said: before the first command, and in the rest at the end.
        """
        if t >= self.seconds - REST:
            return None
        command = next((command for begin, command in reversed(self.commands) if t >= REST + begin), None)
        if command is None or self.steering is None:
            return command
        return replace(command, turn_rate=command.turn_rate + turn * self.steering.turn_rate)

    @property
    def of_servos(self) -> bool:
        """Whether it says where the servos are, rather than what an operator would say."""
        return bool(self.waves)

    def targets(self, t: float, robot: RobotParameters) -> dict[str, float]:
        """Servo angles [rad] at ``t`` [s] from the piece's beginning, within the servos' limits."""
        angles = {name: servo.neutral for name, servo in robot.servos.items()}
        for wave in self.waves:
            angles[wave.servo] += wave.value(t - REST, self.seconds - 2.0 * REST)
        return _within(angles, robot)


@dataclass(frozen=True)
class Rows(Piece):
    """A piece that says where the servos are row by row; each holds for ``period`` [s], the last one to the end."""

    period: float = 1.0
    rows: tuple[Mapping[str, float], ...] = ()
    """[rad] by servo; one that is not named keeps its neutral angle."""

    @property
    def of_servos(self) -> bool:
        """It does."""
        return True

    def targets(self, t: float, robot: RobotParameters) -> dict[str, float]:
        """Servo angles [rad] at ``t`` [s] from the piece's beginning, within the servos' limits."""
        neutral = {name: servo.neutral for name, servo in robot.servos.items()}
        row = self.rows[min(max(int(t / self.period + 1e-6), 0), len(self.rows) - 1)]
        return _within(neutral | dict(row), robot)


def _within(angles: Mapping[str, float], robot: RobotParameters) -> dict[str, float]:
    return {n: min(max(a, robot.servos[n].lower), robot.servos[n].upper) for n, a in angles.items()}


@dataclass(frozen=True)
class Segment:
    """Pieces in one scene, recorded without a break; ``tell`` is what to prepare."""

    name: str
    scene: Scene
    tell: str
    pieces: tuple[Piece, ...]

    @property
    def seconds(self) -> float:
        """[s] that it lasts."""
        return sum(piece.seconds for piece in self.pieces)

    @property
    def steered(self) -> bool:
        """Whether somebody has to steer the mouse through a piece of it."""
        return any(piece.steering is not None for piece in self.pieces)

    def spans(self) -> Mapping[str, tuple[float, float]]:
        """By piece: its first and last time [s] in the segment."""
        found, begin = {}, 0.0
        for piece in self.pieces:
            found[piece.name] = (begin, begin + piece.seconds)
            begin += piece.seconds
        return found


@dataclass(frozen=True)
class Protocol:
    """Segments in the order in which they are done."""

    name: str
    segments: tuple[Segment, ...]

    @property
    def seconds(self) -> float:
        """[s] of motion, without what is prepared in between."""
        return sum(segment.seconds for segment in self.segments)
