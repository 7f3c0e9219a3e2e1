"""The motion module: no jumps, postures, stopping, silence, bad input, resets."""

from __future__ import annotations

import copy
import itertools
import math
from dataclasses import replace

import hypothesis
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nermo_control.gait.gaits import GaitDefinition
from nermo_control.gait.knowledge_base import GaitParameters, LegStride
from nermo_control.gait.trajectory import TrajectoryGenerator
from nermo_control.legs.kinematics import LegKinematics
from nermo_control.lift import KNEE_COMPRESSION, LIFT_DURATION, LIFTED_LEG, SHIFT_DURATION
from nermo_control.motion.body import LATEST_TICKS
from nermo_control.motion.config import MotionModuleConfig
from nermo_control.motion_module import MotionModule
from nermo_control.types import FootTrajectory, Four, MotionCommand, MotionOutput, Phase, Posture, SpineModes
from nermo_description.parameters import LEGS, RobotParameters
from nermo_description.robots import load_robot

PERIOD = 5_000_000
WALK = MotionCommand(0, 0.09, 0.0, Posture.WALK, "trot", 0.8)
STAND = replace(WALK, posture=Posture.STAND)
STILL = replace(WALK, posture=Posture.STILL)


class Rig:
    """A motion module with its trajectory generator and ideal servos, as the graph runs them in real time."""

    def __init__(self, robot: RobotParameters, start: float = 0.0) -> None:
        self.robot = robot
        self.parameters = GaitParameters()
        self.module = MotionModule(robot, self.parameters, PERIOD)
        self.generator = TrajectoryGenerator(self.parameters)
        self.kinematics = [LegKinematics(robot.front_leg if i < 2 else robot.rear_leg, pair) for i, pair in PAIRS]
        self.servos: tuple[float, ...] = (start,) * len(robot.servos)
        self.stamp = -PERIOD
        self.outputs: list[MotionOutput] = []

    def run(
        self,
        seconds: float,
        command: MotionCommand | None,
        repeat: bool = True,
        generator: bool = True,
        knowledge_base: bool = True,
    ) -> list[MotionOutput]:
        """Ticks for a time; `repeat` stamps the command anew each tick."""
        first = len(self.outputs)
        for _ in range(round(seconds * 1e9 / PERIOD)):
            self.stamp += PERIOD
            if knowledge_base:
                self.module.sign_of_life("gait_knowledge_base", self.stamp)
            if command is not None and repeat:
                command = replace(command, stamp=self.stamp)
            output = self.module.step(self.stamp, command, self.servos)
            if generator:
                for trajectory in self.generator.step(output.leg_states):
                    self.module.accept(trajectory)
                self.module.sign_of_life("trajectory_generator", self.stamp)
            self.servos = output.servo_positions
            self.outputs.append(output)
        return self.outputs[first:]

    def tune(self, parameters: GaitParameters, config: MotionModuleConfig) -> None:
        """New parameters for both."""
        self.module.set_parameters(parameters)
        self.module.set_config(config)
        self.generator.set_parameters(parameters)

    def feet(self, output: MotionOutput | None = None) -> list[tuple[float, float]]:
        """Feet (x, z) of the servo positions."""
        servos = (output or self.outputs[-1]).servo_positions
        names = list(self.robot.servos)
        return [
            kinematics.forward(servos[names.index(f"{leg}_hip")], servos[names.index(f"{leg}_knee")])
            for leg, kinematics in zip(LEGS, self.kinematics, strict=True)
        ]


PAIRS = [(0, "front"), (1, "front"), (2, "rear"), (3, "rear")]
NEUTRAL = [(0.005, -0.045), (0.005, -0.045), (0.0, -0.05), (0.0, -0.05)]


@pytest.fixture
def rig(robot: RobotParameters) -> Rig:
    return Rig(robot)


