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
from scipy.stats import binom, kstest, norm

from simgap.analysis.diagnose import diagnose
from simgap.analysis.options import Options
from simgap.data.recording import recording_from_table

Array = NDArray[np.float64]

DRAWS = 20
"""Of forty, run once: from 0.14 to 0.91, p = 0.37 (Kolmogorov-Smirnov); an interval also allows for the law's error."""


@pytest.fixture(scope="module")
def below() -> Array:
    """(draws,) Share of what is said of a dry friction that lies below the truth; no two pendulums are alike."""
    plant, found = plant_of("pendulum"), []
    for draw in range(DRAWS):
        rng = np.random.default_rng([20181, draw])
        friction = float(np.exp(rng.uniform(np.log(0.05), np.log(0.4))))
        heavier, lighter, gain = np.exp(0.05 * rng.standard_normal(3))
        damping = float(np.exp(0.1 * rng.standard_normal()))

        def change(
            model: mujoco.MjModel,
            friction: float = friction,
            mass: float = heavier,
            inertia: float = lighter,
            gain: float = gain,
            damping: float = damping,
        ) -> None:
            model.dof_frictionloss[:] = friction
            model.body_mass[:] *= mass
            model.body_inertia[:] *= inertia
            model.dof_damping[:] *= damping
            model.actuator_gainprm[:, 0] *= gain
            model.actuator_biasprm[:, 1] *= gain

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
