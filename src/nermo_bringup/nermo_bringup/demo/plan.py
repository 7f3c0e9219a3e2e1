"""What the demo does, second by second, as a command file for the command player."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

Kind = Literal["stand", "walk", "turn_left", "turn_right", "turn_spine", "balance", "sit"]

WALK_SPEED_M_S = 0.2
"""More than any gait can do: the high-level controller clips it to the gait's full stride."""
TURN_SPEED_M_S = 0.08
TURN_RATE_RAD_S = 0.3
SPINE_TURN_RATE_RAD_S = 0.4
"""By mix turning: the spine bends and the legs help."""
LIFTED = "rear_left"
"""The leg of the balance test: without compensation the mouse falls back on it (N table 6.5)."""
BALANCE_S = 4.0
"""The spine bends for 1 s, the leg rises in 0.3 s, and stays up."""
STAND_S = 2.0
REST_S = 1.0
"""Between a walk and the next posture: the mouse comes to a stop by itself."""


@dataclass(frozen=True, slots=True)
class Scene:
    """One part of the demo; times in s since its start."""

    kind: Kind
    begin: float
    end: float
    gait: str = ""
    """Of a walk or turn."""

    @property
    def duration(self) -> float:
        """[s]"""
        return self.end - self.begin


@dataclass(frozen=True, slots=True)
class Plan:
    """The scenes, and the command file that plays them."""

    scenes: tuple[Scene, ...]
    gait_frequency: float
    """[Hz]"""
    command_file: dict[str, Any]

    @property
    def duration(self) -> float:
        """[s]"""
        return self.scenes[-1].end


def make_plan(gaits: Sequence[str], gait_frequency: float, walk_duration: float, turn_duration: float) -> Plan:
    """Stand, walk each gait on a straight line with a stop after it, turn by legs and by spine, lift a leg, sit.

    Args:
        gaits: names in the gait knowledge-base.
        gait_frequency: [Hz] of the walks.
        walk_duration: [s] of each walk.
        turn_duration: [s] of each turn.
    """
    scenes: list[Scene] = []
    commands: list[dict[str, Any]] = []
    now = 0.0

    def scene(kind: Kind, duration: float, **command: Any) -> None:
        nonlocal now
        scenes.append(Scene(kind, now, now + duration, command.get("gait", "")))
        commands.append({"at": now, **command})
        now += duration

    def rest() -> None:
        nonlocal now
        commands.append({"at": now, "forward_velocity": 0.0, "turn_rate": 0.0})
        now += REST_S
        scene("stand", STAND_S, posture="stand")

    walking = {"posture": "walk", "gait_frequency": gait_frequency}
    scene("stand", STAND_S, posture="stand")
    for gait in gaits:
        straight = {"trajectory_mode": "straight_line", "forward_velocity": WALK_SPEED_M_S, "turn_rate": 0.0}
        scene("walk", walk_duration, gait=gait, **walking, **straight)
        rest()
    turns: tuple[tuple[Kind, float], ...] = (("turn_left", TURN_RATE_RAD_S), ("turn_right", -TURN_RATE_RAD_S))
    for kind, turn_rate in turns:
        free = {"trajectory_mode": "external", "forward_velocity": TURN_SPEED_M_S, "turn_rate": turn_rate}
        scene(kind, turn_duration, gait=gaits[0], **walking, **free)
        rest()
    bent = {"trajectory_mode": "external", "forward_velocity": TURN_SPEED_M_S, "turn_rate": SPINE_TURN_RATE_RAD_S}
    turning = {"turning_strategy": "mix", "spine_modes": {"turning": True, "offset_compensation": True}}
    scene("turn_spine", turn_duration, gait=gaits[0], **walking, **bent, **turning)
    rest()
    balancing = {"balance_compensation": True, "offset_compensation": True}
    scene("balance", BALANCE_S, posture=f"lift_{LIFTED}", spine_modes=balancing)
    scene("stand", STAND_S, posture="stand", spine_modes={}, turning_strategy="")
    scene("sit", STAND_S, posture="sit")
    return Plan(tuple(scenes), gait_frequency, {"description": "nermo demo", "duration": now, "commands": commands})
