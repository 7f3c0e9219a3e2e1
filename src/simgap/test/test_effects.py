"""Every effect at every site of every robot: nothing at its neutral value, something at its strongest."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import cast

import mujoco
import numpy as np
import pytest
from robots import ARM, LEG, MODELS, aligned_of, simulate

from simgap.data.errors import GapInputError
from simgap.data.mapping import parse_map
from simgap.data.plant import Plant, build_plant
from simgap.effects.base import Context, Effect, Site, group_names, named_sites
from simgap.effects.body import shift_com
from simgap.effects.contact import GravityLean, GroundSlope
from simgap.effects.friction import CoulombFriction, StribeckFriction
from simgap.effects.library import effect_classes, enumerate_effects, load_effects
from simgap.effects.tendon import TendonFriction
from simgap.inference.nuisance import apply_nuisances, enumerate_nuisances
from simgap.simulation.replay import Replayer
from simgap.simulation.scales import Scales, measure_scales
from simgap.simulation.variant import FrictionPath, Variant
from simgap.simulation.windows import cut

NAMES = {
    *("servo_delay", "servo_dead_band", "servo_backlash", "servo_gain", "servo_offset", "servo_rate_limit"),
    *("servo_torque_limit", "supply_sag", "coulomb_friction", "viscous_friction", "stribeck_friction", "load_friction"),
    *("armature", "tendon_slack", "tendon_elasticity", "tendon_friction", "tendon_detached", "joint_stiffness"),
    *("joint_damping", "joint_rest_angle", "joint_range", "mass", "com_shift", "inertia", "ground_friction"),
    *("ground_slope", "foot_compliance", "sensor_bias", "sensor_scale", "sensor_delay", "sensor_misalignment"),
    *("sensor_saturation", "link_latency", "link_jitter", "link_loss", "clock_offset", "gravity_lean"),
    *("joint_elasticity", "soft_mount", "thermal_drift", "torque_ripple"),
}


def _setup(name: str) -> tuple[Replayer, Variant, list[Effect]]:
    plant, aligned, floor = aligned_of(name, simulate(name, 6.0))
    replayer = Replayer(plant, aligned, cut(aligned), floor, 1)
    nominal = Variant.nominal(plant)
    effects = enumerate_effects(Context(plant, measure_scales(replayer, nominal)))
    forms = [a for e in effects for a in e.alternatives() if a.form in ("damped", "own time", "swaying")]
    return replayer, nominal, [*effects, *forms]


def test_the_library_has_the_public_names() -> None:
    assert set(effect_classes()) >= NAMES
    for effect in effect_classes().values():
        assert effect.__doc__


@pytest.mark.parametrize("name", list(MODELS))
def test_effects_are_neutral_at_neutral_and_act_elsewhere(name: str) -> None:
    replayer, nominal, effects = _setup(name)
    window = np.array([4])
    variants = [nominal]
    for effect in effects:
        for values in ([p.neutral for p in effect.parameters], effect.starts()[-1]):
            variant = nominal.copy()
            effect.apply(variant, tuple(values))
            variants.append(variant)
    outputs = replayer.run(variants, window)
    scale = outputs[0].std(axis=(0, 1))
    idle = []
    for i, effect in enumerate(effects):
        neutral, acting = outputs[1 + 2 * i], outputs[2 + 2 * i]
        if effect.name != "tendon_detached":
            np.testing.assert_allclose(neutral, outputs[0], atol=2e-4 * scale.max(), err_msg=repr(effect))
        if np.abs(acting - outputs[0]).max() < 1e-7:
            idle.append(repr(effect))
    # Some motions do not excite some sites, and the place of a cart on its rail is no matter, nor is that of a trunk on
    # flat ground (x and y, the first two of its position).
    quiet = (
        "com_shift",
        "joint_range",
        "sensor_saturation",
        "servo_rate_limit",
        "servo_torque_limit",
        "ground_",
        "inertia",
    )
    loud = [key for key in idle if not key.startswith((*quiet, "stribeck", "load_friction", "supply_sag"))]
    assert set(loud) <= {
        *("sensor_bias@slide", "sensor_bias@trunk:x", "sensor_bias@trunk:y"),
        *("foot_compliance@foot", "servo_dead_band@cable_servo (full)"),
    }


def test_starts_and_bounds_agree() -> None:
    for name in MODELS:
        for effect in _setup(name)[2]:
            for start in effect.starts():
                for value, parameter in zip(start, effect.parameters, strict=True):
                    assert parameter.low <= value <= parameter.high, f"{effect!r} {parameter}"


def test_shifted_com_equals_a_recompiled_model() -> None:
    """The compiled model takes shortcuts for centred bodies; editing it must switch them off."""
    spec = mujoco.MjSpec.from_string(ARM)
    edited = spec.compile()
    body = edited.body("fore").id
    shift_com(edited, body, (0.01, 0.0, -0.03))
    mujoco.mj_setConst(edited, mujoco.MjData(edited))
    reference = mujoco.MjSpec.from_string(ARM)
    fore = reference.body("fore")
    fore.explicitinertial = True
    fore.mass, fore.inertia = float(edited.body_mass[body]), edited.body_inertia[body]
    fore.ipos, fore.iquat = edited.body_ipos[body], edited.body_iquat[body]
    compiled = reference.compile()
    found = []
    for model in (edited, compiled):
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = [0.4, -0.3], [1.0, 2.0]
        for _ in range(200):
            mujoco.mj_step(model, data)
        found.append(data.qpos.copy())
    np.testing.assert_allclose(found[0], found[1], atol=1e-9)


def test_nuisances_move_the_model_both_ways() -> None:
    plant, aligned, _ = aligned_of("leg", simulate("leg", 6.0))
    for nuisance in enumerate_nuisances(plant, aligned.outputs.std(axis=0), np.ones(len(plant.inputs)), aligned.period):
        changed = []
        for z in (-1.0, 0.0, 1.0):
            variant = Variant.nominal(plant)
            apply_nuisances([nuisance], variant, np.array([z]))
            fields = ("body_mass", "body_inertia", "body_ipos", "dof_damping", "dof_armature", "jnt_stiffness",
                      "actuator_gainprm", "actuator_biasprm", "geom_friction", "geom_solref")  # fmt: skip
            values = [np.asarray(getattr(variant.model, f)).ravel() for f in fields]
            firmness = [variant.model.opt.impratio]
            paths = [variant.outputs.bias, variant.inputs.delay]
            changed.append(np.concatenate([*values, variant.model.opt.gravity, firmness, *paths]))
        assert np.abs(changed[0] - changed[1]).max() > 0, nuisance.name
        assert np.abs(changed[2] - changed[0]).max() > np.abs(changed[2] - changed[1]).max(), nuisance.name


def test_a_spring_that_is_added_to_a_spring_pulls_to_the_zero() -> None:
    replayer, nominal, effects = _setup("leg")
    added = next(e for e in effects if repr(e) == "joint_stiffness@knee (added)")
    (joint,), changed = added.site.targets, nominal.copy()
    added.apply(changed, (0.4,))
    model = replayer.plant.model
    address, dof = model.jnt_qposadr[joint], model.jnt_dofadr[joint]
    assert model.jnt_stiffness[joint] > 0.0 and model.qpos_spring[address] != model.qpos0[address]
    data = mujoco.MjData(model)
    for q in (-0.5, 0.2, 0.9):
        forces = []
        for variant in (nominal, changed):
            mujoco.mj_resetData(variant.model, data)
            data.qpos[address] = q
            mujoco.mj_forward(variant.model, data)
            forces.append(float(data.qfrc_spring[dof]))
        assert forces[1] - forces[0] == pytest.approx(-0.4 * (q - model.qpos0[address]), abs=1e-9)


def test_groups_come_from_shared_words() -> None:
    names = [
        f"{end}_{side}_{part}" for end in ("front", "rear") for side in ("left", "right") for part in ("hip", "knee")
    ]
    groups = group_names(names, {"mine": ("front_left_hip", "rear_left_knee")})
    assert groups["all_knees"] == {n for n in names if n.endswith("knee")}
    assert groups["rear"] == {n for n in names if n.startswith("rear")}
    assert groups["mine"] == {"front_left_hip", "rear_left_knee"}


USER_EFFECT = '''
from simgap.effects.base import Effect, Site, Parameter

class Wind(Effect):
    """A steady wind along x."""
    name = "wind"

    @classmethod
    def candidates(cls, context):
        yield cls(Site("all", ()), [Parameter("speed", "m/s", 0.0, -10.0, 10.0, (-2.0, 2.0), 1.0)])

    def apply(self, variant, values):
        variant.model.opt.wind[0] = values[0]
        variant.model.opt.density = 1.2
'''


def test_a_user_adds_an_effect_in_a_file(tmp_path: Path) -> None:
    path = tmp_path / "mine.py"
    path.write_text(USER_EFFECT)
    classes = load_effects(path)
    plant, aligned, floor = aligned_of("pendulum", simulate("pendulum", 6.0))
    replayer = Replayer(plant, aligned, cut(aligned), floor, 1)
    context = Context(plant, measure_scales(replayer, Variant.nominal(plant)))
    assert "wind@all" in {e.key for e in enumerate_effects(context, classes)}
    path.write_text("import nothing_of_this_name")
    with pytest.raises(GapInputError, match=r"mine\.py"):
        load_effects(path)
    path.write_text("x = 1")
    with pytest.raises(GapInputError, match="defines no effect"):
        load_effects(path)


def test_the_leg_has_tendon_and_ground_effects() -> None:
    assert "tendon" in LEG
    keys = {e.key for e in _setup("leg")[2]}
    assert {"tendon_slack@knee_cable", "tendon_detached@knee_cable", "ground_friction@foot"} <= keys


@pytest.mark.parametrize("kind", [GroundSlope, GravityLean])
@pytest.mark.parametrize(("slope", "way"), [((0.1, 0.0), (1.0, 0.0)), ((0.0, 0.1), (0.0, -1.0))])
def test_a_slope_is_slid_down_whichever_way_it_is_seen(
    kind: type[GroundSlope | GravityLean], slope: tuple[float, float], way: tuple[float, float]
) -> None:
    """A puck without friction: g sin cos along the plumb line's level, or g sin in the axes of the ground."""
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><option timestep="0.001" cone="elliptic"/><worldbody><geom type="plane" size="9 9 1" friction="0"/>
        <body pos="0 0 0.02"><freejoint/><geom type="box" size=".05 .05 .02" friction="0"/></body>
        </worldbody></mujoco>"""
    )
    variant = SimpleNamespace(model=model)
    kind(Site("all", ()), []).apply(cast(Variant, variant), slope)
    data = mujoco.MjData(model)
    for _ in range(1000):
        mujoco.mj_step(model, data)
    steep = np.sin(0.1) * (np.cos(0.1) if kind is GroundSlope else 1.0)
    np.testing.assert_allclose(data.qpos[:2], 0.5 * 9.81 * steep * np.array(way), atol=0.02)
    assert (data.qpos[2] < -0.02) == (kind is GroundSlope)


FIRM = [("firm", 3.0, 0.0, 5e-4), ("", 3.0, 2e-3, 1e-2), ("firm", 5.0, 0.49, 0.51), ("", 5.0, 0.49, 0.51)]
"""Form, pull [N], and within which distances [m] it moves."""


@pytest.mark.parametrize(("form", "pull", "least", "most"), FIRM)
@pytest.mark.parametrize("kind", [CoulombFriction, StribeckFriction, TendonFriction])
def test_firm_friction_holds_what_is_smaller(
    kind: type[Effect], form: str, pull: float, least: float, most: float
) -> None:
    """A kilogram on a rail with 4 N of dry friction, under a pull for a second."""
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><option timestep="0.001" gravity="0 0 0"/><worldbody><body>
        <joint name="rail" type="slide" axis="1 0 0"/>
        <geom type="box" size=".05 .05 .05" mass="1"/></body></worldbody>
        <tendon><fixed name="cable"><joint joint="rail" coef="1"/></fixed></tendon></mujoco>"""
    )
    plant = SimpleNamespace(model=model)
    variant = SimpleNamespace(model=model, plant=plant, friction=FrictionPath.neutral(cast(Plant, plant)))
    values = (0.0, 4.0, 1.0) if kind is StribeckFriction else (4.0,)
    effect = kind(Site("rail", (0,)), [], form)
    assert {e.form for e in (effect, *effect.alternatives())} == {"", "firm"}
    effect.apply(cast(Variant, variant), values)
    data = mujoco.MjData(model)
    data.qfrc_applied[0] = pull
    for _ in range(1000):
        mujoco.mj_step(model, data)
    assert least <= data.qpos[0] <= most


