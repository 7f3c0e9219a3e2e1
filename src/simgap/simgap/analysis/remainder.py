"""What is left when all that was found is taken away: how much, and which variable it goes with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import toeplitz

from simgap.inference.residual import Residuals
from simgap.simulation.variant import Variant

Array = NDArray[np.float64]

_BINS = 8
"""Of a joint's position or load."""
_RIDGE = 1e-3
"""Of the regression, as a share of its features' power: enough that empty bins do no harm."""
_GROUPS = 4
"""Of blocks, each predicted from the others."""
_SLOWEST, _FASTEST = 0.3, 12.0
"""[Hz] of what may come at regular times."""
_FREQUENCIES = 3000
"""That are tried, at most: enough for two minutes."""
_MOST = 8
GOES, MAINLY = 0.1, 0.5
"""Shares of what is left from which on a variable is named, and from which on it is most of it."""
NEAR_FLOOR = 1.2
"""[noise floors] Nothing is said about what goes with less: it is the sensors' own."""
_SMALL, _BRISK = 1e-3, 0.05
"""Share of the force that brings a joint to its usual speed within so many seconds, by which a response is tried."""
_CREEP = 0.05
"""Of the spread of a joint's rate: slower than that it stands."""
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
    """Something that what is left may go with: forces (or offsets of a sensor) that are functions of it.

    ``parts`` are (force (nw, ns, k) at the compared samples, joint at which it acts) pairs, with joints as positions in
    the measured state.
    """

    kind: str
    name: str
    parts: tuple[tuple[Array, int], ...]


