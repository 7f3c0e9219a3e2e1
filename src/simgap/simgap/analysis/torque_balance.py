"""Near before far: what the torque balance of each joint says by itself, without a simulation.

Where all joints are measured, the model's inverse dynamics say which torque tau a motion took. A drive gives what its
input asks for, and some of it is lost,

    tau = g K (u(t - lag) + o - q) - f sign(dq) - d dq,

with K the drive's nominal gain. Of a servo this is solved for its error u - q, in which tau / (g K) and the losses are
linear: of a gain that is wrong by decades the error is large and well measured, and of one that is right it vanishes.
Where a torque drives the joint it is solved for tau itself. Gain, friction, damping, zero and lag come of a regression
of seconds, in which other joints, contacts and chaos have no say. It is rough (accelerations are those of a smoothed
log), so it judges nothing: it is told as a first answer, and the search for the whole robot begins there as well.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear
from scipy.signal import savgol_coeffs

from simgap.data.align import Aligned
from simgap.data.channels import is_servo, model_names
from simgap.data.plant import Plant
from simgap.simulation.contacts import colliding
from simgap.simulation.state import MeasuredState

Array = NDArray[np.float64]
Obj = mujoco.mjtObj

_SPAN, _ORDER = 0.1, 3
"""[s] and degree of the local polynomial that gives speeds and accelerations."""
_LATEST = 0.12
"""[s] Lags are looked for up to here."""
_ROWS = 4000
"""Rows that are looked at, at most, spread over the recording."""
_FEW = 60
"""Moving rows that are needed."""
_MOVING = 0.05
"""Of a joint's usual speed: slower, what friction does is not known."""
_ROUNDS, _ROBUST = 8, 2.0
"""Of reweighting; and the robust deviations from which a row counts less."""
_LEAST_GAIN, _LARGEST_GAIN = 0.002, 100.0
EXPLAINED = 0.5
"""Share of the torque's power that a balance must explain before the search begins where it says."""
_IMMODERATE = 5.0
"""Times the torque that a motion takes: such losses are those of a gain that is wrong."""
WORTH = 0.1
"""Share of a joint's usual torque that a term must carry to be spoken for."""


@dataclass(frozen=True)
class Balance:
    """What the torque balance of one joint says.

    Attributes:
        joint, actuator: names; the actuator is empty where a recorded torque drives the joint.
        gain: factor of the drive's nominal gain; where ``borrowed``, that of other joints, for this one's motion takes
            too little torque to tell. Friction and damping are in proportion to it.
        friction: dry friction beside the model's [N m or N].
        damping: beside the model's [N m s/rad or N s/m].
        offset: what a servo adds to its command, in the command's unit; of another drive the torque beside [N m or N].
        lag: [s] of the input.
        torque: root mean square of the torque that the motion took [N m or N].
        explained: share of the power of the servo's error (of the torque) that the balance explains (1: all).
        nominal: share of it that nominal numbers explain; negative where they make it worse.
        carries: {term: root mean square of what it carries, as a share of that error (torque)}.
        servo: whether the drive is a position servo.
    """

    joint: str
    actuator: str
    gain: float
    friction: float
    damping: float
    offset: float
    lag: float
    torque: float
    explained: float
    nominal: float
    carries: dict[str, float]
    servo: bool = False
    borrowed: bool = False

    @property
    def lost(self) -> float:
        """Root mean square of friction and damping, were the gain the nominal one [N m or N]."""
        share = float(np.hypot(self.carries["friction"], self.carries["damping"]))
        return share * self.torque / max(self.carries["torque"], 1e-300) / self.gain

    def told(self) -> dict[str, object]:
        """As a row of the report."""
        return {
            "joint": self.joint,
            "gain": None if self.borrowed else self.gain,
            "friction": self.friction,
            "damping": self.damping,
            "offset": self.offset,
            "lag_s": self.lag,
            "torque_rms": self.torque,
            "explained": self.explained,
            "explained_by_nominal": self.nominal,
        }


def balances(plant: Plant, aligned: Aligned, state: MeasuredState) -> list[Balance]:
    """Of every driven joint; empty where a joint is not measured, a base floats, or bodies can touch the ground.

    Where runs differ, of those that are as most are.
    """
    rows = np.bincount([run.setup for run in aligned.runs], [run.stop - run.start for run in aligned.runs])
    setup = int(np.argmax(rows))
    model = copy.copy(plant.model)
    plant.setups[setup].apply(model)
    plant = replace(plant, model=model)
    if state.base is not None or not state.complete(model) or model.na or colliding(model)[0]:
        return []
    motion = _Motion.of(plant, aligned, state, setup)
    return _lent([b for dof in _driven(plant) if (b := _balance(plant, aligned, motion, dof)) is not None])


