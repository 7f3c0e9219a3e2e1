"""Windows are as long as the robot lets them be."""

from __future__ import annotations

from pathlib import Path

import mujoco
import pytest
from robots import aligned_of, simulate

import simgap
from simgap.data.align import align
from simgap.data.mapping import load_map
from simgap.data.noise_floor import noise_floor
from simgap.data.plant import build_plant
from simgap.data.recording import load_table, recording_from_table
from simgap.simulation.horizon import SHORTEST, usable_horizon
from simgap.simulation.replay import Replayer
from simgap.simulation.variant import Variant
from simgap.simulation.windows import HORIZON, cut


@pytest.mark.parametrize("name", ["arm", "cart_pole"])
def test_what_does_not_amplify_errors_keeps_long_windows(name: str) -> None:
    plant, aligned, floor = aligned_of(name, simulate(name, 6.0))
    replayer = Replayer(plant, aligned, cut(aligned), floor, 1)
    assert usable_horizon(replayer, Variant.nominal(plant)) == pytest.approx(HORIZON, abs=0.01)


def test_a_swinging_double_pendulum_gets_short_windows() -> None:
    folder = Path(simgap.__file__).parent / "examples" / "double_pendulum"
    plant = build_plant(
        mujoco.MjSpec.from_file(str(folder / "model.xml")),
        load_map(folder / "map.yaml"),
    )
    aligned = align(recording_from_table(load_table(folder / "excerpt.csv"), plant), plant)
    replayer = Replayer(plant, aligned, cut(aligned, most=30), noise_floor(aligned), 1)
    assert SHORTEST <= usable_horizon(replayer, Variant.nominal(plant)) < 0.5 * HORIZON
