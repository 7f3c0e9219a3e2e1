"""What has to be found although something simpler imitates it, or although it is not the only one."""

from __future__ import annotations

import copy
import functools
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest
from robots import plant_of, simulate

from simgap.analysis.diagnose import Diagnosis, diagnose
from simgap.analysis.options import Options
from simgap.data.align import align
from simgap.data.noise_floor import noise_floor
from simgap.data.plant import Plant
from simgap.data.recording import recording_from_table
from simgap.effects.base import Context, Effect
from simgap.effects.library import enumerate_effects
from simgap.inference import partners
from simgap.inference.effort import Effort
from simgap.inference.fit import Fitter
from simgap.inference.hypothesis import Fit, Hypothesis
from simgap.inference.model_selection import earns, stands_out
from simgap.inference.nuisance import BOX
from simgap.inference.proposals import Proposals
from simgap.inference.residual import Residuals
from simgap.inference.scores import Scored, Scores
from simgap.inference.screen import Screened, screen
from simgap.inference.select import Selector
from simgap.simulation.replay import Replayer
from simgap.simulation.scales import measure_scales
from simgap.simulation.variant import Variant
from simgap.simulation.windows import cut

pytestmark = pytest.mark.long  # minutes of computing on a slow machine


def _names(found: Diagnosis) -> set[str]:
    return {f"{e['name']}@{e['site']}" for e in found.report["effects"]}


_DRAG = ("coulomb_friction", "viscous_friction", "servo_gain")


@functools.cache
def _diagnosed() -> tuple[Plant, Diagnosis]:

    def stick(model: mujoco.MjModel) -> None:
        model.dof_damping[:] += 0.15
        model.dof_frictionloss[:] += 0.1

    plant, table = plant_of("pendulum"), simulate("pendulum", 12.0, change=stick)
    options = Options(baselines=False, only=_DRAG, threads=1)
    return plant, diagnose([recording_from_table(table, plant)], plant, options)


@pytest.fixture
def drag_and_friction() -> tuple[Plant, Diagnosis]:
    """Of a hinge with both, as it was before another test went on with it."""
    return copy.deepcopy(_diagnosed())


def test_a_soft_foot_is_not_taken_for_a_sensor_of_height() -> None:
    """Here the ground also holds feet more firmly than the model's."""

    def soften(model: mujoco.MjModel) -> None:
        foot = model.geom("foot").id
        model.geom_solref[foot, 0] *= 2.0
        model.geom_priority[foot] = 1
        model.opt.impratio = 3.0

    plant = plant_of("leg")
    only = ("foot_compliance", "sensor_bias", "sensor_scale", "ground_friction")
    table = simulate("leg", 12.0, change=soften)
    found = diagnose([recording_from_table(table, plant)], plant, Options(baselines=False, only=only, threads=1))
    assert _names(found) == {"foot_compliance@foot"}, found.report["reasons"]
    (effect,) = found.report["effects"]
    assert effect["parameters"]["time_factor"]["value"] == pytest.approx(2.0, rel=0.15)


def test_a_wrong_first_effect_is_given_up_for_what_was_found_beside_it(
    drag_and_friction: tuple[Plant, Diagnosis],
) -> None:
    """Drag and friction of a hinge; begun with a gain, friction was added, and too much is left."""

    _, found = drag_and_friction
    selector, right = found.selector, found.selection
    kinds = {e.name: e for e in selector.effects}
    wrong = Hypothesis((kinds["servo_gain"], kinds["coulomb_friction"]))
    fit = selector.fitter.fit(wrong, np.array([0.9, 0.1]), np.zeros(len(selector.fitter.nuisances)))
    stuck = replace(right, best=selector.scores.scored(selector.fitter.cross_validate(fit)))
    assert right.best.score < stuck.best.score
    better = selector._begun_elsewhere(stuck, right.screened).best
    assert {e.key for e in better.fit.hypothesis.effects} == {"coulomb_friction@hinge", "viscous_friction@hinge"}
    assert better.score < stuck.best.score


