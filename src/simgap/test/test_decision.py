"""What counts as one answer, and what a stated number weighs."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import mujoco
import numpy as np
import pytest
from robots import aligned_of, plant_of, simulate
from scipy.stats import t

from simgap.data.plant import Plant
from simgap.effects.base import Context, Effect
from simgap.effects.library import enumerate_effects
from simgap.effects.servo import STATED, ServoGain
from simgap.inference.decision import Class, names
from simgap.inference.hypothesis import Fit, Hypothesis
from simgap.inference.model_selection import only_larger_group
from simgap.inference.scores import temperature
from simgap.inference.thresholds import LAW_ERROR
from simgap.simulation.replay import Replayer
from simgap.simulation.scales import measure_scales
from simgap.simulation.variant import Variant
from simgap.simulation.windows import cut


@pytest.fixture(scope="module")
def effects() -> list[Effect]:
    plant, aligned, floor = aligned_of("arm", simulate("arm", 6.0))
    replayer = Replayer(plant, aligned, cut(aligned), floor)
    context = Context(plant, measure_scales(replayer, Variant.nominal(plant)))
    return enumerate_effects(context, (), ("coulomb_friction",))


def fit(effects: list[Effect], key: str, x: list[float], sd: list[float]) -> Fit:
    found = next(e for e in effects if e.key == key)
    none = np.zeros(0)
    made = Fit(Hypothesis((found,)), np.array(x), none, 0.0, np.zeros((0, 0, 0)), np.zeros((0, 0, 0, 0)))
    made.covariance = np.diag(np.square(sd))
    return made


def test_a_group_that_adds_nothing_is_the_same_answer(effects: list[Effect]) -> None:
    elbow = fit(effects, "coulomb_friction@elbow", [0.25], [0.01])
    nothing = fit(effects, "coulomb_friction@all", [0.004, 0.25], [0.01, 0.01])
    both = fit(effects, "coulomb_friction@all", [0.1, 0.25], [0.01, 0.01])
    shoulder = fit(effects, "coulomb_friction@shoulder", [0.25], [0.01])
    assert only_larger_group(elbow, nothing)
    assert not only_larger_group(nothing, elbow), "the larger one comes second"
    assert not only_larger_group(elbow, both)
    assert not only_larger_group(shoulder, nothing), "what shows is the elbow"
    group = Class((nothing, elbow), 1.0)
    assert group.holds(names(elbow))
    assert group.holds(names(nothing))
    assert not group.holds(names(shoulder))


def test_a_gain_that_is_stated_is_not_off_by_decades() -> None:
    plain = plant_of("arm")
    rows = {model_name: {"kp": 12.0, "kd": 0.5} for model_name in plain.names(mujoco.mjtObj.mjOBJ_ACTUATOR)}
    stated = replace(plain, map=plain.map.model_copy(update={"gains": rows}))

    def cost(plant: Plant, value: float) -> float:
        context = Context(plant, cast(Any, None))
        own = next(e for e in ServoGain.candidates(context) if e.site.name == "elbow_servo")
        return Hypothesis((own,)).implausible(np.array([value]))

    def density(value: float) -> float:
        """Of Student's t with two degrees of freedom, over that at its middle."""
        return float(t.logpdf(np.log(value) / STATED, 2.0) - t.logpdf(0.0, 2.0))

    assert cost(plain, 0.5) == 0.0
    assert cost(stated, 0.5) == pytest.approx(-density(0.5))
    assert 3.0 < cost(stated, 0.02) - cost(stated, 0.5) < 10.0
    assert cost(stated, 1.0) == 0.0


def test_gains_that_are_stated_together_are_off_together() -> None:
    """A unit that was forgotten is one mistake, whatever the number of servos; servos that differ are as many."""
    plain = plant_of("arm")
    rows = {name: {"kp": 12.0, "kd": 0.5} for name in plain.names(mujoco.mjtObj.mjOBJ_ACTUATOR)}
    stated = replace(plain, map=plain.map.model_copy(update={"gains": rows}))
    own = next(e for e in ServoGain.candidates(Context(stated, cast(Any, None))) if e.site.name == "all")
    assert len(own.parameters) == 2
    both, one, alone = (Hypothesis((own,)).implausible(np.array(x)) for x in ([0.5, 0.5], [0.5, 1.0], [0.7071, 0.7071]))
    assert both == pytest.approx(-float(t.logpdf(np.log(0.5) / STATED, 2.0) - t.logpdf(0.0, 2.0)))
    assert one == pytest.approx(alone + 2.0 * 0.5 * (0.5 * np.log(2.0) / STATED) ** 2, rel=1e-3)


def test_law_error_does_not_weigh_on_what_is_stated() -> None:
    assert temperature(10.0) == 1.0
    assert temperature(1000.0) == pytest.approx(1000.0 * LAW_ERROR)
    assert temperature(float("nan")) == 1.0
