"""Forward model of tactile feet: from the force on each to the volts that the robot reads (C 4.2 and 4.3)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from nermo_sensors.parameters import TactileParameters, load_tactile


class TactileFeet:
    """The cells of each foot, sampled together, with noise."""

    def __init__(self, parameters: TactileParameters | None = None, feet: int = 4, seed: int = 0) -> None:
        self.parameters = parameters or load_tactile("nermo_lite")
        self._kinds = self.parameters.cells.present
        self._cells = {name: [kind.make() for _ in range(feet)] for name, kind in self._kinds.items()}
        self._feet, self._seed = feet, seed
        self.temperature = next(iter(self._kinds.values())).reference_temperature
        """[degC]"""
        self.clear()

    def read(self, forces: Sequence[float], period: float, frequency: float = 0.0) -> dict[str, list[float]]:
        """Voltages [V] of the feet, by cell.

        `forces`: normal force on each foot [N]; `period`: time since the last call [s]; `frequency`: of the load
        [rad/s]. The first call after the start or after `clear` knows no rate.

        Raises ValueError where the period is not positive or a force is not finite.
        """
        if not period > 0.0:
            raise ValueError(f"period = {period} s: must be above 0")
        if len(forces) != self._feet or not all(map(math.isfinite, forces)):
            raise ValueError(f"forces = {list(forces)} N: must be {self._feet} finite numbers")
        noise = self._random.standard_normal((len(self._cells), self._feet))
        offsets = self._biases + noise * self._noises
        return {
            name: [
                cell.read(force, period, frequency, self.temperature, offset)
                for cell, force, offset in zip(cells, forces, row, strict=True)
            ]
            for (name, cells), row in zip(self._cells.items(), offsets.tolist(), strict=True)
        }

    def clear(self) -> None:
        """Starts anew, as after a reset: the past is forgotten, biases are drawn."""
        self._random: Any = np.random.default_rng(self._seed)
        self._noises = np.array([[kind.noise] for kind in self._kinds.values()])
        self._biases = np.zeros((len(self._kinds), self._feet))
        for row, kind in enumerate(self._kinds.values()):
            if kind.bias > 0.0:
                self._biases[row] = self._random.standard_normal(self._feet) * kind.bias
        for cells in self._cells.values():
            for cell in cells:
                cell.clear()
