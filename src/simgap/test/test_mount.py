"""A mount that gives way: the replay's law against MuJoCo's own joints, and what is found of it."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
import yaml
from numpy.typing import NDArray
from robots import MAPS, MODELS, plant_of

from simgap.blind.robots import commands
from simgap.correction.apply import apply
from simgap.correction.changes import correction
from simgap.correction.signals import Signals
from simgap.data.align import align
from simgap.data.mapping import load_map
from simgap.data.mounting import fixed_bases, mounting
from simgap.data.noise_floor import noise_floor
from simgap.data.plant import Plant, build_plant, load_spec
from simgap.data.recording import recording_from_table
from simgap.effects.base import Context, Effect
from simgap.effects.library import enumerate_effects
from simgap.inference.fit import Fitter
from simgap.inference.hypothesis import Hypothesis
from simgap.inference.residual import Residuals
from simgap.simulation.replay import Replayer
from simgap.simulation.scales import measure_scales
from simgap.simulation.variant import Variant
from simgap.simulation.windows import cut

Array = NDArray[np.float64]
PERIOD, NOISE, OWN = 0.005, 4e-4, 0.3
"""[s]; standard deviation of joint angles [rad]; inertia of a stand as a share of the robot's."""
ROOTS = {"arm": "upper", "camera": "column"}


class Stand:
    """A robot on a stand of two hinges, written into its file, and what the stand is."""

    def __init__(self, name: str, hertz: float, ratio: float = 0.1) -> None:
        self.name, self.plant = name, plant_of(name)
        found = self.plant.mounting
        assert found is not None
        self.body, carried = found.bodies[0], float(found.inertia.mean())
        self.inertia, self.ratio = OWN * carried, ratio
        stiffness = (2.0 * np.pi * hertz) ** 2 * (carried + self.inertia)
        self.compliance = 1.0 / stiffness
        damping = 2.0 * ratio * np.sqrt(stiffness * (carried + self.inertia))
        told = f'stiffness="{stiffness}" damping="{damping}" armature="{self.inertia}"'
        root = f'<body name="{ROOTS[name]}">'
        below = f"""<body name="stand"><joint axis="1 0 0" {told}/><joint axis="0 1 0" {told}/>
          <inertial pos="0 0 0" mass="1e-6" diaginertia="1e-9 1e-9 1e-9"/>{root}"""
        xml = MODELS[name].replace(root, below).replace("</worldbody>", "</body></worldbody>")
        self.model = mujoco.MjModel.from_xml_string(xml)

    def record(self, seconds: float, rest: float = 0.0, noise: float = NOISE) -> dict[str, Array]:
        """A log; the robot is told to stand still for ``rest`` seconds, after it has come to rest."""
        n, data = int(seconds / PERIOD), mujoco.MjData(self.model)
        told = commands(self.name, 0, n, PERIOD)
        begin = int(rest / PERIOD)
        if rest:
            told = {c: np.concatenate([np.zeros(begin), u[: n - begin] - u[0]]) for c, u in told.items()}
            mujoco.mj_step(self.model, data, 4000)
        rows = np.empty((n, len(self.plant.outputs)))
        for k in range(n):
            for channel in self.plant.inputs:
                data.ctrl[channel.actuator] = told[channel.column][k] * channel.scale
            mujoco.mj_forward(self.model, data)
            rows[k] = self.plant.read(data.sensordata)
            mujoco.mj_step(self.model, data, round(PERIOD / self.model.opt.timestep))
        rows += noise * np.random.default_rng(1).standard_normal(rows.shape)
        outputs = {c.column: rows[:, i] for i, c in enumerate(self.plant.outputs)}
        return {"t": PERIOD * np.arange(n), **told, **outputs}

    def variant(self) -> Variant:
        made = Variant.nominal(self.plant)
        made.mounts.compliance[self.body] = self.compliance
        made.mounts.ringing[self.body], made.mounts.inertia[self.body] = self.ratio, self.inertia
        return made


def _replayer(plant: Plant, table: dict[str, Array], horizon: float) -> Replayer:
    aligned = align(recording_from_table(table, plant), plant)
    return Replayer(plant, aligned, cut(aligned, horizon), noise_floor(aligned), 1)