def is_still(outputs: list[MotionOutput]) -> bool:
    return all(output.servo_positions == outputs[0].servo_positions for output in outputs)


def is_walking(outputs: list[MotionOutput]) -> bool:
    return any(Phase.SWING in output.leg_states.phases for output in outputs)


def warnings(outputs: list[MotionOutput]) -> list[str]:
    return [warning for output in outputs for warning in output.warnings]


def assert_on_four_feet(rig: Rig) -> None:
    for (_, z), (_, ground) in zip(rig.feet(), NEUTRAL, strict=True):
        assert z == pytest.approx(ground, abs=1e-6)


# No jumps

any_command = st.builds(
    MotionCommand,
    stamp=st.just(0),
    forward_velocity=st.floats(-0.2, 0.2),
    turn_rate_normalized=st.floats(-1.0, 1.0),
    posture=st.sampled_from([Posture.WALK] * 4 + list(Posture)),
    gait=st.sampled_from(["trot", "walking_trot", "lateral_walk"]),
    gait_frequency=st.floats(0.3, 1.0),
    turning_strategy=st.sampled_from(["leg", "spine", "mix"]),
    spine_modes=st.builds(SpineModes, st.booleans(), st.booleans(), st.booleans(), st.booleans()),
)


@settings(max_examples=40, deadline=None)
@given(
    st.floats(-0.5, 0.5),
    st.lists(st.tuples(any_command, st.floats(0.02, 1.5), st.booleans(), st.booleans()), min_size=2, max_size=8),
)
def test_no_sequence_of_commands_makes_a_servo_jump(
    robot: RobotParameters, start: float, script: list[tuple[MotionCommand, float, bool, bool]]
) -> None:
    rig = Rig(robot, start)
    last = rig.servos
    for command, seconds, repeat, generator in script:
        for output in rig.run(seconds, command, repeat=repeat, generator=generator):
            for name, before, now in zip(robot.servos, last, output.servo_positions, strict=True):
                assert abs(now - before) <= robot.servos[name].max_velocity * PERIOD * 1e-9 + 1e-12
            last = output.servo_positions
    assert not [text for text in warnings(rig.outputs) if "slowed down" in text], "smooth by itself, not by the limit"


@pytest.mark.parametrize("name", ["nermo_lite", "nermo"])
@pytest.mark.parametrize("modes", [SpineModes(False, False, True, True), SpineModes(False, True, True, False)])
def test_the_longest_stride_at_1_hz_with_offset_compensation_is_smooth_by_itself(name: str, modes: SpineModes) -> None:
    """Found by hypothesis: this swing takes nearly all that a rear knee can do, and the offset changes meanwhile."""
    fast = replace(WALK, forward_velocity=0.125, gait="lateral_walk", gait_frequency=1.0)
    rig, plain = Rig(load_robot(name)), Rig(load_robot(name))
    for each, command in ((rig, replace(fast, spine_modes=modes)), (plain, fast)):
        each.run(1.0, replace(WALK, forward_velocity=0.0, gait_frequency=1.0), repeat=False)
        each.run(3.0, command)
    assert not [text for text in warnings(rig.outputs) if "slowed down" in text]
    # The foot keeps to its path; only its height's offset comes later.
    for ours, other in zip(rig.outputs, plain.outputs, strict=True):
        assert [x for x, _ in rig.feet(ours)] == pytest.approx([x for x, _ in plain.feet(other)], abs=1e-6)


@pytest.mark.parametrize("name", ["nermo", "nermo_lite"])
@settings(max_examples=10, deadline=None)
@given(st.lists(st.integers(1, LATEST_TICKS), min_size=20, max_size=60))
def test_ticks_that_come_late_slow_no_servo_down(name: str, periods: list[int]) -> None:
    robot = load_robot(name)
    rig = Rig(robot)
    rig.run(1.0, replace(WALK, forward_velocity=0.06))
    last = rig.servos
    for number in itertools.islice(itertools.cycle(periods), 200):
        rig.stamp += (number - 1) * PERIOD
        rig.run(PERIOD * 1e-9, replace(WALK, forward_velocity=0.06))
        for before, now, servo in zip(last, rig.servos, robot.servos.values(), strict=True):
            assert abs(now - before) <= servo.max_velocity * number * PERIOD * 1e-9 + 1e-12
        last = rig.servos
    assert not warnings(rig.outputs)


