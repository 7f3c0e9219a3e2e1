"""The spine controller: fusion, modes, smoothness and bad input."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from thesis_robot import NEUTRAL_FEET

from nermo_control.gait.knowledge_base import GaitParameters
from nermo_control.gait.phase import LegPhases, legs_at
from nermo_control.spine.balance import BalanceCompensation, CentreOfMass
from nermo_control.spine.controller import FASTEST, NOT_LIFTED, SpineController, SpineTarget, fuse
from nermo_control.spine.kinematics import SpineKinematics
from nermo_control.spine.offset import OffsetCompensation
from nermo_control.spine.stride import StrideExtension
from nermo_control.spine.tendon import SpineTendon
from nermo_control.types import MotionCommand, Posture, SpineModes
from nermo_description.robots import load_robot

PERIOD_NS = 5_000_000
PERIOD = PERIOD_NS * 1e-9
ROBOT = load_robot("nermo_lite")
HIP_POSITIONS = ROBOT.hip_positions
KINEMATICS = SpineKinematics(ROBOT.spine)
TENDON = SpineTendon(ROBOT.spine)
COM = CentreOfMass(KINEMATICS, ROBOT.front_mass, ROBOT.masses.front_com, ROBOT.masses.rear, ROBOT.masses.rear_com)
BALANCE = BalanceCompensation(KINEMATICS, COM, HIP_POSITIONS, 0.1)
FOOT_X = tuple(NEUTRAL_FEET[pair][0] for pair in ("front", "front", "rear", "rear"))
FOOT_Z = tuple(NEUTRAL_FEET[pair][1] for pair in ("front", "front", "rear", "rear"))
GAITS = GaitParameters().gaits
WALK = MotionCommand(0, 0.1, 0.0, Posture.WALK, "trot", 0.8)
TURN = replace(WALK, turning_strategy="spine")
shares = st.floats(-1.0, 1.0)


@pytest.fixture
def controller() -> SpineController:
    return SpineController(ROBOT, GaitParameters(), PERIOD_NS)


def legs_of(seconds: float, gait: str = "trot", frequency: float = 0.8) -> LegPhases:
    return legs_at(seconds * frequency, GAITS[gait], frequency)


def run(
    controller: SpineController,
    command: MotionCommand,
    seconds: float = 1.0,
    walking: bool = True,
    lifted: tuple[bool, bool, bool, bool] = NOT_LIFTED,
) -> list[SpineTarget]:
    return [
        controller.step(command, legs_of(tick * PERIOD) if walking else None, FOOT_X, FOOT_Z, lifted)
        for tick in range(round(seconds / PERIOD))
    ]


def values(targets: Sequence[SpineTarget]) -> np.ndarray:
    return np.array([target.flexion for target in targets])


# Fusion (5.45)-(5.46)


@given(shares, shares, st.floats(0.0, 5.0))
def test_fusion_stays_in_range_and_is_the_same_for_both_sides(turn: float, secondary: float, exponent: float) -> None:
    share = fuse(turn, secondary, exponent)
    assert -1.0 <= share <= 1.0
    assert fuse(-turn, -secondary, exponent) == -share


@given(st.floats(0.0, 1.0), shares)
def test_fusion_is_the_printed_one_for_left_turns(turn: float, secondary: float) -> None:
    assert fuse(turn, secondary, 1.0) == pytest.approx(turn + (1.0 - turn) * secondary)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_full_lock_leaves_nothing_to_the_secondary_modes(side: float) -> None:
    assert fuse(side, -side, 1.0) == fuse(side, side, 1.0) == side
    assert fuse(0.0, side, 1.0) == side


def test_a_larger_exponent_prefers_turning() -> None:
    assert fuse(0.5, -1.0, 1.0) == pytest.approx(0.0)
    assert fuse(0.5, -1.0, 3.0) == pytest.approx(0.375)


# Modes


def test_without_modes_the_spine_is_straight(controller: SpineController) -> None:
    for target in run(controller, replace(WALK, turn_rate_normalized=1.0)):
        assert target == SpineTarget(0.0, 0.0, (0.0, 0.0, 0.0, 0.0))


@pytest.mark.parametrize(
    "command", [TURN, replace(WALK, turning_strategy="mix"), replace(WALK, spine_modes=SpineModes(turning=True))]
)
@pytest.mark.parametrize("alpha", [-1.0, -0.4, 0.7])
def test_turning_bends_to_the_side_of_the_turn(
    controller: SpineController, command: MotionCommand, alpha: float
) -> None:
    last = run(controller, replace(command, turn_rate_normalized=alpha))[-1]
    assert last.flexion == pytest.approx(0.1 * alpha, abs=1e-6)
    assert last.servo_position == pytest.approx(TENDON.servo_position(0.1 * alpha), abs=1e-5)


def test_a_standing_mouse_does_not_bend_to_turn(controller: SpineController) -> None:
    run(controller, replace(TURN, turn_rate_normalized=1.0))
    straightened = run(controller, replace(TURN, turn_rate_normalized=1.0), walking=False)
    assert abs(straightened[-1].flexion) < 1e-6


@pytest.mark.parametrize(("velocity", "sign"), [(0.1, 1.0), (0.0, 1.0), (-0.1, -1.0)])
def test_stride_extension_is_in_step_with_the_legs(controller: SpineController, velocity: float, sign: float) -> None:
    command = replace(WALK, forward_velocity=velocity, spine_modes=SpineModes(stride_extension=True))
    flexion = values(run(controller, command, 3.0))
    stride = StrideExtension(KINEMATICS, HIP_POSITIONS, 0.1)
    wanted = sign * np.array([stride.flexion(legs_of(tick * PERIOD)) for tick in range(flexion.size)])
    assert flexion[200:] == pytest.approx(wanted[200:], abs=1e-6)
    assert np.abs(flexion).max() == pytest.approx(0.1, abs=1e-4)


def test_turning_scales_stride_extension_down(controller: SpineController) -> None:
    command = replace(TURN, turn_rate_normalized=-0.75, spine_modes=SpineModes(stride_extension=True))
    late = values(run(controller, command, 3.0))[200:]
    assert late.max() == pytest.approx(-0.05, abs=1e-3)
    assert late.min() == pytest.approx(-0.1, abs=1e-3)


@pytest.mark.parametrize("leg", range(4))
def test_balance_bends_before_a_standing_foot_is_lifted(controller: SpineController, leg: int) -> None:
    lifted = (leg == 0, leg == 1, leg == 2, leg == 3)
    command = replace(WALK, posture=Posture.STAND, spine_modes=SpineModes(balance_compensation=True))
    expected, met = BALANCE.static(leg, FOOT_X, FOOT_Z)
    last = run(controller, command, walking=False, lifted=lifted)[-1]
    assert met and not last.warnings
    assert last.flexion == pytest.approx(expected, abs=1e-6)
    assert abs(run(controller, command, walking=False)[-1].flexion) < 1e-6


def test_balance_while_walking_brings_the_com_to_the_standing_diagonal(controller: SpineController) -> None:
    command = replace(WALK, spine_modes=SpineModes(balance_compensation=True))
    targets = run(controller, command, 5.0)
    # Front right and rear left stand for the first half of each cycle of 250 ticks.
    assert targets[500 + 124].flexion == pytest.approx(BALANCE.dynamic(1, FOOT_X, FOOT_Z)[0], abs=1e-3)
    assert targets[750 - 1].flexion == pytest.approx(BALANCE.dynamic(0, FOOT_X, FOOT_Z)[0], abs=1e-3)


def test_walking_with_both_secondary_modes_extends_the_stride() -> None:
    one, both = (SpineController(ROBOT, GaitParameters(), PERIOD_NS) for _ in range(2))
    stride = replace(WALK, spine_modes=SpineModes(stride_extension=True))
    stride_and_balance = replace(WALK, spine_modes=SpineModes(stride_extension=True, balance_compensation=True))
    contradicting, plain = run(both, stride_and_balance), run(one, stride)
    assert values(contradicting) == pytest.approx(values(plain))
    assert "contradict each other" in " ".join(contradicting[-1].warnings)
    assert not plain[-1].warnings


def test_offset_compensation_follows_the_flexion(controller: SpineController) -> None:
    modes = SpineModes(stride_extension=True, offset_compensation=True)
    offset = OffsetCompensation(KINEMATICS, HIP_POSITIONS)
    for target in run(controller, replace(WALK, spine_modes=modes), 2.0)[200:]:
        assert target.foot_offsets == pytest.approx((0.0, 0.0, *offset.offsets(target.flexion)), abs=1e-6)


def test_lifts_that_no_flexion_balances_are_reported(controller: SpineController) -> None:
    command = replace(WALK, spine_modes=SpineModes(balance_compensation=True))
    both_front = run(controller, command, 0.1, walking=False, lifted=(True, True, False, False))
    assert any("over the feet" in warning for warning in both_front[-1].warnings)


# Smoothness and limits


@given(
    st.lists(
        st.tuples(
            st.floats(allow_nan=True, allow_infinity=True),
            st.sampled_from(["leg", "spine", "mix"]),
            st.booleans(),
            st.booleans(),
            st.sampled_from([-0.1, 0.0, 0.1]),
            st.sampled_from(["trot", "walking_trot", "lateral_walk", None]),
            st.sampled_from([NOT_LIFTED, (False, False, True, False), (True, True, True, False)]),
        ),
        min_size=1,
        max_size=8,
    )
)
def test_whatever_is_commanded_the_flexion_is_in_range_and_never_jumps(script: list) -> None:
    controller = SpineController(ROBOT, GaitParameters(), PERIOD_NS)
    last, offsets = 0.0, np.zeros(4)
    for alpha, strategy, extend, balance, velocity, gait, lifted in script:
        modes = SpineModes(False, extend, not extend, balance)
        command = MotionCommand(0, velocity, alpha, Posture.WALK, "trot", 0.8, strategy, modes)
        for tick in range(25):
            legs = legs_of(tick * PERIOD, gait, 2.0) if gait else None
            target = controller.step(command, legs, FOOT_X, FOOT_Z, lifted)
            assert abs(target.flexion) <= 0.1 + 1e-12
            assert abs(target.flexion - last) <= FASTEST * 0.1 * PERIOD + 1e-12
            assert np.abs(np.array(target.foot_offsets) - offsets).max() < 0.002
            assert math.isfinite(target.servo_position)
            last, offsets = target.flexion, np.array(target.foot_offsets)


def test_a_thrown_stick_bends_without_a_jump_in_rate(controller: SpineController) -> None:
    flexion = values(run(controller, replace(TURN, turn_rate_normalized=1.0), 0.5))
    rates = np.diff(flexion, prepend=0.0) / PERIOD
    assert rates[0] < 0.15 * rates.max()
    assert np.abs(np.diff(rates)).max() < 0.25 * rates.max()
    assert flexion[50] > 0.095, "full lock within a quarter of a second"
    assert np.all(rates >= -1e-12), "no overshoot"


def test_the_servo_range_limits_the_flexion() -> None:
    servo = ROBOT.servos["spine_lateral"].model_copy(update={"lower": -0.2, "upper": 0.3})
    narrow = ROBOT.model_copy(update={"servos": {**ROBOT.servos, "spine_lateral": servo}})
    for alpha in (-1.0, 1.0):
        controller = SpineController(narrow, GaitParameters(), PERIOD_NS)
        last = run(controller, replace(TURN, turn_rate_normalized=alpha))[-1]
        assert last.servo_position == pytest.approx(0.2 * alpha, abs=1e-4)


def test_a_changed_range_is_taken_up_without_a_jump(controller: SpineController) -> None:
    command = replace(TURN, turn_rate_normalized=1.0)
    before = run(controller, command)[-1].flexion
    controller.set_parameters(GaitParameters(max_spine_flexion=0.05))
    after = values(run(controller, command))
    assert abs(after[0] - before) <= FASTEST * 0.1 * PERIOD + 1e-12
    assert after[-1] == pytest.approx(0.05, abs=1e-6)


def test_a_spine_that_may_not_bend_stays_straight_and_says_that_it_cannot_balance() -> None:
    controller = SpineController(ROBOT, GaitParameters(max_spine_flexion=0.0), PERIOD_NS)
    modes = SpineModes(stride_extension=True, offset_compensation=True, balance_compensation=True)
    command = replace(TURN, turn_rate_normalized=1.0, spine_modes=modes)
    for target in run(controller, command):
        assert target.flexion == target.servo_position == 0.0
        assert target.foot_offsets == pytest.approx((0.0, 0.0, 0.0, 0.0), abs=1e-12)
    lift = run(controller, command, walking=False, lifted=(False, False, True, False))[-1]
    assert lift.flexion == 0.0 and lift.warnings


def test_reset_goes_on_from_where_the_servo_is(controller: SpineController) -> None:
    controller.reset(TENDON.servo_position(0.08))
    flexion = values(run(controller, WALK))
    assert flexion[0] == pytest.approx(0.08, abs=FASTEST * 0.1 * PERIOD + 1e-9)
    assert flexion[-1] == 0.0
