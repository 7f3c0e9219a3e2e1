"""What makes a command usable: one function a command, each returning what is wrong in words, or None."""

from __future__ import annotations

import difflib
from typing import get_args

from nermo_control.gait.knowledge_base import GaitParameters, frequency_error
from nermo_control.types import ControlCommand, MotionCommand, Posture, TrajectoryMode, TurningStrategy
from nermo_description import ranges

_STRATEGIES = get_args(TurningStrategy)
_POSTURES = frozenset(Posture)
_MODES = frozenset(TrajectoryMode)


def control_command_error(command: ControlCommand, parameters: GaitParameters) -> str | None:
    """What is wrong with the operator's command; empty names and frequency 0 stand for the defaults."""
    if (wrong := ranges.control_command_error(command)) is not None:
        return wrong
    if command.posture not in _POSTURES:
        return _unknown("posture", command.posture, _POSTURES)
    if command.trajectory_mode not in _MODES:
        return _unknown("trajectory_mode", command.trajectory_mode, _MODES)
    if command.gait and command.gait not in parameters.gaits:
        return _unknown("gait", command.gait, parameters.gaits)
    if command.turning_strategy and command.turning_strategy not in _STRATEGIES:
        return _unknown("turning_strategy", command.turning_strategy, _STRATEGIES)
    return frequency_error(command.gait_frequency) if command.gait_frequency != 0.0 else None


def motion_command_error(command: MotionCommand, parameters: GaitParameters) -> str | None:
    """What is wrong with a motion command; the gait matters only for walking."""
    if (wrong := ranges.motion_command_error(command)) is not None:
        return wrong
    if command.posture not in _POSTURES:
        return _unknown("posture", command.posture, _POSTURES)
    if command.posture != Posture.WALK:
        return None
    if command.gait not in parameters.gaits:
        return _unknown("gait", command.gait, parameters.gaits)
    if command.turning_strategy not in _STRATEGIES:
        return _unknown("turning_strategy", command.turning_strategy, _STRATEGIES)
    return frequency_error(command.gait_frequency)


def _unknown(field: str, value: object, known: object) -> str:
    names = sorted(str(name) if isinstance(name, str) else f"{int(name)} ({name.name})" for name in known)  # type: ignore[attr-defined]
    near = difflib.get_close_matches(str(value), names, n=1)
    hint = f"did you mean {near[0]}? " if near else ""
    return f"{field} = {value!r} is unknown; {hint}allowed: {', '.join(names)}"