def _held(law: str, form: str) -> float:
    """How far a rail that already rubs a little lets a kilogram creep in a second, with 4 N of friction added."""
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><option timestep="0.001" gravity="0 0 0"/><worldbody><body>
        <joint name="rail" type="slide" axis="1 0 0" frictionloss="0.5" {law}/>
        <geom type="box" size=".05 .05 .05" mass="1"/></body></worldbody></mujoco>"""
    )
    variant = SimpleNamespace(model=model, plant=SimpleNamespace(model=model))
    CoulombFriction(Site("rail", (0,)), [], form).apply(cast(Variant, variant), (4.0,))
    data = mujoco.MjData(model)
    data.qfrc_applied[0] = 3.0
    for _ in range(1000):
        mujoco.mj_step(model, data)
    return float(data.qpos[0])


def test_firm_friction_holds_where_the_model_has_some_already_but_a_law_of_its_own_stays() -> None:
    assert _held("", "firm") < 1e-5 < 1e-3 < _held("", "")
    own = 'solimpfriction="0.95 0.97 0.001 0.5 2"'
    assert _held(own, "firm") == _held(own, "")


_HIPS = (("q", "left"), ("p", "right"))


def test_what_no_channel_tells_anything_of_is_no_site() -> None:
    # Two legs on a fixed trunk, of which one is recorded: "all" joints are those of that leg.
    # No servo drives the other, so that it stays in the model (data/unrecorded.py).
    leg = '<body pos="{x} 0 1"><joint name="{n}_hip" axis="0 1 0"/><geom size=".05" mass="1"/></body>'
    legs = "".join(leg.format(x=x, n=n) for x, n in ((0, "left"), (1, "right")))
    servo = '<position name="left" joint="left_hip" kp="5" kv=".3"/>'
    xml = f"<mujoco><worldbody>{legs}</worldbody><actuator>{servo}</actuator></mujoco>"
    rows: dict[str, object] = {
        "time": {"column": "t", "unit": "s"},
        "inputs": [{"column": "u", "unit": "rad", "actuator": "left", "kind": "position"}],
        "outputs": [{"column": "q", "unit": "rad", "joint": "left_hip", "quantity": "position"}],
    }
    one = Context(build_plant(mujoco.MjSpec.from_string(xml), parse_map(rows)), cast(Scales, None))
    assert [s.name for s in named_sites(one, mujoco.mjtObj.mjOBJ_JOINT, [0, 1])] == ["left_hip"]
    assert [s.name for s in named_sites(one, mujoco.mjtObj.mjOBJ_BODY, [1, 2])] == ["body_1"]
    rows["outputs"] = [{"column": c, "unit": "rad", "joint": f"{j}_hip", "quantity": "position"} for c, j in _HIPS]
    both = Context(build_plant(mujoco.MjSpec.from_string(xml), parse_map(rows)), cast(Scales, None))
    assert [s.name for s in named_sites(both, mujoco.mjtObj.mjOBJ_JOINT, [0, 1])] == ["left_hip", "right_hip", "all"]
