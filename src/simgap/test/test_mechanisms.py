"""Does an effect of the library do what the mechanism of a hidden truth does, where all other numbers are right?"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import mujoco
import numpy as np
import pytest

from simgap.analysis.diagnose import diagnose
from simgap.analysis.options import Options
from simgap.blind import cases, recordings
from simgap.blind.cases import Case, Injected, robot_of
from simgap.blind.faults.base import LEVELS
from simgap.blind.faults.table import FAULTS
from simgap.blind.imitate import left_by_imitation
from simgap.blind.recordings import simulate
from simgap.blind.truth import record
from simgap.data.align import align
from simgap.data.mapping import parse_map
from simgap.data.noise_floor import noise_floor
from simgap.data.plant import Plant, build_plant
from simgap.data.recording import recording_from_table
from simgap.effects.base import Context, Effect
from simgap.effects.library import enumerate_effects
from simgap.inference.effort import Effort
from simgap.inference.fit import Fitter
from simgap.inference.hypothesis import Hypothesis
from simgap.inference.residual import Residuals
from simgap.inference.scores import Scores
from simgap.inference.screen import screen
from simgap.simulation.integration import step_inertia
from simgap.simulation.replay import Replayer
from simgap.simulation.scales import Scales, measure_scales
from simgap.simulation.variant import Variant
from simgap.simulation.windows import cut


@pytest.fixture
def exact(monkeypatch: pytest.MonkeyPatch) -> None:
    """Truths whose numbers are those of the nominal model."""
    build = recordings.build
    monkeypatch.setattr(recordings, "build", lambda *a, **k: build(*a, **(k | {"spread": (0.0, 0.0)})))


def _case(robot: str, name: str, level: int = 1, size: float | None = None, kind: str = "") -> Case:
    places = cases.all_sites(robot)
    fault = next(f for f in FAULTS if f.name == name and places[f.kind] and kind in ("", f.kind))
    site = places[fault.kind][0]
    size = fault.sizes[level] if size is None else size
    injected = Injected(name, fault.kind, site.name, site.members, LEVELS[level], size, True, site.places)
    return simulate(Case("000", robot, "single", (3, 5), 6.0, [injected]))


def _replayed(case: Case) -> tuple[Fitter, list[Effect], Plant]:
    robot = robot_of(case.robot)
    plant = build_plant(mujoco.MjSpec.from_string(robot.xml), parse_map(robot.mapping))
    # Truths have a finer step, at which servos act on the speed before it.
    plant.model.dof_armature[:] -= 1.4 * step_inertia(plant.model)
    aligned = align(recording_from_table(case.columns, plant), plant)
    nominal = Variant.nominal(plant)
    replayer = Replayer(plant, aligned, cut(aligned, 0.4, most=12), noise_floor(aligned), 1)
    effects = enumerate_effects(Context(plant, measure_scales(replayer, nominal), {}), (), ())
    return Fitter(Residuals.build(replayer, nominal), []), effects, plant


def _typical(fitter: Fitter, hypothesis: Hypothesis, x: list[float]) -> float:
    """Gap of a typical window [noise floors]."""
    values, none = np.array(x), np.zeros(0)
    starts = (fitter.variant(Hypothesis(), none, none), fitter.variant(hypothesis, values, none))
    fitter.residuals.update_start(*starts)
    return Scores(fitter).typical(fitter.mean_square(fitter.replay(hypothesis, [(values, none)])[0]))


@pytest.mark.parametrize(
    ("robot", "name"),
    [
        ("arm", "servo_backlash"),
        ("arm", "servo_rate_limit"),
        ("arm", "joint_range"),
        ("arm", "joint_elasticity"),
        ("arm", "soft_mount"),
        ("finger", "tendon_slack"),
        ("finger", "tendon_elasticity"),
    ],
)
def test_at_the_true_value_little_is_left(exact: None, robot: str, name: str) -> None:
    """The rest is the other time step, and the other law."""
    case = _case(robot, name)
    fitter, effects, _ = _replayed(case)
    (fault,) = case.faults
    without = _typical(fitter, Hypothesis(), [])
    left = [
        _typical(fitter, Hypothesis((effect,)), [fault.parameters[p.name] for p in effect.parameters])
        for effect in effects
        if (effect.name, effect.site.name) == (name, fault.site)
        and all(p.name in fault.parameters for p in effect.parameters)
    ]
    assert min(left) - 1.0 < 0.3 * (without - 1.0)


def test_a_filtered_report_is_told_from_a_late_one(exact: None) -> None:
    """The hidden one passes two filters, the library's one."""
    case = _case("pendulum", "sensor_delay", kind="filtered")
    fitter, effects, _ = _replayed(case)
    (fault,) = case.faults
    late, filtered = (e for e in effects if (e.name, e.site.name) == ("sensor_delay", fault.site))
    assert (late.form, filtered.form) == ("late", "filtered")
    without = _typical(fitter, Hypothesis(), [])
    best = min(_typical(fitter, Hypothesis((late,)), [k * fault.size]) for k in (0.5, 0.7, 0.85, 1.0, 1.2))
    left = _typical(fitter, Hypothesis((filtered,)), [fault.size])
    assert left - 1.0 < 0.1 * (without - 1.0)
    assert left < 0.7 * best


