"""The corrected model with its map is the model that was diagnosed, and moves as the diagnosis says."""

from __future__ import annotations

import copy
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from numpy.typing import NDArray
from robots import MAPS, MODELS, plant_of, simulate

from simgap.correction.apply import apply
from simgap.correction.changes import Signal, correction
from simgap.correction.known_map import write_map
from simgap.data.align import align
from simgap.data.errors import GapInputError
from simgap.data.mapping import load_map
from simgap.data.noise_floor import noise_floor
from simgap.data.plant import Plant, build_plant, load_spec
from simgap.data.recording import recording_from_table
from simgap.effects.base import Context
from simgap.effects.library import enumerate_effects
from simgap.inference.nuisance import apply_nuisances, enumerate_nuisances
from simgap.simulation.replay import Replayer
from simgap.simulation.scales import measure_scales
from simgap.simulation.variant import Variant
from simgap.simulation.windows import cut

Array = NDArray[np.float64]
ARM_SERVOS = ("shoulder_servo", "elbow_servo")


class Bench:
    """A robot, its log, and what a corrected model of it does."""

    def __init__(self, name: str, folder: Path) -> None:
        self.name, self.folder = name, folder
        (folder / "robot.xml").write_text(MODELS[name])
        (folder / "map.yaml").write_text("# of the workshop\n" + yaml.safe_dump(MAPS[name]))
        self.table = simulate(name, 4.5)
        self.plant = plant_of(name)
        self.replayer = self.replayer_of(self.plant)
        self.context = Context(self.plant, measure_scales(self.replayer, Variant.nominal(self.plant)))

    def replayer_of(self, plant: Plant) -> Replayer:
        aligned = align(recording_from_table(self.table, plant), plant)
        return Replayer(plant, aligned, cut(aligned, 0.5, most=3), noise_floor(aligned), 1)

    def corrected(self, variant: Variant, again: bool = False) -> Plant:
        """The plant of what `apply` writes."""
        report = {"correction": correction(variant.plant, variant).report()}
        start = [self.folder / ("new" if again else "robot"), self.folder / "new"]
        files = start[0].with_suffix(".xml"), self.folder / ("new_map.yaml" if again else "map.yaml")
        out = self.folder / ("newer.xml" if again else "new.xml")
        new_map = out.with_name(f"{out.stem}_map.yaml")
        apply(report, files[0], out, self.folder / "signals.py", (files[1], new_map))
        assert "# of the workshop" in new_map.read_text()
        return build_plant(load_spec(out), load_map(new_map))

    def differs(self, variant: Variant, plant: Plant) -> float:
        """How far the corrected model goes from the variant, as a share of how far the variant goes from nominal."""
        nominal, wanted = self.replayer.run([Variant.nominal(self.plant), variant])
        (found,) = self.replayer_of(plant).run([Variant.nominal(plant)])
        assert np.isfinite(found).all()
        return float(np.abs(found - wanted).max() / max(np.abs(wanted - nominal).max(), 1e-9))


@pytest.mark.parametrize("name", ["cart_pole", "arm", "leg"])
def test_every_effect_is_there_again(name: str, tmp_path: Path) -> None:
    bench = Bench(name, tmp_path)
    share: dict[str, float] = {}
    effects = enumerate_effects(bench.context)
    effects += [a for e in effects for a in e.alternatives() if a.form in ("damped", "own time", "swaying")]
    for effect in effects:
        for end in (0, -1) if name != "leg" else (-1,):
            variant = Variant.nominal(bench.plant)
            effect.apply(variant, tuple(p.tries[end] for p in effect.parameters))
            share[f"{effect.key} {effect.form} {end}"] = bench.differs(variant, bench.corrected(variant))
    # What a joint with friction below zero would do, no model can: it is told as none.
    share = {key: value for key, value in share.items() if "friction" not in key or not key.endswith(" 0")}
    assert len(share) > 40 and not {k: v for k, v in share.items() if v > 0.01}


def _moved(plant: Plant, bench: Bench, seed: int) -> Variant:
    """All nominal numbers somewhere within their tolerances."""
    aligned, rng, variant = bench.replayer.aligned, np.random.default_rng(seed), Variant.nominal(plant)
    sizes = aligned.outputs.std(axis=0), np.sqrt((aligned.inputs**2).mean(axis=0))
    nuisances = enumerate_nuisances(plant, *sizes, aligned.period)
    apply_nuisances(nuisances, variant, rng.uniform(-1.0, 1.0, len(nuisances)))
    return variant


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("name", ["cart_pole", "arm", "leg"])
def test_so_are_nominal_numbers_and_what_is_found_in_the_corrected_model(name: str, seed: int, tmp_path: Path) -> None:
    bench = Bench(name, tmp_path)
    first = _moved(bench.plant, bench, seed)
    once = bench.corrected(first)
    assert bench.differs(first, once) < 0.02
    second = _moved(once, bench, seed + 10)
    twice = bench.corrected(second, again=True)
    nominal, wanted = bench.replayer_of(once).run([Variant.nominal(once), second])
    (found,) = bench.replayer_of(twice).run([Variant.nominal(twice)])
    assert np.abs(found - wanted).max() < 0.02 * np.abs(wanted - nominal).max()


