"""How to diagnose."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from simgap.analysis.experiment import Menu
from simgap.analysis.localisation import Phases
from simgap.analysis.stages import Staged
from simgap.data.align import Aligned
from simgap.data.plant import Plant
from simgap.data.recording import Recording
from simgap.effects.base import Effect
from simgap.inference.budget import Hurry
from simgap.inference.effort import Effort, Progress
from simgap.inference.nuisance import Nuisance, enumerate_nuisances
from simgap.simulation.integration import FINER
from simgap.simulation.windows import WARM_UP, Windows

Array = NDArray[np.float64]


@dataclass
class Options:
    """How to diagnose."""

    seed: int = 0
    threads: int | None = None
    extra_effects: tuple[type[Effect], ...] = ()
    groups: dict[str, tuple[str, ...]] = field(default_factory=dict)
    baselines: bool = True
    only: tuple[str, ...] = ()
    """Names of the effects to consider; all where empty."""
    progress: Progress | None = None
    keep: Callable[[Effect], bool] | None = None
    """Which candidates make sense on this robot; all where None."""
    nuisances: Callable[[Plant, Array, Array, float], list[Nuisance]] = enumerate_nuisances
    """What may be off about this robot without being a fault; takes what `enumerate_nuisances` takes."""
    finer: int = FINER
    """Steps of the replay for one of the model's, where its bodies touch the ground."""
    effort: Effort | None = None
    """By default as much as the model is worth."""
    max_windows: int | None = None
    """By default as many as the model is worth."""
    horizon: float | None = None
    """[s] of a window, by default as long as the model is worth; shorter where the robot blows up an error of its start
    (`horizon.py`)."""
    cut: Callable[[Aligned], Windows] | None = None
    """Chooses the windows where somebody knows which of them tell most; then `max_windows`, `horizon` and `warm_up` say
    nothing. By default the recording is tiled with them (`windows.cut`)."""
    warm_up: float = WARM_UP
    """[s] before a window in which the model is held to the measurement."""
    resolution: dict[str, float] = field(default_factory=dict)
    """Least noise floor by output [unit of the channel]: what its sensor can resolve, however quiet it looks."""
    phases: Phases | None = None
    """Phases of each channel's motion for `where`; by the channel's own speed where None."""
    left: float = math.inf
    """[noise floors] that this robot leaves in a channel at most where all is explained, where somebody knows it from
    robots like it; without it any robot is judged by `inference/thresholds.py` alone."""
    menu: Menu | None = None
    """Where the next experiment is chosen from; by default the one that suits any robot with inputs."""
    budget: float | None = None
    """[s] that the diagnosis may take; no limit where None."""
    hurry: Hurry = field(default_factory=Hurry)
    """Wanted, at any time, it ends the search as a budget that is spent does."""

    corrects: Plant | None = None
    """The model as it was before `simgap apply` wrote into it what an earlier diagnosis had found, where it did: a
    further cause is judged beside that."""

    reference: Sequence[Recording] = ()
    """Recordings of the same robot when it was well: the fault is what is new."""

    staged: Callable[[Staged], None] | None = None
    """Told what is known so far, as soon as it is; beside `progress`, which only says how far it is."""

    def tell(self, result: Staged) -> None:
        """Report what is known so far."""
        if self.staged:
            self.staged(result)

    def say(self, stage: str, share: float) -> None:
        """Report progress."""
        if self.progress:
            self.progress(stage, share)