def test_a_tick_later_than_that_moves_a_servo_no_farther(rig: Rig) -> None:
    rig.run(1.0, WALK)
    last = rig.servos
    rig.stamp += 60 * PERIOD
    rig.run(PERIOD * 1e-9, replace(WALK, posture=Posture.STAND))
    for before, now, servo in zip(last, rig.servos, rig.robot.servos.values(), strict=True):
        assert abs(now - before) <= servo.max_velocity * LATEST_TICKS * PERIOD * 1e-9 + 1e-12


@settings(max_examples=20, deadline=None)
@given(st.lists(st.tuples(any_command, st.floats(0.1, 3.0), st.floats(0.02, 1.0)), min_size=2, max_size=6))
def test_not_even_extreme_frequencies_ask_for_more_than_a_servo_can(
    robot: RobotParameters, script: list[tuple[MotionCommand, float, float]]
) -> None:
    rig = Rig(robot)
    last = rig.servos
    for command, frequency, seconds in script:
        for output in rig.run(seconds, replace(command, gait_frequency=frequency)):
            for name, before, now in zip(robot.servos, last, output.servo_positions, strict=True):
                assert abs(now - before) <= robot.servos[name].max_velocity * PERIOD * 1e-9 + 1e-12
            last = output.servo_positions


def test_the_first_command_is_where_the_servos_are(robot: RobotParameters) -> None:
    rig = Rig(robot, 0.3)
    [first] = rig.run(5e-3, WALK)
    assert first.servo_positions == (0.3,) * len(robot.servos)


def test_nothing_moves_before_a_command(robot: RobotParameters) -> None:
    rig = Rig(robot, 0.3)
    assert is_still(rig.run(1.0, None))
    assert is_still(rig.run(1.0, STILL))


# Walking


def test_walking_begins_in_the_neutral_stance_and_lifts_the_right_feet(rig: Rig) -> None:
    rig.run(2.0, STAND)
    for foot, neutral in zip(rig.feet(), NEUTRAL, strict=True):
        assert foot == pytest.approx(neutral, abs=1e-6)
    rig.run(0.3, WALK)
    assert rig.outputs[-1].leg_states.phases == (Phase.SWING, Phase.STANCE, Phase.STANCE, Phase.SWING)
    lifted = [z > ground + 0.005 for (_, z), (_, ground) in zip(rig.feet(), NEUTRAL, strict=True)]
    assert lifted == [True, False, False, True]


def test_a_steady_trot_makes_the_stride_of_its_velocity(rig: Rig) -> None:
    rig.run(4.0, WALK)
    outputs = rig.run(2.5, WALK)
    for leg in range(4):
        x = [rig.feet(output)[leg][0] for output in outputs]
        assert max(x) - min(x) == pytest.approx(0.09 / (0.8 * 2.0), rel=0.02)
    assert not warnings(outputs)


@pytest.mark.parametrize(("turn", "shorter"), [(0.5, (0, 2)), (-0.5, (1, 3))])
def test_turning_shortens_the_inner_strides(rig: Rig, turn: float, shorter: tuple[int, int]) -> None:
    rig.run(1.0, WALK)
    velocities = rig.run(0.5, replace(WALK, turn_rate_normalized=turn))[-1].leg_states.velocities
    assert velocities == pytest.approx([0.045 if leg in shorter else 0.09 for leg in range(4)])


