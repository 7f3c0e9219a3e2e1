"""Is the map right? Wrong units, flipped signs and swapped columns are noticed here, before an effect explains them."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from simgap.data.align import Aligned
from simgap.data.channels import model_names
from simgap.data.errors import GapInputError
from simgap.data.plant import Plant
from simgap.simulation.state import MeasuredState

Array = NDArray[np.float64]

# Ratios between units that are commonly taken for each other.
_CONFUSIONS = {
    "degrees for radians": 180.0 / np.pi,
    "radians for degrees": np.pi / 180.0,
    "turns for radians": 1.0 / (2 * np.pi),
    "revolutions per minute for radians per second": 60.0 / (2 * np.pi),
    "a unit a thousand times smaller": 1000.0,
    "a unit a thousand times larger": 0.001,
    "centimetres for metres": 100.0,
    "metres for centimetres": 0.01,
}
_CLEAR = 0.9
"""Correlation from which two signals count as the same thing."""


def check_map(plant: Plant, aligned: Aligned, state: MeasuredState) -> list[str]:
    """Compare channels that must agree by definition or by mechanics.

    Rates with the slope of positions, position commands with the positions they command, and joint torques with what
    the measured motion takes by inverse dynamics.

    Returns:
        Warnings about what looks odd but is not certain.

    Raises:
        GapInputError: a unit, sign or column that is wrong beyond doubt.
    """
    warnings: list[str] = []
    try:
        _check_ranges(plant, aligned)
        _check_rates(plant, aligned)
        _check_commands(plant, aligned, warnings)
        _check_torques(plant, aligned, state, warnings)
    except GapInputError as error:
        raise GapInputError(f"{aligned.source}: {error}") from error
    return warnings


def _check_ranges(plant: Plant, aligned: Aligned) -> None:
    model = plant.model
    for i, channel in enumerate(plant.outputs):
        if channel.qpos < 0 or not aligned.live[i]:
            continue
        joint = int(np.flatnonzero(model.jnt_qposadr == channel.qpos)[0])
        if not model.jnt_limited[joint]:
            continue
        low, high = model.jnt_range[joint]
        values = channel.coordinate(aligned.outputs[aligned.valid[:, i], i])
        outside = np.percentile(np.maximum(low - values, values - high), 75)
        if outside > 2.0 * (high - low):
            raise GapInputError(
                f"outputs: column {channel.column!r} lies far outside the range of joint {channel.subsystem!r} "
                f"({low:.3g} to {high:.3g}; median {np.median(values):.3g}): the unit in the map is wrong"
            )

    _check_heights(plant, aligned)


def _check_heights(plant: Plant, aligned: Aligned) -> None:
    """A free body is recorded about as high as the model's reference pose has it, not a hundred times higher."""
    model = plant.model
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    reference = plant.read(data.sensordata)
    for i, channel in enumerate(plant.outputs):
        if channel.sensor_type != mujoco.mjtSensor.mjSENS_FRAMEPOS or channel.component != 2 or not aligned.live[i]:
            continue
        height = float(np.median(aligned.outputs[aligned.valid[:, i], i]))
        if min(height, reference[i]) <= 0:
            continue
        for label, ratio in _CONFUSIONS.items():
            if ("unit" in label or "metres" in label) and abs(np.log(height / reference[i] / ratio)) < 0.7:
                raise GapInputError(
                    f"outputs: column {channel.column!r} lies at a height of {height:.3g} m where the model has "
                    f"{reference[i]:.3g} m: its unit in the map is wrong (it looks like {label})"
                )


def check_replay(plant: Plant, measured: Array, replayed: Array) -> None:
    """Compare changes within windows (nw, ns, no), measured and replayed by the nominal model, for mistaken units.

    For channels that nothing else is compared with (inertial sensors, forces, bodies).

    Raises:
        GapInputError: a channel moves like the replayed one, times a factor between units that people confuse.
    """
    for i, channel in enumerate(plant.outputs):
        if channel.wrapped or (channel.qpos >= 0 and channel.sensor_type != mujoco.mjtSensor.mjSENS_FRAMEPOS):
            continue
        a = replayed[..., i] - replayed[..., i].mean(axis=1, keepdims=True)
        b = measured[..., i] - measured[..., i].mean(axis=1, keepdims=True)
        whole = np.isfinite(a).all(axis=1) & np.isfinite(b).all(axis=1)
        a, b = a[whole].ravel(), b[whole].ravel()
        power = float(np.linalg.norm(a) * np.linalg.norm(b))
        if power <= 0 or float(a @ b) < 0.7 * power:
            continue
        slope = float(np.linalg.norm(b) / np.linalg.norm(a))
        for label, ratio in _CONFUSIONS.items():
            if abs(np.log(slope)) > 1.2 and abs(np.log(slope / ratio)) < 0.4:
                raise GapInputError(
                    f"outputs: column {channel.column!r} moves {slope:.3g} times as much as the model: "
                    f"its unit in the map is wrong (it looks like {label})"
                )


