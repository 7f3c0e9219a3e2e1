"""`nermo bench faults`: every fault, injected while walking, and what the robot made of it."""

from __future__ import annotations

import itertools
import signal
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nermo_description.parameters import RobotParameters
from nermo_description.results import CommandError
from nermo_description.silence import WATCHDOG
from nermo_hw.bench.rig import Rig
from nermo_hw.safety.rules import RULE_OF, Cause, State
from nermo_hw.safety.sensor_checks import SMOOTHING

MARGIN_S = 0.2
"""A state that comes later than its time and this is late: two control ticks, one exchange, and a busy machine."""
BOOT_S = 0.3
"""After a brown-out the boards need this until they can say that they are limp; they are so at once."""
MOVING_S = 0.5
"""Until a servo of the walk has moved as far as it takes to notice that a reading does not."""
PAUSES_S = 5.0
"""Of the walk in ten seconds of movement."""
STOPS_EARLIER = {
    Cause.COMMAND_SILENCE,
    Cause.COMMAND_LOST,
    Cause.LINK_LOST,
    Cause.LONG_SILENCE,
    Cause.LINE_LOST,
    Cause.DEVICE_LIMP,
}
"""Causes on whose way commands or the device are silent, which is noticed first."""
PATIENCE = 3.0
"""So many times as late as it may be, a state is waited for before it counts as not reached."""
_TRIALS = 5


@dataclass(frozen=True)
class Injection:
    """A fault: how it is done, what it should lead to, and how it is undone."""

    name: str
    cause: Cause | None
    """None: the robot's end itself has died, and the device's watchdog acts."""
    do: Callable[[Rig], Any]
    undo: Callable[[Rig], Any]
    delay: float = 0.0
    """Until the condition itself begins [s]: a wire that is cut is noticed by what does not come."""

    @property
    def state(self) -> State:
        """What it should lead to."""
        return State.LIMP if self.cause is None else RULE_OF[self.cause].state

    @property
    def walks_on(self) -> bool:
        """Whether the robot follows until it has taken the state: where it stops earlier, the machine was busy."""
        return self.cause is not None and self.cause not in STOPS_EARLIER

    @property
    def within(self) -> float:
        """Time that it may take [s]."""
        after = WATCHDOG.after if self.cause is None else RULE_OF[self.cause].after
        return self.delay + after + MARGIN_S


def _on_device(
    name: str, cause: Cause, word: str, wrong: dict[str, Any], well: dict[str, Any], delay: float = 0.0
) -> Injection:
    """The emulated device is told a word, with other arguments to undo it."""
    return Injection(
        name, cause, lambda rig: rig.device(word, **wrong), lambda rig: rig.device(word, **well), delay=delay
    )


def _walking(name: str, cause: Cause, **wrong: Any) -> Injection:
    """The workstation walks otherwise, or not at all."""
    return Injection(
        name, cause, lambda rig: rig.walker("walk", **{"on": True, **wrong}), lambda rig: rig.walker("walk", on=True)
    )


def _sensors(name: str, cause: Cause, word: str, sensor: str, delay: float = 0.0) -> Injection:
    """A sensor goes wrong as the word says."""
    return _on_device(name, cause, word, {"names": [sensor]}, {"names": []}, delay)


def _bad_line(what: str) -> Injection:
    """The serial line: every frame so."""
    wrong, well = ({"name": what, "value": value} for value in (1.0, 0.0))
    return _on_device(f"line_{what}", Cause.LINE_LOST, "line_fault", wrong, well)


def _voltage(name: str, cause: Cause, value: float) -> Injection:
    return _on_device(name, cause, "voltage", {"value": value}, {"value": None})


def _revive(rig: Rig) -> None:
    before = len(rig.states())
    rig.start_robot()
    rig.until(lambda: len(rig.states()) > before, "the robot's end is there again")


def _refused(rig: Rig) -> None:
    """Somebody releases, and the robot refuses. Raises CommandError where it does not."""
    rig.until(lambda: "still say" in str(rig.walker("release")), "a release is refused")


