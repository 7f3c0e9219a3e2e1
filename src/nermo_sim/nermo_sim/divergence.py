"""What is left behind when a simulation runs away: the model, and the last second of its states."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS
LARGEST = 1e10
"""MuJoCo's own limit (mjMAXVAL) beyond which a value counts as bad."""

TOO_FAST = 300.0
"""Speed of a joint [rad/s] that no servo reaches, twenty times over."""


class SimulationDivergedError(RuntimeError):
    """The simulation has stopped on a value that is not finite."""

    def __init__(self, joint: str, time: float, folder: Path) -> None:
        super().__init__(
            f"the simulation diverged at {time:.3f} s at joint {joint!r}; model and states are in {folder}"
        )
        self.joint, self.time, self.folder = joint, time, folder


class StateHistory:
    """The last states and commands, in a ring."""

    def __init__(self, model: mujoco.MjModel, length: int) -> None:
        self._model = model
        self._states = np.zeros((length, mujoco.mj_stateSize(model, STATE)))
        self._controls = np.zeros((length, model.nu))
        self._count = 0

    def add(self, data: mujoco.MjData, control: NDArray[np.float64]) -> bool:
        """Keeps the present state; returns whether it is finite and of a sane size."""
        row = self._count % len(self._states)
        state = self._states[row]
        mujoco.mj_getState(self._model, data, state, STATE)
        self._controls[row] = control
        self._count += 1
        return bool(state.dot(state) < LARGEST * LARGEST)

    def clear(self) -> None:
        """Forgets all states."""
        self._count = 0

    def save(self, folder: Path) -> SimulationDivergedError:
        """Writes `model.mjb`, `states.npz` and `about.json` into a new folder; returns the error that names it."""
        joint = self._culprit()
        present = min(self._count, len(self._states))
        order = np.arange(self._count - present, self._count) % len(self._states)
        states = self._states[order]
        folder.mkdir(parents=True, exist_ok=True)
        mujoco.mj_saveModel(self._model, str(folder / "model.mjb"), None)
        np.savez(folder / "states.npz", states=states, controls=self._controls[order])
        time = float(states[-1, 0])
        about = {"joint": joint, "time_s": time, "mujoco": mujoco.__version__, "state": STATE.name}
        (folder / "about.json").write_text(json.dumps(about, indent=2) + "\n", encoding="utf-8")
        return SimulationDivergedError(joint, time, folder)

    def _culprit(self) -> str:
        """Name of the joint that ran away first: the one with most of the energy when the first is too fast.

        All is lost within a few physics steps, so these are played again one by one, from the last sane state.
        """
        model, replay = self._model, mujoco.MjData(self._model)
        hinges = np.isin(model.jnt_type[model.dof_jntid], (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE))
        energies = np.zeros(model.nv)
        for number in range(max(0, self._count - len(self._states)), self._count):
            mujoco.mj_setState(model, replay, self._states[number % len(self._states)], STATE)
            if _is_sane(replay.qvel[hinges]) and number + 1 < self._count:
                continue
            if number > 0:
                mujoco.mj_setState(model, replay, self._states[(number - 1) % len(self._states)], STATE)
            replay.ctrl[:] = self._controls[number % len(self._states)]
            while _is_sane(replay.qvel[hinges]) and replay.time < self._states[number % len(self._states), 0]:
                mujoco.mj_step(model, replay)
            energies = np.nan_to_num(model.dof_M0 * replay.qvel**2, nan=0.0) * hinges
            break
        joint = int(model.dof_jntid[int(np.argmax(energies))])
        return str(mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, joint) or f"joint {joint}")


def _is_sane(speeds: NDArray[np.float64]) -> bool:
    return bool(np.abs(speeds).max(initial=0.0) < TOO_FAST)


@dataclass(frozen=True, slots=True)
class DivergenceDump:
    """A dump read back."""

    model: mujoco.MjModel
    joint: str
    time_s: float
    states: NDArray[np.float64]
    """Shape (ticks, state size), each for `mujoco.mj_setState(model, data, state, STATE)`; the last is the bad one."""
    controls: NDArray[np.float64]
    """Shape (ticks, actuators) [rad]."""


def load_dump(folder: Path) -> DivergenceDump:
    """Reads what `StateHistory.save` wrote; the same release of MuJoCo is needed."""
    about = json.loads((folder / "about.json").read_text(encoding="utf-8"))
    with np.load(folder / "states.npz") as arrays:
        states, controls = arrays["states"], arrays["controls"]
    model = mujoco.MjModel.from_binary_path(str(folder / "model.mjb"))
    return DivergenceDump(model, about["joint"], about["time_s"], states, controls)