def test_too_long_a_stride_is_clipped_and_said(rig: Rig) -> None:
    rig.run(1.0, WALK)
    output = rig.run(0.1, replace(WALK, forward_velocity=0.5))[-1]
    assert max(output.leg_states.velocities) == pytest.approx(0.096)
    assert "clipped to 0.096 m/s" in output.warnings[0]


def test_a_gait_that_changes_replans_all_legs_at_the_start_of_a_cycle(rig: Rig) -> None:
    rig.run(4.0, WALK)
    outputs = rig.run(1.3, replace(WALK, gait="lateral_walk"))
    [change] = [o for o in outputs if all(o.leg_states.requested) and o.leg_states.duty_factor == 0.68]
    assert all(state.leg_states.duty_factor == 0.5 for state in outputs[: outputs.index(change)])


@pytest.mark.parametrize(("strategy", "bends", "modulates"), [("leg", 0, 1), ("spine", 1, 0), ("mix", 1, 1)])
def test_legs_and_spine_turn_as_the_strategy_says(rig: Rig, strategy: str, bends: int, modulates: int) -> None:
    rig.run(3.0, replace(WALK, turn_rate_normalized=0.5, turning_strategy=strategy))  # type: ignore[arg-type]
    spine = rig.servos[list(rig.robot.servos).index("spine_lateral")]
    left, right, *_ = rig.outputs[-1].leg_states.velocities
    assert (spine > 0.01, left < right) == (bool(bends), bool(modulates))


def test_offset_compensation_lifts_one_rear_foot_and_lowers_the_other(robot: RobotParameters) -> None:
    plain, compensated = Rig(robot), Rig(robot)
    turn = replace(WALK, turn_rate_normalized=1.0, turning_strategy="spine")
    plain.run(3.0, turn)
    compensated.run(3.0, replace(turn, spine_modes=SpineModes(offset_compensation=True)))
    offsets = [b - a for (_, a), (_, b) in zip(plain.feet(), compensated.feet(), strict=True)]
    assert offsets[:2] == pytest.approx([0.0, 0.0], abs=1e-9)
    assert offsets[2] * offsets[3] < 0.0
    assert min(abs(offsets[2]), abs(offsets[3])) > 0.002


# Postures


@pytest.mark.parametrize("posture", [Posture.STAND, Posture.SIT, Posture.CROUCH])
def test_a_posture_is_reached_and_kept_without_commands(rig: Rig, posture: Posture) -> None:
    rig.run(1.0, WALK)
    rig.run(2.0, replace(WALK, posture=posture))
    assert is_still(rig.run(2.0, replace(WALK, posture=posture, stamp=rig.stamp), repeat=False))
    if posture is Posture.STAND:
        assert_on_four_feet(rig)
    else:
        assert rig.servos == tuple(rig.robot.posture(posture.name.lower()).values())


def test_stop_freezes_at_once_and_walking_goes_on_from_there(rig: Rig) -> None:
    rig.run(2.1, WALK)
    before = rig.servos
    assert all(output.servo_positions == before for output in rig.run(1.0, replace(WALK, posture=Posture.STOP)))
    assert is_walking(rig.run(3.0, WALK))


def test_standing_still_keeps_the_feet_where_they_are(rig: Rig) -> None:
    rig.run(2.2, WALK)
    before = [x for x, _ in rig.feet()]
    rig.run(0.2, STILL)
    assert [x for x, _ in rig.feet()] == pytest.approx(before, abs=2e-3)
    assert_on_four_feet(rig)
    assert is_still(rig.run(0.5, STILL))
    rig.run(1.5, STAND)
    assert rig.feet()[0] == pytest.approx(NEUTRAL[0], abs=1e-6)


# Silence


