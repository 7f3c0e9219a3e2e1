"""What servos have left of their torque as they warm: known before a replay, from what was recorded.

A servo's heat follows the square of the torque that its law gives at the measured angle, speed and command, through a
filter of first order; so windows that start anywhere start as warm as the servo was.
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from simgap.data.align import Aligned
from simgap.data.plant import Plant
from simgap.data.temperature import measured_warming, warms
from simgap.simulation.state import MeasuredState
from simgap.simulation.variant import Variant

Array = NDArray[np.float64]

_EVERY = 0.02
"""[s] between two poses at which the lengths of cables are looked up; heat is far slower."""
_SINGLE = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
_AT_JOINT = int(mujoco.mjtTrn.mjTRN_JOINT)
_AT_TENDON = int(mujoco.mjtTrn.mjTRN_TENDON)
_WARMEST = 0.1
"""The law's denominator is never below this: of a motor that cools it falls."""


def heated(plant: Plant) -> list[int]:
    """Actuators whose torque follows from what is recorded: without a state of their own, their motion measured."""
    model = plant.model
    seen = {channel.qpos for channel in plant.outputs if channel.qpos >= 0}
    found = []
    for a in range(model.nu):
        plain = int(model.actuator_gaintype[a]) == int(mujoco.mjtGain.mjGAIN_FIXED)
        told = bool(model.actuator_biasprm[a, 1:3].any())
        if plain and model.actuator_dyntype[a] == 0 and (not told or _joints(model, a) <= seen):
            found.append(a)
    return found


def _joints(model: mujoco.MjModel, a: int) -> set[int]:
    """Addresses in qpos of what an actuator's length depends on; -1 among them where that cannot be told."""
    target, kind = int(model.actuator_trnid[a, 0]), int(model.actuator_trntype[a])
    if kind == _AT_JOINT:
        return {int(model.jnt_qposadr[target]) if int(model.jnt_type[target]) in _SINGLE else -1}
    if kind != _AT_TENDON:
        return {-1}
    dofs = {
        int(d)
        for wrap in range(model.tendon_adr[target], model.tendon_adr[target] + model.tendon_num[target])
        for d in _dofs(model, int(model.wrap_type[wrap]), int(model.wrap_objid[wrap]))
    }
    joints = [int(model.dof_jntid[d]) for d in dofs]
    return {int(model.jnt_qposadr[j]) if int(model.jnt_type[j]) in _SINGLE else -1 for j in joints}


def _dofs(model: mujoco.MjModel, wrap: int, target: int) -> list[int]:
    """Degrees of freedom that move an element of a tendon."""
    if wrap == int(mujoco.mjtWrap.mjWRAP_JOINT):
        return [int(model.jnt_dofadr[target])]
    if wrap == int(mujoco.mjtWrap.mjWRAP_SITE):
        body = int(model.site_bodyid[target])
    elif wrap in (int(mujoco.mjtWrap.mjWRAP_SPHERE), int(mujoco.mjtWrap.mjWRAP_CYLINDER)):
        body = int(model.geom_bodyid[target])
    else:
        return []
    found: list[int] = []
    while body > 0:
        found += range(model.body_dofadr[body], model.body_dofadr[body] + model.body_dofnum[body])
        body = int(model.body_parentid[body])
    return found