def test_a_ripple_with_a_weaker_second_wave_is_nearly_the_librarys(exact: None) -> None:
    case = _case("arm", "torque_ripple")
    fitter, effects, _ = _replayed(case)
    (fault,) = case.faults
    (effect,) = (e for e in effects if (e.name, e.site.name) == ("torque_ripple", fault.site))
    amplitude, period = fault.parameters["amplitude"], fault.parameters["period"]
    without = _typical(fitter, Hypothesis(), [])
    middle = effect.parameters[2].neutral
    left = [
        _typical(fitter, Hypothesis((effect,)), [amplitude, period, middle + share * period])
        for share in np.arange(-0.5, 0.5, 0.1)
    ]
    assert min(left) - 1.0 < 0.3 * (without - 1.0)
    assert max(left) > without


def test_a_sagging_supply_weakens_servos_at_their_limit_too(exact: None) -> None:
    """Both servos of the arm saturate in this recording."""
    case = _case("arm", "supply_sag", level=2)
    fitter, effects, _ = _replayed(case)
    truth = recordings.Truths(case, robot_of("arm")).broken()
    (effect,) = (e for e in effects if e.key == "supply_sag@all")
    sag = truth.sag * effect._reference / truth.sag_at  # type: ignore[attr-defined]
    assert _typical(fitter, Hypothesis((effect,)), [sag]) < 0.1 * _typical(fitter, Hypothesis(), [])


@pytest.mark.parametrize(("robot", "level"), [("pendulum", 1), ("arm", 2), ("camera", 1)])
def test_a_motor_that_warms_is_as_warm_in_every_window(exact: None, robot: str, level: int) -> None:
    """The hidden one warms by the torque that it asks for, step by step, and loses relative to a healthy robot's."""
    case = _case(robot, "thermal_drift", level)
    fitter, effects, plant = _replayed(case)
    (fault,) = case.faults
    plain = next(e for e in effects if e.key == f"thermal_drift@{fault.site}")
    (effect,) = plain.alternatives()
    usual = dict(zip(plain.site.targets, plain._usual, strict=True))  # type: ignore[attr-defined]
    servo = plant.model.actuator(fault.members[0]).id
    healthy = recordings.Truths(case, robot_of(robot))._scale().force[servo]
    loss = 4.0 * fault.size * (usual[servo] / healthy) ** 2
    without = _typical(fitter, Hypothesis(), [])
    left = _typical(fitter, Hypothesis((effect,)), [loss, fault.parameters["time"]])
    cold = _typical(fitter, Hypothesis((effect,)), [loss, 60.0])
    assert left - 1.0 < 0.2 * (without - 1.0)
    assert left < 0.5 * cold


def test_a_foot_that_slips_only_when_little_friction_is_left_is_tried_there(exact: None) -> None:
    """The leg hardly pushes sideways: with a quarter of its friction the foot still sticks, and little changes."""
    fitter, effects, _ = _replayed(_case("leg", "ground_friction", size=0.07))
    (effect,) = (e for e in effects if e.key == "ground_friction@foot")
    without = _typical(fitter, Hypothesis(), [])
    assert _typical(fitter, Hypothesis((effect,)), [0.25]) > 0.9 * without
    assert min(_typical(fitter, Hypothesis((effect,)), list(start)) for start in effect.starts()) < 0.7 * without