def test_what_was_reached_from_another_first_effect_is_not_built_on_again(
    drag_and_friction: tuple[Plant, Diagnosis], monkeypatch: pytest.MonkeyPatch
) -> None:
    _, found = drag_and_friction
    selector, right = found.selector, found.selection
    asked: list[str] = []
    one_more = selector.partners.one_more

    def noted(base: Scored, *rest: Any) -> list[Scored]:
        asked.append(base.key)
        return one_more(base, *rest)

    monkeypatch.setattr(selector.partners, "one_more", noted)
    monkeypatch.setattr(selector, "_leaves_much", lambda scored: True)
    selector._reached.clear()
    nothing = replace(right, best=right.reference, gains=[])
    drag, rub = (min((s for s in right.singles if n in s.key), key=lambda s: s.score) for n in ("viscous", "coulomb"))
    one = selector._forward(nothing, right.singles, rub, right.screened)
    assert len(asked) > 1 and {e.name for e in one.best.fit.hypothesis.effects} == set(_DRAG[:2])
    asked.clear()
    other = selector._forward(nothing, right.singles, drag, right.screened)
    assert asked == [drag.key] and other.best.key == one.best.key


def test_beside_many_parameters_the_first_alone_is_fitted_to_its_end(
    drag_and_friction: tuple[Plant, Diagnosis], monkeypatch: pytest.MonkeyPatch
) -> None:
    _, found = drag_and_friction
    selector, right = found.selector, found.selection
    monkeypatch.setattr(partners, "_MANY", 1)
    rub = min((s for s in right.singles if "coulomb" in s.key), key=lambda s: s.score)
    many = selector.partners.one_more(rub, selector.proposals.beside, right.singles, right.screened)
    assert {e.name for e in many[0].fit.hypothesis.effects} == set(_DRAG[:2])
    assert [s.fit.polished for s in many] == [True] + [False] * (len(many) - 1)
    assert many[0].score < right.best.score + 2.0
    # What promises nothing is not fitted on: the gain beside both.
    more = selector.partners.one_more(right.best, selector.proposals.beside, right.singles, right.screened)
    assert not any(s.fit.polished for s in more)


def test_two_effects_are_found_at_once_where_a_third_stands_in_for_both(
    drag_and_friction: tuple[Plant, Diagnosis],
) -> None:
    """Stuck with a gain alone, as where beside it neither drag nor friction earns its place."""
    _, found = drag_and_friction
    selector, right = found.selector, found.selection
    gain = min((s for s in right.singles if "servo_gain" in s.key), key=lambda s: s.score)
    pair = selector.candidates.paired(right.singles)
    assert pair is not None
    assert {e.key for e in pair.fit.hypothesis.effects} == {"coulomb_friction@hinge", "viscous_friction@hinge"}
    gains = [selector.scores.difference(right.reference.fit, gain.fit)]
    begun = selector._begun_in_pairs(replace(right, best=gain, rivals=[gain], gains=gains), right.screened)
    assert {e.key for e in begun.best.fit.hypothesis.effects} == {"coulomb_friction@hinge", "viscous_friction@hinge"}
    # Where that is there already, it stays.
    assert selector._begun_in_pairs(right, right.screened) is right
    assert selector.candidates.paired([gain]) is None


def test_two_effects_are_found_of_which_none_would_do_alone(drag_and_friction: tuple[Plant, Diagnosis]) -> None:
    plant, found = drag_and_friction
    selector, right = found.selector, found.selection
    nothing = replace(right, best=right.reference, gains=[])
    both = selector._only_together(nothing, right.screened).best
    assert {e.key for e in both.fit.hypothesis.effects} == {"coulomb_friction@hinge", "viscous_friction@hinge"}
    # Where nothing is left to find, nothing is.
    healthy = simulate("pendulum", 12.0)
    clean = diagnose([recording_from_table(healthy, plant)], plant, Options(baselines=False, only=_DRAG, threads=1))
    assert clean.selection.best is clean.selection.reference
    assert clean.selector._only_together(clean.selection, clean.selection.screened).best is clean.selection.reference


