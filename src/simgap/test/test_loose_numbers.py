"""Nominal numbers that may go far: which do is where the fault is, and what the search begins from."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from robots import aligned_of, simulate

from simgap.effects.base import Context
from simgap.effects.library import enumerate_effects
from simgap.inference.fit import Fitter
from simgap.inference.hypothesis import Hypothesis
from simgap.inference.loose_numbers import fit_loosely, own_moved_into, spoken_for, with_own_as_modelled
from simgap.inference.nuisance import BOX, enumerate_nuisances
from simgap.inference.residual import Residuals
from simgap.simulation.replay import Replayer
from simgap.simulation.scales import measure_scales
from simgap.simulation.variant import Variant
from simgap.simulation.windows import cut


def _prepared(change=None):  # type: ignore[no-untyped-def]
    plant, aligned, floor = aligned_of("arm", simulate("arm", seconds=10.0, change=change))
    nominal = Variant.nominal(plant)
    replayer = Replayer(plant, aligned, cut(aligned, 0.4, most=16), floor, 1)
    swing, size = aligned.outputs.std(axis=0), np.sqrt((aligned.inputs**2).mean(axis=0))
    fitter = Fitter(Residuals.build(replayer, nominal), enumerate_nuisances(plant, swing, size, aligned.period))
    fitter.fit_nuisances()
    effects = enumerate_effects(Context(plant, measure_scales(replayer, nominal), {}), (), ("mass", "servo_gain"))
    return fitter, effects


@pytest.mark.parametrize("share", [0.6, 1.8])
def test_a_number_that_is_far_off_goes_far_and_names_its_effect_with_its_size(share: float) -> None:
    """A servo whose gain is another: its number leaves its box alone, and the effect begins about where it is."""

    def change(model: mujoco.MjModel) -> None:
        model.actuator_gainprm[1, 0] *= share
        model.actuator_biasprm[1, 1] *= share

    fitter, effects = _prepared(change)
    z = fit_loosely(fitter)
    starts = spoken_for(fitter, effects, z, 4)
    assert fitter.nuisances[int(np.argmax(np.abs(z)))].name.startswith("gain")
    assert (np.abs(z) > BOX).sum() <= 3, "few go far"
    keys = [effect.key for effect, _, _ in starts]
    name = mujoco.mj_id2name(fitter.base.model, mujoco.mjtObj.mjOBJ_ACTUATOR, 1)
    assert f"servo_gain@{name}" in keys
    effect, x, rest = starts[keys.index(f"servo_gain@{name}")]
    assert x[0] == pytest.approx(share, rel=0.15)
    assert np.abs(rest).max() <= BOX and rest[int(np.argmax(np.abs(z)))] == 0.0
    assert effect.parameters[0].low <= x[0] <= effect.parameters[0].high


def test_of_a_healthy_robot_none_goes_far_and_the_sensitivities_stay() -> None:
    fitter, effects = _prepared()
    kept = fitter.jacobian
    z = fit_loosely(fitter)
    assert fitter.jacobian is kept
    assert np.abs(z).max() < BOX and spoken_for(fitter, effects, z, 4) == []


def test_only_the_numbers_that_an_effect_changes_are_as_modelled_again() -> None:
    """And of an effect that changes none of them there is no such start."""
    fitter, effects = _prepared()
    z = np.linspace(0.4, 1.2, len(fitter.nuisances))
    names = [n.name for n in fitter.nuisances]
    starts = with_own_as_modelled(fitter, [(e, np.array(e.starts()[0])) for e in effects], z)
    assert {e.key for e, _, _ in starts} == {e.key for e in effects}, "each mass and gain is among the numbers too"
    for effect, x, rest in starts:
        assert tuple(x) == effect.starts()[0]
        own = {names[i].split()[0] for i in np.flatnonzero(rest != z)}
        assert own == ({"gain"} if effect.name == "servo_gain" else {"mass", "inertia"}), "inertia goes with mass"
        assert (rest[rest != z] == 0.0).all()
    (friction,) = (
        e
        for e in enumerate_effects(
            Context(fitter.residuals.replayer.plant, measure_scales(fitter.residuals.replayer, fitter.base), {}),
            (),
            ("coulomb_friction",),
        )
        if e.key.endswith("@elbow")
    )
    assert with_own_as_modelled(fitter, [(friction, np.array([0.1]))], z) == []


@pytest.mark.parametrize("z_own", [-1.2, 0.8])
def test_what_a_number_changes_as_an_effect_does_becomes_the_effects_and_the_model_stays(z_own: float) -> None:
    fitter, effects = _prepared()
    names = [n.name for n in fitter.nuisances]
    gains = {e.form: e for e in effects if e.name == "servo_gain" and len(e.site.targets) == 1}
    effect = gains["stiffness"]
    own = names.index(f"gain {effect.site.name}")
    z = np.linspace(-0.4, 0.5, len(names))
    z[own] = z_own
    x = np.array([0.7])
    moved, rest = own_moved_into(fitter, effect, x, z)
    assert rest[own] == 0.0 and np.array_equal(np.delete(rest, own), np.delete(z, own))
    hypothesis = Hypothesis((effect,))
    before, after = fitter.replay(hypothesis, [(x, z), (moved, rest)])
    np.testing.assert_allclose(after, before, atol=1e-6)
    assert (moved[0] < 0.7) == (z_own < 0.0)
    again = own_moved_into(fitter, effect, moved, rest)
    assert np.array_equal(again[0], moved) and np.array_equal(again[1], rest), "nothing is left to move"
    # A number of one servo is none of both.
    both = next(e for e in effects if e.name == "servo_gain" and len(e.site.targets) > 1)
    values = np.full(len(both.parameters), 0.7)
    untouched = own_moved_into(fitter, both, values, z)
    assert np.array_equal(untouched[0], values) and np.array_equal(untouched[1], z)


def test_a_number_is_not_tried_again_where_it_tells_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    fitter, _ = _prepared()
    z, nothing, none = np.full(len(fitter.nuisances), 0.3), Hypothesis(), np.zeros(0)
    residual = fitter.replay(nothing, [(none, z)])[0]
    before = fitter.jacobian
    fitter.refresh(nothing, none, z, residual)
    everywhere = fitter.jacobian
    dull = np.zeros(before.shape[:2], bool)
    dull[0, 2:], dull[1] = True, True
    monkeypatch.setattr(fitter, "_dull", dull)
    fitter.jacobian = before
    fitter.refresh(nothing, none, z, residual)
    assert not np.array_equal(before[0], everywhere[0])
    np.testing.assert_array_equal(fitter.jacobian[dull], before[dull])
    np.testing.assert_allclose(fitter.jacobian[~dull], everywhere[~dull], rtol=1e-5, atol=1e-5)
