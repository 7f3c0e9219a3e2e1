"""Rules that decide what is added and what is said, one by one."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from robots import aligned_of, plant_of, simulate

from simgap.analysis.diagnose import odd_timing, timing_at_its_limit
from simgap.analysis.self_contact import without_needless_contacts
from simgap.data.mapping import parse_map
from simgap.data.plant import build_plant, load_spec
from simgap.effects.base import Context
from simgap.effects.library import enumerate_effects
from simgap.inference.decision import Class
from simgap.inference.model_selection import BEST_OF_SEVERAL, EVIDENCE_MORE, FURTHER, RELEVANT, earns
from simgap.inference.nuisance import BOX, enumerate_nuisances
from simgap.inference.screen import _directions
from simgap.inference.verdict import shared
from simgap.simulation.contacts import colliding
from simgap.simulation.replay import Replayer
from simgap.simulation.scales import measure_scales
from simgap.simulation.state import measured_state
from simgap.simulation.variant import Variant
from simgap.simulation.windows import cut


def _scored(effects: int) -> Any:
    fit = SimpleNamespace(
        hypothesis=SimpleNamespace(effects=[None] * effects, grows=False),
        prior=0.0,
        strained=[],
        likelihood=None,
        cost=0.0,
        held=None,
    )
    return SimpleNamespace(fit=fit)


def _scores(**told: Any) -> Any:
    """What a fit leaves is its gap, here and where it runs free; nothing is a matter of chance, no model corrected."""
    itself = {measure: lambda held: held for measure in ("typical", "overall", "gap")}
    as_held = {**itself, "left": lambda fit: fit.held, "free_error": lambda fit: fit.held}
    return SimpleNamespace(**{**as_held, "roughness": 0.0, "written": 0.0, **told})


@pytest.mark.parametrize(("gain", "first", "earned"), [(40.0, 300.0, True), (40.0, 500.0, False), (15.0, 100.0, False)])
def test_a_further_cause_may_earn_a_tenth_of_the_first(gain: float, first: float, earned: bool) -> None:
    """It leaves much: the share of what is left that it takes is small."""
    scores = _scores(
        difference=lambda worse, better: (gain, 0.5 * gain, 2.0 * gain),
        typical=lambda held: 20.0,
        overall=lambda held: 20.0,
    )
    without, with_ = _scored(1), _scored(2)
    without.fit.cost, with_.fit.cost = gain, 0.0
    assert (FURTHER, EVIDENCE_MORE) == (0.1, 16.0), "the cases are written for these"
    assert earns(scores, without, with_, looked_at=10, first=first) == earned


@pytest.mark.parametrize(
    ("gain", "corrected", "strain", "earned"),
    [
        (40.0, 0.0, 0.0, True),
        (40.0, 300.0, 0.0, True),
        (40.0, 500.0, 0.0, False),
        (40.0, 500.0, 9.0, False),
        (15.0, 100.0, 0.0, False),
    ],
)
def test_the_first_cause_beside_a_corrected_model_is_a_further_one(
    gain: float, corrected: float, strain: float, earned: bool
) -> None:
    """It leaves much of the gap, and little of where the robot goes; strain about corrected numbers says nothing."""
    scores = _scores(
        difference=lambda worse, better: (gain, 0.5 * gain, 2.0 * gain),
        typical=lambda held: 20.0,
        overall=lambda held: 20.0,
        gap=lambda held: 20.0,
        free_error=lambda fit: fit.cost,
        written=corrected,
    )
    without, with_ = _scored(0), _scored(1)
    without.fit.cost, with_.fit.cost = gain, 0.0
    without.fit.prior, without.fit.strained = strain, [0] if strain else []
    assert earns(scores, without, with_, looked_at=10) == earned


@pytest.mark.parametrize(
    ("before", "after", "earned"),
    [(2.0, 1.7, True), (1.11, 1.03, True), (1.228, 1.212, False), (1.11, 1.07, False), (0.98, 0.9, False)],
)
def test_a_first_cause_takes_a_part_of_the_gap_or_most_of_what_is_above_the_floor(
    before: float, after: float, earned: bool
) -> None:
    without, with_ = _scored(0), _scored(1)
    without.fit.held, with_.fit.held = before, after
    without.fit.cost = 50.0
    scores = _scores(difference=lambda worse, better: (40.0, 20.0, 60.0))
    assert earns(scores, without, with_, looked_at=100) == earned


@pytest.mark.parametrize(("roughness", "earned"), [(0.0, True), (11.0, True), (12.0, False)])
def test_what_the_best_of_several_gains_by_chance_is_not_earned(roughness: float, earned: bool) -> None:
    without, with_ = _scored(0), _scored(1)
    without.fit.held, with_.fit.held, without.fit.cost = 2.0, 1.0, 50.0
    scores = _scores(difference=lambda worse, better: (40.0, 20.0, 60.0), roughness=roughness)
    assert BEST_OF_SEVERAL == 3.4, "the cases are written for it"
    assert earns(scores, without, with_, looked_at=100) == earned


@pytest.mark.parametrize(
    ("low", "without_best", "free", "earned"),
    [
        (20.0, 30.0, 92.0, False),
        (20.0, 30.0, 88.0, True),
        (-5.0, 30.0, 88.0, True),
        (-5.0, 20.0, 70.0, False),
        (20.0, -9.0, 70.0, True),
    ],
)
def test_a_cause_of_which_windows_show_little_must_tell_where_the_robot_goes_and_in_more_than_one_block(
    low: float, without_best: float, free: float, earned: bool
) -> None:
    """It gains enough, and takes 3 % of the gap: that of a double pendulum's friction, whose start is forgiven."""
    without, with_ = _scored(0), _scored(1)
    without.fit.held, with_.fit.held = 1.98, 1.92
    without.fit.cost = 90.0
    scores = _scores(
        difference=lambda worse, better: (80.0, low, 120.0),
        without_best=lambda worse, better: without_best,
        free_error=lambda fit: 100.0 if fit is without.fit else free,
    )
    assert (EVIDENCE_MORE, RELEVANT) == (16.0, 0.1), "the cases are written for these"
    assert earns(scores, without, with_, looked_at=100) == earned


