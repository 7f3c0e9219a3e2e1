"""Simulation-based calibration: truths drawn from what is believed before, and where they fall in what is said after.

Talts et al. 2018 (arXiv:1804.06788): where truths are drawn from the prior, and recordings made of them, the share of a
posterior below its truth is uniform. The whole diagnosis is asked, not its linear core (`test_intervals.py`).
"""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray
from robots import plant_of, simulate
from scipy.stats import binom, kstest, norm, truncnorm

from simgap.analysis.diagnose import diagnose
from simgap.analysis.options import Options
from simgap.data.recording import recording_from_table
from simgap.inference.nuisance import BOX, GAIN, INERTIA, MASS, PASSIVE

Array = NDArray[np.float64]

DRAWS = 20
"""Of forty, run once: from 0.10 to 0.94, p = 0.25 (Kolmogorov-Smirnov); truths scatter by 0.65 of what is said."""


@pytest.fixture(scope="module")
def below() -> Array:
    """(draws,) Share of what is said of a dry friction that lies below the truth; no two pendulums are alike."""
    plant, found = plant_of("pendulum"), []
    for draw in range(DRAWS):
        rng = np.random.default_rng([20181, draw])
        friction = float(np.exp(rng.uniform(np.log(0.05), np.log(0.4))))
        sizes = np.array([MASS, INERTIA, GAIN, PASSIVE, PASSIVE])
        off = np.exp(sizes * truncnorm.rvs(-BOX, BOX, size=len(sizes), random_state=rng))

        def change(model: mujoco.MjModel, friction: float = friction, off: Array = off) -> None:
            heavier, slower, gain, damping, armature = off
            model.dof_frictionloss[:] = friction
            model.body_mass[:] *= heavier
            model.body_inertia[:] *= heavier * slower
            model.actuator_gainprm[:, 0] *= gain
            model.actuator_biasprm[:, 1] *= gain
            model.dof_damping[:] *= damping
            model.dof_armature[:] *= armature

        table = simulate("pendulum", 8.0, seed=draw, change=change)
        options = Options(baselines=False, only=("coulomb_friction",), threads=1)
        report = diagnose([recording_from_table(table, plant)], plant, options).report
        (effect,) = report["effects"]
        assert effect["name"] == "coulomb_friction"
        (number,) = effect["parameters"].values()
        low, high = number["ci90"]
        deviation = (high - low) / (2.0 * norm.ppf(0.95))
        found.append(float(norm.cdf((friction - number["value"]) / deviation)))
    return np.array(found)


@pytest.mark.long
def test_truths_lie_anywhere_in_what_is_said_of_them(below: Array) -> None:
    assert kstest(below, "uniform").pvalue > 0.01
    outside = int(np.sum((below < 0.05) | (below > 0.95)))
    assert outside <= binom.ppf(0.999, DRAWS, 0.1), "what is said is too narrow"
    assert np.std(norm.ppf(below)) > 0.4, "what is said is so wide that it says nothing"
