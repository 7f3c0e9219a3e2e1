"""Servos that lose torque as they warm: the law in a replay, a known loss, a thermometer, what is exported."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest
import yaml
from numpy.typing import NDArray
from robots import MAPS, MODELS, plant_of, simulate

from simgap.correction.apply import apply
from simgap.correction.changes import correction
from simgap.correction.signals import Signals
from simgap.data.align import align
from simgap.data.errors import GapInputError
from simgap.data.mapping import load_map
from simgap.data.noise_floor import noise_floor
from simgap.data.plant import Plant, build_plant, load_spec
from simgap.data.recording import recording_from_table
from simgap.data.temperature import measured_warming, warms
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

LOSS, TIME, USUAL = 1.5, 3.0, 1.0
"""Of the pendulum's servo: what it loses, within how many seconds, relative to how many N m."""


class Hot:
    """A servo that warms, beside a plain simulation: `qfrc_applied` takes away what its motor lacks."""

    def __init__(self, servo: int = 0) -> None:
        self.servo, self.heat, self.seen = servo, 0.0, [0.0]

    def __call__(self, data: mujoco.MjData) -> None:
        model = data.model
        # What the servo asks for here; the force in the data is that of the step before.
        length, rate = data.qpos[self.servo], data.qvel[self.servo]
        bias = model.actuator_biasprm[self.servo]
        asked = model.actuator_gainprm[self.servo, 0] * data.ctrl[self.servo] + bias[1] * length + bias[2] * rate
        if model.actuator_forcelimited[self.servo]:
            asked = np.clip(asked, *model.actuator_forcerange[self.servo])
        left = 1.0 / (1.0 + LOSS * self.heat)
        data.qfrc_applied[self.servo] = (left - 1.0) * asked
        self.heat += model.opt.timestep / TIME * ((asked / USUAL) ** 2 - self.heat)
        self.seen.append(self.heat)


def _table(seconds: float = 12.0) -> tuple[dict[str, Array], Hot]:
    hot = Hot()
    return simulate("pendulum", seconds, seed=2, push=hot), hot


def _replayer(plant: Plant, table: dict[str, Array], horizon: float = 0.5, most: int = 12) -> Replayer:
    aligned = align(recording_from_table(table, plant), plant)
    return Replayer(plant, aligned, cut(aligned, horizon, most=most), noise_floor(aligned), 1)


def _heated(plant: Plant, loss: float = LOSS) -> Variant:
    variant = Variant.nominal(plant)
    variant.servos.heat_loss[:], variant.servos.heat_time[:], variant.servos.heat_reference[:] = loss, TIME, USUAL
    return variant


def _effects(replayer: Replayer) -> list[Effect]:
    nominal = Variant.nominal(replayer.plant)
    context = Context(replayer.plant, measure_scales(replayer, nominal), warming=replayer.heat.measured)
    return enumerate_effects(context, (), ("thermal_drift",))


def _left(replayer: Replayer, variants: list[Variant]) -> list[float]:
    """Root mean squares of what each variant leaves of the recording, in noise floors."""
    measured = replayer.aligned.outputs[replayer.windows.rows()]
    found = (replayer.run(variants) - measured[None]) / replayer.floor
    return [float(np.sqrt((f**2).mean())) for f in found]


def test_heat_beside_a_replay_is_that_of_an_independent_simulation() -> None:
    table, hot = _table()
    plant = plant_of("pendulum")
    replayer = _replayer(plant, table)
    variant = _heated(plant)
    inputs = replayer.aligned.inputs
    left = replayer.heat.left(variant, inputs, replayer.state)
    assert left is not None
    seconds = plant.model.opt.timestep * np.arange(len(hot.seen))
    expected = 1.0 / (1.0 + LOSS * np.interp(replayer.aligned.time, seconds, hot.seen))
    assert expected.min() < 0.7, "it has to warm"
    np.testing.assert_allclose(left[:, 0], expected, atol=0.02)
    nothing, all_of_it = _left(replayer, [Variant.nominal(plant), variant])
    assert nothing > 10.0
    assert all_of_it < 0.1 * nothing


def test_each_run_begins_cold() -> None:
    table, _ = _table(9.0)
    table["run"] = (table["t"] > 4.5).astype(float)
    plant = plant_of("pendulum", lambda data: data.update(segments={"column": "run"}))
    replayer = _replayer(plant, table)
    left = replayer.heat.left(_heated(plant), replayer.aligned.inputs, replayer.state)
    assert left is not None
    one, two = replayer.aligned.runs
    assert left[one.start, 0] == left[two.start, 0] == 1.0
    assert max(left[one.stop - 1, 0], left[two.stop - 1, 0]) < 0.9


def test_a_known_loss_and_its_time_are_found() -> None:
    table, _ = _table(15.0)
    plant = plant_of("pendulum")
    replayer = _replayer(plant, table, most=24)
    (effect,) = _effects(replayer)
    (own,) = effect.alternatives()
    fitter = Fitter(Residuals.build(replayer, Variant.nominal(plant)), [])
    fit = fitter.fit(Hypothesis((own,)), np.array([2.0, 4.0]), np.zeros(0))
    loss, time = fit.x
    made = Variant.nominal(plant)
    own.apply(made, (loss, time))
    # Relative to another usual torque, the same loss is another number.
    found = made.servos.heat_loss[0] / made.servos.heat_reference[0] ** 2
    assert found == pytest.approx(LOSS / USUAL**2, rel=0.1)
    assert time == pytest.approx(TIME, rel=0.15)


def _told(row: dict[str, object]) -> Callable[[dict[str, object]], None]:
    return lambda data: data.update(auxiliary=[row])


