"""The engine against plain mj_step loops, and the residual's promises."""

from __future__ import annotations

from dataclasses import fields, replace

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray
from robots import MODELS, aligned_of, plant_of, simulate

from simgap.data.align import Aligned, align
from simgap.data.noise_floor import noise_floor
from simgap.data.plant import Plant
from simgap.data.recording import recording_from_table
from simgap.inference.residual import Residuals, channel_gap
from simgap.simulation.extra_laws import SHAPES, needs_past, needs_step
from simgap.simulation.integration import finer
from simgap.simulation.replay import Replayer
from simgap.simulation.variant import Variant
from simgap.simulation.windows import at_limit, cut, unseen

Array = NDArray[np.float64]


def _replayer(name: str, threads: int = 1, **kwargs: object) -> tuple[Plant, Aligned, Replayer]:
    plant, aligned, floor = aligned_of(name, simulate(name, 10.0, **kwargs))  # type: ignore[arg-type]
    return plant, aligned, Replayer(plant, aligned, cut(aligned), floor, threads)


@pytest.mark.parametrize("name", MODELS)
def test_gap_of_the_truth_is_one(name: str) -> None:
    _, _, replayer = _replayer(name)
    nominal = Variant.nominal(replayer.plant)
    residuals = Residuals.build(replayer, nominal)
    gap = channel_gap(residuals.of([nominal])[0], residuals.mask)
    assert (gap > 0.5).all() and (gap < 1.3).all()


@pytest.mark.parametrize("name", ["arm", "leg", "pendulum"])
def test_drop_outs_leave_the_gap_of_the_truth_at_one(name: str) -> None:
    """A window that began in a hole began elsewhere, and was judged by what came behind it."""
    table, random = simulate(name, 15.0), np.random.default_rng(5)
    lost, begin = np.zeros(len(table["t"]), dtype=bool), 0.7
    while begin < 15.0:
        end = begin + random.uniform(0.3, 1.2)
        lost |= (table["t"] >= begin) & (table["t"] < end)
        begin = end + random.uniform(1.0, 2.0)
    for column in [c for c in table if c.startswith("q")]:
        table[column][lost] = np.nan
    plant, aligned, floor = aligned_of(name, table)
    replayer = Replayer(plant, aligned, cut(aligned), floor, 1)
    windows, holes = replayer.windows, unseen(aligned)
    assert len(windows) > 5 and np.mean(holes) > 0.2
    assert not any(holes[start - windows.warm_up : start + 1].any() for start in windows.start)
    nominal = Variant.nominal(plant)
    residuals = Residuals.build(replayer, nominal)
    gap = channel_gap(residuals.of([nominal])[0], residuals.mask)
    assert (gap > 0.5).all() and (gap < 1.3).all()


def test_a_slower_sensor_has_no_holes() -> None:
    _, whole, _ = aligned_of("arm", simulate("arm", 8.0))
    valid = whole.valid.copy()
    valid[np.arange(len(valid)) % 7 > 0, 1] = False
    assert not unseen(whole).any() and not unseen(replace(whole, valid=valid)).any()
    valid[700:760, 1] = False
    found = np.flatnonzero(unseen(replace(whole, valid=valid)))
    assert 690 < found[0] <= 700 and 760 <= found[-1] < 772 and (np.diff(found) == 1).all()


def test_a_finer_step_is_closer_to_a_leg_that_has_none() -> None:
    def continuous(model: mujoco.MjModel) -> None:
        model.opt.timestep = 6.25e-5

    plant, aligned, floor = aligned_of("leg", simulate("leg", 6.0, noise=2e-5, change=continuous))
    left = []
    for times in (1, 2, 4):
        fine = finer(plant, times)
        assert fine.model.opt.timestep == plant.model.opt.timestep / times
        nominal = Variant.nominal(fine)
        residuals = Residuals.build(Replayer(fine, aligned, cut(aligned), floor, 1), nominal)
        left.append(float((residuals.of([nominal])[0] ** 2).mean()))
    assert left[1] < 0.7 * left[0] and left[2] < left[1], left
    pendulum, _, _ = aligned_of("pendulum", simulate("pendulum", 5.0))
    assert finer(pendulum) is pendulum, "no contact"


def test_same_bits_at_any_number_of_threads_and_company() -> None:
    _, _, one = _replayer("arm", 1)
    _, _, two = _replayer("arm", 2)
    nominal, late = Variant.nominal(one.plant), Variant.nominal(one.plant)
    late.inputs.delay[:] = 0.013
    late.servos.dead_band[0] = 0.01
    together = one.run([nominal, late, nominal])
    np.testing.assert_array_equal(together, two.run([nominal, late, nominal]))
    np.testing.assert_array_equal(together[0], together[2])
    np.testing.assert_array_equal(together[0], one.run([nominal])[0])
    np.testing.assert_array_equal(one.run([late], np.array([3, 7]))[0], together[1][[3, 7]])