def _gap(replayer: Replayer, variant: Variant) -> float:
    """Of a typical window [noise floors]."""
    (found,) = replayer.run([variant])
    left = (found - replayer.aligned.outputs[replayer.windows.rows()]) / replayer.floor
    return float(np.median(np.sqrt((left**2).mean(axis=(1, 2)))))


def _effect(replayer: Replayer) -> Effect:
    context = Context(replayer.plant, measure_scales(replayer, Variant.nominal(replayer.plant)))
    (found,) = enumerate_effects(context, (), ("soft_mount",))
    return found


@pytest.mark.parametrize("name", ["arm", "camera"])
@pytest.mark.parametrize("hertz", [3.0, 8.0, 15.0])
def test_from_rest_the_replay_goes_as_a_robot_on_real_hinges(name: str, hertz: float) -> None:
    stand = Stand(name, hertz)
    table = stand.record(9.0, rest=0.3, noise=1e-5)
    replayer = _replayer(stand.plant, table, 1.0)
    nominal, tilting = replayer.run([Variant.nominal(stand.plant), stand.variant()], np.array([0]))[:, 0]
    measured = replayer.aligned.outputs[replayer.windows.rows()[0]]
    angles = [i for i, c in enumerate(stand.plant.outputs) if c.unit == "rad"]
    error, size = (np.abs(found - measured)[:, angles].max() for found in (tilting, nominal))
    assert size > 2.0 * error
    assert error < max(0.08 * size, 0.4 * NOISE)


@pytest.mark.parametrize(("hertz", "left"), [(3.0, 6.0), (8.0, 2.0), (30.0, 1.5)])
def test_in_full_motion_little_is_left_of_what_it_does(hertz: float, left: float) -> None:
    """What rings on from before a window is known by its run-in alone."""
    stand = Stand("arm", hertz)
    replayer = _replayer(stand.plant, stand.record(10.0), 1.0)
    nominal, found = _gap(replayer, Variant.nominal(stand.plant)), _gap(replayer, stand.variant())
    assert found < left
    assert found < 0.4 * nominal or hertz > 8.0


def test_a_compliance_is_found_again() -> None:
    stand = Stand("arm", 6.0)
    replayer = _replayer(stand.plant, stand.record(12.0), 0.6)
    (swaying,) = _effect(replayer).alternatives()
    fitter = Fitter(Residuals.build(replayer, Variant.nominal(stand.plant)), [])
    fit = fitter.fit(Hypothesis((swaying,)), np.array([0.3 * stand.compliance, 0.01, 0.05]), np.zeros(0))
    assert fit.x[0] == pytest.approx(stand.compliance, rel=0.1)
    assert fit.x[2] == pytest.approx(stand.ratio, abs=0.06)


def test_the_corrected_model_has_no_gap(tmp_path: Path) -> None:
    stand = Stand("arm", 8.0)
    table = stand.record(10.0)
    (tmp_path / "robot.xml").write_text(MODELS["arm"])
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(MAPS["arm"]))
    found = correction(stand.plant, stand.variant())
    assert {(s.where, s.name, s.quantity) for s in found.signals} == {
        ("mount", "upper", quantity) for quantity in ("compliance", "ringing", "inertia")
    }
    out, maps = tmp_path / "new.xml", (tmp_path / "map.yaml", tmp_path / "new_map.yaml")
    apply({"correction": found.report()}, tmp_path / "robot.xml", out, tmp_path / "signals.py", maps)
    plant = build_plant(load_spec(out), load_map(maps[1]))
    before = _gap(_replayer(stand.plant, table, 0.6), Variant.nominal(stand.plant))
    after = _gap(_replayer(plant, table, 0.6), Variant.nominal(plant))
    assert before > 3.0 and after < 2.0