def test_what_bent_nominal_numbers_hide_is_found_beside_untouched_ones(
    drag_and_friction: tuple[Plant, Diagnosis],
) -> None:
    _, found = drag_and_friction
    selector, right = found.selector, found.selection
    single = min((s for s in right.singles if "coulomb" in s.key), key=lambda s: s.score)
    bent = replace(single.fit, z=np.full_like(single.fit.z, BOX))
    before = selector.fitter.jacobian
    fits = {
        frozenset(e.key for e in s.fit.hypothesis.effects): s.fit
        for s in selector.partners.beside_untouched(bent, right.singles)
    }
    both = fits[frozenset({"coulomb_friction@hinge", "viscous_friction@hinge"})]
    assert both.cost < right.best.fit.cost + 3.0
    assert selector.fitter.jacobian is before


def test_an_effect_counts_that_shows_beside_a_channel_that_is_far_off() -> None:
    plant = plant_of("arm")
    aligned = align(recording_from_table(simulate("arm", 8.0), plant), plant)
    nominal = Variant.nominal(plant)
    replayer = Replayer(plant, aligned, cut(aligned), noise_floor(aligned), 1)
    fitter = Fitter(Residuals.build(replayer, nominal), [])
    scores = Scores(fitter)
    effects = enumerate_effects(Context(plant, measure_scales(replayer, nominal)))

    def fit(second: float, *effects: Effect) -> Scored:
        held = np.broadcast_to([200.0**2, second**2], fitter.recorded.shape)
        none = np.zeros(0)
        made = Fit(Hypothesis(effects), none, none, float(fitter.data_cost(held)), none, none, held)
        made.held_cost = fitter.likelihood.costs(held, fitter.likelihood.scale(held)).sum(axis=-1)
        return scores.scored(made)

    without, with_ = fit(20.0), fit(2.0, effects[0])
    assert with_.gap > 0.99 * without.gap
    assert earns(scores, without, with_, 100)
    # A hundredth of one channel is nothing.
    assert not earns(scores, without, fit(19.8, effects[0]), 100)


def test_a_stop_that_gives_way_is_told_with_its_law() -> None:
    def stop(model: mujoco.MjModel) -> None:
        joint = model.joint("pan")
        joint.range, model.jnt_limited[joint.id] = [-9.0, 0.3], 1
        model.jnt_solref[joint.id] = 1.0 / (120.0 * 0.2), 0.2

    plant, table = plant_of("camera"), simulate("camera", 12.0, change=stop)
    only = ("joint_range", "joint_stiffness", "servo_gain", "servo_torque_limit")
    found = diagnose([recording_from_table(table, plant)], plant, Options(baselines=False, only=only, threads=1))
    (effect,) = found.report["effects"]
    assert (effect["name"], effect["site"], effect["form"]) == ("joint_range", "pan", "upper, soft")
    values = {name: p["value"] for name, p in effect["parameters"].items()}
    assert values["upper"] == pytest.approx(0.3, abs=0.005)
    assert values["frequency"] == pytest.approx(120.0, rel=0.05)
    assert values["damping_ratio"] == pytest.approx(0.2, rel=0.05)
    # A law that bounces a little otherwise leaves a third of it.
    typical = found.report["gap"]["typical"]
    assert typical["after"] < 0.03 * typical["before"]


@pytest.mark.parametrize(("others", "alone"), [((5.0, 2.0), True), ((60.0, 2.0), False), ((-3.0,), True)])
def test_an_effect_stands_out_where_no_other_takes_a_third_of_what_it_takes(
    others: tuple[float, ...], alone: bool
) -> None:
    plant = plant_of("pendulum")
    aligned = align(recording_from_table(simulate("pendulum", 6.0), plant), plant)
    replayer = Replayer(plant, aligned, cut(aligned), noise_floor(aligned), 1)
    effects = enumerate_effects(Context(plant, measure_scales(replayer, Variant.nominal(plant))))

    def fit(cost: float, *which: int) -> Scored:
        none = np.zeros(0)
        return Scored(Fit(Hypothesis(tuple(effects[i] for i in which)), none, none, cost, none, none), cost, 1.0)

    base, best = fit(1000.0, 0), fit(900.0, 0, 1)
    rivals = [best, *(fit(1000.0 - gain, 0, 2 + i) for i, gain in enumerate(others))]
    assert stands_out(base.fit, best.fit, rivals) is alone
    # A little is never much more than nothing.
    assert not stands_out(base.fit, fit(990.0, 0, 1).fit, rivals[:1])