def _lent(found: list[Balance]) -> list[Balance]:
    """With the usual gain of the others for joints whose own cannot be told."""
    told = [b.gain for b in found if b.carries["torque"] > WORTH]
    usual = float(np.median(told)) if told else _moderate(found)
    made = []
    for b in found:
        if b.carries["torque"] <= WORTH:
            share = usual / b.gain
            b = replace(b, gain=usual, friction=share * b.friction, damping=share * b.damping, borrowed=True)
        made.append(b)
    return made


def _moderate(found: Sequence[Balance]) -> float:
    """Gain at which drives lose as much as the motion takes, where by the nominal one they would lose many times that.

    A servo's error at a steady load says gain or zero, and in motion loss over gain: of a published gain that is fifty
    times too large, all of it is zeros and losses that no gear has.
    """
    servos = [b for b in found if b.servo]
    took = float(np.linalg.norm([b.torque for b in servos]))
    lost = float(np.linalg.norm([b.lost for b in servos])) if servos else 0.0
    return max(took / lost, _LEAST_GAIN) if lost > _IMMODERATE * took else 1.0


def hints(found: Sequence[Balance], switched: bool = False) -> list[tuple[str, str, float]]:
    """Effects (name, site, value) that balances speak for, kind by kind, what carries most first.

    A balance is one of times at which servos had power. Where they are ``switched``, damping is theirs until shown
    otherwise: a motor brakes more than a bearing.

    A kind is spoken of once it is worth it at one joint, and then at all, if most balances are believed; else at those
    whose balance is.
    """
    believed = [b for b in found if b.explained > EXPLAINED and b.explained > b.nominal + WORTH**2]
    if 2 * len(believed) < len(found):
        found = believed
    kinds: dict[str, tuple[float, list[tuple[str, str, float]]]] = {}
    for b in found:
        off = abs(float(np.log(max(b.gain, _LEAST_GAIN)))) if b.actuator else 0.0
        brakes = b.servo and switched
        rows = [
            ("servo_gain", b.actuator, b.gain, off),
            ("coulomb_friction", b.joint, b.friction, b.carries["friction"]),
            ("servo_damping", b.actuator if brakes else "", b.damping, b.carries["damping"]),
            ("viscous_friction", "" if brakes else b.joint, b.damping, b.carries["damping"]),
            ("joint_damping", "" if brakes else b.joint, b.damping, b.carries["damping"]),
            ("servo_offset", b.actuator if b.servo else "", b.offset, b.carries["offset"]),
        ]
        for name, site, value, worth in rows:
            if site:
                most, spoken = kinds.setdefault(name, (0.0, []))
                kinds[name] = max(most, worth), [*spoken, (name, site, value)]
    ranked = sorted((kind for kind in kinds.values() if kind[0] > WORTH), key=lambda kind: -kind[0])
    return [row for _, spoken in ranked for row in spoken]


