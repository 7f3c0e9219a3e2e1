"""Near before far: parts whose both ends are measured, each looked at by itself, without any simulation.

A servo is told where to go and says where it is; a cable has a motor at one end and joints with encoders at the other.
Such a part needs no dynamics, no contacts and no other part to show an offset, a delay or a stretch. What stands out
among its likes is where the search for the whole robot begins as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from simgap.data.align import Aligned
from simgap.data.channels import InputChannel, OutputChannel
from simgap.data.plant import Plant

Array = NDArray[np.float64]
Sens = mujoco.mjtSensor

LATEST = 0.3
"""[s] Lags are looked for up to here."""
STANDS_OUT = 6.0
"""Robust deviations (of the other parts of the kind) from which a part stands out; and so many noise floors."""
LIKES = 3
"""Parts of a kind that are needed to say what is usual among them."""
_STILL = 0.15
"""[s] for which a command has to rest before a servo is asked where it came to rest."""
_FEW = 20
"""Resting samples that are needed."""
_LAST = {Sens.mjSENS_ACTUATORPOS, Sens.mjSENS_TENDONPOS}


@dataclass(frozen=True)
class Border:
    """What the signals at both ends of one part say.

    Attributes:
        part: name of the actuator, or of the sensor whose cable it is.
        kind: servo (command and report) or cable (report and joints' encoders).
        offset: of a servo at rest, report minus command; of a cable report minus what the joints say, on average.
        lag: [s] by which the report follows the command; NaN for a cable, or where nothing moves.
        spread: deviation of what offset is the mean of.
        unit: of offset, spread and noise.
        noise: floor of the report.
        stands_out: names of the numbers (offset, lag, spread) in which it differs from its likes.
    """

    part: str
    kind: str
    offset: float
    lag: float
    spread: float
    unit: str
    noise: float = 0.0
    stands_out: tuple[str, ...] = ()

    def told(self) -> dict[str, object]:
        """As a row of the report."""
        numbers = {"offset": self.offset, "lag_s": self.lag, "spread": self.spread}
        return {
            "part": self.part,
            "kind": self.kind,
            **{k: None if np.isnan(v) else float(v) for k, v in numbers.items()},
            "unit": self.unit,
            "stands_out": list(self.stands_out),
        }


def borders(plant: Plant, aligned: Aligned, floor: Array) -> list[Border]:
    """Parts of a robot whose both ends are measured. ``floor`` (no,) is the outputs' noise."""
    found = [*_servos(plant, aligned, floor), *_cables(plant, aligned, floor)]
    return [_compared(b, [o for o in found if o.kind == b.kind], aligned.period) for b in found]


def hints(found: Sequence[Border]) -> list[tuple[str, str, float]]:
    """Effects (name, site, value) that parts which stand out speak for, where their value is plain."""
    lags = [b.lag for b in found if b.kind == "servo" and np.isfinite(b.lag)]
    usual = float(np.median(lags)) if lags else np.inf
    spoken = []
    for b in found:
        if b.kind == "servo" and "lag" in b.stands_out and b.lag > usual:
            spoken.append(("servo_delay", b.part, float(b.lag - usual)))
        if b.kind == "servo" and "offset" in b.stands_out:
            spoken.append(("servo_offset", b.part, b.offset))
    return spoken


def _servos(plant: Plant, aligned: Aligned, floor: Array) -> list[Border]:
    made = []
    for i, command in enumerate(plant.inputs):
        if command.actuator < 0 or command.kind != "position" or command.measured:
            continue
        report = _report(plant, aligned, command)
        if report is None:
            continue
        index, channel = report
        # In the unit of the command, which is what a servo compares: its own length, gear times the joint.
        told, gear = aligned.inputs[:, i], 1.0
        said = aligned.outputs[:, index]
        if channel.qpos >= 0:
            gear = float(plant.model.actuator_gear[command.actuator, 0])
            said = gear * channel.coordinate(said)
        ok = aligned.valid[:, index] & aligned.enabled
        error = (said - told)[_resting(aligned, told) & ok]
        rests = len(error) >= _FEW
        made.append(
            Border(
                mujoco.mj_id2name(plant.model, mujoco.mjtObj.mjOBJ_ACTUATOR, command.actuator) or command.name,
                "servo",
                float(np.median(error)) if rests else np.nan,
                _lag(aligned, told, said, ok),
                float(error.std()) if rests else np.nan,
                channel.unit,
                float(floor[index] * abs(gear / channel.gear)),
            )
        )
    return made


def _report(plant: Plant, aligned: Aligned, command: InputChannel) -> tuple[int, OutputChannel] | None:
    """The output that says where a servo is: its own report, or the position of the joint that it drives."""
    model, actuator = plant.model, command.actuator
    joint = model.actuator_trnid[actuator, 0] if model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_JOINT else -1
    best = None
    for i, output in enumerate(plant.outputs):
        if not aligned.live[i]:
            continue
        if output.sensor_type == Sens.mjSENS_ACTUATORPOS and _object(model, output) == actuator:
            return i, output
        if joint >= 0 and output.qpos == model.jnt_qposadr[joint]:
            best = i, output
    return best


def _object(model: mujoco.MjModel, output: OutputChannel) -> int:
    return int(model.sensor_objid[np.flatnonzero(model.sensor_adr == output.address)[0]])


def _resting(aligned: Aligned, told: Array) -> NDArray[np.bool_]:
    """Rows before which a command has not moved for a while, within a run."""
    steps = max(round(_STILL / aligned.period), 1)
    found = np.zeros(len(told), bool)
    tolerance = 1e-3 * max(float(np.ptp(told)), 1e-12)
    for run in aligned.runs:
        moved = np.abs(np.diff(told[run.start : run.stop], prepend=np.nan)) > tolerance
        moved[0] = True
        since = np.arange(len(moved)) - np.maximum.accumulate(np.where(moved, np.arange(len(moved)), 0))
        found[run.start : run.stop] = since >= steps
    return found


def _lag(aligned: Aligned, told: Array, said: Array, ok: NDArray[np.bool_]) -> float:
    """Delay [s] of the command that explains a report best by least squares; NaN where nothing moves."""
    if ok.sum() < _FEW or np.ptp(told) < 1e-9:
        return float("nan")
    _, costs, usable = lag_costs(aligned, told, said, ok)
    return refined(costs) * aligned.period if usable.sum() >= _FEW else float("nan")


def lag_costs(
    aligned: Aligned, told: Array, said: Array, ok: NDArray[np.bool_]
) -> tuple[NDArray[np.int64], Array, NDArray[np.bool_]]:
    """Lags in rows, what a straight line in ``told``, so much later, leaves of ``said`` squared, and the rows used."""
    steps = np.arange(0, max(round(LATEST / aligned.period), 2) + 1)
    costs = np.zeros(len(steps))
    usable = ok & np.concatenate([np.arange(r.stop - r.start) >= steps[-1] for r in aligned.runs])
    if not usable.any():
        return steps, costs, usable
    y = said[usable] - said[usable].mean()
    for k in steps:
        late = np.concatenate([_delayed(told[r.start : r.stop], int(k)) for r in aligned.runs])
        x = late[usable] - late[usable].mean()
        costs[k] = float(y @ y - (x @ y) ** 2 / max(float(x @ x), 1e-300))
    return steps, costs, usable


def refined(costs: Array) -> float:
    """Where the least of costs lies, between rows: the vertex of the parabola about it."""
    k = int(np.argmin(costs))
    if not 0 < k < len(costs) - 1:
        return float(k)
    curve = costs[k - 1] - 2.0 * costs[k] + costs[k + 1]
    return float(k + 0.5 * (costs[k - 1] - costs[k + 1]) / max(curve, 1e-300))


def _delayed(values: Array, steps: int) -> Array:
    return np.concatenate([np.full(min(steps, len(values)), values[0]), values[: len(values) - steps]])


def _cables(plant: Plant, aligned: Aligned, floor: Array) -> list[Border]:
    """Lengths that are measured at a motor against those that the joints' encoders give."""
    model = plant.model
    measured = {int(o.qpos): i for i, o in enumerate(plant.outputs) if o.qpos >= 0 and aligned.live[i]}
    ends = [
        (i, o)
        for i, o in enumerate(plant.outputs)
        if o.sensor_type in _LAST and aligned.live[i] and o.qpos < 0 and _driven(model, o) <= set(measured)
    ]
    ends = [(i, o) for i, o in ends if _driven(model, o)]
    if not ends:
        return []
    data, rows = mujoco.MjData(model), np.arange(0, len(aligned.time), max(len(aligned.time) // 2000, 1))
    lengths = np.zeros((len(rows), len(plant.outputs)))
    for k, row in enumerate(rows):
        for address, i in measured.items():
            data.qpos[address] = plant.outputs[i].coordinate(aligned.outputs[row, i])
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_sensorPos(model, data)
        lengths[k] = plant.read(data.sensordata)
    made = []
    for i, output in ends:
        ok = aligned.valid[rows, i] & np.all([aligned.valid[rows, measured[q]] for q in _driven(model, output)], axis=0)
        if ok.sum() >= _FEW:
            error = (aligned.outputs[rows, i] - lengths[:, i])[ok]
            unit, noise = output.unit, float(floor[i])
            made.append(Border(output.name, "cable", float(np.median(error)), np.nan, float(error.std()), unit, noise))
    return made


def _driven(model: mujoco.MjModel, output: OutputChannel) -> set[int]:
    """Addresses of the coordinates on which a measured length depends, in the reference pose."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    index, tendon = _object(model, output), -1
    if output.sensor_type == Sens.mjSENS_TENDONPOS:
        tendon = index
    elif model.actuator_trntype[index] == mujoco.mjtTrn.mjTRN_TENDON:
        tendon = int(model.actuator_trnid[index, 0])
    if tendon < 0:
        return set()
    first, count = int(model.ten_J_rowadr[tendon]), int(model.ten_J_rownnz[tendon])
    arms = np.abs(np.asarray(data.ten_J).ravel()[first : first + count])
    dofs = np.asarray(model.ten_J_colind)[first : first + count][arms > 1e-9]
    return {int(model.jnt_qposadr[model.dof_jntid[d]]) for d in dofs}


def _compared(mine: Border, likes: Sequence[Border], period: float) -> Border:
    """The same, with what stands out among its likes."""
    if len(likes) < LIKES:
        return mine
    out, least = [], dict.fromkeys(("offset", "spread"), STANDS_OUT * mine.noise) | {"lag": 2.0 * period}
    for name in ("offset", "lag", "spread"):
        others = np.array([getattr(o, name) for o in likes if o is not mine])
        others, value = others[np.isfinite(others)], getattr(mine, name)
        if len(others) < LIKES - 1 or not np.isfinite(value):
            continue
        away = abs(value - np.median(others))
        usual = 1.4826 * float(np.median(np.abs(others - np.median(others))))
        steady = name != "offset" or not mine.spread > abs(value)
        if (
            away > max(STANDS_OUT * usual, least[name])
            and steady
            and not (name == "spread" and value < np.median(others))
        ):
            out.append(name)
    return replace(mine, stands_out=tuple(out))
