"""Runs that differ: what is changed in the model for some of them, as the map says."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from simgap.data.channels import find
from simgap.data.errors import GapInputError
from simgap.data.mapping import GainRow, Map, PayloadRow, RunRow

Array = NDArray[np.float64]
Obj = mujoco.mjtObj


@dataclass(frozen=True)
class Setup:
    """A change of the model that some runs share; ``apply`` enters it into a model in place."""

    name: str
    changes: tuple[Callable[[mujoco.MjModel], None], ...] = ()

    def apply(self, model: mujoco.MjModel) -> None:
        """Enter it; whatever else is changed in the model stays."""
        for change in self.changes:
            change(model)


AS_MODELLED = Setup("as modelled")


def setups(model: mujoco.MjModel, mapping: Map) -> tuple[tuple[Setup, ...], dict[float | str, int]]:
    """All setups, that of the model first; and which of them each run has that the map speaks of.

    Raises:
        GapInputError: an actuator or body that the model lacks, or a payload at one that cannot take it.
    """
    segments = mapping.segments
    if segments is None or not segments.runs:
        return (AS_MODELLED,), {}
    volts = [row.supply for row in segments.runs.values() if row.supply is not None]
    usual = segments.supply or (float(np.median(volts)) if volts else None)
    made, index = [AS_MODELLED], {}
    for label, row in segments.runs.items():
        setup = _setup(model, row, usual, f"{mapping.source}: segments.runs.{said(label)}")
        same = next((i for i, other in enumerate(made) if other.name == setup.name), len(made))
        if same == len(made):
            made.append(setup)
        index[label] = same
    return tuple(made), index


def said(label: float | str) -> str:
    """A run's number or name, in words."""
    return label if isinstance(label, str) else f"{label:g}"


def _setup(model: mujoco.MjModel, row: RunRow, usual: float | None, where: str) -> Setup:
    names, changes = [], []
    for name, gains in row.gains.items():
        actuator = find(model, Obj.mjOBJ_ACTUATOR, name, "actuator", f"{where}.gains.{name}")
        names.append(f"{name} kp {gains.kp:g} kd {gains.kd:g}")
        changes.append(_gains(model, actuator, gains))
    if row.payload is not None:
        body = find(model, Obj.mjOBJ_BODY, row.payload.body, "body", f"{where}.payload.body")
        if model.body_simple[body] and model.body_dofnum[body] == 6:
            raise GapInputError(
                f"{where}.payload.body: {row.payload.body} floats by itself; give its model the payload as a body"
            )
        names.append(f"{row.payload.mass:g} kg at {row.payload.body} {row.payload.pos}")
        changes.append(_payload(body, row.payload))
    if row.supply is not None and usual is not None and row.supply != usual:
        names.append(f"{row.supply:g} V")
        changes.append(_supply(row.supply / usual))
    return Setup(", ".join(names) or AS_MODELLED.name, tuple(changes))


def _gains(nominal: mujoco.MjModel, actuator: int, row: GainRow) -> Callable[[mujoco.MjModel], None]:
    """Gains in joint units, as `gains` of the map has them; a factor that the model has on its own stays."""
    gear, own = float(nominal.actuator_gear[actuator, 0]), float(nominal.actuator_gainprm[actuator, 0])
    kd = -float(nominal.actuator_biasprm[actuator, 2]) * gear**2
    factor = row.kp / (own * gear) if own else 1.0

    def apply(model: mujoco.MjModel) -> None:
        model.actuator_gainprm[actuator, 0] *= factor
        model.actuator_biasprm[actuator, 1] *= factor
        if kd:
            model.actuator_biasprm[actuator, 2] *= row.kd / kd
        else:
            model.actuator_biasprm[actuator, 2] -= row.kd / gear**2

    return apply


def _payload(body: int, row: PayloadRow) -> Callable[[mujoco.MjModel], None]:
    def apply(model: mujoco.MjModel) -> None:
        add_point_mass(model, body, row.mass, row.pos)

    return apply


def _supply(share: float) -> Callable[[mujoco.MjModel], None]:
    """Servos that are driven by their voltage: all their torques are in proportion to it."""

    def apply(model: mujoco.MjModel) -> None:
        model.actuator_gainprm[:, 0] *= share
        model.actuator_biasprm[:, 1] *= share
        model.actuator_forcerange[:] *= share

    return apply


def add_point_mass(model: mujoco.MjModel, body: int, mass: float, pos: Sequence[float]) -> None:
    """Add a point mass [kg] at a place [m, body frame] to a body, in place."""
    old, rotation = float(model.body_mass[body]), np.zeros(9)
    mujoco.mju_quat2Mat(rotation, model.body_iquat[body])
    axes = rotation.reshape(3, 3)
    inertia = axes @ np.diag(model.body_inertia[body]) @ axes.T
    centre = (old * model.body_ipos[body] + mass * np.asarray(pos)) / (old + mass)
    for m, place in ((old, model.body_ipos[body] - centre), (mass, np.asarray(pos) - centre)):
        inertia = inertia + m * (place @ place * np.eye(3) - np.outer(place, place))
    size, axes = np.linalg.eigh(inertia)
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    model.body_mass[body], model.body_ipos[body], model.body_inertia[body] = old + mass, centre, size
    mujoco.mju_mat2Quat(model.body_iquat[body], axes.reshape(-1))
    model.body_sameframe[body] = model.body_simple[body] = 0
