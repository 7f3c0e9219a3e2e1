"""The pantograph leg's dynamics three ways: they agree where they should, and what C left open is there."""

from __future__ import annotations

import math

import numpy as np
import pytest

from nermo_control.legs.aslp import AslpPose
from nermo_control.legs.aslp_symbolic import minimal_functions
from nermo_control.pantograph_controller import aslp_leg, aslp_springs
from nermo_description.pantograph import PantographParameters
from nermo_description.robots import ParameterError, load_any_robot
from nermo_sim.experiments import stability
from nermo_sim.experiments.runs import Job, Settings
from nermo_sim.leg_dynamics.fixed_base import build_fixed_base, comes_to_rest, trajectory
from nermo_sim.leg_dynamics.massless import Equilibrium, FollowingLegs, look_up_table


@pytest.fixture(scope="module")
def robot() -> PantographParameters:
    found = load_any_robot("cheetah_cub")
    assert isinstance(found, PantographParameters)
    return found


@pytest.fixture(scope="module")
def equilibrium(robot: PantographParameters) -> Equilibrium:
    return Equilibrium(robot.leg)


def test_symbolic_torques_are_those_of_the_kinematics(robot):
    """Two derivations that share nothing: sympy from the joints' places, `aslp` by hand from the laws of cosines."""
    leg, springs, functions = aslp_leg(robot.leg), aslp_springs(robot.leg), minimal_functions(robot.leg)
    random = np.random.default_rng(2)
    for _ in range(200):
        knee = random.uniform(leg.knee_reference, 2.2)
        pose = AslpPose(0.0, knee, random.uniform(0.01, 0.95) * leg.widest(knee))
        *passive, toe = functions.torques(knee, pose.opening, robot.leg.toe_rest, 0.0, 0.0, 0.0)
        assert passive == pytest.approx(springs.torques(leg, pose), rel=1e-7, abs=1e-9)
        assert toe == 0.0
        assert functions.lengths(knee, pose.opening) == pytest.approx((leg.diagonal(knee), leg.parallel(pose)))


def test_state_dependent_limit_and_the_direction_of_its_constraint(robot):
    """B of (2.13) is the widest opening, and the limit of l_p pushes along the corrected (2.16), (-dB/dk, 1)."""
    leg, functions, small = aslp_leg(robot.leg), minimal_functions(robot.leg), 1e-6
    for knee in (0.8, 1.2, 1.7):
        bound, slope, bend = functions.bound(knee)
        assert bound == pytest.approx(leg.widest(knee))
        assert slope == pytest.approx((leg.widest(knee + small) - leg.widest(knee - small)) / (2 * small), rel=1e-5)
        slopes = [functions.bound(knee + way * small)[1] for way in (-1, 1)]
        assert bend == pytest.approx((slopes[1] - slopes[0]) / (2 * small), rel=1e-4)
        by_knee, by_opening = (
            (
                functions.lengths(knee + a * small, bound + b * small)[1]
                - functions.lengths(knee - a * small, bound - b * small)[1]
            )
            for a, b in ((1, 0), (0, 1))
        )
        assert by_knee / by_opening == pytest.approx(-slope, rel=1e-5)


def test_closed_loops_and_minimal_coordinates_move_alike(robot):
    """Let go as in C 2.5.1: MuJoCo's constraints against forces from sympy, loops against no loops."""
    one, other = (trajectory(robot, kind, "implicit_fast", 2e-4, 0.4) for kind in ("constraints", "minimal"))
    assert np.ptp(one[:, 0]) > 0.1
    apart = np.abs(one - other)
    assert apart[:, 0].max() < 0.01  # rad, of 0.15
    assert apart[:, 1].max() < 6e-4  # m: the stops yield differently


def test_mass_less_forces_are_the_slopes_of_the_least_energy(equilibrium):
    def least(length: float, theta: float) -> float:
        return float(equilibrium.functions.forces(equilibrium.knee(length, theta), length, theta)[0])

    small = 1e-5
    for length, theta in ((0.12, 0.3), (0.13, 0.8), (0.10, 0.5), (0.14, 0.4), (0.14, 1.0)):
        effort = equilibrium.effort(length, theta, equilibrium.knee(length, theta))
        assert effort.force == pytest.approx(
            -(least(length + small, theta) - least(length - small, theta)) / (2 * small), rel=1e-4
        )
        assert effort.torque == pytest.approx(
            -(least(length, theta + small) - least(length, theta - small)) / (2 * small), rel=1e-4, abs=1e-7
        )
        assert effort.cable == 0.0


def test_cable_of_the_mass_less_leg_pulls_only(robot, equilibrium):
    """Taut, its tension is the slope of the energy by its length; slack, it has none."""
    length, theta = 0.125, 0.5
    free = equilibrium.knee(length, theta)
    tight = 0.5 * (free + equilibrium.closed_knee(length))
    knee = equilibrium.knee(length, theta, cable_knee=tight)
    assert knee == pytest.approx(tight)
    tension = equilibrium.effort(length, theta, knee, cable_knee=tight).cable
    leg, small = aslp_leg(robot.leg), 1e-6
    nearby = [leg.knee_of_cable(leg.cable_of_knee(tight) + way * small) for way in (-1, 1)]
    energies = [equilibrium.functions.forces(knee, length, theta)[0] for knee in nearby]
    assert tension > 0.0
    assert tension == pytest.approx(-(energies[1] - energies[0]) / (2 * small), rel=1e-4)
    assert equilibrium.effort(length, theta, free, cable_knee=free - 0.1).cable == 0.0


def test_table_is_a_stiffening_leg(robot):
    table = look_up_table(robot.leg, 15)
    assert np.isfinite(table.force).all()
    along = table.free_toe
    assert (along[:-1] > 0.0).all()
    assert along.max() > 7.0  # with a free toe; a Cheetah-Cub's leg bears 13 N (C 4.2) with a turned one
    assert table.force.max() > 13.0
    assert along[-2] < 3.0


def test_viscous_friction_follows_the_equilibrium_and_takes_energy(robot):
    base = build_fixed_base(robot, "massless_friction")
    assert comes_to_rest(base, 5e-4, "semi_implicit")
    assert isinstance(base.forces, FollowingLegs)
    assert 0.0 < base.forces.dissipated < 2.0 * base.start_energy
    length, theta = float(base.data.qpos[1]), float(base.data.qpos[2])
    assert base.forces.knees[0] == pytest.approx(base.forces._equilibrium.knee(length, theta), abs=0.02)


@pytest.mark.parametrize("kind", ["constraints", "minimal", "massless"])
def test_long_steps_are_told_from_stable_ones(robot, kind):
    assert comes_to_rest(build_fixed_base(robot, kind), 2e-4, "semi_implicit")
    assert not comes_to_rest(build_fixed_base(robot, kind), 1.5e-2, "semi_implicit")


def test_experiment_counts_as_the_thesis_does(robot):
    assert stability.coordinates(robot, "constraints")["maximal_coordinates"] == 198  # C 2.6.2
    assert stability.coordinates(robot, "massless")["coordinates"] == 18  # and 19 with a quaternion, as C's
    case = stability.Case("step", "massless", "euler")
    found = stability.run(Job(case, 0, Settings("cheetah_cub", quick=True)))
    assert 5e-4 < found["largest_step_s"] < 1e-2
    with pytest.raises(
        ParameterError, match="'nermo_lite' is of the family mouse; needed here is pantograph: cheetah_cub"
    ):
        stability.run(Job(case, 0, Settings("nermo_lite", quick=True)))
    assert math.isfinite(found["step_cost_s"])
