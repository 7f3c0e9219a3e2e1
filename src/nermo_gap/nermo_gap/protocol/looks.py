"""Where a diagnosis looks in a protocol's recordings: where what moves tells most, and a replay can begin."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from simgap.data.align import Aligned
from simgap.data.errors import GapInputError
from simgap.simulation.windows import FOLDS, Windows

LENGTH = 0.5
"""[s] of a window: a step and what the body makes of it."""


def looker(looks: Mapping[float, Sequence[float]], warm_up: float) -> Callable[[Aligned], Windows]:
    """Cuts a recording where its runs are looked at, {run: [s] from its beginning}; ``warm_up`` [s] lies before.

    Runs are dealt to the folds in turn, so that each fold holds something of every scene. Where nothing was measured,
    as where a filmed mouse has walked out of the picture, there is nothing to look at.
    """

    def cut(aligned: Aligned) -> Windows:
        length, lead = round(LENGTH / aligned.period), round(warm_up / aligned.period)
        starts, blocks = [], []
        for number, run in enumerate(run for run in aligned.runs if looks.get(run.label)):
            for look in looks[run.label]:
                start = run.start + max(round(look / aligned.period), lead)
                if start + length < run.stop and aligned.valid[start : start + length].any():
                    starts.append(start)
                    blocks.append(number)
        if len(set(blocks)) < FOLDS:
            raise GapInputError(
                f"{aligned.source}: {len(set(blocks))} pieces of the protocol are measured and long enough to look at; "
                f"{FOLDS} are needed: record it anew"
            )
        block = np.unique(blocks, return_inverse=True)[1].astype(np.int64)
        return Windows(
            np.array(starts, np.int64), lead, length, np.arange(length, dtype=np.int64), block, block % FOLDS
        )

    return cut
