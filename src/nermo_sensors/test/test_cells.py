"""The cells of a foot are a list: a third kind is a class and an entry, and a foot may lack one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nermo_description.feet import named_readings, readings_by_cell
from nermo_description.parameter_files import ParameterError, read_yaml, write_yaml
from nermo_sensors.bench.rig import Rig
from nermo_sensors.cells import Cells
from nermo_sensors.cells.cell import CellParameters
from nermo_sensors.estimation.estimator import LegLoadEstimator
from nermo_sensors.estimation.health import Fault
from nermo_sensors.models.foot import TactileFeet
from nermo_sensors.parameters import TactileParameters, load_tactile

TICK = 5_000_000
CONVERTER = {"lower": 0.0, "upper": 5.0, "bits": 12}


class LinearPad(CellParameters):
    """Volts in proportion to the load."""

    gain: float

    def make(self) -> LinearPad:
        return self

    def read(self, force: float, period: float, frequency: float, temperature: float, offset: float = 0.0) -> float:
        return self.converter.make().read(self.gain * force + offset)

    def clear(self) -> None:
        pass

    def expected(self, load: Any) -> tuple[Any, Any]:
        return self.gain * load, self.gain


class ThreeCells(Cells):
    """With a third kind."""

    pad: LinearPad | None = None


class ThreeCellFeet(TactileParameters):
    """Feet that may have it."""

    cells: ThreeCells


def feet_with(**cells: Any) -> ThreeCellFeet:
    """Nermo-Lite's feet with other cells; None takes one away."""
    data = load_tactile("nermo_lite").model_dump()
    data["cells"] |= cells
    return ThreeCellFeet.model_validate(data)


def walk(feet: TactileParameters, seconds: float, broken: str = "") -> tuple[LegLoadEstimator, float]:
    """Four feet that bear 0 to 1.4 N in turn; the estimator, and the rms error of the second half [N]."""
    estimator, twin = LegLoadEstimator(feet), TactileFeet(feet, seed=2)
    errors = []
    for tick in range(1, round(seconds / 0.005)):
        phases = 0.005 * tick + np.array([0.0, 0.5, 0.25, 0.75])
        loads = 1.4 * np.clip(np.sin(2.0 * np.pi * phases), 0.0, None)
        readings = twin.read(loads.tolist(), 0.005)
        readings.pop(broken, None)
        answer = estimator.step(tick * TICK, readings, 2.0 * np.pi, (loads == 0.0).tolist())
        if answer is not None:
            errors.append(answer.load - loads)
    return estimator, float(np.sqrt(np.mean(np.array(errors)[len(errors) // 2 :] ** 2)))


PAD = {"gain": 2.0, "noise": 0.005, "converter": CONVERTER}


def test_a_third_cell_is_felt_sent_and_believed() -> None:
    feet = feet_with(pad=PAD)
    assert set(TactileFeet(feet).read([0.5] * 4, 0.005)) == {"piezoresistive", "piezoelectric", "pad"}
    estimator, error = walk(feet, 4.0)
    assert estimator.cells == ("piezoresistive", "piezoelectric", "pad")
    assert estimator.broken() == []
    assert error < 0.5 * walk(load_tactile("nermo_lite"), 4.0)[1], "a good cell more makes the estimate better"


@pytest.mark.parametrize("missing", ["piezoresistive", "piezoelectric", "pad"])
def test_any_cell_of_three_may_fall_silent(missing: str) -> None:
    feet = feet_with(pad=PAD)
    estimator, error = walk(feet, 4.0, broken=missing)
    place = estimator.cells.index(missing)
    assert set(estimator.broken()) == {(foot, place, Fault.MISSING) for foot in range(4)}
    assert error < 0.15


@pytest.mark.parametrize("cells", [{"piezoelectric": None}, {"piezoresistive": None, "pad": PAD}])
def test_a_foot_may_lack_one(cells: dict[str, Any]) -> None:
    estimator, error = walk(feet_with(**cells), 4.0)
    assert estimator.broken() == []
    assert error < 0.25


def test_one_entry_over_a_base_changes_one_cell(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    write_yaml({"base": "nermo_lite", "name": "mine", "cells": {"piezoelectric": {"gain": 0.8}}}, file)
    mine, base = load_tactile(file).cells.present, load_tactile("nermo_lite").cells.present
    assert mine["piezoelectric"] == base["piezoelectric"].model_copy(update={"gain": 0.8})
    assert mine["piezoresistive"] == base["piezoresistive"]


@pytest.mark.parametrize(
    ("cells", "words"),
    [
        ({"piezoelectrik": {}}, "cells.piezoelectrik: no such field; did you mean 'piezoelectric'"),
        ({"piezoelectric": {"gian": 1.0}}, "cells.piezoelectric.gian: no such field; did you mean 'gain'"),
        ({"piezoelectric": {"gain": -1.0}}, "cells.piezoelectric.gain: is -1.0"),
        ({"piezoelectric": None, "piezoresistive": None}, "there is none; known are piezoresistive, piezoelectric"),
    ],
)
def test_a_wrong_cell_is_named(tmp_path: Path, cells: dict[str, Any], words: str) -> None:
    file = tmp_path / "mine.yaml"
    write_yaml({"base": "nermo_lite", "name": "mine", "cells": cells}, file)
    with pytest.raises(ParameterError, match=words):
        load_tactile(file)
    assert read_yaml(file)["base"] == "nermo_lite"


def test_the_bench_of_two_cells_says_which_one_is_not_there() -> None:
    with pytest.raises(ParameterError, match="have no piezoelectric cell, which this needs; they have piezoresistive"):
        Rig().run(feet_with(piezoelectric=None), seed=1)


def test_readings_go_through_a_message_by_name() -> None:
    readings = {"piezoresistive": [1.0, 2.0, 3.0, 4.0], "pad": [5.0, 6.0, 7.0, 8.0]}
    names, voltages = named_readings(readings)
    assert names[0] == "front_left_piezoresistive" and names[-1] == "rear_right_pad"
    assert readings_by_cell(names[::-1], voltages[::-1]) == readings
    told = readings_by_cell([*names[1:], "tail_pad"], [*voltages[1:], 9.0])
    assert np.isnan(told["piezoresistive"][0]) and told["piezoresistive"][1:] == [2.0, 3.0, 4.0]
    assert set(told) == set(readings)
