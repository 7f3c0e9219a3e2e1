"""The posture DIRECT: the servos follow targets from outside, without a jump and in range, as long as they come."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nermo_control.gait.knowledge_base import GaitParameters
from nermo_control.gait.trajectory import TrajectoryGenerator
from nermo_control.high_level_controller import HighLevelController
from nermo_control.motion_module import MotionModule
from nermo_control.nodes.conversions import ServoArrays, UnusableMessageError
from nermo_control.types import ControlCommand, MotionCommand, MotionOutput, Odometry, Phase, Posture, ServoTargets
from nermo_description.robots import load_robot
from nermo_description.silence import TARGETS, WALK
from nermo_interfaces.msg import ServoCommand

PERIOD = 5_000_000
ROBOT = load_robot("nermo_lite")
NAMES = list(ROBOT.servos)
KNEE = NAMES.index("front_left_knee")
NEUTRAL = tuple(servo.neutral for servo in ROBOT.servos.values())
COMMAND = MotionCommand(0, 0.06, 0.0, Posture.WALK, "trot", 0.8)


class Mouse:
    """A motion module in real time with ideal servos, its trajectory generator, and somebody who plays targets."""

    def __init__(self) -> None:
        self.module = MotionModule(ROBOT, GaitParameters(), PERIOD)
        self.generator = TrajectoryGenerator(GaitParameters())
        self.servos: tuple[float, ...] = tuple(ROBOT.posture("crouch").values())
        self.stamp = 0
        self.targets: ServoTargets | None = None
        self.warnings: list[str] = []

    def tick(self, posture: Posture, wanted: tuple[float | None, ...] | None = None) -> MotionOutput:
        """One tick; the newest targets stay there when there are none."""
        self.stamp += PERIOD
        if wanted is not None:
            self.targets = ServoTargets(self.stamp, wanted)
        self.module.sign_of_life("gait_knowledge_base", self.stamp)
        self.module.sign_of_life("trajectory_generator", self.stamp)
        command = replace(COMMAND, stamp=self.stamp, posture=posture)
        before = self.servos
        output = self.module.step(self.stamp, command, before, targets=self.targets)
        for trajectory in self.generator.step(output.leg_states):
            self.module.accept(trajectory)
        self.servos = output.servo_positions
        self.warnings = list(output.warnings)
        for name, old, new in zip(NAMES, before, self.servos, strict=True):
            assert abs(new - old) <= ROBOT.servos[name].max_velocity * PERIOD * 1e-9 + 1e-9, name
        return output

    def run(
        self, seconds: float, posture: Posture, wanted: tuple[float | None, ...] | None = None
    ) -> list[MotionOutput]:
        return [self.tick(posture, wanted) for _ in range(round(seconds * 1e9 / PERIOD))]


@pytest.fixture
def standing() -> Mouse:
    mouse = Mouse()
    mouse.run(2.0, Posture.STAND)
    return mouse


def bent(angle: float, servo: int = KNEE) -> tuple[float, ...]:
    return (*NEUTRAL[:servo], angle, *NEUTRAL[servo + 1 :])


def test_the_servos_are_where_the_targets_are_after_a_smooth_approach(standing: Mouse) -> None:
    first = standing.servos[KNEE]
    way = [output.servo_positions[KNEE] for output in standing.run(1.0, Posture.DIRECT, bent(-0.4))]
    assert standing.servos == bent(-0.4)
    assert abs(way[0] - first) < 0.002 < abs(way[-1] - first), "it begins at rest"
    # From then on each target is reached in its own tick.
    for tick in range(100):
        angle = -0.4 + 0.1 * math.sin(0.05 * tick)
        assert standing.tick(Posture.DIRECT, bent(angle)).servo_positions[KNEE] == angle


def test_meanwhile_the_legs_count_as_standing(standing: Mouse) -> None:
    output = standing.run(0.5, Posture.DIRECT, bent(-0.4))[-1].leg_states
    assert output.gait_frequency == 0.0 and not any(output.requested)
    assert set(output.phases) == {Phase.STANCE} and set(output.velocities) == {0.0}


def test_a_servo_that_is_not_named_stays_where_it_is(standing: Mouse) -> None:
    before = standing.servos
    wanted = tuple(-0.3 if k == KNEE else None for k in range(len(NAMES)))
    standing.run(1.0, Posture.DIRECT, wanted)
    assert standing.servos == (*before[:KNEE], -0.3, *before[KNEE + 1 :])


def test_a_target_beyond_a_servos_range_is_held_to_it_and_said(standing: Mouse) -> None:
    standing.run(1.5, Posture.DIRECT, bent(9.0))
    servo = ROBOT.servos["front_left_knee"]
    assert standing.servos[KNEE] == servo.upper
    assert f"front_left_knee: target beyond {servo.lower:g} to {servo.upper:g} rad, held to that range" in (
        standing.warnings
    )


def test_silent_targets_are_held_and_then_the_mouse_stands_and_follows_again_when_they_are_back(
    standing: Mouse,
) -> None:
    stand = standing.servos
    standing.run(1.0, Posture.DIRECT, bent(-0.4))
    standing.run(TARGETS.after, Posture.DIRECT)
    assert standing.servos == bent(-0.4)
    standing.tick(Posture.DIRECT)
    assert "nothing from servo_targets for 0.3 s: the mouse stands" in standing.warnings
    standing.run(1.5, Posture.DIRECT)
    assert standing.servos == pytest.approx(stand)
    standing.run(1.0, Posture.DIRECT, bent(-0.4))
    assert standing.servos == bent(-0.4)
    assert TARGETS.after == WALK.after


def test_nobody_plays_so_the_mouse_stands(standing: Mouse) -> None:
    stand = standing.servos
    standing.run(1.0, Posture.DIRECT)
    assert standing.servos == pytest.approx(stand)


def test_a_walk_ends_first_and_begins_again_from_the_stand(standing: Mouse) -> None:
    standing.run(2.0, Posture.WALK)
    standing.run(1.5, Posture.DIRECT, bent(-0.4))
    assert standing.servos == bent(-0.4)
    outputs = standing.run(3.0, Posture.WALK)
    assert outputs[-1].leg_states.gait_frequency == COMMAND.gait_frequency


def test_stop_freezes_the_servos_on_their_way(standing: Mouse) -> None:
    standing.run(0.1, Posture.DIRECT, bent(-0.4))
    here = standing.servos
    standing.run(0.5, Posture.STOP, bent(-0.4))
    assert standing.servos == here


ANGLES = st.floats(-10.0, 10.0)
TARGETS_OF_ANYBODY = st.tuples(*[st.one_of(st.none(), ANGLES)] * len(NAMES))


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.sampled_from(list(Posture)), st.none() | TARGETS_OF_ANYBODY, st.integers(1, 120))))
def test_whatever_is_asked_in_whatever_order_no_servo_jumps_or_leaves_its_range(sequence) -> None:
    mouse = Mouse()
    for posture, wanted, ticks in sequence:
        for _ in range(ticks):
            mouse.tick(posture, wanted)
            for name, angle in zip(NAMES, mouse.servos, strict=True):
                assert ROBOT.servos[name].lower - 1e-9 <= angle <= ROBOT.servos[name].upper + 1e-9, name
    mouse.run(6.0, Posture.STAND)
    stand = mouse.servos
    mouse.run(0.5, Posture.STAND)
    assert mouse.servos == pytest.approx(stand), "it comes to a stand from anywhere"


def test_the_high_level_controller_passes_the_posture_on_until_nobody_asks_for_it() -> None:
    controller = HighLevelController(ROBOT, GaitParameters())
    asked = ControlCommand(PERIOD, posture=Posture.DIRECT, forward_velocity=0.1)
    told = controller.step(PERIOD, asked, Odometry(PERIOD, 0.0, 0.0, 0.0))
    assert (told.posture, told.forward_velocity) == (Posture.DIRECT, 0.0)
    later = PERIOD + round(WALK.after * 1e9) + PERIOD
    assert controller.step(later, asked, Odometry(later, 0.0, 0.0, 0.0)).posture is Posture.STILL


@pytest.mark.parametrize(
    ("message", "complaint"),
    [
        (ServoCommand(name=["tail", "toe"], position=[0.0, 0.0]), "unknown servo toe: the robot has"),
        (ServoCommand(name=["tail", "tail"], position=[0.0, 0.0]), "a servo is named twice"),
        (ServoCommand(name=["tail"], position=[]), "1 servo names but 0 positions"),
        (ServoCommand(name=["tail"], position=[math.nan]), "position of tail is nan rad: must be finite"),
        (ServoCommand(), "no servo is named"),
    ],
)
def test_targets_that_cannot_be_used_are_refused_in_words(message: ServoCommand, complaint: str) -> None:
    with pytest.raises(UnusableMessageError, match=complaint):
        ServoArrays(ROBOT).targets(message)


def test_targets_come_by_name() -> None:
    told = ServoArrays(ROBOT).targets(ServoCommand(name=["tail", "front_left_knee"], position=[0.2, -0.1]))
    assert told.positions[KNEE] == -0.1 and told.positions[NAMES.index("tail")] == 0.2
    assert told.positions.count(None) == len(NAMES) - 2
