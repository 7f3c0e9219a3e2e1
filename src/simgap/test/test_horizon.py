"""Windows are as long as the robot lets them be."""

from __future__ import annotations

from pathlib import Path

import mujoco
import pytest
from robots import aligned_of, simulate

import nermo_gap
from nermo_gap.core.align import align
from nermo_gap.core.horizon import SHORTEST, usable_horizon
from nermo_gap.core.mapping import load_map
from nermo_gap.core.noise import noise_floor
from nermo_gap.core.plant import build_plant
from nermo_gap.core.recording import load_table, recording_from_table
from nermo_gap.core.replay import Replayer
from nermo_gap.core.variant import Variant
from nermo_gap.core.windows import HORIZON, cut


@pytest.mark.parametrize("name", ["arm", "cart_pole"])
def test_what_does_not_amplify_errors_keeps_long_windows(name: str) -> None:
    plant, aligned, floor = aligned_of(name, simulate(name, 6.0))
    replayer = Replayer(plant, aligned, cut(aligned), floor, 1)
    assert usable_horizon(replayer, Variant.nominal(plant)) == pytest.approx(HORIZON, abs=0.01)


def test_a_swinging_double_pendulum_gets_short_windows() -> None:
    folder = Path(nermo_gap.__file__).parent / "examples" / "double_pendulum"
    plant = build_plant(
        mujoco.MjSpec.from_file(str(folder / "model.xml")),
        load_map(folder / "map.yaml"),
    )
    aligned = align(recording_from_table(load_table(folder / "excerpt.csv"), plant), plant)
    replayer = Replayer(plant, aligned, cut(aligned, most=30), noise_floor(aligned), 1)
    assert SHORTEST <= usable_horizon(replayer, Variant.nominal(plant)) < 0.5 * HORIZON