def test_replay_equals_mj_step() -> None:
    """A window is what a loop over mj_step from the same start gives (with constant inputs)."""
    table = simulate("arm", 10.0)
    table["u0"][:], table["u1"][:] = 0.3, -0.2
    plant, aligned, floor = aligned_of("arm", table)
    windows = cut(aligned)
    replayer = Replayer(plant, aligned, windows, floor, 1)
    simulated = replayer.run([Variant.nominal(plant)])[0, 4]
    data = mujoco.MjData(plant.model)
    row = windows.start[4]
    data.qpos[:], data.qvel[:] = replayer.state.position[row], replayer.state.velocity[row]
    data.ctrl[:] = [0.3, -0.2]
    expected = []
    for _ in range(windows.length * 2):
        mujoco.mj_step(plant.model, data)
        expected.append(data.sensordata.copy())
    np.testing.assert_allclose(simulated, np.array(expected)[windows.sample * 2], atol=1e-9)


CHANGES = {
    "dof_damping": lambda m: m.dof_damping.__iadd__(0.3),
    "dof_frictionloss": lambda m: m.dof_frictionloss.__iadd__(0.2),
    "body_mass": lambda m: m.body_mass.__imul__(1.3),
    "gravity": lambda m: m.opt.gravity.__iadd__([0.5, 0, 0]),
    "armature": lambda m: m.dof_armature.__iadd__(0.02),
    "kp": lambda m: (m.actuator_gainprm.__imul__(0.8), m.actuator_biasprm.__imul__(0.8)),
}


@pytest.mark.parametrize("change", list(CHANGES))
def test_a_changed_model_explains_a_changed_robot(change: str) -> None:
    _, _, replayer = _replayer("arm", change=CHANGES[change])
    nominal, changed = Variant.nominal(replayer.plant), Variant.nominal(replayer.plant)
    CHANGES[change](changed.model)
    residuals = Residuals.build(replayer, changed)
    before, after = channel_gap(residuals.of([nominal, changed]), residuals.mask)
    assert (after < 1.3).all() and before.max() > 5.0


def test_a_late_command_explains_a_late_robot() -> None:
    def late(table: dict[str, Array]) -> dict[str, Array]:
        return {k: np.concatenate([np.full(4, v[0]), v[:-4]]) for k, v in table.items()}

    _, _, replayer = _replayer("arm", signal=late)
    variant = Variant.nominal(replayer.plant)
    variant.inputs.delay[:] = 4 * 0.005
    residuals = Residuals.build(replayer, variant)
    before, after = channel_gap(residuals.of([Variant.nominal(replayer.plant), variant]), residuals.mask)
    assert (after < 1.3).all() and (before > 20.0).all()


@pytest.mark.parametrize(("robot", "share"), [("leg", 0.1), ("finger", 0.15), ("arm", 0.4), ("pendulum", 0.5)])
def test_narrow_play_is_no_play(robot: str, share: float) -> None:
    """A play that shrinks to nothing leaves the nominal model, but for half a time step that its motor lags behind.

    That lag is small beside a play of 0.02 rad on the leg; the others move fast.
    """
    _, _aligned, replayer = _replayer(robot)
    nominal = Variant.nominal(replayer.plant)
    gaps = []
    for width in (1e-6, 0.02, 0.1):
        variant = nominal.copy()
        variant.servos.backlash[0] = width
        gaps.append(np.abs(replayer.run([variant])[0] - replayer.run([nominal])[0])[..., 0].max())
    assert gaps[0] < share * gaps[1] < gaps[2]


def test_stribeck_friction_lies_between_its_limits() -> None:
    """At a velocity scale far above every motion it is Coulomb friction, far below it is none."""
    _, _, replayer = _replayer("pendulum")
    nominal = Variant.nominal(replayer.plant)
    coulomb, fast, slow = nominal.copy(), nominal.copy(), nominal.copy()
    coulomb.model.dof_frictionloss[:] = 0.3
    for variant, scale in ((fast, 1e6), (slow, 1e-9)):
        variant.friction.stribeck[:], variant.friction.stribeck_velocity[:] = 0.3, scale
    outputs = replayer.run([nominal, coulomb, fast, slow])
    assert np.abs(outputs[1] - outputs[0]).max() > 1e-2
    np.testing.assert_allclose(outputs[2], outputs[1], atol=1e-9)
    np.testing.assert_allclose(outputs[3], outputs[0], atol=1e-9)


@pytest.mark.parametrize("path", ["servos", "friction"])
def test_every_law_that_acts_makes_its_variant_be_stepped(path: str) -> None:
    nominal = Variant.nominal(plant_of("leg"))
    assert not needs_step(nominal) and not needs_past(nominal)
    names = {field.name for field in fields(getattr(nominal, path))}
    for name in names:
        variant = nominal.copy()
        changed = getattr(variant, path)
        setattr(changed, name, getattr(changed, name) + True)
        assert needs_step(variant) == (name not in SHAPES), name
        assert name not in SHAPES or SHAPES[name] in names - SHAPES.keys(), f"{name} shapes no law"


