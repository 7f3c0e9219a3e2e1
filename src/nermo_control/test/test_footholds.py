"""Steps over a gap: the forecast of footfalls, the changes that keep feet out, and the controller that makes them."""

from __future__ import annotations

import pytest

from nermo_control.footholds import Footfalls, Gap, landing_change, length_change
from nermo_control.pantograph_controller import PantographController, PantographGait
from nermo_control.types import ControlCommand, Phase
from nermo_description.pantograph import PantographParameters
from nermo_description.robots import load_any_robot

PERIOD = 5_000_000


def walk(cycles: float, stride: float = 0.2, slip: float = 0.01) -> Footfalls:
    """A trot of 1 Hz at a constant speed: each foot stands for the second half of its cycle, sliding back a little."""
    footfalls = Footfalls()
    for tick in range(round(200 * cycles)):
        time = tick / 200
        body = stride * time
        phases, fractions, feet, touching = [], [], [], []
        for leg in range(4):
            place = (time + (0.5 if leg in (1, 2) else 0.0)) % 1.0
            stands = place >= 0.5
            share = 2.0 * (place - 0.5) if stands else 2.0 * place
            phases.append(Phase.STANCE if stands else Phase.SWING)
            fractions.append(share)
            # The hip is over the foot in the middle of the stance.
            feet.append(body - stride * (place - 0.75) - slip * share + (0.1 if leg < 2 else -0.1))
            # Feet brush the ground in mid-swing, which is no footfall.
            touching.append(stands or 0.48 < share < 0.52)
        footfalls.step(body, feet, touching, phases, fractions)
    return footfalls


def test_feet_will_stand_one_stride_ahead_of_where_they_stood():
    footfalls = walk(3.99)
    assert footfalls.stride(0) == pytest.approx(0.2, rel=0.01)
    # Legs 0 and 3 are at the end of a stance, in which the body went from 0.7 to 0.8 m.
    low, high = footfalls.stretch(0)
    assert (low, high) == (pytest.approx(0.84, abs=2e-3), pytest.approx(0.85, abs=2e-3))
    assert footfalls.ahead(0, 2) == (pytest.approx(low + 0.4, abs=1e-3), pytest.approx(high + 0.4, abs=1e-3))
    assert walk(0.2).ahead(0) is None


def test_each_foot_is_put_to_the_nearer_side_that_it_can_reach():
    gap = Gap(1.0, 1.05)
    assert landing_change(gap, (0.9, 0.98), 0.01, 0.05, 0.01) == 0.0
    assert landing_change(gap, (0.985, 0.995), 0.01, 0.05, 0.01) == pytest.approx(-0.005)
    assert landing_change(gap, (1.03, 1.04), 0.01, 0.05, 0.01) == pytest.approx(0.03)
    # Neither side is in reach: as far ahead as it goes.
    assert landing_change(gap, (1.002, 1.012), 0.01, 0.05, 0.01) == 0.05
    with pytest.raises(ValueError, match="gap from 1.0 m to 0.9 m"):
        Gap(1.0, 0.9)


def test_all_legs_alike_clear_a_gap_that_lies_between_their_footfalls():
    footfalls = walk(3.7)
    stood = footfalls.ahead(0, 3)
    clear = Gap(stood[1] + 0.02, stood[1] + 0.04)
    assert length_change(clear, footfalls, 0.01, 1.0, 0.04) == 0.0
    gap = Gap(stood[0] - 0.005, stood[1] + 0.005)
    change = length_change(gap, footfalls, 0.01, 1.0, 0.04)
    assert -0.04 <= change < 0.0
    assert gap.clearance(stood) < 0.0 <= gap.clearance((stood[0] + 3 * change, stood[1] + 3 * change))
    assert length_change(gap, walk(0.2), 0.01, 1.0, 0.04) is None


def test_a_leg_lands_ahead_from_its_next_swing_on_and_the_others_do_not():
    robot = load_any_robot("cheetah_cub")
    assert isinstance(robot, PantographParameters)
    stand = list(robot.posture("stand").values())
    plain, changed = (PantographController(robot, PantographGait(), PERIOD) for _ in range(2))
    swung, seen = False, False
    for tick in range(400):
        command = ControlCommand(tick * PERIOD, forward_velocity=0.2, gait="trot", gait_frequency=2.0)
        outputs = [one.step(tick * PERIOD, command, None, stand) for one in (plain, changed)]
        stands = outputs[0].leg_states.next_phases[0] is Phase.STANCE
        if tick == 300:
            assert stands
            changed.landings[0] = 0.02
        hips = [output.servo_positions[0] for output in outputs]
        assert outputs[0].servo_positions[2:] == outputs[1].servo_positions[2:]
        swung = swung or (tick > 300 and not stands)
        if not swung:
            assert hips[0] == hips[1]
        elif stands:
            seen = True
            assert hips[1] > hips[0] + 0.05  # the foot stands ahead
            assert changed.shifts == (0.02, 0.0, 0.0, 0.0)
    assert seen
