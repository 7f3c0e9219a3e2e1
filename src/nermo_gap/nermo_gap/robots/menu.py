"""Experiments that a mouse may be asked to do next: all on four standing feet, as command files for `nermo play`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nermo_description.parameter_files import write_yaml
from nermo_description.parameters import LEGS, RobotParameters
from nermo_gap.core.align import Aligned
from nermo_gap.core.experiment import SETTLE, Experiment
from nermo_gap.core.plant import Plant

Array = NDArray[np.float64]

LENGTH = 5.0
"""[s] of an experiment after settling."""
EVERY = 0.02
"""[s] between two entries of a command file."""


@dataclass(frozen=True)
class MouseMenu:
    """Squats, swaying, and bending the spine, each at two frequencies together and within their range."""

    robot: RobotParameters

    def experiments(self, plant: Plant, aligned: Aligned, about: Sequence[int]) -> Sequence[Experiment]:
        """See core.experiment.Menu."""
        knees = {f"{leg}_knee": -0.35 for leg in LEGS}
        # Front hips turn back where rear hips do too: the body sways over its feet.
        hips = {f"{leg}_hip": 0.2 for leg in LEGS}
        spine = {servo: 0.35 for servo in self.robot.servos if servo.startswith("spine")}
        return [
            self._made(plant, aligned.period, "squat", "squat on all four legs, slowly and quickly at once", knees),
            self._made(plant, aligned.period, "sway", "sway forth and back over the feet, slowly and quickly", hips),
            self._made(plant, aligned.period, "bend", "bend the spine, slowly and quickly at once", spine),
        ]

    def _made(self, plant: Plant, period: float, name: str, what: str, sizes: dict[str, float]) -> Experiment:
        count = round((SETTLE + LENGTH) / period)
        t = np.maximum(period * np.arange(count) - SETTLE, 0.0)
        wave = np.clip(t / 0.5, 0.0, 1.0) * (0.7 * np.sin(2 * np.pi * 0.5 * t) + 0.3 * np.sin(2 * np.pi * 2.3 * t))
        inputs = np.empty((count, len(plant.inputs)))
        for i, channel in enumerate(plant.inputs):
            servo = self.robot.servos[channel.name]
            size = sizes.get(channel.name, 0.0)
            # What bends one way only, and knees, move to one side of neutral.
            one_way = size < 0.0 or channel.name == "spine_vertical"
            shape = 0.5 * np.clip(t / 0.5, 0.0, 1.0) * (1.0 + wave) if one_way else wave
            inputs[:, i] = np.clip(servo.neutral + size * shape, servo.lower, servo.upper)
        return Experiment(name, what, period, inputs)

    def write(self, experiment: Experiment, plant: Plant, stem: Path) -> Path:
        """Write a command file for `nermo play`."""
        path = stem.with_suffix(".yaml")
        path.parent.mkdir(parents=True, exist_ok=True)
        stride = max(round(EVERY / experiment.period), 1)
        names = [c.name for c in plant.inputs]
        commands = [
            {
                "at": round(k * experiment.period, 4),
                "servos": {n: round(float(v), 5) for n, v in zip(names, row, strict=True)},
            }
            for k, row in list(enumerate(experiment.inputs))[::stride]
        ]
        write_yaml({"description": experiment.description, "commands": commands}, path)
        return path
