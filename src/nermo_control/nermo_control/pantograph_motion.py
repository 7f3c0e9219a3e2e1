"""What stands between commands of a graph and the controller of a robot with pantograph legs.

What is unusable is refused in words, silence ends in standing, STOP freezes the servos where they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from nermo_control.inbox import Inbox
from nermo_control.oscillators.legs import OscillatorSettings
from nermo_control.pantograph_controller import PantographController, PantographGait
from nermo_control.pantograph_gaits import PANTOGRAPH_GAITS
from nermo_control.types import ControlCommand, LegLoads, MotionOutput, Posture
from nermo_description import ranges
from nermo_description.pantograph import PantographParameters
from nermo_description.parameter_files import read_yaml, validate
from nermo_description.silence import WALK

SLOWEST, FASTEST = 0.1, 5.0
"""Gait frequencies that a command may ask for [Hz]."""
LONGEST_STEP = 0.13
"""Of a command [m]: the largest that gaits were looked for with."""
_POSTURES = (Posture.WALK, Posture.STAND, Posture.SIT, Posture.CROUCH, Posture.STOP, Posture.STILL)
_GAITS = ("", *PANTOGRAPH_GAITS)


class SavedGait(BaseModel):
    """A gait as `nermo optimize --cost limit-cycle` saves it."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    gait: PantographGait = PantographGait()
    frequency_hz: float = Field(2.86, ge=SLOWEST, le=FASTEST, description="Where a command does not say")
    step_length_m: float = Field(0.126, gt=0.0, le=LONGEST_STEP, description="L that it was found with")


class PantographMotionConfig(BaseModel):
    """Settings that are no gait parameters."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    silence_timeout: float = Field(
        WALK.after,
        ge=0.05,
        le=1.0,
        description="Silence of the command after which the robot stands",
        json_schema_extra={"unit": "s", "readOnly": True},
    )
    coordination: Literal["cpg", "tegotae"] = Field(
        "cpg",
        description="Who lifts a foot: coupled oscillators, or the legs' loads",
        json_schema_extra={"readOnly": True},
    )
    oscillators: OscillatorSettings = OscillatorSettings(feedback=3.0, fixed_point_compensation=False)


def read_saved_gait(path: Path) -> SavedGait:
    """A gait from a YAML file. Raises ParameterError naming file, field, value and what is allowed."""
    return validate(read_yaml(path), path, SavedGait)


def command_error(command: ControlCommand) -> str | None:
    """What is wrong with a command for a robot without spine and tail, in words; None where nothing is."""
    if (wrong := ranges.control_command_error(command)) is not None:
        return wrong
    if command.posture not in _POSTURES:
        return f"posture = {command.posture.name}: allowed {', '.join(posture.name for posture in _POSTURES)}"
    if command.gait not in _GAITS:
        return f"gait = {command.gait!r} is unknown; allowed: {', '.join(_GAITS[1:])}"
    frequency = command.gait_frequency
    if frequency != 0.0 and not SLOWEST <= frequency <= FASTEST:
        return f"gait_frequency = {frequency} Hz: allowed {SLOWEST} to {FASTEST} Hz, or 0 for the gait's own"
    return None


class PantographMotion:
    """Turns commands into servo positions, one control tick at a time. It cannot turn: `turn_rate` does not count."""

    def __init__(
        self, robot: PantographParameters, saved: SavedGait, period_ns: int, config: PantographMotionConfig
    ) -> None:
        gait = saved.gait.model_copy(update={"kind": config.coordination, "oscillators": config.oscillators})
        self._saved, self._gait = saved, gait
        self._controller = PantographController(robot, gait, period_ns)
        self._inbox: Inbox[ControlCommand] = Inbox(command_error, config.silence_timeout, lockstep=False)
        self._last: MotionOutput | None = None

    def step(
        self, stamp: int, command: ControlCommand | None, servo_positions: Sequence[float], loads: LegLoads | None
    ) -> MotionOutput:
        """One control tick at `stamp` [ns], on the newest command and loads."""
        warnings: list[str] = []
        self._inbox.take(stamp, command, warnings)
        wanted = self._inbox.command
        if wanted is not None and wanted.posture is Posture.STOP and self._last is not None:
            return replace(self._last, warnings=tuple(warnings))
        if wanted is not None and wanted.posture is Posture.WALK:
            wanted = self._walk(wanted, warnings) if self._inbox.fresh(stamp) else self._stand(wanted)
        output = self._controller.step(stamp, wanted, None, servo_positions, loads=loads)
        self._last = replace(output, warnings=(*warnings, *output.warnings))
        return self._last

    def _walk(self, command: ControlCommand, warnings: list[str]) -> ControlCommand:
        frequency = command.gait_frequency or self._saved.frequency_hz
        fastest = LONGEST_STEP * frequency / self._gait.duty_factor
        velocity = min(max(command.forward_velocity, -fastest), fastest)
        if velocity != command.forward_velocity:
            warnings.append(f"forward_velocity = {command.forward_velocity:.3f} m/s: clipped to {velocity:.3f}")
        if velocity == 0.0:
            return self._stand(command)
        return replace(command, forward_velocity=velocity, gait_frequency=frequency)

    @staticmethod
    def _stand(command: ControlCommand) -> ControlCommand:
        return replace(command, posture=Posture.STAND)