def test_sensor_paths_are_undone_at_the_start_of_a_window() -> None:
    """A biased, scaled and late sensor is explained by the same path, although windows start from what it says."""
    table = simulate("arm", 10.0)
    shifted = np.concatenate([np.full(3, table["q1"][0]), table["q1"][:-3]])
    table["q1"] = 1.1 * shifted + 0.05
    plant, aligned, floor = aligned_of("arm", table)
    replayer = Replayer(plant, aligned, cut(aligned), floor, 1)
    variant = Variant.nominal(plant)
    variant.outputs.scale[1], variant.outputs.bias[1], variant.outputs.delay[1] = 1.1, 0.05, 3 * 0.005
    residuals = Residuals.build(replayer, variant)
    before, after = channel_gap(residuals.of([Variant.nominal(plant), variant]), residuals.mask)
    assert (after < 1.4).all() and before[1] > 20.0


def test_a_broken_simulation_is_told_apart() -> None:
    _, _, replayer = _replayer("arm")
    broken = Variant.nominal(replayer.plant)
    broken.model.dof_damping[:] = -1e4
    outputs = replayer.run([Variant.nominal(replayer.plant), broken])
    assert np.isfinite(outputs[0]).all() and np.isnan(outputs[1]).any()


def test_a_sensor_rests_at_its_limit_although_its_noise_was_judged_too_small() -> None:
    _, aligned, floor = aligned_of("arm", simulate("arm", 12.0))
    limit = np.percentile(aligned.outputs[:, 0], 70)
    outputs, seen = aligned.outputs.copy(), aligned.outputs[:, 0] > limit
    noise = 1.5 * floor[0] * np.random.default_rng(0).standard_normal(int(seen.sum()))
    outputs[seen, 0] = limit + noise
    outputs[:, 1] = 0.0
    found = at_limit(replace(aligned, outputs=outputs), floor)
    assert np.mean(found[seen]) > 0.8 and np.mean(found[~seen]) < 0.02


def test_windows_do_not_begin_where_a_sensor_is_saturated() -> None:
    _, aligned, floor = aligned_of("arm", simulate("arm", 12.0))
    assert not at_limit(
        replace(aligned, outputs=1e-3 * np.random.default_rng(0).standard_normal(aligned.outputs.shape)),
        np.full(2, 1e-3),
    ).any()
    clipped = replace(aligned, outputs=np.clip(aligned.outputs, None, np.percentile(aligned.outputs, 60, axis=0)))
    avoided = at_limit(clipped, floor)
    assert 0.1 < avoided.mean() < 0.8
    windows, plain = cut(clipped, avoided=avoided), cut(clipped)
    begins = [avoided[s - windows.warm_up : s + 1].any() for s in windows.start]
    assert np.mean(begins) < 0.5 * np.mean([avoided[s - plain.warm_up : s + 1].any() for s in plain.start])
    assert np.all(np.diff(windows.start) >= windows.length)


def test_where_a_dead_channel_s_joint_is_follows_from_its_servo() -> None:
    """And asking how far it is a guess leaves the replay as it was."""
    table = simulate("arm", 10.0)
    table["q1"][:] = 0.31
    plant, aligned, floor = aligned_of("arm", table)
    replayer = Replayer(plant, aligned, cut(aligned), floor, 1)
    nominal = [Variant.nominal(plant)]
    before = replayer.run(nominal)
    assert len(replayer.unseen()) == 1
    assert replayer.guesswork() < 0.1
    np.testing.assert_array_equal(before, replayer.run(nominal))


def test_a_servo_that_was_switched_off_gives_no_torque_then() -> None:
    own: list[mujoco.MjModel] = []
    kept: list[Array] = []

    def switch(data: mujoco.MjData) -> None:
        model = own[-1]
        off = (int(data.time / 0.005 + 1e-6) * 0.005) % 2.0 > 1.201
        model.actuator_gainprm[:], model.actuator_biasprm[:] = (0.0, 0.0) if off else (kept[0], kept[1])

    def keep(model: mujoco.MjModel) -> None:
        own.append(model)
        kept.extend([model.actuator_gainprm.copy(), model.actuator_biasprm.copy()])

    table = simulate("pendulum", 12.0, change=keep, push=switch)
    table["on"] = (table["t"] % 2.0 <= 1.201).astype(float)
    gaps: dict[bool, float] = {}
    for told in (True, False):
        row = {"enabled": {"column": "on"}} if told else {}
        plant = plant_of("pendulum", lambda data, row=row: data.update(row))  # type: ignore[misc]
        aligned = align(recording_from_table(table, plant), plant)
        assert aligned.enabled.all() != told
        floor = noise_floor(aligned)
        replayer = Replayer(plant, aligned, cut(aligned, 0.4), floor, 1)
        residuals = Residuals.build(replayer, Variant.nominal(plant))
        # Of most windows: one that begins in the corner of a switch has a bad start.
        gaps[told] = np.median(np.sqrt((residuals.of([Variant.nominal(plant)])[0] ** 2).mean(axis=(1, 2))))
    assert gaps[True] < 1.5 and gaps[False] > 10.0
