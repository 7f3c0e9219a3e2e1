"""The one table of what can go wrong: from which limit on, for how long, what state it leads to, and what ends it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum, IntEnum

from nermo_description.silence import AWAY, CROUCH, HOLD, LINK

RANGE_MARGIN = 0.3
"""[rad] A servo cannot be so far beyond its range."""
SPEED_FACTOR = 3.0
"""A servo cannot be so many times as fast as it turns without a load."""


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
    LONG_SILENCE = "long_silence"
    IMU_INVALID = "imu_invalid"
    IMU_FROZEN = "imu_frozen"
    IMU_IMPLAUSIBLE = "imu_implausible"
    BATTERY_INVALID = "battery_invalid"
    BATTERY_FROZEN = "battery_frozen"
    BATTERY_IMPLAUSIBLE = "battery_implausible"
    SERVO_INVALID = "servo_invalid"
    SERVO_FROZEN = "servo_frozen"
    SERVO_IMPLAUSIBLE = "servo_implausible"

    def __str__(self) -> str:
        return self.value


class Ends(Enum):
    """What ends a cause whose condition has gone."""

    BY_ITSELF = "by itself"
    RELEASE = "with a release"
    NEW_WALK = "when the commands stand and then walk anew, or with a release"

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
    ends: Ends = Ends.RELEASE
    limit: float = math.nan
    """Default of the setting that `what` names; NaN where it names none."""
    unit: str = ""
    """Of the limit."""

    @property
    def latched(self) -> bool:
        """Whether it stays when the condition has gone."""
        return self.ends is not Ends.BY_ITSELF


RULES: tuple[Rule, ...] = (
    Rule(Cause.START, "the supervisor has started", State.LIMP, 0.0),
    Rule(Cause.COMMAND_SILENCE, "no acceptable servo_command", State.HOLD, HOLD.after, Ends.BY_ITSELF),
    Rule(Cause.COMMAND_LOST, "still no acceptable servo_command", State.CROUCH, CROUCH.after, Ends.BY_ITSELF),
    Rule(Cause.LINK_LOST, "nothing at all from the workstation", State.CROUCH, LINK.after, Ends.BY_ITSELF),
    Rule(Cause.LONG_SILENCE, "no acceptable servo_command for new_walk_after", State.CROUCH, AWAY.after, Ends.NEW_WALK),
    Rule(Cause.EMERGENCY_STOP, "pad, keyboard, any publisher of emergency_stop, or SIGUSR1", State.LIMP, 0.0),
    Rule(Cause.FALLEN, "the body is tilted by more than max_tilt", State.LIMP, 0.2, limit=1.05, unit="rad"),
    # A servo of this size stalls at about 1 A; less than that for long burns it.
    Rule(Cause.OVER_CURRENT, "a servo draws more than max_current", State.LIMP, 0.25, limit=0.9, unit="A"),
    # Two lithium-polymer cells: 3.3 and 3.0 V each.
    Rule(Cause.LOW_BATTERY, "voltage below low_voltage", State.CROUCH, 1.0, limit=6.6, unit="V"),
    Rule(Cause.EMPTY_BATTERY, "voltage below empty_voltage", State.LIMP, 0.5, limit=6.0, unit="V"),
    Rule(Cause.SILENT_SERVO, "a servo does not answer its board", State.CROUCH, 0.1),
    Rule(Cause.LINE_LOST, "the device, or a board of it, does not answer", State.LIMP, 0.3),
    Rule(Cause.DEVICE_LIMP, "the device is limp by itself: watchdog, restart, over-current", State.LIMP, 0.1),
    # Without an IMU falls are not seen: low down there is none. Without a battery reading power may go any moment.
    Rule(Cause.IMU_INVALID, "no unit quaternion, or a rate or acceleration that is no number", State.CROUCH, 0.1),
    Rule(Cause.IMU_FROZEN, "the same to the last bit while servos or the body move", State.CROUCH, 0.5),
    Rule(Cause.IMU_IMPLAUSIBLE, "orientation against accelerometer or gyroscope", State.CROUCH, 1.0),
    Rule(Cause.BATTERY_INVALID, "a voltage that is no number", State.CROUCH, 3.0),
    Rule(Cause.BATTERY_FROZEN, "voltage and current the same to the last bit while servos move", State.CROUCH, 10.0),
    Rule(Cause.BATTERY_IMPLAUSIBLE, "voltage above highest_voltage", State.CROUCH, 1.0, limit=9.0, unit="V"),
    Rule(Cause.SERVO_INVALID, "a position, speed or current that is no number", State.CROUCH, 0.1),
    Rule(Cause.SERVO_FROZEN, "a position the same to the last bit while the servo is told to move", State.CROUCH, 0.5),
    Rule(
        Cause.SERVO_IMPLAUSIBLE,
        f"{RANGE_MARGIN:g} rad beyond its range, or {SPEED_FACTOR:g} times faster than it can be",
        State.CROUCH,
        0.25,
    ),
)
"""Bad commands (stale, from the future, repeated, out of order, not finite, of a wrong length, with unknown names) are
refused and counted; when no other comes, command_silence follows. Positions, rates and torques are limited without a
change of state. A supervisor that dies is the device's to notice: its watchdog makes the servos limp."""

RULE_OF: dict[Cause, Rule] = {rule.cause: rule for rule in RULES}


def table() -> str:
    """The rules as a Markdown table, as it stands in the documentation."""
    rows = ["| cause | when | state | after | ends, once the reason has gone |", "|---|---|---|---|---|"]
    for rule in RULES:
        limit = "" if math.isnan(rule.limit) else f" ({rule.limit:g} {rule.unit})"
        rows += [f"| `{rule.cause}` | {rule.what}{limit} | {rule.state} | {rule.after:g} s | {rule.ends} |"]
    return "\n".join(rows)