def test_a_second_effect_is_found_that_strained_nominal_numbers_had_swallowed() -> None:
    """Beside the first effect they do something else than in the nominal model."""

    def heavy(model: mujoco.MjModel) -> None:
        model.dof_armature[model.joint("pan").dofadr[0]] += 0.0016

    plant, table = plant_of("camera"), simulate("camera", 14.0, change=heavy)
    only = ("sensor_bias", "armature", "servo_gain", "mass")
    tilted = recording_from_table(table | {"q1": table["q1"] + 0.15}, plant)
    found = diagnose([tilted], plant, Options(baselines=False, only=only, threads=1))
    assert _names(found) == {"sensor_bias@tilt_pos", "armature@pan"}, found.report["reasons"]


def test_friction_of_a_cable_and_of_its_joint_are_not_both_named() -> None:
    """One change under two names: two constraints are stiffer than one, and so fit a little better."""
    plant = plant_of("finger")
    only = ("tendon_friction", "coulomb_friction", "joint_damping")
    table = simulate("finger", 8.0, change=_rub)
    found = diagnose([recording_from_table(table, plant)], plant, Options(baselines=False, only=only, threads=1))
    fitter = found.selector.fitter
    kinds = {e.key: e for e in found.selector.effects}

    def says_again(*names: str) -> bool:
        hypothesis = Hypothesis(tuple(kinds[n] for n in names))
        x = np.array([p.tries[0] for e in hypothesis.effects for p in e.parameters])
        return found.selector.partners._says_again(fitter.fit(hypothesis, x, np.zeros(len(fitter.nuisances)), 1))

    assert says_again("tendon_friction@cable", "coulomb_friction@knuckle")
    assert not says_again("tendon_friction@cable", "joint_damping@knuckle")
    assert not says_again("tendon_friction@cable", "coulomb_friction@wrist")
    assert len(_names(found)) == 1, found.report["reasons"]


def _rub(model: mujoco.MjModel) -> None:
    model.dof_frictionloss[model.joint("knuckle").dofadr[0]] += 0.15


def test_a_mass_that_lies_aside_comes_before_gravity_that_leans_far() -> None:
    """One change of a pendulum under two names, of which the milder is the likelier."""

    def aside(model: mujoco.MjModel) -> None:
        model.body_ipos[model.body("link").id, 0] += 0.03

    plant, table = plant_of("pendulum"), simulate("pendulum", 12.0, change=aside)
    options = Options(baselines=False, only=("com_shift", "gravity_lean", "servo_offset"), threads=1)
    found = diagnose([recording_from_table(table, plant)], plant, options)
    assert found.report["verdict"] == "ambiguous"
    assert _names(found) == {"com_shift@link"}
    assert "gravity_lean@all" in found.report["equivalent"][0]


def test_a_winner_that_ended_in_a_wrong_optimum_is_restarted_out_of_it(
    drag_and_friction: tuple[Plant, Diagnosis],
) -> None:
    _, found = drag_and_friction
    selector, right = found.selector, found.selection
    candidates, best = selector.candidates, right.best.fit
    stuck = replace(best, x=best.x * [0.75, 1.0], cost=best.cost + 40.0)
    better = candidates.restarted(replace(right.best, fit=stuck))
    assert better.fit.cost == pytest.approx(best.cost, abs=0.5)
    assert candidates.restarted(right.best) is right.best


def test_partners_are_compared_by_a_few_steps_where_many_numbers_are_off(
    drag_and_friction: tuple[Plant, Diagnosis],
) -> None:
    _, found = drag_and_friction
    selector, right = found.selector, found.selection
    base = min((s for s in right.singles if s.key == "coulomb_friction@hinge"), key=lambda s: s.score).fit
    fitter = selector.fitter
    fitter.refresh(base.hypothesis, base.x, base.z, base.residual)
    proposals = Proposals(fitter, selector.effects, Effort(twice=True), lambda stage, share: None)
    partners = proposals.beside(base)
    effect, x, z = partners[0]
    assert effect.key == "viscous_friction@hinge"
    # What was compared is where a fit of both begins: next to its end.
    begun = fitter.fit(base.hypothesis.with_effect(effect), x, z, 0)
    assert begun.cost < base.cost - 0.5 * (base.cost - right.best.fit.cost)
    assert "coulomb_friction@hinge" not in {e.key for e, _, _ in partners}


