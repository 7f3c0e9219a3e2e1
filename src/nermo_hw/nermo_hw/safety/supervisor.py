"""The safety supervisor: commands and sensor data in, what the servos may do out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from nermo_description.emergency_stops import EmergencyStops
from nermo_description.parameters import RobotParameters
from nermo_description.servo_command import RefusedCommandError, ServoCommandDoor
from nermo_description.silence import HOLD
from nermo_hw.safety.new_walk import NewWalk
from nermo_hw.safety.rules import RULE_OF, RULES, Cause, Rule, State
from nermo_hw.safety.sensor_checks import SENSOR_CAUSES, SensorChecks
from nermo_hw.safety.servo_limits import ServoLimits
from nermo_hw.types import LATCHED, Array, SensorSample, ServoTargets

__all__ = ["Output", "RefusedCommandError", "SafetySettings", "SafetySupervisor"]

LONGEST_TICK = 0.05
"""A tick that came later than this [s] is no reason to move further."""
STEADY = 2
"""So many exchanges in a row must be answered in whole before a line that was silent counts as there again: one answer
that happens to come is none that a walk can rely on."""
ARRIVED = 0.02
"""Nearer than this [rad] to the command, the slow approach is over."""


def _unit(unit: str) -> dict[str, Any]:
    return {"unit": unit}


def _limit(cause: Cause, description: str, **bounds: Any) -> Any:
    """The setting whose default stands in the row of its cause."""
    rule = RULE_OF[cause]
    return Field(rule.limit, description=description, json_schema_extra=_unit(rule.unit), **bounds)


class SafetySettings(BaseModel):
    """What may be set; by default the limits are those of the table of rules, which has the times too."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    max_command_age: float = Field(
        HOLD.after, ge=0.01, le=1.0, description="Commands older than this are stale", json_schema_extra=_unit("s")
    )
    max_command_lead: float = Field(
        0.02, ge=0.0, le=0.5, description="Commands stamped further ahead are refused", json_schema_extra=_unit("s")
    )
    torque_share: float = Field(1.0, gt=0.0, le=1.0, description="Share of the stall torque that may be asked for")
    max_current: float = _limit(Cause.OVER_CURRENT, "Of one servo", gt=0.0, le=10.0)
    low_voltage: float = _limit(Cause.LOW_BATTERY, "Battery is low", ge=0.0, le=30.0)
    empty_voltage: float = _limit(Cause.EMPTY_BATTERY, "Battery is empty", ge=0.0, le=30.0)
    highest_voltage: float = _limit(Cause.BATTERY_IMPLAUSIBLE, "More than a full battery has", ge=0.0, le=60.0)
    new_walk_after: float = Field(
        RULE_OF[Cause.LONG_SILENCE].after,
        ge=0.0,
        le=3600.0,
        description="Without commands for so long, a walk must begin anew before the robot follows; 0: it need not",
        json_schema_extra=_unit("s"),
    )
    max_tilt: float = _limit(Cause.FALLEN, "Tilted further, it has fallen", ge=0.1, le=math.pi)
    approach_velocity: float = Field(
        2.0,
        ge=0.1,
        le=20.0,
        description="Of a servo that crouches, or comes back to the commands",
        json_schema_extra=_unit("rad/s"),
    )

    @model_validator(mode="after")
    def _ordered(self) -> SafetySettings:
        if self.empty_voltage > self.low_voltage:
            raise ValueError(f"empty_voltage = {self.empty_voltage} V: at most low_voltage = {self.low_voltage} V")
        return self


@dataclass(frozen=True, slots=True)
class Output:
    """What one tick of the supervisor decided."""

    targets: ServoTargets
    state: State
    causes: tuple[Cause, ...]
    """All that hold or are latched, worst first."""