def test_an_effect_far_larger_than_its_starts_is_looked_for_where_it_is(exact: None) -> None:
    """Of a hip that hardly has to push, drag that counts beside its servo's is many times what its torque suggests."""
    case = _case("leg", "viscous_friction", size=3.0)
    (fault,) = case.faults
    fitter, effects, _ = _replayed(case)
    fitter.fit_nuisances()
    assert fitter.nominal is not None
    (drag,) = (e for e in effects if (e.name, e.site.name) == ("viscous_friction", fault.site))
    (found,) = screen(fitter, fitter.nominal, [drag])
    assert fault.parameters["damping"] > 3.0 * max(drag.parameters[0].tries)
    assert found.x[0] == pytest.approx(fault.parameters["damping"], rel=0.3)


@pytest.mark.parametrize("name", ["coulomb_friction", "stribeck_friction"])
def test_stribecks_law_is_tried_where_coulombs_wins_and_named_where_it_is_the_robots(name: str) -> None:
    """Only what screens best is fitted here, which is Coulomb's."""
    case = _case("pendulum", name)
    robot = robot_of("pendulum")
    plant = build_plant(mujoco.MjSpec.from_string(robot.xml), parse_map(robot.mapping))
    only = ("coulomb_friction", "stribeck_friction", "viscous_friction")
    options = Options(baselines=False, only=only, threads=1, effort=Effort(survivors=1))
    found = diagnose([recording_from_table(case.columns, plant)], plant, options)
    assert found.selection.screened[0].effect.name == "coulomb_friction"
    assert [e["name"] for e in found.report["effects"]] == [name]


def test_a_group_of_servos_is_told_in_one_unit() -> None:
    """An offset in radians is none in metres; a cable's is called slack, and says so."""
    _, effects, _ = _replayed(_case("finger", "servo_offset"))
    offsets = [e for e in effects if e.name == "servo_offset"]
    assert [e.site.name for e in offsets] == ["wrist_servo"]
    (slack,) = (e for e in effects if e.name == "tendon_slack")
    assert slack.aliases == ("servo_offset@cable_servo",) and slack.parameters[0].low < 0.0
    assert {"servo_gain@all", "servo_dead_band@cable_servo"} <= {e.key for e in effects}
    assert "servo_dead_band@all" not in {e.key for e in effects}


_CABLE = """<mujoco><compiler angle="radian"/><option timestep="0.001"/><worldbody>
<body><joint name="pulley" axis="0 1 0" damping=".05" armature=".01"/><geom size=".02" mass=".1"/></body>
<body pos=".2 0 0"><joint name="knee" axis="0 1 0" stiffness="2" springref="1" damping=".02" frictionloss="{knee}"/>
<geom type="capsule" fromto="0 0 0 0 0 -.1" size=".01" mass=".1"/></body></worldbody>
<tendon><fixed name="cable" limited="true" range="0 .001" frictionloss="{cable}">
<joint joint="pulley" coef="-.01"/><joint joint="knee" coef=".01"/></fixed></tendon>
<actuator><position name="servo" joint="pulley" kp="20" kv="0.5"/></actuator></mujoco>"""

_KNEE: dict[str, object] = {
    "time": {"column": "t", "unit": "s"},
    "inputs": [{"column": "u", "unit": "rad", "actuator": "servo", "kind": "position"}],
    "outputs": [{"column": "q", "unit": "rad", "joint": "knee", "quantity": "position"}],
}


