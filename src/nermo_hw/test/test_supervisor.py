"""The safety supervisor: each cause leads to its state in time, and nothing that comes in gets an unsafe output out."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from standing import BEGIN, NEUTRAL, ROBOT, SAMPLE, SERVOS

from nermo_description.silence import WATCHDOG
from nermo_hw.safety.rules import RULE_OF, RULES, Cause, State, table
from nermo_hw.safety.supervisor import Output, RefusedCommandError, SafetySettings, SafetySupervisor
from nermo_hw.types import Fault, SensorSample

LOWER = np.array([servo.lower for servo in ROBOT.servos.values()])
UPPER = np.array([servo.upper for servo in ROBOT.servos.values()])
MAX_VELOCITY = np.array([servo.max_velocity for servo in ROBOT.servos.values()])
TICK = 5_000_000


class Walk:
    """A supervisor that is fed as on a walking robot, tick by tick."""

    def __init__(self, settings: SafetySettings | None = None) -> None:
        self.now = BEGIN
        self.supervisor = SafetySupervisor(ROBOT, settings, now=self.now)
        self.sample: SensorSample | None = SAMPLE
        self.commands = self.heard = True
        self.target = NEUTRAL
        self.servos_follow = True
        """Servos that are at once where they are told to be."""
        self.noise = True
        """Of the IMU: a real one is never twice the same."""

    def tick(self) -> Output:
        self.now += TICK
        if self.heard:
            self.supervisor.heard(self.now)
        if self.commands:
            self.supervisor.take_command(self.now, SERVOS, self.target, self.now)
        output = self.supervisor.step(self.now)
        if self.sample is None:
            self.supervisor.device_silent("nobody answers", self.now)
        else:
            self.supervisor.take_sensors(self._seen(self.sample, output), self.now)
        return output

    def _seen(self, sample: SensorSample, output: Output) -> SensorSample:
        if self.servos_follow:
            sample = replace(sample, servo_positions=output.targets.positions)
        if self.noise:
            rate = sample.angular_velocity + 1e-3 * (self.now // TICK % 7)
            sample = replace(sample, angular_velocity=rate)
        return sample

    def run(self, seconds: float) -> Output:
        for _ in range(round(seconds * 1e9 / TICK)):
            output = self.tick()
        return output

    def released(self) -> Walk:
        self.run(0.1)
        assert self.supervisor.release(self.now) == ""
        assert self.run(0.1).state is State.FOLLOW
        return self


def tilted(angle: float) -> np.ndarray:
    return np.array([math.cos(angle / 2), math.sin(angle / 2), 0.0, 0.0])


def change(walk: Walk, cause: Cause) -> None:
    """Brings a cause about."""
    match cause:
        case Cause.COMMAND_SILENCE | Cause.COMMAND_LOST | Cause.LONG_SILENCE:
            walk.commands = False
        case Cause.LINK_LOST:
            walk.heard = walk.commands = False
        case Cause.EMERGENCY_STOP:
            walk.supervisor.stops.press("a test")
        case Cause.FALLEN:
            walk.sample = replace(SAMPLE, orientation=tilted(1.5))
        case Cause.OVER_CURRENT:
            walk.sample = replace(SAMPLE, servo_currents=np.array([2.0, *[0.1] * (len(SERVOS) - 1)]))
        case Cause.LOW_BATTERY:
            walk.sample = replace(SAMPLE, battery_voltage=6.5)
        case Cause.EMPTY_BATTERY:
            walk.sample = replace(SAMPLE, battery_voltage=5.9)
        case Cause.SILENT_SERVO:
            walk.sample = replace(SAMPLE, silent_servos=("tail",))
        case Cause.LINE_LOST:
            walk.sample = None
        case Cause.DEVICE_LIMP:
            walk.sample = replace(SAMPLE, faults=Fault.WATCHDOG, limp=True)
        case Cause.IMU_INVALID:
            walk.sample = replace(SAMPLE, orientation=np.zeros(4))
        case Cause.IMU_FROZEN:
            walk.noise = False
        case Cause.IMU_IMPLAUSIBLE:
            walk.sample = replace(SAMPLE, linear_acceleration=np.array([20.0, 0.0, 0.0]))
        case Cause.BATTERY_INVALID:
            walk.sample = replace(SAMPLE, battery_voltage=math.nan)
        case Cause.BATTERY_FROZEN:
            walk.sample = replace(SAMPLE, servo_velocities=np.ones(len(SERVOS)))
        case Cause.BATTERY_IMPLAUSIBLE:
            walk.sample = replace(SAMPLE, battery_voltage=12.0)
        case Cause.SERVO_INVALID:
            walk.sample = replace(SAMPLE, servo_currents=np.full(len(SERVOS), math.nan))
        case Cause.SERVO_FROZEN:
            walk.servos_follow = False
        case Cause.SERVO_IMPLAUSIBLE:
            walk.sample = replace(SAMPLE, servo_velocities=np.full(len(SERVOS), 1e3))


UNTIL_NOTICED = {Cause.IMU_FROZEN: 0.3, Cause.SERVO_FROZEN: 0.3, Cause.IMU_IMPLAUSIBLE: 0.3}
"""[s] For servos to move as far as it takes, and for means to change."""


@pytest.mark.parametrize("cause", [rule.cause for rule in RULES if rule.cause is not Cause.START])
def test_each_cause_leads_to_its_state_in_time_and_ends_as_the_table_says(cause: Cause) -> None:
    walk = Walk().released()
    rule = RULE_OF[cause]
    begin = walk.now
    change(walk, cause)
    while cause not in (output := walk.tick()).causes:
        walk.target = NEUTRAL + 0.15 * math.sin((walk.now - begin) * 1e-8)
        late = (walk.now - begin) * 1e-9 - rule.after - UNTIL_NOTICED.get(cause, 0.0)
        assert late <= 2.1 * TICK * 1e-9, output
    assert output.state == max(RULE_OF[other].state for other in output.causes)
    assert output.state >= rule.state
    assert walk.supervisor.reason(cause) != ""

    walk.commands = walk.heard = walk.servos_follow = walk.noise = True
    walk.target = NEUTRAL
    walk.sample = replace(SAMPLE, battery_voltage=7.5)
    output = walk.run(2.0)
    assert (cause in output.causes) == rule.latched
    walk.supervisor.release(walk.now)
    assert walk.run(0.5).state is State.FOLLOW


def test_it_begins_limp_and_only_a_release_gives_power() -> None:
    walk = Walk()
    output = walk.run(2.0)
    assert (output.state, output.causes) == (State.LIMP, (Cause.START,))
    assert not output.targets.energised
    walk.released()


def test_a_release_leaves_what_still_holds() -> None:
    walk = Walk().released()
    change(walk, Cause.FALLEN)
    walk.run(2.0 * RULE_OF[Cause.FALLEN].after)
    assert "fallen (tilted by 1.50 rad)" in walk.supervisor.release(walk.now)
    assert walk.run(0.1).state is State.LIMP


def test_it_says_when_only_the_line_has_to_be_released() -> None:
    walk = Walk()
    walk.tick()
    assert walk.supervisor.waits_for_the_line_only
    walk.released()
    assert not walk.supervisor.waits_for_the_line_only
    change(walk, Cause.LINE_LOST)
    walk.run(0.5)
    assert not walk.supervisor.waits_for_the_line_only
    walk.sample = SAMPLE
    walk.run(0.1)
    assert walk.supervisor.waits_for_the_line_only
    walk.supervisor.stops.press("a test")
    assert not walk.supervisor.waits_for_the_line_only


def test_one_answer_that_happens_to_come_does_not_keep_a_lost_line_alive() -> None:
    walk = Walk().released()
    begin = walk.now
    while Cause.LINE_LOST not in walk.tick().causes:
        walk.sample = SAMPLE if (walk.now - begin) // TICK % 10 == 0 else None
        assert walk.now - begin < 0.4e9


def test_link_loss_needs_a_link_that_was_there() -> None:
    walk = Walk()
    walk.heard = False
    walk.run(1.0)
    walk.released()
    assert walk.run(1.0).state is State.FOLLOW


def test_hold_crouch_and_back_go_without_a_jump() -> None:
    walk = Walk().released()
    held = walk.tick().targets.positions
    walk.commands = False
    assert walk.run(0.3).state is State.HOLD
    assert np.allclose(walk.tick().targets.positions, held)
    walk.run(3.0)
    crouch = np.array(list(ROBOT.posture("crouch").values()))
    assert np.allclose(walk.run(1.0).targets.positions, crouch, atol=1e-6)
    before = walk.tick().targets.positions
    walk.commands = True
    output = walk.tick()
    assert output.state is State.FOLLOW
    fastest = walk.supervisor.settings.approach_velocity * TICK * 1e-9
    assert 0.0 < np.abs(output.targets.positions - before).max() <= fastest + 1e-12


def test_power_comes_back_where_the_servos_are() -> None:
    walk = Walk()
    walk.servos_follow = False
    walk.sample = replace(SAMPLE, servo_positions=np.clip(NEUTRAL + 0.3, LOWER, UPPER))
    walk.run(0.1)
    walk.supervisor.release(walk.now)
    assert np.abs(walk.tick().targets.positions - walk.sample.servo_positions).max() < 0.02


def test_torque_is_limited_by_keeping_the_target_near() -> None:
    walk = Walk(SafetySettings(torque_share=0.5)).released()
    walk.servos_follow = False
    walk.target = UPPER
    positions = walk.run(0.3).targets.positions
    servo = ROBOT.servos["tail"]
    reach = 0.5 * servo.max_torque / servo.proportional_gain
    tail = SERVOS.index("tail")
    assert positions[tail] == pytest.approx(NEUTRAL[tail] + reach)


def test_a_servo_whose_reading_cannot_be_is_not_led_to_where_it_says_it_is() -> None:
    walk = Walk().released()
    walk.servos_follow = False
    tail = SERVOS.index("tail")
    walk.sample = replace(SAMPLE, servo_positions=np.where(np.arange(len(SERVOS)) == tail, 2.0, NEUTRAL))
    positions = [walk.tick().targets.positions[tail] for _ in range(400)]
    assert walk.supervisor.state is State.CROUCH
    assert np.abs(positions).max() <= abs(ROBOT.posture("crouch")["tail"])
    walk.supervisor.stops.press("a test")
    assert abs(walk.run(0.1).targets.positions[tail]) <= abs(ROBOT.posture("crouch")["tail"])


@pytest.mark.parametrize(
    ("stamp", "names", "positions", "words"),
    [
        (0, SERVOS, NEUTRAL[:-1], "11 names but 10 positions"),
        (0, SERVOS[:-1], NEUTRAL[:-1], "head_pan missing"),
        (0, ("nose", *SERVOS[1:]), NEUTRAL, "unknown servo nose"),
        (0, (SERVOS[1], *SERVOS[1:]), NEUTRAL, "missing"),
        (0, SERVOS, [math.nan, *NEUTRAL[1:]], "position of front_left_hip = nan rad: allowed -10 to 10 rad"),
        (0, SERVOS, [1e308, *NEUTRAL[1:]], "allowed -10 to 10 rad"),
        (-300_000_000, SERVOS, NEUTRAL, "stale: 0.300 s old"),
        (100_000_000, SERVOS, NEUTRAL, "0.100 s in the future"),
        (-TICK, SERVOS, NEUTRAL, "repeated"),
        (-2 * TICK, SERVOS, NEUTRAL, "out of order"),
    ],
)
def test_a_bad_command_is_refused_and_changes_nothing(stamp: int, names: tuple, positions: list, words: str) -> None:
    walk = Walk().released()
    before = walk.supervisor.accepted, walk.supervisor.command_stamp
    with pytest.raises(RefusedCommandError, match=words):
        walk.supervisor.take_command(walk.now + TICK + stamp, names, positions, walk.now + TICK)
    assert (walk.supervisor.accepted, walk.supervisor.command_stamp) == before
    assert walk.supervisor.refused == 1


ANY_FLOAT = st.floats(width=64)
EVENTS = st.one_of(
    st.tuples(
        st.just("command"),
        st.integers(-(10**9), 10**9),
        st.lists(st.sampled_from((*SERVOS, "nose", "")), max_size=3),
        st.lists(ANY_FLOAT, max_size=len(SERVOS) + 2),
    ),
    st.tuples(
        st.just("good"), st.integers(-(10**8), 10**8), st.just([]), st.lists(ANY_FLOAT, min_size=11, max_size=11)
    ),
    st.tuples(st.just("sensors"), st.just(0), st.just([]), st.lists(ANY_FLOAT, min_size=11, max_size=11)),
    st.tuples(st.sampled_from(("release", "stop", "heard", "silent")), st.just(0), st.just([]), st.just([])),
    st.tuples(st.just("wait"), st.integers(-(10**7), 2 * 10**9), st.just([]), st.just([])),
)


@given(st.lists(EVENTS, max_size=40))
def test_nothing_that_comes_in_gets_an_unsafe_output_out(events: list) -> None:
    now = BEGIN
    supervisor = SafetySupervisor(ROBOT, now=now)
    supervisor.take_sensors(SAMPLE, now)
    supervisor.release(now)
    last = supervisor.step(now).targets
    for what, offset, odd_names, numbers in events:
        now += TICK
        match what:
            case "command" | "good":
                names = (*odd_names, *SERVOS[: len(numbers) - len(odd_names)]) if what == "command" else SERVOS
                try:
                    supervisor.take_command(now + offset, names, numbers, now)
                except RefusedCommandError:
                    assert supervisor.refused > 0
            case "sensors":
                values = np.array(numbers)
                sample = replace(
                    SAMPLE,
                    servo_positions=values,
                    servo_velocities=values[::-1],
                    servo_currents=values,
                    orientation=values[:4],
                    battery_voltage=numbers[0],
                )
                supervisor.take_sensors(sample, now)
            case "release":
                supervisor.release(now)
            case "stop":
                supervisor.stops.press("a test")
            case "heard":
                supervisor.heard(now)
            case "silent":
                supervisor.device_silent("nobody answers", now)
            case "wait":
                now += offset
        before = supervisor.state
        output = supervisor.step(now)
        positions = output.targets.positions
        assert np.isfinite(positions).all()
        assert (positions >= LOWER).all() and (positions <= UPPER).all()
        assert output.targets.energised == (output.state is not State.LIMP)
        if State.LIMP not in (before, output.state) and what not in ("release",):
            # Never further than a servo turns in the longest tick that counts.
            assert (np.abs(positions - last.positions) <= MAX_VELOCITY * 0.05 + 1e-9).all()
        last = output.targets


def test_the_table_stands_in_the_documentation() -> None:
    page = Path(__file__).parents[3] / "docs" / "nermo_link.md"
    assert table() in page.read_text(encoding="utf-8")


def test_the_supervisor_knows_that_a_line_is_lost_before_the_boards_give_up() -> None:
    rule = RULE_OF[Cause.LINE_LOST]
    assert rule.after < WATCHDOG.after
    assert f"{rule.after:g} s" in WATCHDOG.why


BLIND = {
    name: np.full_like(getattr(SAMPLE, name), math.nan)
    for name in (
        "servo_positions",
        "servo_velocities",
        "servo_currents",
        "orientation",
        "angular_velocity",
        "linear_acceleration",
    )
}


def test_a_device_without_sensors_is_followed_and_its_battery_still_counts():
    walk = Walk()
    walk.servos_follow = walk.noise = False
    walk.sample = replace(SAMPLE, **BLIND, battery_current=math.nan, blind=True)
    walk.released()
    walk.target = NEUTRAL + 0.3
    output = walk.run(2.0)
    assert output.state is State.FOLLOW
    np.testing.assert_allclose(output.targets.positions, walk.target, atol=1e-9)
    walk.sample = replace(walk.sample, battery_voltage=6.3)
    assert Cause.LOW_BATTERY in walk.run(1.5).causes
    walk.sample = replace(walk.sample, battery_voltage=7.5, blind=False)
    assert {Cause.IMU_INVALID, Cause.SERVO_INVALID} <= set(walk.run(0.5).causes)
