"""The next experiment: a safe menu for any robot, the most telling entry, and its command file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from robots import aligned_of, plant_of, simulate

from simgap.analysis.experiment import GenericMenu
from simgap.analysis.next_experiment import simulate as run_experiment
from simgap.data.recording import load_table, recording_from_table
from simgap.simulation.replay import Replayer
from simgap.simulation.variant import Variant
from simgap.simulation.windows import cut


@pytest.mark.parametrize("robot", ["pendulum", "cart_pole", "arm"])
def test_menu_stays_within_what_was_recorded(robot: str) -> None:
    plant, aligned, _ = aligned_of(robot, simulate(robot, 6.0))
    menu = GenericMenu().experiments(plant, aligned, [])
    assert len({e.name for e in menu}) == len(menu) >= 4
    rate = np.abs(np.diff(aligned.inputs, axis=0)).max(axis=0) / aligned.period
    for experiment in menu:
        assert (experiment.inputs >= aligned.inputs.min(axis=0) - 1e-9).all(), experiment.name
        assert (experiment.inputs <= aligned.inputs.max(axis=0) + 1e-9).all(), experiment.name
        for i, channel in enumerate(plant.inputs):
            if channel.kind == "position":
                fastest = np.abs(np.diff(experiment.inputs[:, i])).max() / experiment.period
                assert fastest <= 2.0 * rate[i], experiment.name


def test_command_file_says_what_the_simulation_was_told(tmp_path: Path) -> None:
    def degrees(data: dict[str, object]) -> None:
        data["inputs"][0].update(unit="deg", sign=-1)  # type: ignore[index]

    plant = plant_of("pendulum", degrees)
    _, aligned, _ = aligned_of("pendulum", simulate("pendulum", 6.0))
    experiment = GenericMenu().experiments(plant, aligned, [])[1]
    path = GenericMenu().write(experiment, plant, tmp_path / "next")
    columns = load_table(path)
    assert np.allclose(-np.radians(columns["u"]), experiment.inputs[:, 0], atol=1e-6)
    assert np.allclose(np.diff(columns["t"]), experiment.period)
    # It can be recorded and diagnosed with the same map.
    recorded = recording_from_table({**columns, "q": np.sin(columns["t"])}, plant)
    assert np.allclose(recorded.inputs, experiment.inputs, atol=1e-6)


def test_experiment_is_simulated_from_rest() -> None:
    plant, aligned, floor = aligned_of("arm", simulate("arm", 6.0))
    replayer = Replayer(plant, aligned, cut(aligned), floor, 1)
    hold, sweep = GenericMenu().experiments(plant, aligned, [])[:2]
    nominal = Variant.nominal(plant)
    still, moving = (run_experiment(replayer, [nominal], e)[0] for e in (hold, sweep))
    assert still.shape == (len(hold.inputs), len(plant.outputs))
    tail = slice(len(still) // 2, None)
    assert np.ptp(still[tail], axis=0).max() < 0.02 and np.ptp(moving[tail, 0]) > 0.2