def test_the_wrapper_leans_gravity_as_far_as_the_stand_tilts_at_rest() -> None:
    stand = Stand("camera", 5.0, 1.0)
    standing, model = mujoco.MjData(stand.model), plant_of("camera").model
    mujoco.mj_step(stand.model, standing, 8000)
    rows = [{"where": "mount", "name": "column", "quantity": "compliance", "value": stand.compliance}]
    signals, data = Signals(model, rows), mujoco.MjData(model)
    for _ in range(4000):
        signals.step(data, np.zeros(model.nu))
        mujoco.mj_step(model, data)
    tilt = standing.qpos[:2]
    assert np.abs(tilt).max() > 1e-3
    np.testing.assert_allclose(model.opt.gravity[:2] / 9.81, [tilt[1], -tilt[0]], rtol=0.15, atol=1e-4)


_GANTRY = """<mujoco><worldbody><geom name="floor" type="plane" size="1 1 .1"/><body name="foot" pos="0 0 .02">
<geom type="box" size=".1 .1 .05" mass="1"/><body name="arm" quat="0 1 0 0"><joint name="a" axis="0 0 1"/>
<joint name="b" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 .2 0 -.2" size=".02" mass=".3"/></body></body>
<body name="cart" pos="0 1 1"><joint type="slide"/><geom size=".01"/></body>
<body name="ball" pos="0 2 1"><freejoint/><geom size=".01"/></body>
<body name="wall" pos="1 0 0"><geom size=".1 .1 .1" type="box"/></body></worldbody>
<actuator><motor joint="b"/></actuator></mujoco>"""


def test_what_stands_fixed_with_joints_on_it_can_tilt_and_nothing_else() -> None:
    spec = mujoco.MjSpec.from_string(_GANTRY)
    model = spec.compile()
    assert [model.body(b).name for b in fixed_bases(model)] == ["foot"]
    found = mounting(spec, model)
    assert found is not None and spec.compile().njnt == model.njnt
    names = [found.model.joint(int(j)).name for j in found.rows["jnt"]]
    assert names == [model.joint(j).name for j in range(model.njnt)]
    # It stands in the floor, which did not matter while neither moved.
    data = mujoco.MjData(found.model)
    mujoco.mj_forward(found.model, data)
    assert not any(found.model.body("foot").id in found.model.geom_bodyid[contact.geom] for contact in data.contact)


@pytest.mark.parametrize("name", ["quad", "leg", "cart_pole"])
def test_what_floats_or_slides_has_no_mount(name: str) -> None:
    assert plant_of(name).mounting is None


def test_a_mount_that_gives_nothing_is_the_plain_model_to_the_last_bit() -> None:
    stand = Stand("arm", 6.0)
    replayer = _replayer(stand.plant, stand.record(9.0), 0.6)
    nominal, same, firm = (Variant.nominal(stand.plant) for _ in range(3))
    same.mounts.ringing[:], same.mounts.inertia[:] = 0.3, 1.0
    firm.mounts.compliance[stand.body] = 1e-9
    outputs = replayer.run([nominal, same, firm])
    np.testing.assert_array_equal(outputs[1], outputs[0])
    np.testing.assert_allclose(outputs[2], outputs[0], atol=1e-6)


def test_other_laws_act_on_a_mount_as_they_do_without() -> None:
    stand = Stand("arm", 6.0)
    replayer = _replayer(stand.plant, stand.record(9.0), 0.6)
    nominal = Variant.nominal(stand.plant)
    made = [nominal.copy() for _ in range(6)]
    made[0].servos.backlash[0], made[1].servos.compliance[1] = 0.05, 0.01
    made[2].friction.stribeck[:], made[2].friction.stribeck_velocity[:] = 0.2, 0.5
    made[3].inputs.delay[:], made[3].model.dof_damping[:] = 0.03, 0.4
    made[4].friction.ripple[:], made[4].friction.ripple_period[:] = 0.5, 0.3
    made[5].servos.heat_loss[:] = 1.0
    firm = [variant.copy() for variant in made]
    for variant in firm:
        variant.mounts.compliance[stand.body] = 1e-9
    plain, mounted = (replayer.run(variants) for variants in (made, firm))
    moved = np.abs(plain - replayer.run([nominal])).max(axis=(1, 2, 3))
    assert (moved > 3e-3).all()
    assert (np.abs(mounted - plain).max(axis=(1, 2, 3)) < 0.02 * moved).all()
