"""Experiments that could be run next: what they are, and the menu of safe ones that suits any robot with inputs."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from simgap.data.align import Aligned
from simgap.data.plant import Plant
from simgap.data.units import factor

Array = NDArray[np.float64]

SETTLE = 1.0
"""[s] of holding the first command before the experiment begins."""
LENGTH = 7.0
"""[s] of an experiment of the generic menu, after settling."""
_SINGLE = 4
"""At most this many inputs get experiments of their own."""


@dataclass(frozen=True)
class Experiment:
    """What every input of a plant would be told.

    Attributes:
        name: short, unique in its menu.
        description: one sentence for the person who runs it.
        period: [s] of the rows.
        inputs: (n, ni) in the units of the plant's controls (column value = inputs / channel.scale), held between rows.
        settle: [s] at the beginning in which the first row is held and nothing is scored.
        details: whatever the menu needs to write the command file; the core does not look at it.
    """

    name: str
    description: str
    period: float
    inputs: Array
    settle: float = SETTLE
    details: dict[str, object] = field(default_factory=dict)


class Menu(Protocol):
    """Where the experiments come from, and how they are handed to the robot. Give it as ``Options.menu``."""

    def experiments(self, plant: Plant, aligned: Aligned, about: Sequence[int]) -> Sequence[Experiment]:
        """Experiments that are safe to run on this robot.

        ``aligned`` is the recording under diagnosis; ``about`` lists the inputs that the open hypotheses concern
        (empty: all of them). Each is simulated first and dropped where a hypothesis leaves what was recorded.
        """
        ...

    def write(self, experiment: Experiment, plant: Plant, stem: Path) -> Path:
        """Write the command file of a chosen experiment; returns its path (``stem`` with a suffix of its own)."""
        ...


class GenericMenu:
    """Hold, sweeps, chirps, steps and two frequencies within what the recording has already told the robot.

    Amplitudes stay within the recorded range of each input, and rates of position commands within one and a half times
    the recorded ones: what the robot has borne once. The command file is a table with the columns and units of the map.
    """

    def experiments(self, plant: Plant, aligned: Aligned, about: Sequence[int]) -> Sequence[Experiment]:
        """See Menu."""
        period, told = aligned.period, aligned.inputs
        low, high = np.percentile(told, [1.0, 99.0], axis=0)
        centre, half = 0.5 * (low + high), 0.5 * (high - low)
        steps = [np.diff(told[r.start : r.stop], axis=0) for r in aligned.runs]
        rate = 1.5 * np.percentile(np.abs(np.concatenate(steps)), 99.5, axis=0) / period
        rate = np.where([c.kind == "position" for c in plant.inputs], rate, np.inf)
        n = round((SETTLE + LENGTH) / period)
        t = np.maximum(period * np.arange(n) - SETTLE, 0.0)
        moving = [i for i in range(len(plant.inputs)) if half[i] > 0]
        several = moving if len(moving) > 1 else []
        single = [i for i in moving if not about or i in about][:_SINGLE]
        ease = np.clip(t / 0.5, 0.0, 1.0)

        def made(name: str, what: str, waves: dict[int, Array]) -> Experiment:
            inputs = np.tile(centre, (n, 1))
            for i, wave in waves.items():
                inputs[:, i] += half[i] * ease * wave
            return Experiment(name, what, period, inputs)

        def chirp(i: int, phase: float = 0.0) -> Array:
            top = 5.0 if len(plant.inputs) < 3 else 3.0
            frequency = 0.3 * (top / 0.3) ** (t / LENGTH)
            angle = 2 * np.pi * 0.3 * LENGTH / np.log(top / 0.3) * ((top / 0.3) ** (t / LENGTH) - 1.0)
            bound = rate[i] / (2 * np.pi * frequency * half[i])
            return np.minimum(1.0, bound) * np.sin(angle + phase)

        def two(i: int, phase: float) -> Array:
            fast = min(0.35, rate[i] / (2 * np.pi * 2.1 * half[i]))
            return 0.6 * np.sin(2 * np.pi * 0.45 * t + phase) + fast * np.sin(2 * np.pi * 2.1 * t + 2.0 * phase)

        def stairs(i: int, order: int) -> Array:
            levels = np.array([0.0, 0.8, -0.6, 0.4, -0.8, 0.6, -0.3, 0.0])
            wanted = np.roll(levels, order)[np.minimum((t / LENGTH * 7).astype(int), 7)]
            value, out, step = 0.0, np.empty(n), rate[i] * period / half[i]
            for k in range(n):
                value += float(np.clip(wanted[k] - value, -step, step))
                out[k] = value
            return out

        names = [c.name for c in plant.inputs]
        menu = [made("hold", "hold the middle of the recorded commands", {})]
        for i in single:
            menu.append(made(f"sweep {names[i]}", f"slow sweep of {names[i]} alone", {i: np.sin(2 * np.pi * 0.3 * t)}))
            menu.append(made(f"chirp {names[i]}", f"chirp of {names[i]} alone", {i: chirp(i)}))
            menu.append(made(f"steps {names[i]}", f"steps of {names[i]} alone", {i: stairs(i, 0)}))
        shift = {i: 2 * np.pi * k / max(len(several), 1) for k, i in enumerate(several)}
        if several:
            menu.append(made("sweep all", "slow sweep of all inputs", {i: np.sin(1.9 * t + shift[i]) for i in several}))
            menu.append(made("chirp all", "chirp of all inputs", {i: chirp(i, shift[i]) for i in several}))
            menu.append(made("steps all", "steps of all inputs", {i: stairs(i, k) for k, i in enumerate(several)}))
        if moving:
            waves = {i: two(i, shift.get(i, 0.0)) for i in moving}
            menu.append(made("two frequencies", "a slow and a fast wave together, all inputs", waves))
        return menu

    def write(self, experiment: Experiment, plant: Plant, stem: Path) -> Path:
        """Write a CSV with the time and input columns of the map, in its units."""
        path = stem.with_suffix(".csv")
        path.parent.mkdir(parents=True, exist_ok=True)
        columns = [c.column for c in plant.inputs]
        scale = np.array([c.scale for c in plant.inputs])
        seconds, _ = factor(plant.map.time.unit, ("time",), plant.map.source)
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow([plant.map.time.column, *columns])
            for k, row in enumerate(experiment.inputs / scale):
                writer.writerow([f"{k * experiment.period / seconds:.9g}", *(f"{v:.9g}" for v in row)])
        return path
