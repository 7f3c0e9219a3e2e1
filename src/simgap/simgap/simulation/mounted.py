"""Simulations of robots whose mounts tilt, with the coordinates of those that stand firm."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import mujoco
import numpy as np
from mujoco import batch as mjbatch
from numpy.typing import NDArray

from simgap.data.mounting import Mounting
from simgap.simulation.variant import Variant

Array = NDArray[np.float64]

RINGS_ON = 0.8
"""[s] before the warm-up from which the motion is followed: a mount still rings from what the robot did then."""
_FASTEST = 0.5
"""Radians of its ringing that a mount goes through in a time step at most; a stiffer one is given more inertia, which
leaves how far it tilts."""
_LEAST = 0.02
"""Inertia of a mount of which nothing is known, as a share of what stands on it."""
_FIRM = 1e9
"""Inertia of a mount that does not tilt, as that share."""
_HELD = 1e6
"""Inertia of one that is held to find what it would have to hold, as that share."""
_ADDRESSED = {"qpos": "qpos", **dict.fromkeys(("qvel", "qacc", "qacc_warmstart"), "dof")}


def on_mounts(mounting: Mounting, variant: Variant) -> mujoco.MjModel:
    """The model of a variant with springs below its bases."""
    made, dt = mounting.of(variant.model), float(variant.model.opt.timestep)
    for i, body in enumerate(mounting.bodies):
        dofs, carried = mounting.tilt[i], mounting.inertia[i]
        give = float(variant.mounts.compliance[body])
        if give <= 0.0:
            made.dof_armature[dofs] = _FIRM * carried
            continue
        stiffness = 1.0 / give
        own = max(float(variant.mounts.inertia[body]), stiffness * (dt / _FASTEST) ** 2)
        inertia = np.maximum(own, _LEAST * carried)
        made.dof_armature[dofs] = inertia
        made.jnt_stiffness[made.dof_jntid[dofs]] = stiffness
        made.dof_damping[dofs] = 2.0 * variant.mounts.ringing[body] * np.sqrt(stiffness * (carried + inertia))
    return made


class MountedBatch(mjbatch.Batch):
    """A batch whose fields have the rows of the plain model; how far mounts tilt, it knows alone."""

    def __init__(self, mounting: Mounting, model: mujoco.MjModel, nsim: int, nthread: int) -> None:
        super().__init__(model, nsim, nthread)
        self._mounting = mounting
        self._at = model.jnt_qposadr[model.dof_jntid[mounting.tilt.ravel()]]
        self._plain: dict[str, NDArray[Any]] = {}

    def _rows(self, name: str) -> NDArray[np.int64] | None:
        kind = "dof" if name.startswith("qfrc_") else _ADDRESSED.get(name)
        return None if kind is None else self._mounting.rows[kind]

    def bind(self, name: str) -> NDArray[Any]:
        """A live array with the rows of the plain model."""
        return self._live(name, self._rows(name), super().bind(name))

    def expand(self, name: str) -> NDArray[Any]:
        """A live array of values of each simulation, with the rows of the plain model."""
        return self._live(name, self._mounting.rows_of(name), super().expand(name))

    def _live(self, name: str, rows: NDArray[np.int64] | None, whole: NDArray[Any]) -> NDArray[Any]:
        if rows is None:
            return whole
        if name not in self._plain:
            self._plain[name] = whole[:, rows]
        return self._plain[name]

    def whole(self, name: str) -> NDArray[Any]:
        """A field of the model, mounts and all."""
        return super().expand(name)

    def _tell(self) -> None:
        for name, values in self._plain.items():
            rows = self._rows(name)
            if rows is None:
                super().expand(name)[:, self._mounting.rows_of(name)] = values
            elif name in ("qpos", "qvel", "qfrc_applied", "qacc_warmstart"):
                super().bind(name)[:, rows] = values

    def _hear(self) -> None:
        for name, values in self._plain.items():
            rows = self._rows(name)
            if rows is not None:
                values[:] = super().bind(name)[:, rows]

    def step(self, *args: Any, **how: Any) -> None:
        """As of a batch."""
        self._tell()
        try:
            super().step(*args, **how)
        finally:
            self._hear()

    def forward(self, *args: Any, **how: Any) -> None:
        """As of a batch."""
        self._tell()
        super().forward(*args, **how)
        self._hear()

    def rollout(self, nstep: int, control: Array, kinds: int, record: Iterable[str], **how: Any) -> Any:
        """As of a batch, told controls and applied forces (n, nstep, nu + nv) of the plain model."""
        self._tell()
        nu, nv = self.model.nu, self.model.nv
        told = np.zeros((*control.shape[:-1], nu + nv))
        told[..., :nu] = control[..., :nu]
        told[..., nu + self._mounting.rows["dof"]] = control[..., nu:]
        return super().rollout(nstep, told, kinds, record, **how)

    def put(self, plain: mjbatch.Batch) -> None:
        """Begin where simulations of the plain model are."""
        for name in ("qpos", "qvel", "act", "history", "qacc_warmstart"):
            self.bind(name)[:] = plain.bind(name)

    def balance(self) -> None:
        """Tilt the mounts as far as the robot, where it is and as it moves, weighs on them."""
        tilt = self._mounting.tilt.ravel()
        armature, stiffness = self.whole("dof_armature"), self.whole("jnt_stiffness")[:, self.model.dof_jntid[tilt]]
        stiffness = stiffness.reshape(len(stiffness), len(tilt), -1)[..., 0]
        kept = armature.copy()
        # What a mount that cannot tilt would have to hold, which is what its inertia is accelerated with.
        armature[:, tilt] = firm = _HELD * self._mounting.inertia.ravel()
        super().bind("qpos")[:, self._at] = 0.0
        super().bind("qvel")[:, tilt] = 0.0
        self.forward()
        moment = firm * super().bind("qacc")[:, tilt]
        super().bind("qpos")[:, self._at] = np.divide(moment, stiffness, out=np.zeros_like(moment), where=stiffness > 0)
        armature[:] = kept