class SafetySupervisor:
    """Decides in every control tick what the servos may do. All times are integer ns on one clock.

    now: the time at the start. The servos are limp until `release`.
    """

    def __init__(self, robot: RobotParameters, settings: SafetySettings | None = None, *, now: int) -> None:
        self.robot = robot
        self.settings = settings or SafetySettings()
        self.servos = tuple(robot.servos)
        self.stops = EmergencyStops()
        """Who stops the robot; any thread and signal handler may say so here."""
        self._limits = ServoLimits(robot, self.settings.torque_share)
        self._door = ServoCommandDoor(self.servos, self.settings.max_command_age, self.settings.max_command_lead)
        self._crouch = np.array(list(robot.posture("crouch").values()))
        self._output = self._limits.position(np.array([servo.neutral for servo in robot.servos.values()]))
        self._command: Array | None = None
        self._command_at = now
        self._command_stamp: int | None = None
        self._heard_at: int | None = None
        self._new_walk = NewWalk()
        self._checks = SensorChecks(robot, self.settings.highest_voltage)
        self._sample: SensorSample | None = None
        self._sample_at = now
        self._answered = 0
        """Exchanges in a row that all boards have answered."""
        self._since: dict[Cause, int] = {}
        """Since when a condition has held without a break."""
        self._why: dict[Cause, str] = {Cause.START: "just started"}
        self._latched: set[Cause] = {Cause.START}
        self._state = State.LIMP
        self._last_step = now
        self._approaching = True
        self.refused = 0
        self.last_refusal = ""
        self.accepted = 0

    # What comes in

    def take_command(self, stamp: int, names: Sequence[str], positions: Sequence[float], now: int) -> None:
        """Takes a servo command. Raises RefusedCommandError, which is counted, and then nothing has changed."""
        try:
            command = np.array(self._door.open(stamp, names, positions, now))
        except RefusedCommandError as error:
            self.refused += 1
            self.last_refusal = str(error)
            raise
        self._command, self._command_at, self._command_stamp = command, now, stamp
        self.accepted += 1
        if Cause.LONG_SILENCE in self._latched:
            self._new_walk.take(command, now)
            if self._new_walk.begun:
                self._latched.discard(Cause.LONG_SILENCE)

    def heard(self, now: int) -> None:
        """The workstation gave any sign of life. The link counts as lost only after the first."""
        self._heard_at = now

    def take_sensors(self, sample: SensorSample, now: int) -> None:
        """Takes what one exchange with the device brought."""
        self._sample, self._sample_at = sample, now
        settings = self.settings
        found = self._checks.take(sample, None if self._state is State.LIMP else self._goal(self._state), now)
        for cause in SENSOR_CAUSES:
            finding = found.get(cause)
            self._note(cause, *((None, "") if finding is None else (finding.since, finding.why)))
        self._watch(
            Cause.FALLEN, self._tilt(sample) > settings.max_tilt, now, f"tilted by {self._tilt(sample):.2f} rad"
        )
        worst = _largest(sample.servo_currents)
        hot = worst is not None and sample.servo_currents[worst] > settings.max_current
        self._watch(
            Cause.OVER_CURRENT, hot, now, f"{self.servos[worst or 0]} draws {_at(sample.servo_currents, worst)} A"
        )
        voltage = sample.battery_voltage
        self._watch(Cause.LOW_BATTERY, voltage < settings.low_voltage, now, f"{voltage:.2f} V")
        self._watch(Cause.EMPTY_BATTERY, voltage < settings.empty_voltage, now, f"{voltage:.2f} V")
        self._watch(Cause.SILENT_SERVO, bool(sample.silent_servos), now, ", ".join(sample.silent_servos))
        self._answered = 0 if sample.missing else self._answered + 1
        if sample.missing:
            self._watch(Cause.LINE_LOST, True, now, f"{', '.join(sample.missing)} silent")
        elif self._answered >= STEADY:
            self._watch(Cause.LINE_LOST, False, now, "")
        faults = sample.faults & LATCHED
        self._watch(Cause.DEVICE_LIMP, bool(faults), now, f"device reports {faults.name or faults}")

    def device_silent(self, why: str, now: int) -> None:
        """An exchange with the device failed."""
        self._answered = 0
        self._watch(Cause.LINE_LOST, True, now, why)

    def release(self, now: int) -> str:
        """Takes back every latched cause whose condition has gone; what is left, in words, empty where nothing is.

        Emergency stops are taken back all together, once no source says stop any more.

        A device that is limp because it was told so, or because it has restarted, is no reason to refuse: releasing it
        is what this is for.
        """
        stopped = self.stops.release()
        self._watch_stops(now)
        for cause in list(self._latched):
            if cause is Cause.DEVICE_LIMP or cause not in self._since:
                self._latched.discard(cause)
        self._since.pop(Cause.DEVICE_LIMP, None)
        self._begin_softly()
        left = [cause for cause in self._holding(now) if RULE_OF[cause].latched]
        return "; ".join(stopped if cause is Cause.EMERGENCY_STOP else self.reason(cause) for cause in left)

    @property
    def waits_for_the_line_only(self) -> bool:
        """Whether nothing is latched but the start and a line or device that is there again."""
        line = {Cause.START, Cause.LINE_LOST, Cause.DEVICE_LIMP}
        others = {cause for cause in self._holding(self._last_step) if RULE_OF[cause].latched} - line
        waits = bool(self._latched) and not others and Cause.LINE_LOST not in self._since
        return waits and not self.stops.active

    # What goes out

    def step(self, now: int) -> Output:
        """One control tick."""
        dt = min(max((now - self._last_step) * 1e-9, 0.0), LONGEST_TICK)
        self._last_step = now
        self._watch_stops(now)
        self._watch_long_silence(now)
        # Silence is a condition that holds from the last sign of life on.
        self._since[Cause.COMMAND_SILENCE] = self._since[Cause.COMMAND_LOST] = self._command_at
        if self._heard_at is not None:
            self._since[Cause.LINK_LOST] = self._heard_at
        causes = self._holding(now)
        if Cause.LONG_SILENCE in causes and Cause.LONG_SILENCE not in self._latched:
            self._new_walk.start()
        if Cause.START not in self._latched:  # a release is needed anyway, and much is just coming up
            self._latched.update(cause for cause in causes if RULE_OF[cause].latched)
        state = max((RULE_OF[cause].state for cause in causes), default=State.FOLLOW)
        if state is not self._state:
            self._begin_softly(from_limp=self._state is State.LIMP)
            self._state = state
        self._move(state, dt, now)
        return Output(ServoTargets(self._output.copy(), energised=state is not State.LIMP), state, causes)

    def reason(self, cause: Cause) -> str:
        """A cause in words."""
        detail = self._why.get(cause, "")
        if cause is Cause.LONG_SILENCE:
            stands = self._new_walk.stands(self._last_step)
            how = "the commands stand: walk" if stands else "let go of the stick until the commands stand, then walk"
            detail = f"{detail}; {how} anew, or release"
        return f"{cause} ({detail})" if detail else str(cause)

    def sentence(self, output: Output) -> str:
        """The state and why, for the diagnostics."""
        why = "; ".join(self.reason(cause) for cause in output.causes)
        return f"{output.state}: {why}" if why else str(output.state)

    @property
    def state(self) -> State:
        """As of the last step."""
        return self._state

    @property
    def command_stamp(self) -> int | None:
        """Of the newest command that was accepted [ns]."""
        return self._command_stamp

    # Inside

    def _watch(self, cause: Cause, holds: bool, now: int, why: str) -> None:
        self._note(cause, self._since.get(cause, now) if holds else None, why)

    def _note(self, cause: Cause, since: int | None, why: str) -> None:
        """Since when a condition has held; None where it does not."""
        if since is None:
            self._since.pop(cause, None)
        else:
            self._since[cause], self._why[cause] = since, why

    def _watch_long_silence(self, now: int) -> None:
        """A robot that has never been commanded, or whose commands come, is not left alone."""
        silence = (now - self._command_at) * 1e-9
        alone = self._command_stamp is not None and silence > RULE_OF[Cause.COMMAND_SILENCE].after
        holds = alone and self.settings.new_walk_after > 0.0
        self._note(Cause.LONG_SILENCE, self._command_at if holds else None, f"no servo_command for {silence:.1f} s")

    def _watch_stops(self, now: int) -> None:
        self._watch(Cause.EMERGENCY_STOP, self.stops.active, now, str(self.stops))

    def _holding(self, now: int) -> tuple[Cause, ...]:
        """Causes that are latched or have lasted long enough, worst first."""
        held = [
            rule.cause
            for rule in RULES
            if rule.cause in self._latched
            or (rule.cause in self._since and now - self._since[rule.cause] >= self._after(rule) * 1e9)
        ]
        return tuple(sorted(held, key=lambda cause: -RULE_OF[cause].state))

    def _after(self, rule: Rule) -> float:
        return self.settings.new_walk_after if rule.cause is Cause.LONG_SILENCE else rule.after

    def _begin_softly(self, from_limp: bool = False) -> None:
        self._approaching = True
        if from_limp:
            self._start_from_measured()

    def _start_from_measured(self) -> None:
        if self._sample is not None:
            measured = self._checks.believable_positions(self._sample)
            self._output = self._limits.position(np.where(np.isfinite(measured), measured, self._output))

    def _move(self, state: State, dt: float, now: int) -> None:
        if state is State.LIMP:
            self._start_from_measured()
            return
        if state is State.HOLD or (state is State.FOLLOW and self._command is None):
            return
        goal = target = self._goal(state)
        if self._sample is not None and now - self._sample_at < 0.1e9:
            positions = self._checks.believable_positions(self._sample)
            target = self._limits.torque(target, positions, self._sample.servo_velocities)
        if state is State.FOLLOW and self._approaching and np.abs(goal - self._output).max() < ARRIVED:
            self._approaching = False
        velocity = self.settings.approach_velocity if state is State.CROUCH or self._approaching else None
        self._output = self._limits.position(self._limits.rate(target, self._output, dt, velocity))

    def _goal(self, state: State) -> Array:
        """Where the servos shall be in the end [rad]."""
        if state is State.CROUCH:
            return self._crouch
        return self._output if state is State.HOLD or self._command is None else self._limits.position(self._command)

    def _tilt(self, sample: SensorSample) -> float:
        """Angle between the body's upward axis and the world's [rad]; NaN where there is no orientation.

        That is a cause of its own.
        """
        w, x, y, z = (float(part) for part in sample.orientation)
        norm = w * w + x * x + y * y + z * z
        if not (math.isfinite(norm) and norm > 0.25):
            return math.nan
        return math.acos(min(max(1.0 - 2.0 * (x * x + y * y) / norm, -1.0), 1.0))


def _largest(values: Array) -> int | None:
    """Place of the largest finite value."""
    finite = np.where(np.isfinite(values), values, -np.inf)
    return int(finite.argmax()) if len(finite) and np.isfinite(finite.max()) else None


def _at(values: Array, place: int | None) -> str:
    return "nan" if place is None else f"{values[place]:.2f}"