@dataclass(frozen=True)
class _Motion:
    """Smoothed motion on some rows of the grid, and the torque that it takes; all (nr, nv) but ``rows``."""

    rows: NDArray[np.int64]
    kernel: Array
    position: Array
    speed: Array
    acceleration: Array
    torque: Array

    @classmethod
    def of(cls, plant: Plant, aligned: Aligned, state: MeasuredState, setup: int) -> _Motion:
        """Of all measured joints, in the order of the model's degrees of freedom; in the runs of one setup."""
        model, period = _free(plant.model), aligned.period
        half = max(round(0.5 * _SPAN / period), 3)
        kernel, slope, curve = (savgol_coeffs(2 * half + 1, _ORDER, deriv=d, delta=period) for d in range(3))
        ok = np.zeros(len(aligned.time), bool)
        for run in (run for run in aligned.runs if run.setup == setup):
            ok[run.start + half + round(_LATEST / period) + 1 : max(run.stop - half, run.start)] = True
        measured = [i for i, c in enumerate(plant.outputs) if c.qpos >= 0]
        rows = np.flatnonzero(ok & aligned.enabled & aligned.valid[:, measured].all(axis=1))
        rows = rows[:: max(-(-len(rows) // _ROWS), 1)]
        order = np.argsort(state.dof)
        q, v, a = (np.zeros((len(rows), model.nv)) for _ in range(3))
        for dof, column in zip(state.dof[order], order, strict=True):
            series = state.position[:, column]
            around = series[rows[:, None] + np.arange(half, -half - 1, -1)]
            q[:, dof], v[:, dof], a[:, dof] = around @ kernel, around @ slope, around @ curve
        data, torque = mujoco.MjData(model), np.zeros((len(rows), model.nv))
        address = np.array([int(model.jnt_qposadr[model.dof_jntid[d]]) for d in range(model.nv)])
        for k in range(len(rows)):
            data.qpos[address], data.qvel[:], data.qacc[:] = q[k], v[k], a[k]
            mujoco.mj_inverse(model, data)
            torque[k] = data.qfrc_inverse + data.qfrc_damper
        return cls(rows, kernel, q, v, a, torque)

    def smoothed(self, series: Array, lag: float, period: float) -> Array:
        """A series (n,) as it was ``lag`` [s] before the rows, smoothed as the motion is."""
        half = len(self.kernel) // 2
        late = lag / period
        whole, share = int(late), late - int(late)
        at = self.rows[:, None] + np.arange(half, -half - 1, -1) - whole
        value: Array = ((1.0 - share) * series[at] + share * series[at - 1]) @ self.kernel
        return value


def _free(model: mujoco.MjModel) -> mujoco.MjModel:
    """The model without constraints: stops, contacts and dry friction."""
    free = copy.copy(model)
    free.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    return free


def _driven(plant: Plant) -> list[int]:
    """Degrees of freedom that an input moves by itself."""
    model, found = plant.model, set()
    for channel in plant.inputs:
        if channel.actuator >= 0 and model.actuator_trntype[channel.actuator] == mujoco.mjtTrn.mjTRN_JOINT:
            found.add(int(model.jnt_dofadr[model.actuator_trnid[channel.actuator, 0]]))
        elif channel.actuator < 0:
            found.add(channel.dof)
    return sorted(found)


def _balance(plant: Plant, aligned: Aligned, motion: _Motion, dof: int) -> Balance | None:
    model = plant.model
    speed = motion.speed[:, dof]
    usual = float(np.sqrt((speed**2).mean()))
    moving = np.abs(speed) > _MOVING * usual
    drives = [
        i
        for i, c in enumerate(plant.inputs)
        if c.dof == dof
        or (c.actuator >= 0 and _joint_dof(model, c.actuator) == dof and model.actuator_dyntype[c.actuator] == 0)
    ]
    if moving.sum() < _FEW or usual <= 0.0 or not drives or not np.any(motion.torque[moving, dof]):
        return None
    # The smoothed sign is what the smoother makes of a reversal.
    direction = np.tanh(speed / (_MOVING * usual))
    terms = np.stack([motion.torque[:, dof], direction, speed, np.ones_like(speed)], axis=1)[moving]
    (first,), several = drives[:1], len(drives) > 1
    actuator = plant.inputs[first].actuator
    if actuator >= 0 and is_servo(model, actuator, 1) and not several:
        solve: _Solve = _servo(plant, aligned, motion, dof, first, terms, moving)
    else:
        solve = _torque(plant, aligned, motion, dof, drives, terms, moving)
    found = min((solve(float(lag)) for lag in np.arange(0.0, _LATEST + 1e-9, 0.5 * aligned.period)), key=_missed)
    joint = int(model.dof_jntid[dof])
    return replace(
        found[1],
        joint=model_names(model, Obj.mjOBJ_JOINT)[joint],
        actuator=model_names(model, Obj.mjOBJ_ACTUATOR)[actuator] if actuator >= 0 else "",
        friction=found[1].friction - float(model.dof_frictionloss[dof]),
        torque=float(np.sqrt((terms[:, 0] ** 2).mean())),
    )


_Solved = tuple[float, Balance]
_Solve = Callable[[float], _Solved]


def _missed(solved: _Solved) -> float:
    return solved[0]


def _servo(
    plant: Plant, aligned: Aligned, motion: _Motion, dof: int, i: int, terms: Array, moving: NDArray[np.bool_]
) -> _Solve:
    """A servo's error by what it carries."""
    model, channel = plant.model, plant.inputs[i]
    gear = float(model.actuator_gear[channel.actuator, 0])
    gain = -float(model.actuator_biasprm[channel.actuator, 1]) * gear**2
    rate = -float(model.actuator_biasprm[channel.actuator, 2]) * gear**2
    friction, damping = float(model.dof_frictionloss[dof]), float(model.dof_damping[dof])
    # Damping in all: less than none would only make up for a lag.
    low = np.array([1.0 / (_LARGEST_GAIN * gain), 0.0, 0.0, -np.inf])
    high = np.array([1.0 / (_LEAST_GAIN * gain), np.inf, np.inf, np.inf])

    def solve(lag: float) -> _Solved:
        error = (motion.smoothed(aligned.inputs[:, i], lag, aligned.period) / gear - motion.position[:, dof])[moving]
        x, missed = _robust(terms, error, low, high)
        stiffness = 1.0 / x[0]
        nominal = terms @ np.array([1.0, friction, damping + rate, 0.0]) / gain
        carried = dict(zip(("torque", "friction", "damping", "offset"), _sizes(terms * x, error), strict=True))
        return missed, Balance(
            "",
            "",
            float(stiffness / gain),
            float(x[1] * stiffness),
            float((x[2] - rate / gain) * stiffness - damping),
            float(-x[3] * gear),
            lag,
            0.0,
            _share(error, terms @ x),
            _share(error, nominal),
            carried,
            servo=True,
        )

    return solve


def _torque(
    plant: Plant,
    aligned: Aligned,
    motion: _Motion,
    dof: int,
    drives: Sequence[int],
    terms: Array,
    moving: NDArray[np.bool_],
) -> _Solve:
    """The torque by what its inputs ask for, with the bias of their actuators; losses with it."""
    low, high = np.array([_LEAST_GAIN, 0.0, -np.inf, -np.inf]), np.array([_LARGEST_GAIN, np.inf, np.inf, np.inf])
    needed, signs = terms[:, 0], np.array([-1.0, -1.0, 1.0])
    friction, damping = float(plant.model.dof_frictionloss[dof]), float(plant.model.dof_damping[dof])
    lost = terms[:, 1:3] @ np.array([friction, damping])

    def solve(lag: float) -> _Solved:
        asked = sum((_asked(plant, aligned, motion, i, lag) for i in drives), np.zeros(len(motion.rows)))[moving]
        columns = np.concatenate([asked[:, None], terms[:, 1:] * signs], axis=1)
        x, missed = _robust(columns, needed, low, high)
        carried = dict(zip(("torque", "friction", "damping", "offset"), _sizes(columns * x, needed), strict=True))
        told = float(x[0]), float(x[1]), float(x[2]) - damping, float(x[3])
        shares = _share(needed, columns @ x), _share(needed, asked - lost)
        return missed, Balance("", "", *told, lag, 0.0, *shares, carried)

    return solve


def _sizes(parts: Array, whole: Array) -> list[float]:
    found: list[float] = (np.sqrt((parts**2).mean(axis=0)) / max(float(np.sqrt((whole**2).mean())), 1e-300)).tolist()
    return found


def _joint_dof(model: mujoco.MjModel, actuator: int) -> int:
    joint = model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_JOINT
    return int(model.jnt_dofadr[model.actuator_trnid[actuator, 0]]) if joint else -1


def _asked(plant: Plant, aligned: Aligned, motion: _Motion, i: int, lag: float) -> Array:
    """Torque (nr,) that an input asks for."""
    channel, model = plant.inputs[i], plant.model
    value = motion.smoothed(aligned.inputs[:, i], lag, aligned.period)
    if channel.actuator < 0:
        return value
    a = channel.actuator
    found: Array = float(model.actuator_gear[a, 0] * model.actuator_gainprm[a, 0]) * value
    return found


def _robust(columns: Array, needed: Array, low: Array, high: Array) -> tuple[Array, float]:
    """Coefficients of the terms, within their bounds; and the robust size of what they miss."""
    scale = np.maximum(np.sqrt((columns**2).mean(axis=0)), 1e-300)
    weight, x, size = np.ones(len(needed)), np.zeros(len(low)), 0.0
    for _ in range(_ROUNDS):
        root = np.sqrt(weight)[:, None]
        x = lsq_linear(root * columns / scale, root[:, 0] * needed, (low * scale, high * scale)).x / scale
        missed = np.abs(needed - columns @ x)
        size = max(1.4826 * float(np.median(missed)), 1e-12)
        weight = np.minimum(1.0, _ROBUST * size / np.maximum(missed, 1e-300))
    return x, size


def _share(needed: Array, given: Array) -> float:
    """Share of the torque's power that is explained; negative where the sum makes it worse."""
    return float(1.0 - ((needed - given) ** 2).mean() / max(float((needed**2).mean()), 1e-300))