def _stop_again(rig: Rig) -> None:
    """Stop, a release that is refused, its end, and stop once more: it is this one that must count."""
    rig.walker("stop", pressed=True)
    _refused(rig)
    _let_go(rig)
    rig.walker("stop", pressed=True)
    _refused(rig)


def _stop_by_two(rig: Rig) -> None:
    """A signal and a publisher, which ends its own."""
    rig.signal_robot(signal.SIGUSR1)
    rig.walker("stop", pressed=True)
    _refused(rig)
    _let_go(rig)


def _let_go(rig: Rig) -> None:
    rig.walker("stop", pressed=False)


def _nothing(rig: Rig) -> None:
    pass


INJECTIONS: tuple[Injection, ...] = (
    _walking("commands_stop", Cause.COMMAND_SILENCE, on=False),
    _walking("commands_stop_long", Cause.COMMAND_LOST, on=False),
    *(
        _walking(f"command_{wrong}", Cause.COMMAND_SILENCE, wrong=wrong)
        for wrong in ("stale", "future", "repeated", "nan", "infinite", "unknown_name", "wrong_length")
    ),
    Injection("network_cut", Cause.LINK_LOST, lambda rig: rig.impair(cut=True), lambda rig: rig.impair()),
    Injection("emergency_stop_topic", Cause.EMERGENCY_STOP, lambda rig: rig.walker("stop", pressed=True), _let_go),
    Injection("emergency_stop_signal", Cause.EMERGENCY_STOP, lambda rig: rig.signal_robot(signal.SIGUSR1), _nothing),
    Injection("emergency_stop_again", Cause.EMERGENCY_STOP, _stop_again, _let_go),
    Injection("emergency_stop_by_two", Cause.EMERGENCY_STOP, _stop_by_two, _nothing),
    _walking("commands_stop_for_long", Cause.LONG_SILENCE, on=False),
    _on_device("fall", Cause.FALLEN, "tilt", {"angle": 1.5}, {"angle": 0.0}),
    _on_device(
        "over_current",
        Cause.OVER_CURRENT,
        "extra_current",
        {"servo": "tail", "current": 1.1},
        {"servo": "tail", "current": 0.0},
    ),
    _voltage("low_battery", Cause.LOW_BATTERY, 6.5),
    _voltage("empty_battery", Cause.EMPTY_BATTERY, 5.8),
    _sensors("silent_servo", Cause.SILENT_SERVO, "silent_servos", "tail"),
    _sensors("silent_board", Cause.LINE_LOST, "silent_boards", "servo board 1"),
    _on_device("imu_without_orientation", Cause.IMU_INVALID, "no_orientation", {"on": True}, {"on": False}),
    _sensors("imu_frozen", Cause.IMU_FROZEN, "frozen", "imu", MOVING_S),
    _on_device("imu_upside_down", Cause.IMU_IMPLAUSIBLE, "upside_down", {"on": True}, {"on": False}, SMOOTHING),
    _sensors("battery_frozen", Cause.BATTERY_FROZEN, "frozen", "battery", PAUSES_S),
    _sensors("battery_without_reading", Cause.BATTERY_INVALID, "unreadable", "battery"),
    _voltage("battery_impossible", Cause.BATTERY_IMPLAUSIBLE, 12.0),
    _sensors("servo_frozen", Cause.SERVO_FROZEN, "frozen", "front_left_hip", MOVING_S),
    _sensors("servo_without_reading", Cause.SERVO_INVALID, "unreadable", "front_left_hip"),
    _on_device(
        "servo_impossible",
        Cause.SERVO_IMPLAUSIBLE,
        "angle_error",
        {"servo": "tail", "angle": 2.0},
        {"servo": "tail", "angle": 0.0},
    ),
    *map(_bad_line, ("corrupt", "wrong_id", "replay", "delay")),
    Injection("cable_pulled", Cause.LINE_LOST, lambda rig: rig.device("unplug", seconds=1.0), _nothing),
    Injection("brown_out", Cause.DEVICE_LIMP, lambda rig: rig.device("brown_out"), _nothing, delay=BOOT_S),
    Injection("robot_end_killed", None, lambda rig: rig.signal_robot(signal.SIGKILL), _revive),
)


