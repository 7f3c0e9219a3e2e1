"""What is left when all that was found is taken away: how much, and which variable it goes with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from simgap.inference.residual import Residuals

Array = NDArray[np.float64]

_BINS, _SLOW_BINS = 8, 5
"""Of a joint's position or load; of what changes slowly (a temperature, a voltage, the time)."""
_RIDGE = 1e-3
"""Of the regression, as a share of its features' power: enough that empty bins do no harm."""
_GROUPS = 4
"""Of blocks, each predicted from the others."""
_SLOWEST, _FASTEST = 0.3, 12.0
"""[Hz] of what may come at regular times."""
_MOST = 8
GOES, MAINLY = 0.1, 0.5
"""Shares of what is left from which on a variable is named, and from which on it is most of it."""
NEAR_FLOOR = 1.2
"""[noise floors] Nothing is said about what goes with less: it is the sensors' own."""
_APART = 20.0
"""[%] by which the share of a typical window differs when it is told."""

HINTS = {
    "direction of motion": "friction or play",
    "speed": "damping that grows with speed, or a lag of a sensor or a command",
    "position": "a spring, a cable, a stop, a gear out of round, or a weight elsewhere",
    "load": "a part that gives way, a limit of torque, or friction that grows with load",
    "time": "something that drifts: heat, a supply that sinks, a part that comes loose",
    "regular times": "a fan, a gear, a belt or a neighbour",
    "steady offset": "a zero of a sensor, ground or mount that leans, or a steady force",
}
"""Kind of variable: what to look for."""


@dataclass(frozen=True)
class Variable:
    """Something that what is left may go with: its features (nw, length, k) as forces in every row of the windows.

    Its share is what it predicts beyond ``beside`` (nw, length, k): what would predict as much without it.
    """

    kind: str
    name: str
    force: Array
    beside: Array


def describe(residuals: Residuals, residual: Array, gap: dict[str, Any], predictable: float) -> dict[str, Any]:
    """``remainder`` of the report.

    ``residual`` (nw, ns, nl) is what the best hypothesis leaves, ``gap`` is that key of the report, ``predictable`` is
    the share of what is left that a flexible regression predicts. ``share_typical`` is the share of a typical window,
    which a few windows that are far off do not move.
    """
    shares = sorted(shares_of(residuals, residual), key=lambda pair: -pair[1])
    found: dict[str, Any] = {
        "share": share_left(gap["before"], gap["after"]),
        "share_typical": share_left(gap["typical"]["before"], gap["typical"]["after"]),
        "predictable_share": predictable,
        "goes_with": [{"variable": v.name, "kind": v.kind, "share": s} for v, s in shares[:_MOST] if s > 0.01],
    }
    return found | {"sentence": sentence(found, gap["after"])}


def share_left(before: float, after: float) -> float:
    """Share (0 to 1) of the gap's power beyond the noise floor that is left, from gaps in noise floors."""
    return max(after**2 - 1.0, 0.0) / max(before**2 - 1.0, after**2 - 1.0, 1e-9)


def sentence(remainder: dict[str, Any], after: float) -> str:
    """What is left, in one sentence."""
    share, typical = 100.0 * remainder["share"], 100.0 * remainder["share_typical"]
    apart = f"; {typical:.0f} % in a typical window" if abs(share - typical) > _APART else ""
    left = f"What is left is {share:.0f} % of the gap's power ({after:.1f} noise floors{apart})"
    if after < NEAR_FLOOR:
        return f"What is left is {after:.1f} noise floors, about what repeating the experiment would leave."
    rows = [row for row in remainder["goes_with"] if row["share"] >= GOES]
    if not rows:
        return f"{left}; it goes with nothing that was recorded: look for what acts from outside, or for small causes."
    first = rows[0]
    amount = "most of it goes" if first["share"] >= MAINLY else f"{100 * first['share']:.0f} % of it goes"
    hint = HINTS.get(first["kind"], "what it changes in the robot")
    # A second variable of the same kind is no second hint.
    others = [row for row in rows[1:] if row["kind"] != first["kind"] and row["share"] > 0.7 * first["share"]]
    beside = f" (nearly as much with {others[0]['variable']})" if others else ""
    return f"{left}; {amount} with {first['variable']}{beside}, so look for {hint}."


def shares_of(residuals: Residuals, residual: Array) -> list[tuple[Variable, float]]:
    """Share (0 to 1) of the residual's power that each variable predicts in blocks that were not fitted."""
    windows = residuals.replayer.windows
    groups = windows.block % _GROUPS
    # A window that is far off counts no more than others.
    target = residual / np.sqrt(1.0 + (residual**2).mean(axis=1, keepdims=True))
    found = []
    known: dict[int, float] = {}
    for variable in [*_variables(residuals), *_regular(residuals, target, groups)]:
        plain = known.get(id(variable.beside))
        if plain is None:
            plain = known[id(variable.beside)] = _explained(residuals, variable.beside, target, groups)
        both = np.concatenate([variable.beside, variable.force], axis=-1)
        share = _explained(residuals, both, target, groups) - max(plain, 0.0)
        found.append((variable, float(np.clip(share, 0.0, 1.0))))
    return found


# -- variables ---------------------------------------------------------------------------------------------------------