@pytest.mark.parametrize(("z", "said"), [(BOX, "+"), (-BOX, "-"), (0.9 * BOX, "")])
def test_timing_that_sits_at_its_limit_is_said_with_its_size(z: float, said: str) -> None:
    plant = plant_of("arm")
    nuisances = enumerate_nuisances(plant, np.ones(2), np.ones(2), 0.005)
    values = np.array([z if n.name == "timing of inputs" else 0.0 for n in nuisances])
    sentence = timing_at_its_limit(
        cast(Any, SimpleNamespace(z=values)), cast(Any, SimpleNamespace(nuisances=nuisances))
    )
    assert (f"({said}" in sentence and " ms)" in sentence and "link_latency" in sentence) if said else sentence == ""


@pytest.mark.parametrize(("z", "said"), [(-12.0, "before"), (12.0, "after"), (0.9 * BOX, "")])
def test_timing_beyond_any_tolerance_is_said_of_long_windows(z: float, said: str) -> None:
    nuisances = enumerate_nuisances(plant_of("arm"), np.ones(2), np.ones(2), 0.005)
    values = np.array([z if n.name == "timing of inputs" else 0.0 for n in nuisances])
    longer, fitter = SimpleNamespace(fit=SimpleNamespace(z=values)), SimpleNamespace(nuisances=nuisances)
    sentence = odd_timing(cast(Any, longer), cast(Any, fitter))
    assert (f"ms {said} their stamps" in sentence) if said else sentence == ""
    assert odd_timing(None, cast(Any, fitter)) == ""


_LEG = """<mujoco><option timestep="0.002"/><worldbody><geom type="plane" size="1 1 .1" pos="0 0 {ground}"/>
<body name="trunk" pos="0 0 1"><body name="shank"><joint name="knee" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 0 0 -.3" size=".02" mass="0.5"/></body></body></worldbody>
<actuator><position name="servo" joint="knee" kp="20"/></actuator></mujoco>"""


@pytest.mark.parametrize(("ground", "touches"), [(0.0, False), (0.69, True)])
def test_a_leg_in_the_air_is_replayed_without_contacts_and_one_that_lands_with(
    tmp_path: Any, ground: float, touches: bool
) -> None:
    model = tmp_path / "leg.xml"
    model.write_text(_LEG.format(ground=ground))
    mapping = {
        "time": {"column": "t", "unit": "s"},
        "inputs": [{"column": "u", "unit": "rad", "actuator": "servo", "kind": "position"}],
        "outputs": [{"column": "q", "unit": "rad", "joint": "knee", "quantity": "position"}],
    }
    plant = build_plant(load_spec(model), parse_map(cast(Any, mapping)))
    _, aligned, floor = aligned_of("pendulum", simulate("pendulum", 5.0))
    state = measured_state(plant, aligned, floor)
    assert colliding(plant.model)[0]
    quiet = without_needless_contacts(plant, state)
    assert bool(colliding(quiet.model)[0]) is touches
    assert colliding(plant.model)[0], "the plant itself is left as it is"


def test_a_glance_at_the_friction_of_feet_looks_at_less_of_it() -> None:
    """Feet that do not slip do not mind more, so that says nothing of less."""
    plant, aligned, floor = aligned_of("quad", simulate("quad", 6.0))
    replayer = Replayer(plant, aligned, cut(aligned, most=3), floor, 1)
    context = Context(plant, measure_scales(replayer, Variant.nominal(plant)))
    for effect in enumerate_effects(context, (), ("ground_friction",)):
        looked_at = [value for (value,) in _directions(effect)]
        assert min(looked_at) < 0.6 and any(value > 1.0 for value in looked_at)


def test_what_all_likely_rivals_share_is_what_can_be_named() -> None:
    def named(probability: float, *effects: str) -> Class:
        fit = SimpleNamespace(hypothesis=SimpleNamespace(effects=[SimpleNamespace(key=key) for key in effects]))
        return Class((cast(Any, fit),), probability)

    rivals = [named(0.5, "gain", "friction"), named(0.3, "gain", "mass"), named(0.15, "gain", "offset")]
    assert shared([*rivals, named(0.05, "slack")]) == (frozenset({"gain"}), pytest.approx(0.95))
    assert shared([*rivals[:2], named(0.2, "slack")])[0] == frozenset()
    assert shared([named(0.95, "gain", "friction"), named(0.05, "slack")])[0] == frozenset({"gain", "friction"})
    assert shared([])[0] == frozenset()
