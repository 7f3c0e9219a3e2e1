"""Effects whose parts have values of their own, tied to a common one, in robots that share one number at first."""

from __future__ import annotations

from functools import cache

import mujoco
import numpy as np
import pytest
from robots import plant_of, simulate

import simgap.effects.base as base
from simgap.analysis.diagnose import Diagnosis, diagnose
from simgap.analysis.options import Options
from simgap.data.recording import recording_from_table
from simgap.effects.friction import CoulombFriction
from simgap.inference.hypothesis import Hypothesis


@pytest.fixture
def many_joints(monkeypatch: pytest.MonkeyPatch) -> None:
    """An arm's two joints count as many, so that a group of them has one number."""
    monkeypatch.setattr(base, "FEW_JOINTS", 1)
    monkeypatch.setattr(base, "SEVERAL_JOINTS", 1)


@cache
def _rubbing(*friction: float, only: tuple[str, ...] = ("coulomb_friction", "viscous_friction")) -> Diagnosis:
    def rub(model: mujoco.MjModel) -> None:
        model.dof_frictionloss[: len(friction)] += friction

    plant = plant_of("arm")
    table = simulate("arm", 14.0, change=rub)
    return diagnose([recording_from_table(table, plant)], plant, Options(baselines=False, only=only, threads=1))


def test_joints_that_rub_unlike_each_other_have_values_of_their_own(many_joints: None) -> None:
    found = _rubbing(0.05, 0.2)
    assert found.report["verdict"] == "effect", found.report["reasons"]
    (effect,) = found.report["effects"]
    assert (effect["name"], effect["site"]) == ("coulomb_friction", "all")
    values = effect["parameters"]
    for name, truth in zip(values, (0.05, 0.2), strict=True):
        low, high = values[name]["ci90"]
        assert low < truth < high and high - low < truth, (name, values[name])
    assert all(name.startswith("friction_") for name in values)


def test_joints_that_rub_alike_share_one_value(many_joints: None) -> None:
    found = _rubbing(0.1, 0.1)
    (effect,) = found.report["effects"]
    assert (effect["name"], effect["site"]) == ("coulomb_friction", "all")
    assert list(effect["parameters"]) == ["friction"]
    assert effect["parameters"]["friction"]["value"] == pytest.approx(0.1, rel=0.15)


def test_what_is_tied_costs_what_a_normal_density_about_the_mean_says(many_joints: None) -> None:
    found = _rubbing(0.1, 0.1)
    everywhere = next(e for e in found.selector.effects if e.key == "coulomb_friction@all")
    assert isinstance(everywhere, CoulombFriction)
    apart = everywhere.apart(found.selector.effects, 0.1)
    assert apart is not None and apart.tie == pytest.approx(0.1 * np.log(2.0))
    hypothesis = Hypothesis((found.selector.effects[0], apart))
    first = len(found.selector.effects[0].parameters)
    x = np.concatenate([found.selector.effects[0].starts()[0], [0.05, 0.25]])
    expected = 0.5 * sum(((v - 0.15) / apart.tie) ** 2 for v in (0.05, 0.25))
    assert hypothesis.tied(x) == pytest.approx(expected)
    pull, step = hypothesis.pull(), np.zeros(len(x))
    assert not pull[:first].any() and not (pull @ hypothesis.scaled(np.r_[x[:first], 0.1, 0.1])).round(9).any()
    # Its slope by finite differences.
    step[first] = 1e-6
    u = hypothesis.scaled(x)
    change = hypothesis.tied(hypothesis.values(u + step)) - hypothesis.tied(hypothesis.values(u - step))
    assert change / 2e-6 == pytest.approx((pull @ u)[first], rel=1e-5)
    # What has values of its own already, or one part, is not taken apart.
    assert apart.apart(found.selector.effects, 0.1) is None
    single = next(e for e in found.selector.effects if e.key.startswith("coulomb_friction") and e is not everywhere)
    assert isinstance(single, CoulombFriction) and single.apart(found.selector.effects, 0.1) is None


def test_parts_keep_the_form_of_their_effect(many_joints: None) -> None:
    """Servos' gains have two: what their error is worth, and what they give at most."""
    found = _rubbing(only=("servo_gain", "coulomb_friction"))
    selector = found.selector
    everywhere = [e for e in selector.effects if e.site.name == "all"]
    everywhere += [law for e in everywhere for law in e.alternatives() if len(law.parameters) == 1]
    assert {e.name for e in everywhere} == {"servo_gain", "coulomb_friction"} and len({e.form for e in everywhere}) > 2
    for effect in everywhere:
        x, z = np.array(effect.starts()[0]), np.zeros(len(selector.fitter.nuisances))
        fit = selector.fitter.fit(Hypothesis((effect,)), x, z, iterations=0, roughly=True)
        made = selector._revision._by_part(fit, effect.name)
        assert made is not None, effect
        (parted,), values = made[0].effects, made[1]
        assert (parted.form, parted.tie > 0.0) == (effect.form, True)
        assert values == pytest.approx([x[0], x[0]])