def positions_by_dof(plant: Plant, aligned: Aligned) -> dict[int, int]:
    """Live outputs that are the position of a joint, by its degree of freedom."""
    model = plant.model
    return {
        int(model.jnt_dofadr[np.flatnonzero(model.jnt_qposadr == c.qpos)[0]]): i
        for i, c in enumerate(plant.outputs)
        if c.qpos >= 0 and aligned.live[i]
    }


def _check_rates(plant: Plant, aligned: Aligned) -> None:
    """A measured rate must be the slope of the measured position of the same coordinate."""
    rates: dict[int, int] = {c.dof: i for i, c in enumerate(plant.outputs) if c.dof >= 0 and aligned.live[i]}
    positions = positions_by_dof(plant, aligned)
    both = sorted(set(rates) & set(positions))
    if not both:
        return
    slopes = np.stack([_slope(aligned, positions[d]) / plant.outputs[positions[d]].gear for d in both], 1)
    values = np.stack([aligned.outputs[:, rates[d]] / plant.outputs[rates[d]].gear for d in both], 1)
    _compare(
        slopes,
        values,
        [plant.outputs[positions[d]].column for d in both],
        [plant.outputs[rates[d]].column for d in both],
        "is the rate of",
    )


def _check_commands(plant: Plant, aligned: Aligned, warnings: list[str]) -> None:
    """A joint follows its position command, roughly and late."""
    model = plant.model
    pairs: list[tuple[int, int]] = []
    for i, channel in enumerate(plant.inputs):
        if channel.kind != "position" or model.actuator_trntype[channel.actuator] != mujoco.mjtTrn.mjTRN_JOINT:
            continue
        joint = int(model.actuator_trnid[channel.actuator, 0])
        for o, output in enumerate(plant.outputs):
            if output.qpos == model.jnt_qposadr[joint] and aligned.live[o]:
                pairs.append((i, o))
    pairs = [(i, o) for i, o in pairs if np.ptp(aligned.inputs[:, i]) > 0]
    if not pairs:
        return
    told = np.stack([aligned.inputs[:, i] for i, _ in pairs], 1)
    done = np.stack([plant.outputs[o].coordinate(aligned.outputs[:, o]) for _, o in pairs], 1)
    lag = _best_lag(told, done, aligned.period)
    told, done = told[: len(told) - lag or None], done[lag:]
    warnings += _compare(
        told,
        done,
        [plant.inputs[i].column for i, _ in pairs],
        [plant.outputs[o].column for _, o in pairs],
        "follows",
        low=0.5,
        falls_short=True,
    )


