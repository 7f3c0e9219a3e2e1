"""The one table of what can go wrong: what state it leads to, after which time, and whether it must be released."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, IntEnum


class State(IntEnum):
    """What the servos do. Of several causes, the one with the highest state wins."""

    FOLLOW = 0
    """Go where the commands say, within the limits."""
    HOLD = 1
    """Stay in the last posture, with power."""
    CROUCH = 2
    """Fold the legs slowly and stay so, with power: nothing can fall any more."""
    LIMP = 3
    """Without power."""

    def __str__(self) -> str:
        return self.name.lower()


class Cause(Enum):
    """Why the servos do not follow."""

    START = "start"
    COMMAND_SILENCE = "command_silence"
    COMMAND_LOST = "command_lost"
    LINK_LOST = "link_lost"
    EMERGENCY_STOP = "emergency_stop"
    FALLEN = "fallen"
    OVER_CURRENT = "over_current"
    LOW_BATTERY = "low_battery"
    EMPTY_BATTERY = "empty_battery"
    SILENT_SERVO = "silent_servo"
    LINE_LOST = "line_lost"
    DEVICE_LIMP = "device_limp"

    def __str__(self) -> str:
        return self.value


@dataclass(frozen=True, slots=True)
class Rule:
    """One row: what a cause is, and what it leads to."""

    cause: Cause
    what: str
    """When it holds, in words."""
    state: State
    after: float
    """How long the condition must last before the state is taken [s]; then it is taken in the next control tick."""
    latched: bool
    """True: stays until it is released and the condition has gone. False: ends with the condition."""


RULES: tuple[Rule, ...] = (
    Rule(Cause.START, "the supervisor has started", State.LIMP, 0.0, True),
    Rule(Cause.COMMAND_SILENCE, "no acceptable servo_command", State.HOLD, 0.2, False),
    Rule(Cause.COMMAND_LOST, "still no acceptable servo_command", State.CROUCH, 1.0, False),
    Rule(Cause.LINK_LOST, "nothing at all from the workstation", State.CROUCH, 0.5, False),
    Rule(
        Cause.EMERGENCY_STOP,
        "pad, keyboard, any publisher of emergency_stop, or SIGUSR1",
        State.LIMP,
        0.0,
        True,
    ),
    Rule(Cause.FALLEN, "the body is tilted by more than max_tilt", State.LIMP, 0.2, True),
    Rule(Cause.OVER_CURRENT, "a servo draws more than max_current", State.LIMP, 0.25, True),
    Rule(Cause.LOW_BATTERY, "voltage below low_voltage", State.CROUCH, 1.0, True),
    Rule(Cause.EMPTY_BATTERY, "voltage below empty_voltage", State.LIMP, 0.5, True),
    Rule(Cause.SILENT_SERVO, "a servo does not answer its board", State.CROUCH, 0.1, True),
    Rule(Cause.LINE_LOST, "the device, or a board of it, does not answer", State.LIMP, 0.3, True),
    Rule(Cause.DEVICE_LIMP, "the device is limp by itself: watchdog, restart, over-current", State.LIMP, 0.1, True),
)
"""Bad commands (stale, from the future, repeated, out of order, not finite, of a wrong length, with unknown names) are
refused and counted; when no other comes, command_silence follows. Positions, rates and torques are limited without a
change of state. A supervisor that dies is the device's to notice: its watchdog makes the servos limp."""

RULE_OF: dict[Cause, Rule] = {rule.cause: rule for rule in RULES}


def table() -> str:
    """The rules as a Markdown table, as it stands in the documentation."""
    rows = ["| cause | when | state | after | latched |", "|---|---|---|---|---|"]
    rows += [
        f"| `{rule.cause}` | {rule.what} | {rule.state} | {rule.after:g} s | {'yes' if rule.latched else 'no'} |"
        for rule in RULES
    ]
    return "\n".join(rows)