@pytest.mark.parametrize("silent", ["repeat", "generator", "knowledge_base"])
def test_half_a_second_after_silence_the_mouse_stands_and_walks_when_it_ends(rig: Rig, silent: str) -> None:
    rig.run(2.2, WALK)
    command = replace(WALK, stamp=rig.stamp)
    stopping = rig.run(0.5, command, **{silent: False})
    node = {"repeat": "high_level_controller", "generator": "trajectory_generator"}.get(silent, "gait_knowledge_base")
    told = [warning for output in stopping for warning in output.warnings if "nothing from" in warning]
    assert told == [f"nothing from {node} for 0.3 s: the mouse stops"]
    assert_on_four_feet(rig)
    assert is_still(rig.run(1.0, command, **{silent: False}))
    assert is_walking(rig.run(1.0, WALK))


def test_a_short_silence_stops_nothing(rig: Rig) -> None:
    rig.run(2.2, WALK)
    outputs = rig.run(0.25, replace(WALK, stamp=rig.stamp), repeat=False) + rig.run(0.5, WALK)
    assert all(Phase.SWING in output.leg_states.phases for output in outputs)


def test_in_lockstep_nothing_is_silent(robot: RobotParameters) -> None:
    rig = Rig(robot)
    rig.module = MotionModule(robot, rig.parameters, PERIOD, MotionModuleConfig(lockstep=True))
    assert is_walking(rig.run(3.0, WALK, repeat=False, knowledge_base=False)[-10:])


def test_a_generator_that_answers_late_or_twice_does_no_harm(rig: Rig) -> None:
    rig.run(2.0, WALK)
    outputs = rig.run(0.7, WALK, generator=False)
    requests = [output.leg_states for output in outputs if any(output.leg_states.requested)]
    before = rig.servos
    for states in requests:
        for trajectory in rig.generator.step(states):
            rig.module.accept(trajectory)
            rig.module.accept(trajectory)
    [after] = rig.run(5e-3, WALK)
    assert after.servo_positions == pytest.approx(before, abs=0.075)


# Bad input


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        ({"forward_velocity": math.nan}, "forward_velocity = nan"),
        ({"forward_velocity": math.inf}, "forward_velocity = inf"),
        ({"turn_rate_normalized": math.nan}, "allowed -1 to 1"),
        ({"turn_rate_normalized": 1.5}, "allowed -1 to 1"),
        ({"gait": "troot"}, "did you mean trot"),
        ({"gait_frequency": 0.0}, "allowed 0.1 to 3.0 Hz"),
        ({"gait_frequency": 50.0}, "allowed 0.1 to 3.0 Hz"),
        ({"posture": 17}, "posture = 17 is unknown"),
        ({"turning_strategy": "wheels"}, "allowed: leg, mix, spine"),
    ],
)
def test_a_bad_command_is_refused_in_words_and_the_mouse_comes_to_a_stand(
    rig: Rig, bad: dict[str, object], words: str
) -> None:
    rig.run(2.2, WALK)
    outputs = rig.run(0.5, replace(WALK, **bad))  # type: ignore[arg-type]
    assert words in outputs[0].warnings[0]
    assert_on_four_feet(rig)
    assert is_still(rig.run(0.5, replace(WALK, **bad)))  # type: ignore[arg-type]
    assert is_walking(rig.run(1.0, WALK))


def test_a_trajectory_that_is_not_finite_is_refused(rig: Rig) -> None:
    zeros: Four = (0.0, 0.0, 0.0, 0.0)
    bad = FootTrajectory(0, Phase.SWING, 0, 0.5, zeros, zeros, (math.nan, 0.0, 0.0, 0.0), zeros)
    with pytest.raises(ValueError, match="leg 0 is not finite"):
        rig.module.accept(bad)
    with pytest.raises(ValueError, match="no duration"):
        rig.module.accept(replace(bad, z_first=zeros, duration=0.0))


def test_a_trajectory_that_nobody_asked_for_is_ignored(rig: Rig) -> None:
    rig.run(2.0, STAND)
    far: Four = (0.0, 0.0, 0.0, 0.5)
    rig.module.accept(FootTrajectory(0, Phase.SWING, rig.stamp + PERIOD, 0.5, far, far, far, far))
    assert is_still(rig.run(0.5, STAND))