def describe(
    residuals: Residuals, variant: Variant, residual: Array, gap: dict[str, Any], predictable: float
) -> dict[str, Any]:
    """``remainder`` of the report.

    ``residual`` (nw, ns, nl) is what the best hypothesis, ``variant``, leaves; ``gap`` is that key of the report;
    ``predictable`` is the share of what is left that a flexible regression predicts (that of the variables below, where
    it is larger, is reported). ``share_typical`` is the share of a typical window, which a few windows that are far off
    do not move.
    """
    found_shares, together = shares_of(residuals, variant, residual)
    shares = sorted(found_shares, key=lambda pair: -pair[1])
    found: dict[str, Any] = {
        "share": share_left(gap["before"], gap["after"]),
        "share_typical": share_left(gap["typical"]["before"], gap["typical"]["after"]),
        "predictable_share": max(predictable, together),
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
        several = 100.0 * remainder["predictable_share"]
        beside = f", several together {several:.0f} %" if several > 100.0 * GOES else ""
        return f"{left}; no variable that was recorded predicts a tenth of it by itself{beside}."
    first = rows[0]
    amount = "most of it goes" if first["share"] >= MAINLY else f"{100 * first['share']:.0f} % of it goes"
    hint = HINTS.get(first["kind"], "what it changes in the robot")
    # A second variable of the same kind is no second hint.
    others = [row for row in rows[1:] if row["kind"] != first["kind"] and row["share"] > 0.7 * first["share"]]
    beside = f" (nearly as much with {others[0]['variable']})" if others else ""
    return f"{left}; {amount} with {first['variable']}{beside}, so look for {hint}."


def shares_of(residuals: Residuals, variant: Variant, residual: Array) -> tuple[list[tuple[Variable, float]], float]:
    """Share (0 to 1) of the residual's power that each variable predicts in blocks that were not fitted; the best three
    together.

    Beyond a steady force at every joint; what changes slowly beyond what direction and load predict without it; what
    comes at regular times beyond the three best others, for commands may be regular too.
    """
    design = _Design(residuals, variant, residual)
    if not design.joints:
        return [], 0.0
    steady, moving, slow = _variables(residuals)
    alone = max(design.explained([steady]), 0.0)
    found = [(steady, alone)] + [(v, design.explained([steady, v]) - alone) for v in moving]
    base = [steady, *(v for v in moving if v.kind in ("direction of motion", "load"))]
    without = max(design.explained(base), 0.0) if slow else 0.0
    found += [(v, design.explained([*base, v]) - without) for v in slow]
    best = [v for v, share in sorted(found, key=lambda pair: -pair[1])[:3] if share > 0.0 and v is not steady]
    together = max(design.explained([steady, *best]), 0.0)
    if (regular := design.regular()) is not None:
        found.append((regular, design.explained([steady, *best, regular]) - together))
    return [(v, float(np.clip(share, 0.0, 1.0))) for v, share in found], together


# -- variables ---------------------------------------------------------------------------------------------------------


def _variables(residuals: Residuals) -> tuple[Variable, list[Variable], list[Variable]]:
    """A steady force; what moves with the robot; what changes slowly."""
    replayer = residuals.replayer
    state, aligned, model = replayer.state, replayer.aligned, replayer.plant.model
    rows = replayer.windows.rows()
    joints, one = range(len(state.dof)), np.ones((*rows.shape, 1))
    steady = Variable("steady offset", "a steady offset or force", tuple((one, j) for j in joints))
    moving, parts = [], list(steady.parts)
    loads = _loads(residuals)
    for j, dof in enumerate(state.dof):
        joint = model.joint(int(model.dof_jntid[dof])).name or f"joint {model.dof_jntid[dof]}"
        rate = state.velocity[:, j] / max(float(state.velocity[:, j].std()), 1e-12)
        # While it stands, friction and play keep the direction in which it came.
        sign = np.stack([np.tanh(10.0 * rate), _last_direction(rate)], -1)[rows]
        parts.append((sign, j))
        moving.append(Variable("direction of motion", f"the direction of motion at {joint}", ((sign, j),)))
        speed = np.stack([rate, rate * np.abs(rate)], -1)[rows]
        moving.append(Variable("speed", f"the speed at {joint}", ((speed, j),)))
        if state.qpos[j] >= 0:
            hats = _hats(state.position[:, j], rows, _BINS)
            moving.append(Variable("position", f"the position of {joint}", ((hats, j),)))
        if j in loads:
            load = (loads[j] / max(float(loads[j].std()), 1e-12))[rows][..., None]
            parts.append((load, j))
            shapes = np.concatenate([_hats(loads[j], rows, _BINS), np.abs(load) * sign], axis=-1)
            moving.append(Variable("load", f"the load at {joint}", ((shapes, j),)))
    slow = []
    for name, values in {**{f"the {n}": v for n, v in aligned.auxiliary.items()}, "time": aligned.time}.items():
        if not np.isfinite(values).all() or not float(np.ptp(values[rows])) > 0.0:
            continue
        # It shows in how much all else counts: friction that a warm gear loses.
        level = (values - values[rows].mean()) / values[rows].std()
        levels = np.stack([level, level**2], -1)[rows]
        kind = "time" if name == "time" else "auxiliary"
        slow.append(Variable(kind, name, tuple((levels * force, j) for force, j in parts)))
    return steady, moving, slow


def _loads(residuals: Residuals) -> dict[int, Array]:
    """Load (n,) by joint: of a position servo commanded minus measured, of other inputs the input itself."""
    replayer = residuals.replayer
    plant, aligned, state = replayer.plant, replayer.aligned, replayer.state
    model, found = plant.model, dict[int, Array]()
    for i, channel in enumerate(plant.inputs):
        dof = channel.dof
        if channel.actuator >= 0:
            if model.actuator_trntype[channel.actuator] != mujoco.mjtTrn.mjTRN_JOINT:
                continue
            dof = int(model.jnt_dofadr[model.actuator_trnid[channel.actuator, 0]])
        for j in np.flatnonzero(state.dof == dof).tolist():
            values = aligned.inputs[:, i]
            if channel.kind == "position" and channel.actuator >= 0:
                values = values / float(model.actuator_gear[channel.actuator, 0]) - state.position[:, j]
            found[j] = values
    return found


def _last_direction(rate: Array) -> Array:
    """Sign (n,) of the last motion that was more than a creep, of rates in their spread."""
    known = np.abs(rate) > _CREEP
    last = np.maximum.accumulate(np.where(known, np.arange(len(rate)), -1))
    found: Array = np.where(last >= 0, np.sign(rate[np.maximum(last, 0)]), 0.0)
    return found


def _hats(values: Array, rows: NDArray[np.int64], count: int) -> Array:
    """Tent functions (*rows.shape, count) over the range of values (n,): a binned variable without steps."""
    low, high = np.percentile(values[rows], [1.0, 99.0])
    at = np.clip((values - low) / max(high - low, 1e-12), 0.0, 1.0) * (count - 1)
    hats: Array = np.maximum(1.0 - np.abs(at[:, None] - np.arange(count)), 0.0)[rows]
    return hats


# -- regression --------------------------------------------------------------------------------------------------------


class _Design:
    """Regression of what is left on forces at joints, which show as the model's own response to them.

    The response of every channel to a small steady force at a joint is simulated in all windows; its mean is taken for
    that of a linear system, whose response to any force is the convolution. A sensor's offset shows in its own channel.
    """

    def __init__(self, residuals: Residuals, variant: Variant, residual: Array) -> None:
        self._residuals = residuals
        windows = residuals.replayer.windows
        self._groups = windows.block % _GROUPS
        # A window that is far off counts no more than others.
        self._weight = 1.0 / np.sqrt(1.0 + (residual**2).mean(axis=1, keepdims=True))
        self._target = residual * self._weight
        self._power = max(float((self._target**2).sum()), 1e-12)
        self._impulse = _impulse_responses(residuals, variant)
        self.joints = len(self._impulse)
        self._made: dict[int, Array] = {}

    def explained(self, variables: Sequence[Variable]) -> float:
        """Share of the power that the variables together predict in groups of blocks that were left out."""
        features = np.concatenate([self._features(v) for v in variables]).astype(float)
        products, pulls = {}, {}
        groups = np.unique(self._groups).tolist()
        if len(groups) < 2:
            return 0.0
        for g in groups:
            a = features[:, self._groups == g].reshape(len(features), -1)
            products[g], pulls[g] = a @ a.T, a @ self._target[self._groups == g].reshape(-1)
        total, pull, missed = sum(products.values()), sum(pulls.values()), 0.0
        for g in groups:
            normal = total - products[g]
            ridge = _RIDGE * np.diag(np.maximum(np.diag(normal), 1e-9 * max(float(np.trace(normal)), 1e-300)))
            weights = np.linalg.solve(normal + ridge, pull - pulls[g])
            inside = self._groups == g
            missed += float(((self._target[inside] - np.tensordot(weights, features[:, inside], 1)) ** 2).sum())
        return 1.0 - missed / self._power

    def _features(self, variable: Variable) -> Array:
        """(k, nw, ns, nl): what each of the variable's forces does to all channels, whitened as the residual is."""
        if id(variable) not in self._made:
            made = [self._of(force, joint) for force, joint in variable.parts]
            self._made[id(variable)] = np.concatenate(made).astype(np.float32)
        return self._made[id(variable)]

    def _of(self, force: Array, joint: int) -> Array:
        residuals = self._residuals
        plant, state = residuals.replayer.plant, residuals.replayer.state
        impulse, count = self._impulse[joint], force.shape[-1]
        found = np.zeros((2 * count, *residuals.mask.shape))
        for c, channel in enumerate(residuals.live):
            spread = toeplitz(impulse[:, c], np.zeros(len(impulse)))
            found[:count, ..., c] = np.moveaxis(spread @ force, -1, 0)
            if plant.outputs[channel].qpos >= 0 and plant.outputs[channel].qpos == state.qpos[joint]:
                found[count:, ..., c] = np.moveaxis(force, -1, 0)
        found = found / residuals.replayer.floor[residuals.live]
        kept = found[np.abs(found).reshape(2 * count, -1).max(axis=1) > 0.0]
        return residuals.whiten(np.where(residuals.mask, kept, 0.0)) * self._weight

    def regular(self) -> Variable | None:
        """Something at the one frequency that predicts most, whatever the robot does."""
        windows, aligned = self._residuals.replayer.windows, self._residuals.replayer.aligned
        time = windows.rows() * aligned.period
        thin = max(time.shape[1] // 24, 1)
        best, found = 0.0, None
        flat = np.ones(time.shape)
        fastest, step = min(_FASTEST, 0.25 / aligned.period), 0.5 / max(aligned.duration, 1.0)
        for frequency in np.arange(_SLOWEST, fastest, max(step, fastest / _FREQUENCIES)).tolist():
            phase = 2.0 * np.pi * frequency * time
            force = np.stack([np.cos(phase), np.sin(phase), flat], -1)
            share = self._plain(force, thin)
            if share > best:
                best, found = share, frequency
        if found is None:
            return None
        phase = 2.0 * np.pi * found * time
        waves = np.stack([np.cos(phase), np.sin(phase)], -1)
        name = f"regular times ({found:.2g} times a second)"
        return Variable("regular times", name, tuple((waves, j) for j in range(self.joints)))

    def _plain(self, force: Array, thin: int) -> float:
        """Share of the power that a force (nw, ns, k) and its integrals predict in each channel by itself: a screen."""
        once = np.cumsum(force, axis=1) / force.shape[1]
        features = np.concatenate([force, once, np.cumsum(once, axis=1) / force.shape[1]], axis=-1)[:, ::thin]
        target, missed = self._target[:, ::thin], 0.0
        a, b = (v.reshape(len(v), -1, v.shape[-1]) for v in (features, target))
        products, pulls = np.swapaxes(a, 1, 2) @ a, np.swapaxes(a, 1, 2) @ b
        for g in np.unique(self._groups):
            inside = self._groups == g
            normal = products[~inside].sum(axis=0)
            ridge = _RIDGE * np.trace(normal) / len(normal) * np.eye(len(normal))
            missed += float(
                ((b[inside] - a[inside] @ np.linalg.solve(normal + ridge, pulls[~inside].sum(axis=0))) ** 2).sum()
            )
        return 1.0 - missed / max(float((target**2).sum()), 1e-12)


def _impulse_responses(residuals: Residuals, variant: Variant) -> Array:
    """Change (nm, ns, nl) of the channels by a force of 1 at a joint that lasts one sample, mean over the windows."""
    replayer = residuals.replayer
    model, state = replayer.plant.model, replayer.state
    moved, sizes = [variant], []
    for j, dof in enumerate(state.dof):
        joint = int(model.dof_jntid[dof])
        # Small against what moves the joint.
        size = _SMALL * max(float(model.dof_M0[dof]) * float(state.velocity[:, j].std()) / _BRISK, 1e-9)
        pushed = variant.copy()
        # A spring with a far end is a steady force.
        if pushed.model.jnt_stiffness[joint] <= 0.0:
            pushed.model.jnt_stiffness[joint] = 1e-6 * size
        pushed.model.qpos_spring[int(model.jnt_qposadr[joint])] += size / float(pushed.model.jnt_stiffness[joint])
        moved.append(pushed)
        sizes.append(size)
    outputs = replayer.run(moved)[..., residuals.live]
    change = np.nan_to_num(outputs[1:] - outputs[0]).mean(axis=1) / np.array(sizes).reshape(-1, 1, 1)
    impulse: Array = np.diff(change, axis=1, prepend=0.0)
    return impulse
