"""Where everything was that nothing measures: the nominal model held to the measurement all along a recording."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from simgap.data.align import Aligned
from simgap.simulation.drive import Drive, Follow
from simgap.simulation.models import Models
from simgap.simulation.state import MeasuredState
from simgap.simulation.variant import Variant

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

_LENGTH, _LEAD = 6.0, 1.5
"""[s] Of the pieces in which a recording is observed, and of their run-ins."""


def observe(
    aligned: Aligned,
    nominal: Variant,
    models: Models,
    inputs: Array,
    states: Sequence[MeasuredState],
    begin: Ints,
    moved: Array | None = None,
) -> Array:
    """State rows (n, nstate) of the ``nominal`` model at the rows ``begin`` (n,) of a recording.

    Each piece's run-in begins at the model's reference pose, or ``moved`` (nq,) from it. ``inputs`` (1, n, ni) and
    ``states`` are what the nominal model is given and where it was measured to be.
    """
    plant, period = nominal.plant, aligned.period
    dt = float(plant.model.opt.timestep)
    pieces: list[tuple[int, int]] = []
    for run in aligned.runs:
        step = max(int(_LENGTH / period), 1)
        pieces += [(s, run.start) for s in range(run.start, run.stop, step)]
    origins = np.array([max(s - int(_LEAD / period), r) for s, r in pieces], np.int64)
    piece_of = np.searchsorted([s for s, _ in pieces], begin, side="right") - 1
    at = np.rint((begin - origins[piece_of]) * period / dt).astype(np.int64)
    which = np.zeros(len(pieces), np.int64)
    batch = models.batch([models.differences(nominal)], which)
    key = 0 if plant.model.nkey else -1
    batch.reset(keyframe=key, stage=mujoco.mjtStage.mjSTAGE_NONE.value)
    if moved is not None:
        batch.bind("qpos")[:] += moved
    drive = Drive(plant, [nominal] * len(pieces), which, inputs, origins, dt, period)
    stops = np.array([next(r.stop for r in aligned.runs if r.start <= o < r.stop) for o in origins])
    drive.limits(np.array([r for _, r in pieces]), stops)
    follow = Follow(states, which, origins, batch, stops)
    found = np.zeros((len(begin), batch.nstate))
    by_step: dict[int, list[int]] = {}
    for w, k in enumerate(at):
        by_step.setdefault(int(k), []).append(w)
    for k in range(int(at.max(initial=0)) + 1):
        position = k * dt / period
        follow.apply(position, None, None)
        for w in by_step.get(k, ()):
            found[w] = batch.state[piece_of[w]]
        batch.ctrl[:], batch.qfrc_applied[:] = drive.at(position)
        batch.step()
    return found