def gait(robot: RobotParameters, frequency: float = 0.8, rate: float = 200.0) -> np.ndarray:
    """Servo positions [rad] of one cycle, shape (ticks, n): diagonal legs swing in turn, spine and tail with them.

    For a robot on a bench: every servo moves at walking speed, well inside its range.
    """
    phase = np.arange(round(rate / frequency)) / round(rate / frequency) * 2.0 * np.pi
    columns = []
    for name, servo in robot.servos.items():
        shift = 0.0 if name.startswith(("front_left", "rear_right")) else np.pi
        amplitude = 0.35 * min(servo.upper - servo.neutral, servo.neutral - servo.lower, 1.0)
        columns.append(servo.neutral + amplitude * np.sin(phase + shift))
    return np.stack(columns, axis=1)


def bench_faults(
    robot: str = "nermo_lite",
    repeats: int = 20,
    seed: int = 0,
    transport: str = "quic",
    names: tuple[str, ...] = (),
    progress: Callable[[str], None] = lambda _: None,
) -> list[dict[str, Any]]:
    """Injects each fault `repeats` times at a random moment of the walk.

    A row has `state` (that should be reached), `reached` and `recovered` (how often), `time_s` (p50 and max, from the
    injection), `within_s` (what it may take), `executed_after` (commands that the device executed when it should
    not follow any more), and `disturbed` (trials that were repeated, as the robot stopped for another reason first).

    Raises NoNamespacesError, CommandError.
    """
    chosen = [injection for injection in INJECTIONS if not names or injection.name in names]
    if unknown := set(names) - {injection.name for injection in INJECTIONS}:
        known = ", ".join(injection.name for injection in INJECTIONS)
        raise CommandError(f"fault {', '.join(sorted(unknown))} is unknown: known are {known}", status=2)
    random = np.random.default_rng(seed)
    with (
        tempfile.TemporaryDirectory(prefix="nermo_bench_faults_") as folder,
        Rig(Path(folder), robot, transport) as rig,
    ):
        rig.walker("gait", postures=gait(rig.robot).tolist())
        rig.walker("walk", on=True)
        return [measure(rig, injection, repeats, random, progress) for injection in chosen]


def measure(
    rig: Rig,
    injection: Injection,
    repeats: int,
    random: np.random.Generator,
    progress: Callable[[str], None] = lambda _: None,
) -> dict[str, Any]:
    """One row on a robot that walks."""
    outcomes: list[_Outcome] = []
    disturbed = 0
    while len(outcomes) < repeats:
        progress(f"{injection.name} {len(outcomes) + 1}/{repeats}")
        outcome = _inject(rig, injection, float(random.uniform(0.2, 1.45)))
        if outcome.disturbed and disturbed < repeats:
            disturbed += 1
        else:
            outcomes.append(outcome)
    return _row(injection, outcomes) | {"disturbed": disturbed}


def bench_cut(
    robot: str = "nermo_lite", seconds: float = 3.0, transport: str = "quic", repeats: int = 5
) -> dict[str, Any]:
    """Cuts the network while walking: time until safe, and until walking again, both at the device."""
    safe, again, oldest = [], [], []
    with tempfile.TemporaryDirectory(prefix="nermo_bench_cut_") as folder, Rig(Path(folder), robot, transport) as rig:
        rig.walker("gait", postures=gait(rig.robot).tolist())
        rig.walker("walk", on=True)
        for _ in range(repeats):
            rig.release()
            time.sleep(1.0)
            seen, cut = len(rig.states()), time.monotonic_ns()
            rig.impair(cut=True)
            time.sleep(seconds)
            back = time.monotonic_ns()
            rig.impair()
            _until_walking(rig, seen)
            entries = rig.states()[seen:]
            safe.append((entries[0]["monotonic_ns"] - cut) * 1e-9)
            again.append((entries[-1]["monotonic_ns"] - back) * 1e-9)
            oldest.append(entries[-1]["command_age_ms"])
    return {
        "cut_s": seconds,
        "repeats": repeats,
        "safe_after_s": _spread(safe),
        "walking_after_s": _spread(again),
        "oldest_command_ms": max(oldest),
    }