def test_friction_in_the_routing_of_a_cable_that_does_not_stretch_is_its_joints() -> None:
    """MuJoCo's friction of tendons brakes a changing length, and a taut cable's does not change: it does nothing."""

    def swing(knee: float, cable: float) -> np.ndarray:
        model = mujoco.MjModel.from_xml_string(_CABLE.format(knee=knee, cable=cable))
        data, found = mujoco.MjData(model), []
        for k in range(2000):
            data.ctrl[0] = -0.4 + 0.3 * np.sin(4.0 * k * 1e-3)
            mujoco.mj_step(model, data)
            found.append(data.qpos[1])
        return np.array(found)[500:]

    free, cable, knee = swing(0.0, 0.0), swing(0.0, 1.0), swing(0.2, 0.0)
    assert np.abs(cable - free).max() < 0.05 * np.abs(knee - free).max()
    plant = build_plant(mujoco.MjSpec.from_string(_CABLE.format(knee=0.0, cable=0.0)), parse_map(_KNEE))
    context = Context(plant, cast(Scales, SimpleNamespace(torque=np.ones(2))))
    aliases = {e.key: e.aliases for e in enumerate_effects(context, only=("coulomb_friction",))}
    assert aliases["coulomb_friction@knee"] == ("tendon_friction@cable",)
    assert aliases["coulomb_friction@pulley"] == aliases["coulomb_friction@all"] == ()


_SERVO = """<mujoco><option timestep="{h}" integrator="{integrator}"/><worldbody><body>
<joint name="j" axis="0 1 0" damping="0.2" armature="0.02"/>
<geom type="capsule" fromto="0 0 0 0 0 -.2" size=".02" mass=".3"/>
</body></worldbody><actuator><position joint="j" kp="8" kv="0.3"/></actuator></mujoco>"""


@pytest.mark.parametrize("integrator", ["implicitfast", "Euler"])
def test_without_the_inertia_that_a_time_step_adds_a_coarse_simulation_is_nearly_exact(integrator: str) -> None:
    def swing(h: float, kind: str, corrected: bool) -> np.ndarray:
        model = mujoco.MjModel.from_xml_string(_SERVO.format(h=h, integrator=kind))
        if corrected:
            model.dof_armature[:] -= step_inertia(model)
        data, found = mujoco.MjData(model), []
        for k in range(round(1.0 / h)):
            data.ctrl[0] = 0.5 * (1.0 - np.cos(10.0 * k * h))
            mujoco.mj_step(model, data)
            found.append(data.qpos[0])
        return np.array(found)[round(0.02 / h) - 1 :: round(0.02 / h)]

    exact = swing(1e-4, "RK4", corrected=False)
    plain, better = (float(np.abs(swing(4e-3, integrator, c) - exact).max()) for c in (False, True))
    assert better < 0.4 * plain
    assert step_inertia(mujoco.MjModel.from_xml_string(_SERVO.format(h=4e-3, integrator="RK4"))) == 0.0


def test_what_nominal_numbers_imitate_is_not_seen() -> None:
    """Two numbers within tolerance explain their own changes, but not a shape that they do not make."""
    time = np.linspace(0.0, 1.0, 200)
    rng = np.random.default_rng(0)

    def seen(z: np.ndarray) -> np.ndarray:
        return 30.0 * np.stack([np.sin(3.0 * time * (1.0 + 0.1 * z[0])), (1.0 + 0.1 * z[1]) * time], 1)

    noise = rng.standard_normal((200, 2))
    assert left_by_imitation(seen, seen(np.array([0.9, -0.8])) + noise, 2) < 1.1
    assert left_by_imitation(seen, seen(np.array([0.0, 3.0])) + noise, 2) > 2.5
    assert left_by_imitation(seen, seen(np.zeros(2)) + 5.0 * np.sign(np.sin(40 * time))[:, None] + noise, 2) > 4.0


def test_a_walking_robot_put_back_to_where_it_was_sees_the_same() -> None:
    """With a play, whose robot has a joint more, up to what the play lets it turn."""
    fault = next(f for f in FAULTS if f.name == "servo_backlash")
    site = cases.all_sites("quad")[fault.kind][0]
    play = Injected("servo_backlash", fault.kind, site.name, site.members, "weak", 0.05, True, site.places)
    for faults, close in (([], 1e-9), ([play], 0.05)):
        truths = recordings.Truths(Case("000", "quad", "single", (3, 6), 1.0, faults), robot_of("quad"))
        made, healthy = truths.broken(), truths.truth()
        commands = recordings.told(made.model, robot_of("quad").mapping, truths.table)
        way = record(made, commands, {}, np.random.default_rng(0))
        put = {k: made.rigid(way.states[k], healthy.model) for k in range(20, 200, 20)}
        back = record(healthy, commands, {}, np.random.default_rng(0), put)
        for name, values in way.columns.items():
            np.testing.assert_allclose(back.columns[name][20:200:20], values[20:200:20], atol=close, err_msg=name)