@pytest.mark.parametrize("far", [True, False])
def test_what_is_compared_begins_halfway_back_where_numbers_are_far_off(
    drag_and_friction: tuple[Plant, Diagnosis], monkeypatch: pytest.MonkeyPatch, far: bool
) -> None:
    _, found = drag_and_friction
    selector, fitter = found.selector, found.selector.fitter
    reference = found.selection.reference.fit
    bent = np.where(np.arange(len(reference.z)) % 2, 1.0, -1.0) * (BOX if far else 0.1)
    base = replace(reference, z=bent)
    drag = next(e for e in selector.effects if e.key == "viscous_friction@hinge")
    begun: list[np.ndarray] = []
    fit = fitter.fit

    def watched(hypothesis: Hypothesis, x: np.ndarray, z: np.ndarray, *args: Any, **options: Any) -> Fit:
        begun.append(z)
        return fit(hypothesis, x, z, *args, **options)

    monkeypatch.setattr(fitter, "fit", watched)
    proposals = Proposals(fitter, selector.effects, Effort(twice=True), lambda stage, share: None)
    best = proposals._compared([(drag, np.array(drag.starts()[0]), base.z)], base, "compare")
    assert [f.hypothesis.key for f in best] == ["viscous_friction@hinge"], "the better end of the two stays"
    assert any(np.array_equal(z, 0.5 * bent) for z in begun) == far
    assert any(np.array_equal(z, bent) for z in begun)


def test_the_law_next_to_the_partner_that_screened_best_is_compared_too(
    drag_and_friction: tuple[Plant, Diagnosis], monkeypatch: pytest.MonkeyPatch
) -> None:
    plant, found = drag_and_friction
    selector, right = found.selector, found.selection
    base = min((s for s in right.singles if s.key == "coulomb_friction@hinge"), key=lambda s: s.score).fit
    fitter = selector.fitter
    fitter.refresh(base.hypothesis, base.x, base.z, base.residual)
    context = Context(plant, measure_scales(fitter.residuals.replayer, Variant.nominal(plant)))
    effects = enumerate_effects(context, (), ("load_friction", "viscous_friction", "coulomb_friction"))

    def missed(*args: Any, **options: Any) -> list[Screened]:
        return [s for s in screen(*args, **options) if s.effect.name == "load_friction"]

    monkeypatch.setattr("simgap.inference.proposals.screen", missed)
    partners = Proposals(fitter, effects, Effort(twice=True), lambda stage, share: None).beside(base)
    assert [e.key for e, _, _ in partners] == ["viscous_friction@hinge", "load_friction@hinge"]


def test_where_many_numbers_are_off_a_further_effect_is_looked_for_at_the_floor_too(
    drag_and_friction: tuple[Plant, Diagnosis],
) -> None:
    _, found = drag_and_friction
    selector, best = found.selector, found.selection.best
    assert not selector._leaves_much(best)
    mouse = Selector(selector.fitter, selector.effects, effort=Effort(twice=True))
    assert mouse._leaves_much(best)


def test_what_promised_and_was_refused_alone_is_tried_beside_another_and_is_no_answer(
    drag_and_friction: tuple[Plant, Diagnosis],
) -> None:
    _, found = drag_and_friction
    selector, right = found.selector, found.selection
    nothing = replace(right, best=right.reference, gains=[])
    refused = min((s for s in right.singles if s.key == "viscous_friction@hinge"), key=lambda s: s.score)
    both = selector._only_together(nothing, right.screened, [refused]).best
    assert {e.key for e in both.fit.hypothesis.effects} == {"coulomb_friction@hinge", "viscous_friction@hinge"}
    # If the time ends meanwhile, what did not earn its place is not what is answered.
    selector._found = nothing
    worse = replace(refused, fit=replace(refused.fit, held_cost=right.reference.fit.held_cost + 1.0), score=-1e9)
    selector._keep(replace(nothing, best=worse))
    assert selector._found.best is right.reference