def test_an_unmeasured_servo_starts_in_neutral(robot: RobotParameters) -> None:
    rig = Rig(robot, 0.2)
    rig.servos = (math.nan, *rig.servos[1:])
    [output] = rig.run(5e-3, None)
    assert output.servo_positions == (robot.servos["front_left_hip"].neutral, *rig.servos[1:])
    assert "front_left_hip: measured position nan" in output.warnings[0]


def test_a_wrong_number_of_servos_is_an_error(rig: Rig) -> None:
    with pytest.raises(ValueError, match="3 servo positions, expected 11"):
        rig.module.step(0, None, [0.0] * 3)


def test_a_repeated_tick_gives_the_same_answer(rig: Rig) -> None:
    [output] = rig.run(2.0, WALK)[-1:]
    assert rig.module.step(rig.stamp, WALK, rig.servos) is output


def test_feet_out_of_reach_are_clamped_and_said(rig: Rig) -> None:
    far = rig.parameters.front.model_copy(update={"neutral_stance_height": -0.1})
    rig.module.set_parameters(rig.parameters.model_copy(update={"front": far}))
    assert any("front_left: foot target out of reach" in text for text in warnings(rig.run(1.0, STAND)))


# Resets and new parameters


@pytest.mark.parametrize("jump", [-2.0, 5.0])
def test_after_a_jump_of_the_clock_the_mouse_moves_on_from_where_it_is(rig: Rig, jump: float) -> None:
    rig.run(2.2, WALK)
    rig.stamp += round(jump * 1e9)
    rig.servos = (0.1,) * len(rig.servos)
    [first] = rig.run(5e-3, WALK)
    assert first.servo_positions == (0.1,) * len(rig.servos)
    assert is_walking(rig.run(3.0, WALK))


def test_a_command_from_before_a_reset_does_not_walk_the_mouse(rig: Rig) -> None:
    rig.run(5.0, WALK)
    old = replace(WALK, stamp=rig.stamp)
    rig.stamp = -PERIOD
    assert not is_walking(rig.run(3.0, old, repeat=False))


def test_a_new_neutral_stance_is_taken_while_standing(rig: Rig) -> None:
    rig.run(2.0, STAND)
    lower = rig.parameters.rear.model_copy(update={"neutral_stance_height": -0.045})
    rig.module.set_parameters(rig.parameters.model_copy(update={"rear": lower}))
    rig.run(1.0, STAND)
    assert rig.feet()[2] == pytest.approx((0.0, -0.045), abs=1e-6)


def test_a_gait_that_is_taken_away_stops_the_mouse(rig: Rig) -> None:
    rig.run(2.2, replace(WALK, gait="walking_trot"))
    gaits = {"trot": rig.parameters.gaits["trot"]}
    rig.module.set_parameters(GaitParameters(gaits=gaits))
    outputs = rig.run(0.5, replace(WALK, gait="walking_trot"))
    assert any("walking_trot" in text for text in warnings(outputs))
    assert_on_four_feet(rig)


# Live tuning (C 5.2.4)


def _stride(pair: str) -> st.SearchStrategy[LegStride]:
    height, position = (-0.045, 0.005) if pair == "front" else (-0.05, 0.0)
    return st.builds(
        LegStride,
        swing_amplitude=st.floats(0.0, 0.015),
        stance_amplitude=st.floats(0.0, 0.008),
        max_stride_length=st.floats(0.0, 0.07),
        neutral_stance_height=st.floats(height - 0.003, height + 0.01),
        neutral_stride_position=st.floats(position - 0.01, position + 0.01),
    )


