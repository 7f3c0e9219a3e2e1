"""The model that each simulation of a replay runs: its variant's, on its mounts or without contacts."""

from __future__ import annotations

import copy
from collections.abc import Sequence

import mujoco
import numpy as np
from mujoco import batch as mjbatch
from numpy.typing import NDArray

from simgap.data.mounting import field_bytes, read_field
from simgap.data.plant import Plant
from simgap.simulation.contacts import may_touch
from simgap.simulation.mounted import MountedBatch, on_mounts
from simgap.simulation.variant import Variant

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Fields = dict[str, NDArray[np.generic]]
"""Fields of a model that are not those of the plant's."""

_LETS_TOUCH = {"geom_contype", "geom_conaffinity", "body_contype", "body_conaffinity", "opt.disableflags"}
"""Fields by which a variant may let touch what cannot in the model."""


class Models:
    """Makes batches of simulations of one plant's variants."""

    def __init__(self, plant: Plant, threads: int) -> None:
        self._mounting, self._threads = plant.mounting, threads
        self._plain = _const(plant.model)
        self._plain_bytes = field_bytes(self._plain)
        self._apart = None if may_touch(self._plain) else _without_contacts(self._plain)
        self._mounted = None if plant.mounting is None else _const(plant.mounting.of(plant.model))
        self._mounted_bytes = {} if self._mounted is None else field_bytes(self._mounted)

    def differences(self, variant: Variant) -> Fields:
        """Fields of a variant's model that are not those of the plant's, or of that on mounts."""
        if tilts(variant) and self._mounting is not None:
            changed, told = _const(on_mounts(self._mounting, variant)), self._mounted_bytes
        else:
            changed, told = _const(variant.model), self._plain_bytes
        different = {}
        for field, usual in told.items():
            mine = read_field(changed, field)
            if mine.tobytes() != usual:
                different[field] = np.array(mine)
        return different

    def batch(self, variants: Sequence[Fields], which: Ints, mounted: bool = False) -> mjbatch.Batch:
        """A simulation for each of ``which`` (n,), an index into the `differences` of variants."""
        count, used = len(which), np.unique(which)
        fields = sorted(set().union(*(variants[v] for v in used)))
        on_mount = (
            MountedBatch(self._mounting, self._mounted, count, self._threads) if mounted and self._mounting else None
        )
        model = self._plain if self._apart is None or _LETS_TOUCH.intersection(fields) else self._apart
        batch = mjbatch.Batch(model, count, self._threads) if on_mount is None else on_mount
        expand = batch.expand if on_mount is None else on_mount.whole
        for field in fields:
            values = expand(field)
            for v in used:
                if field in variants[v]:
                    values[which == v] = variants[v][field]
        return batch

    def begin(self, batch: mjbatch.Batch, rows: Array) -> None:
        """Put simulations into states (n, nstate) of the plain model."""
        if not isinstance(batch, MountedBatch):
            batch.state[:] = rows
            return
        plain = mjbatch.Batch(self._plain, len(rows), 1)
        plain.state[:] = rows
        batch.put(plain)


def tilts(variant: Variant) -> bool:
    """Whether a variant's mounts give way."""
    return variant.plant.mounting is not None and variant.mounts.gives


def _const(model: mujoco.MjModel) -> mujoco.MjModel:
    """``model`` with its derived constants brought up to date, in place."""
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def _without_contacts(model: mujoco.MjModel) -> mujoco.MjModel:
    """A copy in which contacts are not looked for: a sixth of the time of a small robot of which nothing can touch."""
    made = copy.copy(model)
    made.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    return made