def _check_torques(plant: Plant, aligned: Aligned, state: MeasuredState, warnings: list[str]) -> None:
    """Where all coordinates and torques are known, the motion must take about these torques."""
    model = plant.model
    torques = [i for i, c in enumerate(plant.inputs) if c.kind == "torque"]
    if not torques or len(torques) != len(plant.inputs) or not state.complete(model) or state.base is not None:
        return
    if (
        model.nu
        and {c.actuator for c in plant.inputs} != set(range(model.nu))
        and not all(plant.inputs[i].measured for i in torques)
    ):
        return
    dofs = []
    for i in torques:
        channel = plant.inputs[i]
        if channel.dof >= 0:
            dofs.append((channel.dof, 1.0))
        elif model.actuator_trntype[channel.actuator] == mujoco.mjtTrn.mjTRN_JOINT:
            scale = model.actuator_gear[channel.actuator, 0] * model.actuator_gainprm[channel.actuator, 0]
            dofs.append((int(model.jnt_dofadr[model.actuator_trnid[channel.actuator, 0]]), float(scale)))
        else:
            return
    data = mujoco.MjData(model)
    rows = np.concatenate([np.arange(r.start + 4, r.stop - 4) for r in aligned.runs])
    rows = rows[:: max(len(rows) // 3000, 1)]
    needed = np.zeros((len(rows), model.nv))
    acceleration = np.zeros_like(state.velocity)
    for run in aligned.runs:
        part = slice(run.start, run.stop)
        acceleration[part] = np.gradient(state.velocity[part], aligned.period, axis=0)
    for k, row in enumerate(rows):
        data.qpos[state.qpos], data.qvel[state.dof] = state.position[row], state.velocity[row]
        data.qacc[state.dof] = acceleration[row]
        mujoco.mj_inverse(model, data)
        needed[k] = data.qfrc_inverse
    given = np.stack([aligned.inputs[rows, i] * s for i, (_, s) in zip(torques, dofs, strict=True)], 1)
    took = np.stack([needed[:, d] for d, _ in dofs], 1)
    names = model_names(model, mujoco.mjtObj.mjOBJ_JOINT)
    _compare(
        took,
        given,
        [f"joint {names[int(model.dof_jntid[d])]}" for d, _ in dofs],
        [plant.inputs[i].column for i in torques],
        "drives",
        low=0.75,
    )


def _compare(
    reference: Array,
    values: Array,
    reference_names: list[str],
    value_names: list[str],
    verb: str,
    low: float = _CLEAR,
    falls_short: bool = False,
) -> list[str]:
    """Columns of ``values`` should each equal that of ``reference``: correlation high, slope near 1.

    falls_short: a value may well be a fraction of its reference (a joint at a stop, a weak servo), but not a faithful
        image of it, as in another unit.

    Returns:
        Warnings about columns that fall short.

    Raises:
        GapInputError: another column fits instead, the sign is opposite, or the slope is that of a unit mistaken.
    """
    a, b = reference - reference.mean(0), values - values.mean(0)
    norm_a, norm_b = np.linalg.norm(a, axis=0) + 1e-300, np.linalg.norm(b, axis=0) + 1e-300
    match = (a.T @ b) / np.outer(norm_a, norm_b)
    n = match.shape[0]
    warnings = []
    for i in range(n):
        for j in range(i + 1, n):
            own, crossed = min(match[i, i], match[j, j]), min(match[i, j], match[j, i])
            if crossed > max(low, 0.7) and own < 0.6 * crossed:
                raise GapInputError(
                    f"columns {value_names[i]!r} and {value_names[j]!r} look swapped: {value_names[j]!r} {verb} "
                    f"{reference_names[i]!r} (correlation {match[i, j]:.2f}, as mapped {match[i, i]:.2f}); exchange "
                    "the two in the map"
                )
    for i in range(n):
        slope = float(a[:, i] @ b[:, i] / norm_a[i] ** 2)
        if match[i, i] < -max(low, 0.8):
            raise GapInputError(
                f"column {value_names[i]!r} {verb} {reference_names[i]!r} with the opposite sign "
                f"(correlation {match[i, i]:.2f}); set sign: -1 in the map or correct the column"
            )
        if match[i, i] < low or slope <= 0 or abs(np.log(slope)) < 1.2:
            continue
        if falls_short and slope < 1 and match[i, i] < _CLEAR:
            warnings.append(
                f"column {value_names[i]!r} is {slope:.2g} times what {reference_names[i]!r} says and follows it badly "
                f"(correlation {match[i, i]:.2f}): the joint falls short of its commands, or its unit is wrong"
            )
            continue
        for label, ratio in _CONFUSIONS.items():
            if abs(np.log(slope / ratio)) < 0.3:
                raise GapInputError(
                    f"column {value_names[i]!r} is {slope:.3g} times what {reference_names[i]!r} says: "
                    f"one of their units in the map is wrong (it looks like {label})"
                )
    return warnings


def _slope(aligned: Aligned, i: int) -> Array:
    slope = np.zeros(len(aligned.time))
    for run in aligned.runs:
        slope[run.start : run.stop] = np.gradient(aligned.outputs[run.start : run.stop, i], aligned.period)
    return slope


def _best_lag(told: Array, done: Array, period: float) -> int:
    """Rows by which all positions together follow their commands best, up to 0.3 s."""
    candidates = range(0, max(int(0.3 / period), 1), max(int(0.01 / period), 1))
    scores = []
    for lag in candidates:
        a, b = told[: len(told) - lag or None], done[lag:]
        a, b = a - a.mean(0), b - b.mean(0)
        scores.append(
            float(np.abs((a * b).sum(0) / (np.linalg.norm(a, axis=0) * np.linalg.norm(b, axis=0) + 1e-300)).sum())
        )
    return list(candidates)[int(np.argmax(scores))]