class Heat:
    """How warm the servos of one recording are, row by row."""

    def __init__(self, plant: Plant, aligned: Aligned) -> None:
        self._plant, self._aligned = plant, aligned
        self._warming = measured_warming(aligned, plant.model, plant.map)
        self.measured = frozenset(a for a, warming in self._warming.items() if warms(warming))
        """Actuators whose temperature was measured, and is not always the same."""
        self._heated = heated(plant)
        self._lengths: dict[int, tuple[MeasuredState, Array]] = {}

    def left(self, variant: Variant, inputs: Array, state: MeasuredState) -> Array | None:
        """Share (n, nu) of its torque that each actuator has left; None where none loses any.

        ``inputs`` (n, ni): as they reach the servos, but for delays. Every run begins with cold servos.
        """
        servos = variant.servos
        if not servos.heat_loss.any() and not servos.temperature_loss.any():
            return None
        denominator = np.ones((len(inputs), variant.model.nu))
        warming = [a for a in self._heated if servos.heat_loss[a]]
        if warming:
            square = (self._torque(variant, inputs, state) / servos.heat_reference) ** 2
            for a in warming:
                fade = float(np.exp(-self._aligned.period / servos.heat_time[a]))
                for run in self._aligned.runs:
                    rows = slice(run.start, run.stop)
                    heat = lfilter([0.0, 1.0 - fade], [1.0, -fade], square[rows, a])
                    denominator[rows, a] += servos.heat_loss[a] * heat
        for a, rise in self._warming.items():
            denominator[:, a] += servos.temperature_loss[a] * rise / 10.0
        result: Array = 1.0 / np.maximum(denominator, _WARMEST)
        return result

    def _torque(self, variant: Variant, inputs: Array, state: MeasuredState) -> Array:
        """What the variant's own servo law gives where the robot was (n, nu), in the unit of the actuator's force."""
        model, length = variant.model, self._length(state)
        rate = np.zeros_like(length)
        control = np.zeros_like(length)
        for run in self._aligned.runs:
            rows = np.arange(run.start, run.stop)
            rate[rows] = np.gradient(length[rows], self._aligned.period, axis=0)
            for i, channel in enumerate(self._plant.inputs):
                if channel.actuator >= 0:
                    late = rows - float(variant.inputs.delay[i]) / self._aligned.period
                    control[rows, channel.actuator] += np.interp(late, rows, inputs[rows, i])
        bias = model.actuator_biasprm
        force = model.actuator_gainprm[:, 0] * control + bias[:, 0] + bias[:, 1] * length + bias[:, 2] * rate
        limited = model.actuator_forcelimited.astype(bool)
        low, high = np.where(limited, model.actuator_forcerange.T, np.array([[-np.inf], [np.inf]]))
        result: Array = np.clip(force, low, high) * self._aligned.enabled[:, None]
        return result

    def _length(self, state: MeasuredState) -> Array:
        """Lengths (n, nu) of actuators where the robot was measured to be."""
        key = id(state)
        if key not in self._lengths:
            if len(self._lengths) > 50:
                self._lengths.clear()
            self._lengths[key] = state, self._looked_up(state)
        return self._lengths[key][1]

    def _looked_up(self, state: MeasuredState) -> Array:
        model = self._plant.model
        found = np.zeros((len(state.position), model.nu))
        column = {int(address): i for i, address in enumerate(state.qpos) if address >= 0}
        at_cable = [a for a in self._heated if int(model.actuator_trntype[a]) == _AT_TENDON]
        for a in range(model.nu):
            joint = int(model.actuator_trnid[a, 0])
            if int(model.actuator_trntype[a]) == _AT_JOINT and int(model.jnt_type[joint]) in _SINGLE:
                i = column.get(int(model.jnt_qposadr[joint]))
                if i is not None:
                    found[:, a] = model.actuator_gear[a, 0] * state.position[:, i]
        if at_cable:
            every = max(int(_EVERY / self._aligned.period), 1)
            rows, data = np.arange(0, len(found), every), mujoco.MjData(model)
            known = state.qpos >= 0
            lengths = np.empty((len(rows), len(at_cable)))
            for k, row in enumerate(rows):
                data.qpos[state.qpos[known]] = state.position[row, known]
                mujoco.mj_kinematics(model, data)
                mujoco.mj_comPos(model, data)
                mujoco.mj_tendon(model, data)
                mujoco.mj_transmission(model, data)
                lengths[k] = data.actuator_length[at_cable]
            for j, a in enumerate(at_cable):
                found[:, a] = np.interp(np.arange(len(found)), rows, lengths[:, j])
        return found