def test_a_delay_within_a_time_step_stays_out_of_the_model(tmp_path: Path) -> None:
    """MuJoCo makes a whole step of it."""
    bench = Bench("arm", tmp_path)
    step = float(bench.plant.model.opt.timestep)
    for delay, inside in ((0.4 * step, False), (2.4 * step, True)):
        variant = Variant.nominal(bench.plant)
        variant.inputs.delay[:] = delay
        plant = bench.corrected(variant)
        assert bench.differs(variant, plant) < 1e-3
        assert bool(plant.model.actuator_delay.any()) is inside and bool(plant.known) is not inside


def test_a_map_of_any_layout_takes_what_was_found(tmp_path: Path) -> None:
    signals = [Signal("command", "elbow_servo", "delay", 0.0123, "s"), Signal("sensor", "q0", "bias", -0.01, "rad")]
    (tmp_path / "robot.xml").write_text(MODELS["arm"])
    old = {"where": "sensor", "name": "q0", "quantity": "scale", "value": 1.1}
    texts = {
        "plain": yaml.safe_dump(MAPS["arm"]),
        "in one line": yaml.safe_dump(MAPS["arm"], default_flow_style=True, width=10**6),
        "with signals": yaml.safe_dump({"signals": [old], **MAPS["arm"]}, sort_keys=False) + "# the end\n",
    }
    for text in texts.values():
        (tmp_path / "map.yaml").write_text(text)
        write_map(tmp_path / "map.yaml", signals, tmp_path / "new.yaml", *[tmp_path / "robot.xml"] * 2)
        read = load_map(tmp_path / "new.yaml")
        assert [(s.name, s.quantity, s.value) for s in read.signals] == [
            ("elbow_servo", "delay", 0.0123), ("q0", "bias", -0.01)]  # fmt: skip
        assert read.inputs == load_map(tmp_path / "map.yaml").inputs
        assert ("# the end" in text) == ("# the end" in (tmp_path / "new.yaml").read_text())


def test_gains_of_the_robots_own_controller_go_into_its_map(tmp_path: Path) -> None:
    motors = re.sub(r'<position (name="\w+" joint="\w+") [^/]*/>', r"<motor \1/>", MODELS["arm"])
    mapping = copy.deepcopy(MAPS["arm"]) | {"gains": {n: {"kp": 20.0, "kd": 0.5} for n in ARM_SERVOS}}
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(mapping))
    signals = [Signal("controller", ARM_SERVOS[0], "kp", 30.0, "N m/rad")]
    (tmp_path / "robot.xml").write_text(motors)
    write_map(tmp_path / "map.yaml", signals, tmp_path / "new.yaml", *[tmp_path / "robot.xml"] * 2)
    gains = load_map(tmp_path / "new.yaml").gains
    assert {n: (g.kp, g.kd) for n, g in gains.items()} == {ARM_SERVOS[0]: (30.0, 0.5), ARM_SERVOS[1]: (20.0, 0.5)}
    with pytest.raises(GapInputError, match="gains: has no 'hip'"):
        write_map(tmp_path / "map.yaml", [Signal("controller", "hip", "kp", 1.0, "")], tmp_path / "new.yaml",
                  *[tmp_path / "robot.xml"] * 2)  # fmt: skip


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ({"where": "motor"}, r"signals\[0\].where: must be one of"),
        ({"quantity": "delya"}, r"signals\[0\].*a command has no delya; did you mean delay"),
        ({"value": float("nan")}, r"signals\[0\].value: must be a finite number"),
        ({"quantity": "loss", "value": 1.0}, r"loss must be at least 0 and at most 0.99, not 1"),
        ({"quantity": "rate_limit", "value": 0.0}, r"rate_limit must be more than 0"),
        ({"quantity": "scale", "value": 0.0}, r"scale must not be 0"),
        ({"name": "elbow"}, r"signals\[0\].name: 'elbow' is not there; did you mean elbow_servo"),
        ({"quantity": "jitter", "value": 0.01}, r"jitter of 'elbow_servo' needs a row with its update"),
        ({"where": "sensor", "quantity": "bias"}, r"signals\[0\].name: 'elbow_servo' is not there"),
        ({"where": "sensor", "quantity": "turned_about_x"}, r"signals\[0\].name: 'elbow_servo' is not there"),
        ({"unit": "s"}, r"signals\[0\].unit: there is no such key"),
    ],
)
def test_wrong_signals_are_refused(row: dict[str, Any], message: str, tmp_path: Path) -> None:
    right = {"where": "command", "name": "elbow_servo", "quantity": "delay", "value": 0.01}
    (tmp_path / "robot.xml").write_text(MODELS["arm"])
    (tmp_path / "map.yaml").write_text(yaml.safe_dump({**MAPS["arm"], "signals": [{**right, **row}]}))
    with pytest.raises(GapInputError, match=message):
        build_plant(load_spec(tmp_path / "robot.xml"), load_map(tmp_path / "map.yaml"))
