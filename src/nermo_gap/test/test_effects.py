"""The catalogue of faults from end to end: what the twin builds is what the diagnosis means, and writes down again."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from nermo_description.effects import EFFECTS, table
from nermo_description.parameters import LEGS, Deviation
from nermo_description.robots import load_robot
from nermo_gap.explain.candidates import candidates
from nermo_gap.robots.apply import deviations_of, write_robot
from nermo_gap.robots.channels import TRACKER
from nermo_gap.robots.diagnosis import robot_plant
from nermo_gap.robots.simulated import simulate
from nermo_gap.robots.sites import groups
from nermo_gap.robots.trials import trials
from nermo_sim.command_path import CommandPath
from simgap.data.align import Aligned, align
from simgap.data.plant import Plant
from simgap.data.recording import recording_from_table
from simgap.effects.base import Context, Effect, Site, amount
from simgap.effects.library import effect_classes, enumerate_effects
from simgap.simulation.replay import Replayer
from simgap.simulation.scales import measure_scales
from simgap.simulation.signal_path import shape_inputs
from simgap.simulation.variant import Variant
from simgap.simulation.windows import cut

ROBOT = load_robot("nermo_lite")
HIP, KNEE = "front_left_hip", "rear_right_knee"
VERTEBRAE = tuple(f"spine_lateral_{i}_joint" for i in range(1, 5))
KNEE_RANGE = ROBOT.rear_leg_dynamics.knee
FEET = tuple(f"{leg}_foot" for leg in LEGS)

CASES: list[tuple[str, Deviation]] = [
    (KNEE, Deviation.at("servo_gain", KNEE, factor=0.7)),
    ("all_hips", Deviation.at("servo_torque_limit", *(f"{leg}_hip" for leg in LEGS), limit=0.05)),
    ("all_hips", Deviation.at("servo_delay", *(f"{leg}_hip" for leg in LEGS), delay=0.0125)),
    (HIP, Deviation.at("servo_offset", HIP, offset=-0.1)),
    (HIP, Deviation.at("servo_rate_limit", HIP, limit=2.0)),
    (HIP, Deviation.at("servo_dead_band", HIP, half_width=0.03)),
    (HIP, Deviation.at("servo_backlash", HIP, width=0.1)),
    (f"{HIP}_joint", Deviation.at("coulomb_friction", f"{HIP}_joint", friction=0.01)),
    (f"{HIP}_joint", Deviation.at("viscous_friction", f"{HIP}_joint", damping=0.002)),
    ("spine", Deviation.at("joint_damping", *VERTEBRAE, damping=0.0005)),
    (f"{HIP}_joint", Deviation.at("armature", f"{HIP}_joint", inertia=1e-5)),
    ("spine", Deviation.at("joint_stiffness", *VERTEBRAE, factor=0.4)),
    (f"{KNEE}_joint", Deviation.at("joint_rest_angle", f"{KNEE}_joint", shift=0.2)),
    (f"{KNEE}_joint", Deviation.at("joint_range", f"{KNEE}_joint", upper=0.5 * (KNEE_RANGE.lower + KNEE_RANGE.upper))),
    ("spine_left", Deviation.at("tendon_slack", "spine_left", slack=0.002)),
    ("spine_left", Deviation.at("tendon_friction", "spine_left", friction=0.3)),
    (f"{KNEE}_tendon", Deviation.at("tendon_detached", f"{KNEE}_tendon", share=1.0)),
    ("torso", Deviation.at("mass", "torso", change=0.02)),
    ("torso", Deviation.at("com_shift", "torso", x=0.003, y=-0.001, z=0.002)),
    ("torso", Deviation.at("inertia", "torso", factor=1.7)),
    ("all_feet", Deviation.at("ground_friction", *FEET, factor=0.6)),
    ("rear_left_foot", Deviation.at("foot_compliance", "rear_left_foot", time_factor=3.0)),
    ("all", Deviation.at("ground_slope", pitch=0.05, roll=-0.02)),
]
"""What the diagnosis calls the site, and the deviation."""
NAMED = {"ground_slope": "gravity_lean"}
"""What leans on the twin is gravity."""
FIELDS = (
    *("actuator_gainprm", "actuator_biasprm", "actuator_forcerange", "dof_frictionloss", "dof_damping"),
    *("dof_armature", "jnt_stiffness", "qpos_spring", "jnt_range", "tendon_range", "tendon_limited"),
    *("tendon_frictionloss", "body_mass", "body_inertia", "body_ipos", "geom_friction", "geom_solref"),
)


@cache
def walk() -> tuple[Plant, Aligned, Context, tuple[Effect, ...]]:
    """A short walk, and all that may be wrong at it."""
    columns = simulate(ROBOT, 4.5, seed=1)
    plant = robot_plant(ROBOT, list(columns))
    aligned = align(recording_from_table(columns, plant), plant)
    replayer = Replayer(plant, aligned, cut(aligned, 0.4, most=2), np.ones(len(plant.outputs)), 1)
    context = Context(plant, measure_scales(replayer, Variant.nominal(plant)), groups(plant.model))
    return plant, aligned, context, tuple(enumerate_effects(context))


def named(site: str, deviation: Deviation) -> Effect:
    """The diagnosis's own effect for a deviation."""
    name = NAMED.get(deviation.effect, deviation.effect)
    found = [e for e in walk()[3] if (e.name, e.site.name) == (name, site)]
    alike = [e for e in found if {p.name for p in e.parameters} == set(deviation.values) and e.form != "motor"]
    return alike[0] if alike else UNSEEN[name](site)


