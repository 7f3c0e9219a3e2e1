"""The one table of silences: who may be missing for how long, what follows, and why these times differ."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Silence:
    """One row. How long sensors and the device may fail is in the supervisor's table of rules.

    Nermo-Lite's firmware holds copies of HOLD's and WATCHDOG's times: `python -m nermo_hw.firmware.header` writes them.
    """

    of: str
    """What does not come."""
    after: float
    """[s] without it; also the age beyond which what comes is stale."""
    then: str
    why: str


HOLD = Silence(
    "`servo_command`",
    0.2,
    "twin, driver and supervisor hold the last posture",
    "40 ticks: nothing else drives the servos",
)
CROUCH = Silence(
    "`servo_command`", 1.0, "they crouch", "a node that is started anew is back by then, and the mouse walks on"
)
LINK = Silence(
    "the workstation, heartbeats included",
    0.5,
    "the supervisor crouches",
    "10 heartbeats: it is the link that is gone, so there is nobody to wait for",
)
AWAY = Silence(
    "`servo_command`", 5.0, "a walk must begin anew", "whoever held the stick may have let go; `new_walk_after` sets it"
)
STICK = Silence(
    "`joy`, or the stick of the page",
    0.25,
    "one command that stops, then none",
    "before the controller's own, so that the stop is a command",
)
WALK = Silence(
    "`control_command`, `motion_command`, odometry, or a node of the walk",
    0.3,
    "the step is ended and the mouse stands, 0.15 s later",
    "three repeats of the slowest, the gait parameters; over before another sender may begin",
)
TARGETS = Silence(
    "`servo_targets`, or the command to follow them",
    0.3,
    "the servos hold the last ones until then; then the mouse stands",
    "as for a walk; whoever plays them sends them as often as the servos are told",
)
OWNER = Silence(
    "commands of the sender that is obeyed", 0.5, "another one may command", "longer than it takes to stand"
)
GONE = Silence("an end of the link", 5.0, "it is gone, and its stops with it", "ten times what counts as connected")
WATCHDOG = Silence(
    "exchanges with a board",
    0.5,
    "the board makes its servos limp by itself",
    "after the supervisor's own `line_lost` (0.3 s, `safety/rules.py`), for nobody is left who could hold or crouch; "
    "the board's register `watchdog` sets it",
)

SILENCES = (HOLD, CROUCH, AWAY, STICK, WALK, TARGETS, OWNER, LINK, GONE, WATCHDOG)


def table() -> str:
    """The silences as a Markdown table, as it stands in the documentation."""
    rows = ["| silent | for | then | why this time |", "|---|---|---|---|"]
    rows += [f"| {row.of} | {row.after:g} s | {row.then} | {row.why} |" for row in SILENCES]
    return "\n".join(rows)
