"""A new recording beside the robot as it was when it was well: what may count as new."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from simgap.data.plant import Plant
from simgap.inference.budget import Budget
from simgap.inference.familiar import FURTHER, Motion
from simgap.inference.healthy import Healthy, fitting
from simgap.inference.nuisance import Nuisance
from simgap.inference.scores import Scores
from simgap.inference.selection import Selection
from simgap.inference.thresholds import REMAINS
from simgap.inference.verdict import remains
from simgap.simulation.replay import Replayer
from simgap.simulation.variant import Variant

Array = NDArray[np.float64]

_STOOD = 100.0
"""Times as far as in the reference an output goes that stood still there."""


@dataclass
class Comparison:
    """What a new recording is held beside.

    Attributes:
        healthy: the explanation of the healthy robot that suits both.
        replayer: of the windows in which the healthy robot has been too.
        unlike: why there are too few of these, and all are used; empty where there are enough.
        warnings: in sentences.
    """

    healthy: Healthy
    replayer: Replayer
    unlike: str = ""
    warnings: list[str] = field(default_factory=list)

    def settle(self, scores: Scores, selection: Selection) -> None:
        """Take back a cause that explains no more than the model misses of the healthy robot.

        Where a healthy robot has a gap, what is left of it is no noise: it is the same in all windows of a kind, and
        any law that bends to it seems to earn much.
        """
        best, reference = selection.best, selection.reference
        if best is reference or self.healthy.report["typical"] <= REMAINS or remains(scores, reference.fit.held):
            return
        selection.best, scores.missed_anyway = reference, True
        self.warnings.append(
            f"{best.key.replace(' + ', ' and ')} would predict this recording better still, but without a cause the "
            "model misses no more of it than of the reference"
        )


def compare(
    well: Sequence[Healthy],
    floor: Array,
    replay: Callable[[Variant, Array], Replayer],
    nuisances: Callable[[Plant], list[Nuisance]],
    budget: Budget,
) -> Comparison:
    """Choose among explanations of the healthy robot, and the windows where it has been.

    Args:
        well: the best explanation first.
        floor: (no,) noise floor of the new recording.
        replay: makes a replayer of it for a model and a floor.
        nuisances: what may be off about a model.
        budget: for the choice.
    """
    healthy = fitting(well, replay(well[0].base, floor), nuisances, budget)
    replayer = replay(healthy.base, floor * healthy.scale)
    strange, times = Motion.of(replayer, healthy.base).strange(healthy.motion)
    healthy.report["windows"] = {"of": len(strange), "unlike": int(strange.sum())}
    if not strange.any():
        return Comparison(healthy, replayer)
    most = int(np.argmax(times))
    where = f"{strange.sum()} of {len(strange)} windows go where the reference never was"
    if times[most] > FURTHER:
        far = f"{times[most]:.1f} times as far in the same time" if times[most] < _STOOD else "which stood still there"
        where += f" ({replayer.plant.outputs[most].name}: {far})"
    advice = "give a reference with the same motions, or diagnose without one"
    kept = replayer.windows.of(~strange)
    if kept is None:
        return Comparison(healthy, replayer, where, [f"{where}; {advice}"])
    made = Replayer(replayer.plant, replayer.aligned, kept, replayer.floor, replayer.threads)
    left_out = f"{where} and are left out, for what is new cannot be told there; {advice}"
    return Comparison(healthy, made, warnings=[left_out])