def _tendon_friction(site: str) -> Effect:
    """The mouse's strings are pulled by pulleys: the diagnosis sees no force in them to measure friction by."""
    index = walk()[0].model.tendon(site).id
    return effect_classes()["tendon_friction"](Site(site, (index,)), [amount("friction", "N", 0.1)])


def meant(site: str, deviation: Deviation, variant: Variant) -> None:
    """Enters what the diagnosis means by a deviation."""
    effect = named(site, deviation)
    effect.apply(variant, [deviation.values[p.name] for p in effect.parameters])


UNSEEN = {"tendon_friction": _tendon_friction}
"""What a robot file can say and a diagnosis of the mouse does not look for."""


def numbers(model: mujoco.MjModel) -> dict[str, Any]:
    found = {field: np.array(getattr(model, field), dtype=float) for field in FIELDS}
    found["tendon_range"][found["tendon_limited"] == 0] = 0.0
    return {**found, "gravity": model.opt.gravity.copy()}


def test_every_effect_has_a_case() -> None:
    assert [deviation.effect for _, deviation in CASES] == list(EFFECTS)


def test_names_units_and_ranges_are_the_same() -> None:
    for site, deviation in CASES:
        for parameter in named(site, deviation).parameters:
            allowed = EFFECTS[deviation.effect].values[parameter.name]
            assert parameter.unit == allowed.unit
            assert allowed.lower <= parameter.low < parameter.high <= allowed.upper


def test_the_twin_builds_the_model_that_the_diagnosis_means(tmp_path: Path) -> None:
    """All effects on the model in one mouse."""
    plant = walk()[0]
    cases = [case for case in CASES if case[1].kind.acts_on == "model"]
    write_robot([deviation for _, deviation in cases], "nermo_lite", tmp_path / "mine.yaml")
    mine = load_robot(tmp_path / "mine.yaml")
    assert mine.deviations == tuple(deviation for _, deviation in cases)

    nominal, variant = numbers(plant.model), Variant.nominal(plant)
    for site, deviation in cases:
        before = numbers(variant.model)
        meant(site, deviation, variant)
        after = numbers(variant.model)
        assert any((after[field] != before[field]).any() for field in after), deviation.effect

    built = numbers(robot_plant(mine, [f"{servo}_command" for servo in ROBOT.servos] + list(TRACKER)).model)
    for field, value in numbers(variant.model).items():
        # In the replayed model the small parts that never move against the torso are one body with it.
        near = {"rtol": 2e-3} if field.startswith("body") else {"rtol": 1e-6, "atol": 1e-9}
        np.testing.assert_allclose(built[field], value, **near, err_msg=field)
        assert field == "tendon_range" or (built[field] != nominal[field]).any(), field