def test_a_fault_that_nominal_numbers_imitate_grows_until_it_is_seen() -> None:
    """The servo's damping may be off by more than this anyway."""
    fault = next(f for f in FAULTS if f.name == "viscous_friction")
    (site,) = cases.all_sites("pendulum")[fault.kind]
    small = Injected("viscous_friction", fault.kind, site.name, site.members, "weak", 0.03, True, site.places)
    case = recordings.realise(Case("000", "pendulum", "single", (3, 6), 3.0, [small]))
    assert case.faults[0].size > 0.04
    assert case.healthy_shift > recordings.VISIBLE


def test_a_zero_that_is_off_does_not_show_on_a_pole_whose_mass_may_lie_aside() -> None:
    """It hangs, and swings, just so; but it does not weigh on its cart like a heavier one."""
    for name, size, site, shows in (("sensor_bias", 0.05, "swing", False), ("mass", 0.6, "pole", True)):
        kind = next(f.kind for f in FAULTS if f.name == name)
        place = next(s for s in cases.all_sites("cart_pole")[kind] if s.name == site)
        injected = Injected(name, kind, site, place.members, "weak", size, True, place.places)
        case = simulate(Case("000", "cart_pole", "single", (3, 6), 2.0, [injected]))
        left = recordings.Truths(case, robot_of("cart_pole")).beyond_healthy(case.columns)
        assert case.healthy_shift > recordings.VISIBLE
        assert (left > recordings.VISIBLE) == shows, left


def arm_with_a_load_and(name: str, size: float, load: float) -> tuple[Case, recordings.Truths]:
    """A recording of the arm with a fault of its elbow, and a heavier forearm."""
    places = cases.all_sites("arm")
    pair = [
        Injected(f.name, f.kind, site.name, site.members, "medium", amount, True, site.places)
        for wanted, amount in ((name, size), ("mass", load))
        for f in FAULTS
        if f.name == wanted
        for site in places[f.kind][1:2]
    ]
    case = simulate(Case("000", "arm", "pair", (3, 6), 4.0, pair))
    return case, recordings.Truths(case, robot_of("arm"))


@pytest.mark.parametrize(("name", "size"), [("servo_delay", 0.03), ("servo_backlash", 0.2)])
def test_of_a_pair_each_fault_must_show_beside_the_other(name: str, size: float) -> None:
    """A robot with both of them, the other's size not quite known, can imitate a pair; one with one of them cannot."""
    case, truths = arm_with_a_load_and(name, size, load=1.0)
    assert truths.beyond_healthy(case.columns, case.faults) < recordings.VISIBLE
    for other in case.faults:
        assert truths.beyond_healthy(case.columns, [other]) > recordings.VISIBLE


def test_of_a_pair_the_play_s_width_may_be_off_as_well(monkeypatch: pytest.MonkeyPatch) -> None:
    """Most of what is left with a play that is a quarter too wide goes when the play may be narrower."""
    case, truths = arm_with_a_load_and("servo_backlash", 0.2, load=0.6)
    play, heavy = case.faults
    wide = [replace(play, size=1.25 * play.size), heavy]
    free = truths.beyond_healthy(case.columns, wide)
    monkeypatch.setattr(recordings, "ABOUT", 0.0)
    assert free < 0.5 * truths.beyond_healthy(case.columns, wide)


def test_faults_that_are_one_change_under_two_names_are_not_drawn() -> None:
    """What turns about one upright axis shows its mass as inertia; a sprung joint's drag is its damping."""
    camera, finger, arm = (cases.all_sites(name) for name in ("camera", "finger", "arm"))
    kinds = {f.name: f.kind for f in FAULTS}
    assert {s.name for s in camera[kinds["com_shift"]]} == {"fork", "eye"}
    assert len(arm[kinds["com_shift"]]) == 2
    assert {s.name for s in finger[kinds["viscous_friction"]]} == {"wrist"}
    assert {s.name for s in finger[kinds["joint_damping"]]} == {"knuckle"}