any_gait = st.builds(
    GaitDefinition, duty_factor=st.floats(0.4, 0.75), phase_offsets=st.tuples(*[st.floats(0, 0.99)] * 4)
)
any_parameters = st.builds(
    GaitParameters,
    gaits=st.fixed_dictionaries({"trot": any_gait, "walking_trot": any_gait, "lateral_walk": any_gait}),
    front=_stride("front"),
    rear=_stride("rear"),
    turn_response_exponent=st.floats(0.0, 5.0),
    fusion_exponent=st.floats(0.0, 5.0),
    max_spine_flexion=st.floats(0.0, 0.15),
    settle_duration=st.floats(0.05, 0.18),
)
any_config = st.builds(
    MotionModuleConfig,
    gaze=st.sampled_from(["off", "spine", "imu"]),
    tail=st.sampled_from(["off", "spine"]),
    tail_angle=st.floats(-1.0, 1.0),
    arch=st.floats(0.0, 0.15),
)
ROBOTS = {name: load_robot(name) for name in ("nermo_lite", "nermo")}
JUMP = 3.0 * PERIOD * 1e-9 + 1e-4
"""More than this [rad] that a new set of parameters adds to a servo's step would be a jump. Where it begins a way anew
the servo leaves as fast as it is: only what it accelerates in a tick is another, 1.7 rad/s at most so far."""


@pytest.mark.parametrize("name", ["nermo_lite", "nermo"])
@settings(max_examples=12, deadline=None, phases=[hypothesis.Phase.explicit, hypothesis.Phase.generate])
@given(data=st.data())
def test_no_parameter_changed_while_walking_makes_a_servo_jump(name: str, data: st.DataObject) -> None:
    """Two mice walk alike; one gets new parameters. In that tick their servos still agree."""
    robot = ROBOTS[name]
    rig, other = Rig(robot), Rig(robot)
    for _ in range(data.draw(st.integers(1, 3))):
        command = replace(data.draw(any_command), gait_frequency=data.draw(st.floats(0.3, 1.0)))
        seconds = data.draw(st.floats(0.02, 1.0))
        rig.run(seconds, command)
        other.run(seconds, command)
        parameters, config = data.draw(any_parameters), data.draw(any_config)
        rig.tune(parameters, config)
        [tuned], [plain] = rig.run(5e-3, command), other.run(5e-3, command)
        assert tuned.servo_positions == pytest.approx(plain.servo_positions, abs=JUMP)
        other = copy.deepcopy(rig)
    rig.run(0.5, command)
    for before, after in itertools.pairwise(output.servo_positions for output in rig.outputs):
        for servo, last, now in zip(robot.servos.values(), before, after, strict=True):
            assert abs(now - last) <= servo.max_velocity * PERIOD * 1e-9 + 1e-12


def test_new_parameters_are_in_full_effect_after_the_next_cycle(rig: Rig) -> None:
    rig.run(4.0, WALK)
    shape = rig.parameters.front.model_copy(update={"neutral_stance_height": -0.04, "neutral_stride_position": 0.0})
    rig.tune(rig.parameters.model_copy(update={"front": shape}), MotionModuleConfig())
    rig.run(2 * 1.25, WALK)
    feet = [rig.feet(output)[0] for output in rig.run(1.25, WALK)]
    x, z = zip(*feet, strict=True)
    assert max(x) + min(x) == pytest.approx(0.0, abs=1e-3)
    assert min(z) == pytest.approx(-0.045, abs=1e-3)


def test_a_stance_height_changed_while_settling_waits_for_the_next_walk(rig: Rig) -> None:
    rig.run(2.2, WALK)
    rig.run(0.1, STILL)
    shape = rig.parameters.rear.model_copy(update={"neutral_stance_height": -0.04})
    rig.tune(rig.parameters.model_copy(update={"rear": shape}), MotionModuleConfig())
    rig.run(0.3, STILL)
    assert_on_four_feet(rig)


# One leg lifted