@pytest.mark.parametrize(
    ("site", "deviation"),
    [pytest.param(*case, id=case[1].effect) for case in CASES if case[1].kind.acts_on == "commands"],
)
def test_the_twin_does_to_commands_what_the_diagnosis_means(site: str, deviation: Deviation) -> None:
    plant, aligned, _, _ = walk()
    variant = Variant.nominal(plant)
    meant(site, deviation, variant)
    arrives = shape_inputs(aligned, [variant.inputs])[0]
    rows = np.arange(len(arrives))
    for i, late in enumerate(variant.inputs.delay / aligned.period):
        arrives[:, i] = np.interp(rows - late, rows, arrives[:, i])
    # A servo that is told where it is, to within its dead band, stays: here it is off by half the band.
    measured = aligned.inputs - 0.5 * deviation.values.get("half_width", 0.0)
    rests = np.abs(arrives - measured) < variant.servos.dead_band[[channel.actuator for channel in plant.inputs]]
    assert variant.servos.hard[variant.servos.dead_band > 0].all()

    mine = ROBOT.model_copy(update={"deviations": (deviation,)})
    path = CommandPath(mine, [channel.name for channel in plant.inputs], aligned.period)
    passed = np.stack([path(told, here) for told, here in zip(aligned.inputs, measured, strict=True)])
    assert np.abs(passed - aligned.inputs).max() > 1e-3
    # The diagnosis lets a servo that lags turn all through a period.
    slack = aligned.period * deviation.values.get("limit", 0.0)
    np.testing.assert_allclose(passed, np.where(rests, measured, arrives), atol=1e-9 + slack)


def test_what_a_diagnosis_names_is_written_down_as_it_was() -> None:
    effects = []
    for site, deviation in CASES:
        effect = named(site, deviation)
        parameters = {p.name: {"value": deviation.values[p.name], "unit": p.unit} for p in effect.parameters}
        effects.append({"name": effect.name, "site": effect.site.name, "parameters": parameters})
    applied = deviations_of({"effects": effects}, "nermo_lite")
    assert not applied.left_out
    for again, (_, deviation) in zip(applied.deviations, CASES, strict=True):
        assert (again.effect, again.values) == (deviation.effect, deviation.values)
        assert set(again.sites) == set(deviation.sites)


def test_parts_with_values_of_their_own_are_written_down_one_by_one() -> None:
    values = 0.5, 0.7, 0.6, 0.9
    hips = {f"factor_{leg}_hip": {"value": v, "part": f"{leg}_hip"} for leg, v in zip(LEGS, values, strict=True)}
    applied = deviations_of({"effects": [{"name": "servo_gain", "site": "all_hips", "parameters": hips}]}, "nermo_lite")
    assert not applied.left_out
    expected = [Deviation.at("servo_gain", f"{leg}_hip", factor=v) for leg, v in zip(LEGS, values, strict=True)]
    assert list(applied.deviations) == expected


def test_what_a_robot_file_has_no_place_for_is_named_and_left_out() -> None:
    def effect(name: str, **values: float) -> dict[str, object]:
        return {"name": name, "site": f"{KNEE}_joint", "parameters": {n: {"value": v} for n, v in values.items()}}

    applied = deviations_of(
        {
            "effects": [
                effect("joint_range", upper=0.9, frequency=100.0, damping_ratio=0.5),
                effect("joint_stiffness", stiffness=0.01),
                effect("stribeck_friction", static_excess=0.1),
            ]
        },
        "nermo_lite",
    )
    assert applied.deviations == (Deviation.at("joint_range", f"{KNEE}_joint", upper=0.9),)
    assert [text.split("@")[0] for text in applied.left_out] == ["joint_range", "joint_stiffness", "stribeck_friction"]
    assert "frequency, damping_ratio" in applied.left_out[0] and "factor" in applied.left_out[1]


def test_all_that_explains_a_table_and_all_trials_are_of_the_catalogue() -> None:
    for candidate in candidates(ROBOT):
        for size in candidate.sizes:
            assert candidate.deviation(size).effect in EFFECTS
    for expected, deviations in trials(ROBOT).values():
        assert expected == "no_gap" or expected.startswith(deviations[0].effect)


@pytest.mark.parametrize(
    ("effect", "values", "words"),
    [
        ("servo_delay", {"delay": -0.1}, "values.delay of servo_delay = -0.1 s: allowed 0 to 1 s"),
        ("servo_gain", {"gain": 0.1}, "values of servo_gain must be factor"),
        ("servo_gains", {"gain": 0.1}, "must be one of servo_gain"),
        ("joint_range", {}, "must be lower, upper"),
    ],
)
def test_what_is_not_in_the_catalogue_is_refused(effect: str, values: dict[str, float], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        Deviation.at(effect, KNEE, **values)


def test_the_page_shows_the_catalogue() -> None:
    page = Path(__file__).parents[3] / "docs" / "nermo_description.md"
    assert table() in page.read_text(encoding="utf-8")
