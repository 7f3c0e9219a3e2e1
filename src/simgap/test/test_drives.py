"""Drives that give, reports that are filtered, supplies that sway: laws against what follows from them."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
import pytest
from mujoco import batch as mjbatch
from numpy.typing import NDArray
from robots import plant_of, simulate

from simgap.data.align import align
from simgap.data.mapping import parse_map
from simgap.data.noise_floor import noise_floor
from simgap.data.plant import build_plant
from simgap.data.recording import recording_from_table
from simgap.data.supply import measured_supply, sways
from simgap.effects.base import Context
from simgap.effects.library import enumerate_effects
from simgap.inference.fit import Fitter
from simgap.inference.hypothesis import Hypothesis
from simgap.inference.residual import Residuals
from simgap.simulation.extra_laws import ServoStep
from simgap.simulation.replay import Replayer
from simgap.simulation.scales import measure_scales
from simgap.simulation.signal_path import filtered
from simgap.simulation.variant import Variant
from simgap.simulation.windows import cut

Array = NDArray[np.float64]

_STEP, _KP, _LENGTH, _MASS = 0.001, 400.0, 0.2, 0.5
_TURNTABLE = f"""<mujoco><option timestep="{_STEP}" gravity="0 0 {{gravity}}"/><worldbody><body name="link">
<joint name="j" axis="{{axis}}" armature="0.001"/>
<inertial pos="{_LENGTH} 0 0" mass="{_MASS}" diaginertia="1e-4 1e-4 1e-4"/><geom size=".01" mass="0"/>
</body></worldbody><actuator><position name="servo" joint="j" kp="{_KP}" kv="4"/></actuator></mujoco>"""
_MAP = {
    "time": {"column": "t", "unit": "s"},
    "inputs": [{"column": "u", "unit": "rad", "actuator": "servo", "kind": "position"}],
    "outputs": [{"column": "q", "unit": "rad", "joint": "j", "quantity": "position"}],
}
_INERTIA = _MASS * _LENGTH**2 + 1e-4


def _moved(
    compliance: float,
    gravity: float,
    axis: str,
    seconds: float,
    target: Callable[[float], float],
    volts: float = 1.0,
    ringing: float = 0.05,
) -> Array:
    """Angle (n,) of a link behind an elastic drive, whose servo has so many times the usual voltage."""
    spec = mujoco.MjSpec.from_string(_TURNTABLE.format(gravity=gravity, axis=axis))
    plant = build_plant(spec, parse_map(_MAP))
    variant = Variant.nominal(plant)
    variant.servos.compliance[:], variant.servos.ringing[:] = compliance, ringing
    variant.servos.follows = 1.0 if volts != 1.0 else 0.0
    batch = mjbatch.Batch(plant.model, 1, 1)
    batch.reset(stage=mujoco.mjtStage.mjSTAGE_NONE.value)
    servo = ServoStep(plant, [variant], _STEP)
    if servo.active:
        servo.bind(batch)
    found = []
    for k in range(round(seconds / _STEP)):
        control = np.array([[target(k * _STEP)]])
        if servo.active:
            control, force = servo.step(control, np.array([volts]))
            batch.qfrc_applied[:] = force
        batch.ctrl[:] = control
        batch.step()
        found.append(float(batch.qpos[0, 0]))
    return np.array(found)


@pytest.mark.parametrize("compliance", [0.0, 0.02, 0.1])
def test_a_drive_that_gives_and_its_servo_are_two_springs_in_a_row(compliance: float) -> None:
    hangs = _moved(compliance, -9.81, "0 1 0", 4.0, lambda t: 0.0)[-200:].mean()
    # The link sinks until its weight's torque is what the two springs give: about y, down is positive.
    give = compliance + 1.0 / _KP
    assert hangs / give == pytest.approx(_MASS * 9.81 * _LENGTH * np.cos(hangs), rel=0.01)


def test_torque_goes_with_the_voltage() -> None:
    for volts in (0.8, 1.0, 1.1):
        hangs = _moved(0.0, -9.81, "0 1 0", 3.0, lambda t: 0.0, volts)[-200:].mean()
        assert hangs * _KP * volts == pytest.approx(_MASS * 9.81 * _LENGTH * np.cos(hangs), rel=0.01)


def test_a_supply_that_sways_is_read_and_explains_its_servos() -> None:
    """A robot whose servos give what the battery lets them, beside a voltmeter; in millivolts, with its noise."""

    def volts(t: float) -> float:
        return 1.0 + 0.15 * float(np.sin(2.0 * np.pi * 0.4 * t))

    def weaken(data: mujoco.MjData) -> None:
        data.qfrc_applied[:] = (volts(data.time) - 1.0) * data.qfrc_actuator

    table = simulate("arm", 7.5, seed=3, push=weaken)
    noise = np.random.default_rng(1).normal(0.0, 10.0, len(table["t"]))
    table["battery"] = 7400.0 * np.array([volts(t) for t in table["t"]]) + noise
    plant = plant_of("arm", lambda data: data.update(auxiliary=[{"column": "battery", "unit": "mV"}]))
    recording = recording_from_table(table, plant)
    supply = measured_supply(align(recording, plant), plant.map)
    assert supply is not None and sways(supply)
    np.testing.assert_allclose(supply[100:700], [volts(t) for t in table["t"]][100:700], atol=0.01)
    aligned, nominal = align(recording, plant), Variant.nominal(plant)
    replayer = Replayer(plant, aligned, cut(aligned, 0.5, most=8), noise_floor(aligned), 1)
    context = Context(plant, measure_scales(replayer, nominal), swaying=sways(replayer.supply))
    (effect,) = (e for e in enumerate_effects(context, (), ("supply_sag",)) if e.form == "measured")
    fitter = Fitter(Residuals.build(replayer, nominal), [])
    without = fitter.fit(Hypothesis(), np.zeros(0), np.zeros(0))
    fit = fitter.fit(Hypothesis((effect,)), np.array([0.3]), np.zeros(0))
    assert fit.x[0] == pytest.approx(1.0, abs=0.1)
    assert fitter.mean_square(fit.residual).mean() < 0.1 * fitter.mean_square(without.residual).mean()


@pytest.mark.parametrize("volts", [7.4, 0.0])
def test_a_steady_supply_is_no_cause(volts: float) -> None:
    plant = plant_of("arm", lambda data: data.update(auxiliary=[{"column": "battery", "unit": "V"}]))
    table = simulate("arm", 4.5)
    table["battery"] = np.full(len(table["t"]), volts)
    assert not sways(measured_supply(align(recording_from_table(table, plant), plant), plant.map))
    assert not sways(None)


def test_where_runs_have_supplies_of_their_own_the_voltage_is_that_beside_each() -> None:
    def edit(data: dict[str, object]) -> None:
        runs = {0: {"supply": 7.0}, 1: {"supply": 8.0}}
        data.update(auxiliary=[{"column": "battery", "unit": "V"}], segments={"column": "run", "runs": runs})

    table = simulate("arm", 9.0)
    table["run"] = (table["t"] >= 4.5).astype(float)
    table["battery"] = 7.0 + table["run"]
    plant = plant_of("arm", edit)
    assert not sways(measured_supply(align(recording_from_table(table, plant), plant), plant.map))
    together = plant_of("arm", lambda data: data.update(auxiliary=[{"column": "battery", "unit": "V"}]))
    assert sways(measured_supply(align(recording_from_table(table, together), together), together.map))


@pytest.mark.parametrize("compliance", [0.02, 0.1])
def test_a_drive_that_gives_rings(compliance: float) -> None:
    """Against a motor that hardly moves the link swings at the root of stiffness over inertia."""
    swings = _moved(compliance, 0.0, "0 0 1", 1.5, lambda t: 0.2)
    stiffness = 1.0 / (compliance + 1.0 / _KP)
    period = 2.0 * np.pi * np.sqrt(_INERTIA / stiffness)
    past = swings[round(0.3 / _STEP) :] - 0.2
    crossings = np.flatnonzero(np.diff(np.sign(past)) > 0)
    assert len(crossings) > 3
    assert np.diff(crossings).mean() * _STEP == pytest.approx(period, rel=0.05)
    assert np.abs(past[: round(period / _STEP)]).max() > 0.02, "a rigid drive stands still by then"
    assert np.abs(_moved(0.0, 0.0, "0 0 1", 1.5, lambda t: 0.2)[round(0.3 / _STEP) :] - 0.2).max() < 0.001


@pytest.mark.parametrize("ratio", [0.03, 0.1, 0.25])
def test_how_long_a_drive_rings_is_its_damping_ratio(ratio: float) -> None:
    """From the logarithmic decrement of what swings behind a motor that hardly gives."""
    swings = _moved(0.1, 0.0, "0 0 1", 2.0, lambda t: 0.2, ringing=ratio)[round(0.1 / _STEP) :] - 0.2
    peaks = [k for k in range(1, len(swings) - 1) if swings[k - 1] < swings[k] >= swings[k + 1] and swings[k] > 1e-4]
    decrement = np.log(swings[peaks[0]] / swings[peaks[1]])
    assert decrement / np.hypot(2.0 * np.pi, decrement) == pytest.approx(ratio, rel=0.2)


def test_a_filter_lags_by_its_time_constant() -> None:
    steps = np.array([5.0, 40.0])
    ramp = np.tile(np.arange(800.0), (2, 1))
    np.testing.assert_allclose(ramp[:, -1] - filtered(ramp, steps)[:, -1], steps, rtol=1e-6)
    step = np.ones((2, 800))
    step[:, 0] = 0.0
    risen = filtered(step, steps)
    for row, lag in zip(risen, steps, strict=True):
        assert row[round(lag)] == pytest.approx(1.0 - np.exp(-1.0), abs=0.1)
    np.testing.assert_array_equal(filtered(ramp, np.zeros(2)), ramp)