def _variables(residuals: Residuals) -> list[Variable]:
    replayer = residuals.replayer
    windows, state, aligned, model = replayer.windows, replayer.state, replayer.aligned, replayer.plant.model
    rows = windows.start[:, None] + np.arange(windows.length)
    one = np.ones((*rows.shape, 1))
    found = [Variable("steady offset", "a steady offset or force", one, one[..., :0])]
    signs, loads = [], []
    for j, dof in enumerate(state.dof):
        joint = model.joint(int(model.dof_jntid[dof])).name or f"joint {model.dof_jntid[dof]}"
        rate = state.velocity[:, j] / max(float(state.velocity[:, j].std()), 1e-12)
        sign = np.tanh(10.0 * rate)[rows][..., None]
        signs.append(sign)
        found.append(Variable("direction of motion", f"the direction of motion at {joint}", sign, one))
        speed = np.stack([rate, rate * np.abs(rate)], -1)[rows]
        found.append(Variable("speed", f"the speed at {joint}", speed, one))
        if state.qpos[j] >= 0:
            found.append(
                Variable("position", f"the position of {joint}", _hats(state.position[:, j], rows, _BINS), one)
            )
    for name, load in _loads(residuals).items():
        loads.append((load / max(float(load.std()), 1e-12))[rows][..., None])
        found.append(Variable("load", f"the load at {name}", _hats(load, rows, _BINS), one))
    # What changes slowly shows in how much else counts.
    base = np.concatenate([one, *signs, *loads], axis=-1)
    slow = {f"the {name}": ("auxiliary", values) for name, values in aligned.auxiliary.items()}
    slow["time"] = ("time", aligned.time)
    for name, (kind, values) in slow.items():
        if np.isfinite(values).all() and float(np.ptp(values)) > 0.0:
            hats = _hats(values, rows, _SLOW_BINS)
            mixed = (hats[..., :, None] * base[..., None, :]).reshape(*rows.shape, -1)
            found.append(Variable(kind, name, mixed, base))
    return found


def _loads(residuals: Residuals) -> dict[str, Array]:
    """Load (n,) by name: of a position servo commanded minus measured, of other inputs the input itself."""
    replayer = residuals.replayer
    plant, aligned, state = replayer.plant, replayer.aligned, replayer.state
    found: dict[str, Array] = {}
    for i, channel in enumerate(plant.inputs):
        values, name = aligned.inputs[:, i], channel.name
        if channel.kind == "position":
            joint = int(plant.model.actuator_trnid[channel.actuator, 0])
            if plant.model.actuator_trntype[channel.actuator] != mujoco.mjtTrn.mjTRN_JOINT:
                continue
            at = np.flatnonzero(state.qpos == plant.model.jnt_qposadr[joint])
            if not len(at):
                continue
            gear = float(plant.model.actuator_gear[channel.actuator, 0])
            values = values / gear - state.position[:, int(at[0])]
        found[name] = values
    return found


def _hats(values: Array, rows: NDArray[np.int64], count: int) -> Array:
    """Tent functions (*rows.shape, count) over the range of values (n,): a binned variable without steps."""
    low, high = np.percentile(values[rows], [1.0, 99.0])
    at: Array = np.clip((values - low) / max(high - low, 1e-12), 0.0, 1.0) * (count - 1)
    hats: Array = np.maximum(1.0 - np.abs(at[:, None] - np.arange(count)), 0.0)[rows]
    return hats


def _regular(residuals: Residuals, target: Array, groups: NDArray[np.int64]) -> list[Variable]:
    """The one frequency of which most comes at regular times, whatever the robot does."""
    windows, aligned = residuals.replayer.windows, residuals.replayer.aligned
    rows = windows.start[:, None] + np.arange(windows.length)
    time, one = rows * aligned.period, np.ones((*rows.shape, 1))
    fastest = min(_FASTEST, 0.25 / aligned.period)
    frequencies = np.arange(_SLOWEST, fastest, 0.5 / max(aligned.duration, 1.0))
    thin = max(target.shape[1] // 24, 1)
    best: tuple[float, Variable | None] = (0.0, None)
    for frequency in frequencies:
        phase = 2.0 * np.pi * frequency * time
        waves = np.stack([np.cos(phase), np.sin(phase)], -1)
        share = _explained(residuals, np.concatenate([one, waves], -1), target, groups, thin)
        if share > best[0]:
            name = f"regular times ({frequency:.2g} times a second)"
            best = (share, Variable("regular times", name, waves, one))
    return [best[1]] if best[1] is not None else []


# -- regression --------------------------------------------------------------------------------------------------------


def _explained(residuals: Residuals, force: Array, target: Array, groups: NDArray[np.int64], thin: int = 1) -> float:
    """Share of the target's power (nw, ns, nl) that ridge regression predicts in blocks that it has not seen.

    A force that the model lacks shows in a window as its double integral from the window's start.
    """
    windows = residuals.replayer.windows
    if not force.shape[-1]:
        return 0.0
    once = np.cumsum(force, axis=1) / windows.length
    twice = np.cumsum(once, axis=1) / windows.length
    features = np.concatenate([force, once, twice], axis=-1)[:, windows.sample[::thin]]
    features = features / np.maximum(np.sqrt((features**2).mean(axis=(0, 1))), 1e-9)
    target = target[:, ::thin]
    names: Sequence[int] = np.unique(groups).tolist()
    products, pulls, missed = {}, {}, 0.0
    for g in names:
        a, b = features[groups == g].reshape(-1, features.shape[-1]), target[groups == g].reshape(-1, target.shape[-1])
        products[g], pulls[g] = a.T @ a, a.T @ b
    if len(names) < 2:
        return 0.0
    total, pull = sum(products.values()), sum(pulls.values())
    for g in names:
        normal = total - products[g]
        ridge = _RIDGE * np.trace(normal) / len(normal) * np.eye(len(normal))
        weights = np.linalg.solve(normal + ridge, pull - pulls[g])
        b = target[groups == g]
        missed += float(((b - features[groups == g] @ weights) ** 2).sum())
    return 1.0 - missed / max(float((target**2).sum()), 1e-12)