def _until_walking(rig: Rig, seen: int) -> None:
    """Waits until the robot follows, after at least two changes of state."""
    rig.until(lambda: rig.state() == "follow" and len(rig.states()) > seen + 1, "it walks again")


@dataclass(frozen=True, slots=True)
class _Outcome:
    seconds: float | None
    """Until the state; None where it was not reached."""
    recovered: bool
    executed_after: int
    disturbed: bool


def _walk(rig: Rig, seconds: float) -> None:
    """Lets the robot walk for a while. On a busy machine something may stop it meanwhile: then it walks again."""
    for _ in range(_TRIALS):
        rig.release()
        seen = len(rig.states())
        time.sleep(seconds)
        if rig.state() == "follow" and len(rig.states()) == seen:
            return
    raise CommandError(f"the robot does not walk for {seconds:.2g} s, {_TRIALS} times: {rig.states()[-1]}")


def _inject(rig: Rig, injection: Injection, wait: float) -> _Outcome:
    _walk(rig, wait)
    rig.points()
    seen, begin = len(rig.states()), time.monotonic_ns()
    injection.do(rig)
    reached: int | None = None
    try:
        rig.until(lambda: _reached(rig, injection, seen) is not None, injection.name, PATIENCE * injection.within)
        reached = _reached(rig, injection, seen)
    except CommandError:
        reached = None
    time.sleep(0.3)
    executed = _executed_after(rig, injection, begin)
    other = next((entry for entry in rig.states()[seen:] if str(injection.cause) not in entry["causes"]), None)
    injection.undo(rig)
    recovered = True
    try:
        rig.release()
    except CommandError:
        recovered = False
    seconds = None if reached is None else (reached - begin) * 1e-9
    return _Outcome(seconds, recovered, executed, injection.walks_on and other is not None)


def _reached(rig: Rig, injection: Injection, seen: int) -> int | None:
    """When the state was taken [ns, monotonic]; of a dead process, when the device had cut the power."""
    if injection.cause is None:
        return None if rig.device("state")["energised"] else time.monotonic_ns()
    for entry in rig.states()[seen:]:
        if str(injection.cause) in entry["causes"] and State[entry["state"].upper()] >= injection.state:
            return int(entry["monotonic_ns"])
    return None


def _executed_after(rig: Rig, injection: Injection, begin: int) -> int:
    """Points that the device took after the deadline and that are not part of the state: in `hold` a servo that is told
    to go elsewhere, in `crouch` one that goes away from the crouch, in `limp` any.
    """
    deadline = begin + round(injection.within * 1e9)
    late = [targets for at, targets in rig.points() if at > deadline]
    if injection.state is State.LIMP:
        return len(late)
    resolution = 2e-4
    crouch = np.array(list(rig.robot.posture("crouch").values()))
    wrong = 0
    for before, after in itertools.pairwise(late):
        towards = np.abs(after - crouch) <= np.abs(before - crouch) + resolution
        still = np.abs(after - before) <= resolution
        wrong += not np.all(np.isnan(after) | still | towards)
    return wrong


def _row(injection: Injection, outcomes: list[_Outcome]) -> dict[str, Any]:
    times = [outcome.seconds for outcome in outcomes if outcome.seconds is not None]
    return {
        "fault": injection.name,
        "cause": "device watchdog" if injection.cause is None else str(injection.cause),
        "state": str(injection.state),
        "injected": len(outcomes),
        "reached": len(times),
        "time_s": _spread(times),
        "within_s": injection.within,
        "in_time": sum(seconds <= injection.within for seconds in times),
        "recovered": sum(outcome.recovered for outcome in outcomes),
        "executed_after": sum(outcome.executed_after for outcome in outcomes),
    }


def _spread(values: list[float]) -> dict[str, float | None]:
    if not values:
        return {"p50": None, "max": None}
    return {"p50": float(np.median(values)), "max": float(max(values))}