def test_where_a_thermometer_was_read_torque_goes_with_it() -> None:
    """A motor that warms by 30 K whatever it does, and loses a fifth for each 10 K; in Fahrenheit, with noise."""
    warming = [0.0]

    def weaken(data: mujoco.MjData) -> None:
        warming[0] = 30.0 * (1.0 - float(np.exp(-data.time / 4.0)))
        bias = data.model.actuator_biasprm[0]
        asked = data.model.actuator_gainprm[0, 0] * data.ctrl[0] + bias[1] * data.qpos[0] + bias[2] * data.qvel[0]
        asked = np.clip(asked, *data.model.actuator_forcerange[0])
        data.qfrc_applied[0] = asked * (1.0 / (1.0 + 0.2 * warming[0] / 10.0) - 1.0)

    table = simulate("pendulum", 9.0, seed=3, push=weaken)
    kelvins = 295.0 + 30.0 * (1.0 - np.exp(-table["t"] / 4.0))
    noise = np.random.default_rng(0).normal(0.0, 0.2, len(kelvins))
    table["motor"] = (kelvins - 273.15 + noise) * 9.0 / 5.0 + 32.0
    plant = plant_of("pendulum", _told({"column": "motor", "unit": "degF", "actuator": "servo"}))
    replayer = _replayer(plant, table)
    (effect,) = _effects(replayer)
    assert effect.form == "measured"
    fitter = Fitter(Residuals.build(replayer, Variant.nominal(plant)), [])
    fit = fitter.fit(Hypothesis((effect,)), np.array([0.1]), np.zeros(0))
    assert fit.x[0] == pytest.approx(0.2, abs=0.02)


def test_a_motor_that_stays_as_warm_as_it_was_is_judged_by_its_torque() -> None:
    plant = plant_of("pendulum", _told({"column": "motor", "unit": "degC", "actuator": "servo"}))
    table = simulate("pendulum", 4.5)
    table["motor"] = np.full(len(table["t"]), 40.0)
    aligned = align(recording_from_table(table, plant), plant)
    (warming,) = measured_warming(aligned, plant.model, plant.map).values()
    assert not warms(warming)
    assert [e.form for e in _effects(_replayer(plant, table))] == [""]


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ({"column": "motor", "unit": "degC", "actuator": "servos"}, "did you mean servo"),
        ({"column": "motor", "unit": "V", "actuator": "servo"}, "it is a temperature"),
    ],
)
def test_a_thermometer_that_cannot_be_is_refused(row: dict[str, object], message: str) -> None:
    with pytest.raises(GapInputError, match=message):
        plant_of("pendulum", _told(row))


def test_a_corrected_model_leaves_nothing(tmp_path: Path) -> None:
    """Written and read again it does to the recording what the diagnosis does, its other numbers changed as well."""
    table, _ = _table()
    (tmp_path / "robot.xml").write_text(MODELS["pendulum"])
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(MAPS["pendulum"]))
    plant = plant_of("pendulum")
    replayer = _replayer(plant, table)
    found = _heated(plant)
    report = {"correction": correction(plant, found).report()}
    out, new_map = tmp_path / "new.xml", tmp_path / "new_map.yaml"
    apply(report, tmp_path / "robot.xml", out, tmp_path / "signals.py", (tmp_path / "map.yaml", new_map))
    corrected = build_plant(load_spec(out), load_map(new_map))
    before = _left(replayer, [Variant.nominal(plant)])[0]
    after = _left(_replayer(corrected, table), [Variant.nominal(corrected)])[0]
    assert before > 10.0
    assert after == pytest.approx(_left(replayer, [found])[0], rel=0.01)
    assert after < 0.1 * before
    # With another gain as well, its law heats it in both alike.
    found.model.actuator_gainprm[0, 0] *= 1.1
    found.model.actuator_biasprm[0, 1] *= 1.1
    apply({"correction": correction(plant, found).report()}, tmp_path / "robot.xml", out, tmp_path / "signals.py",
          (tmp_path / "map.yaml", new_map))  # fmt: skip
    corrected = build_plant(load_spec(out), load_map(new_map))
    wanted, (again,) = replayer.run([found])[0], _replayer(corrected, table).run([Variant.nominal(corrected)])
    np.testing.assert_allclose(again, wanted, atol=1e-6)


def test_the_wrapper_warms_as_the_law_says() -> None:
    """Beside `mj_step`, on a servo that holds a weight: heat has its own differential equation, here in small steps."""
    plant = plant_of("pendulum")
    model, data = plant.model, mujoco.MjData(plant.model)
    rows = [("heat_loss", LOSS), ("heat_time", TIME), ("heat_reference", USUAL)]
    signals = Signals(model, [{"where": "servo", "name": "servo", "quantity": q, "value": v} for q, v in rows])
    heat, gain, bias = 0.0, model.actuator_gainprm[0, 0], model.actuator_biasprm[0]
    for _ in range(round(4.0 / model.opt.timestep)):
        mujoco.mj_forward(model, data)
        asked = gain * 1.2 + bias[1] * data.qpos[0] + bias[2] * data.qvel[0]
        asked = float(np.clip(asked, *model.actuator_forcerange[0]))
        signals.step(data, [1.2])
        mujoco.mj_forward(model, data)
        assert data.actuator_force[0] == pytest.approx(asked / (1.0 + LOSS * heat), rel=1e-3, abs=1e-4)
        heat += model.opt.timestep / TIME * ((asked / USUAL) ** 2 - heat)
        mujoco.mj_step(model, data)
    assert heat > 0.3
