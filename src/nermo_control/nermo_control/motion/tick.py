"""What is new in a control tick."""

from __future__ import annotations

from dataclasses import dataclass, field

from nermo_control.types import Imu, LegLoads, MotionCommand, ServoTargets


@dataclass(slots=True)
class Tick:
    """One control tick of the motion module."""

    stamp: int
    """[ns]"""
    imu: Imu | None = None
    loads: LegLoads | None = None
    """The newest."""
    targets: ServoTargets | None = None
    """The newest; whether they still count is the goal's business."""
    command: MotionCommand | None = None
    """The last valid one."""
    warnings: list[str] = field(default_factory=list)
    """What had to be clamped or refused, in words."""
