"""How strongly a recording moves the robot, measured on a nominal replay."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from simgap.data.align import Aligned
from simgap.simulation.replay import Replayer
from simgap.simulation.variant import Variant

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Scales:
    """How strongly this recording moves the robot, from a nominal replay; gives effects a sense of size.

    Per degree of freedom: ``torque`` and ``speed`` (root mean square), joint ``inertia``, and the range of motion from
    ``low`` to ``high``. ``force`` is per actuator, ``input_rate`` per input: percentiles 60, 80, 95 of absolute values.
    ``input_update`` [s] is the usual time between two changes of an input.
    """

    torque: Array
    speed: Array
    inertia: Array
    low: Array
    high: Array
    force: Array
    tendon_force: Array
    input_rms: Array
    input_rate: Array
    input_update: Array
    output_rms: Array
    output_extreme: Array


def measure_scales(replayer: Replayer, nominal: Variant) -> Scales:
    """See Scales."""
    model, aligned = replayer.plant.model, replayer.aligned
    found = replayer.probe(nominal, ("qfrc_actuator", "qfrc_applied", "qvel", "qpos", "actuator_force"))
    torque = np.sqrt(((found["qfrc_actuator"] + found["qfrc_applied"]) ** 2).mean(0))
    speed = np.sqrt((found["qvel"] ** 2).mean(0))
    # A passive joint's torque: what moves its inertia about.
    passive = torque < 1e-6 * max(float(torque.max(initial=0.0)), 1e-12)
    swing = np.ptp(found["qpos"], axis=0)
    low, high = np.zeros(model.nv), np.zeros(model.nv)
    for joint in range(model.njnt):
        if int(model.jnt_type[joint]) in (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)):
            q, v = model.jnt_qposadr[joint], model.jnt_dofadr[joint]
            low[v], high[v] = np.percentile(found["qpos"][:, q], [0.5, 99.5])
            if passive[v]:
                inertial = model.dof_M0[v] * speed[v] ** 2 / max(float(swing[q]), 1e-6)
                torque[v] = max(inertial, model.jnt_stiffness[joint] * float(swing[q]) / 2)
    for i, address in enumerate(replayer.state.qpos):
        if address >= 0:
            low[replayer.state.dof[i]], high[replayer.state.dof[i]] = np.percentile(
                replayer.state.position[:, i], [0.2, 99.8]
            )
    force = np.percentile(np.abs(found["actuator_force"]), [60, 80, 95], axis=0).T if model.nu else np.zeros((0, 3))
    tendon_force = np.zeros(model.ntendon)
    for t in range(model.ntendon):
        pulls = (model.actuator_trntype == mujoco.mjtTrn.mjTRN_TENDON) & (model.actuator_trnid[:, 0] == t)
        if pulls.any():
            tendon_force[t] = float(np.sqrt((found["actuator_force"][:, pulls] ** 2).mean()))
        tendon_force[t] = max(tendon_force[t], float(model.tendon_stiffness[t]) * 0.01)
    inputs = aligned.inputs - aligned.inputs.mean(0)
    rates = [np.abs(np.diff(aligned.inputs[r.start : r.stop], axis=0)) / aligned.period for r in aligned.runs]
    rate = np.percentile(np.concatenate(rates), [60, 80, 95], axis=0).T
    outputs = np.where(aligned.valid, aligned.outputs, np.nan)
    return Scales(
        torque=torque,
        speed=speed,
        inertia=np.array(model.dof_M0),
        low=low,
        high=high,
        force=force,
        tendon_force=tendon_force,
        input_rms=np.sqrt((inputs**2).mean(0)),
        input_rate=rate,
        input_update=_update_period(aligned),
        output_rms=np.nan_to_num(np.nanstd(outputs, axis=0)),
        output_extreme=np.nan_to_num(np.nanpercentile(np.abs(outputs), 99.8, axis=0)),
    )


def _update_period(aligned: Aligned) -> Array:
    """Median time [s] between two changes of every input, (ni,); the recording's own period at least."""
    found = np.full(aligned.inputs.shape[1], aligned.period)
    for i in range(len(found)):
        gaps = [np.diff(np.flatnonzero(np.diff(aligned.inputs[r.start : r.stop, i]))) for r in aligned.runs]
        joined = np.concatenate(gaps)
        if len(joined):
            found[i] = max(float(np.median(joined)), 1.0) * aligned.period
    return found