def lifting(posture: Posture, balance: bool = True) -> MotionCommand:
    return replace(STAND, posture=posture, spine_modes=SpineModes(balance_compensation=balance))


@pytest.mark.parametrize("posture", list(LIFTED_LEG))
def test_one_leg_is_lifted_and_the_others_stand(rig: Rig, posture: Posture) -> None:
    leg, names = LIFTED_LEG[posture], list(rig.robot.servos)
    rig.run(1.0, STAND)
    standing = rig.servos
    before = rig.run(SHIFT_DURATION - 0.1, lifting(posture))[-1]
    knee, spine = names.index(f"{LEGS[leg]}_knee"), names.index("spine_lateral")
    assert before.servo_positions[knee] == standing[knee]
    # Bending to the left carries the stability diagonal to the left of the centre of mass: a left leg is free.
    assert (before.servo_positions[spine] > 0.5) == (leg in (0, 2))
    assert (before.servo_positions[spine] < -0.5) == (leg in (1, 3))
    rig.run(1.0, lifting(posture))
    assert rig.servos[knee] == pytest.approx(standing[knee] - KNEE_COMPRESSION[leg])
    for number in set(range(4)) - {leg}:
        assert rig.feet()[number] == pytest.approx(NEUTRAL[number], abs=1e-6)


def test_without_compensation_the_spine_stays_straight(rig: Rig) -> None:
    rig.run(1.0, STAND)
    rig.run(2.0, lifting(Posture.LIFT_REAR_LEFT, balance=False))
    assert rig.servos[list(rig.robot.servos).index("spine_lateral")] == pytest.approx(0.0)
    assert rig.feet()[2][1] > NEUTRAL[2][1] + 0.005


@pytest.mark.parametrize("then", [STAND, WALK, lifting(Posture.LIFT_FRONT_LEFT), replace(STAND, posture=Posture.SIT)])
def test_a_lifted_leg_is_put_down_before_anything_else(rig: Rig, then: MotionCommand) -> None:
    rig.run(1.0, STAND)
    rig.run(2.0, lifting(Posture.LIFT_REAR_RIGHT))
    bend = rig.servos[list(rig.robot.servos).index("spine_lateral")]
    outputs = rig.run(LIFT_DURATION, then)
    heights = [rig.feet(output)[3][1] for output in outputs]
    assert all(later <= earlier + 1e-9 for earlier, later in itertools.pairwise(heights))
    assert heights[-1] == pytest.approx(NEUTRAL[3][1], abs=1e-4)
    assert rig.servos[list(rig.robot.servos).index("spine_lateral")] == pytest.approx(bend, abs=0.02)
    rig.run(4.0, then)
    assert is_walking(rig.outputs[-200:]) == (then is WALK)
    front_left = rig.feet()[0][1]
    if then is STAND:
        assert_on_four_feet(rig)
    elif then.posture == Posture.LIFT_FRONT_LEFT:
        assert front_left > NEUTRAL[0][1] + 0.005
    elif then.posture == Posture.SIT:
        assert front_left == pytest.approx(-0.053, abs=1e-3)


def test_a_leg_is_lifted_from_the_stand_only(rig: Rig) -> None:
    rig.run(1.0, STAND)
    rig.run(1.3, WALK)
    rig.run(4.0, lifting(Posture.LIFT_FRONT_RIGHT))
    for number in (0, 2, 3):
        assert rig.feet()[number] == pytest.approx(NEUTRAL[number], abs=1e-6)
    assert rig.feet()[1][1] > NEUTRAL[1][1] + 0.005


def test_a_freeze_keeps_a_lifted_leg_up(rig: Rig) -> None:
    rig.run(1.0, STAND)
    rig.run(2.0, lifting(Posture.LIFT_REAR_LEFT))
    frozen = rig.servos
    assert is_still(rig.run(1.0, replace(STAND, posture=Posture.STOP)))
    assert rig.servos == frozen
