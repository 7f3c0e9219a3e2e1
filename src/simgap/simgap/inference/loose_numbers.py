"""Nominal numbers as far off as a recording would have them: which of them go far says where a fault may be.

Candidates are screened one by one, beside numbers that are all a little off, and what each shows there may be little.
Here all numbers move at once, under a prior whose tails let a few of them go far. That proposes and judges nothing.
"""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from simgap.effects.base import Effect
from simgap.inference.fit import Fitter
from simgap.inference.hypothesis import Hypothesis
from simgap.inference.nuisance import BOX

Array = NDArray[np.float64]
Entry = tuple[str, int]
"""A number of a model: its field, and where it stands there."""

_REACH = 12.0
"""Standard deviations that a number may be off: a factor of 2.6 for most."""
_TAIL = 1.0
"""Degrees of freedom of the prior (Cauchy's)."""
_ROUNDS, _INNER = 8, 6
"""Of new sensitivities, and of new weights of the prior with each."""
_TRIALS = (1.0, 0.5, 0.25)
_MOVED = 0.5
"""Standard deviations that a number has to move for its sensitivities to be taken anew."""
_ENDED = 4.0
"""[nats] A fit ends when a round gains less."""
_FIELDS = (
    "body_mass",
    "body_ipos",
    "body_inertia",
    "dof_damping",
    "dof_armature",
    "dof_frictionloss",
    "jnt_stiffness",
    "actuator_gainprm",
    "geom_friction",
    "geom_solref",
)
"""Of a model, where nominal numbers and effects may change the same."""
_ALIKE = 1e-6
"""Two changes of a model whose ratio is the same at all entries to within this are one."""
_SIZES = 1e-12
"""Changes that are smaller are none."""


def fit_loosely(fitter: Fitter) -> Array:
    """Nominal numbers (nz,) in standard deviations of their usual priors, begun where the model has them."""
    assert fitter.nominal is not None
    nothing, none = Hypothesis(), np.zeros(0)
    z, residual = np.zeros_like(fitter.nominal.z), fitter.nominal.residual
    cost = float(fitter.data_cost(fitter.mean_square(residual)))
    with fitter.sensitivities_kept():
        fitter.jacobian = fitter.nominal_jacobian
        about = z.copy()
        for round_ in range(_ROUNDS):
            moved = np.abs(z - about) > _MOVED
            if moved.any():
                fitter.refresh(nothing, none, z, residual, moved)
                about[moved] = z[moved]
            elif round_:
                break
            step = _step(fitter, residual, z)
            points = [z + t * step for t in _TRIALS]
            residuals = fitter.replay(nothing, [(none, p) for p in points])
            costs = fitter.data_cost(fitter.mean_square(residuals)) + np.array([_prior(p) for p in points])
            best = int(np.argmin(costs))
            gain = cost - float(costs[best])
            if gain > 0.0:
                z, residual, cost = points[best], residuals[best], float(costs[best])
            if gain < _ENDED:
                break
    return z


def _prior(z: Array) -> float:
    return 0.5 * (_TAIL + 1.0) * float(np.log1p(z * z / _TAIL).sum())


def _step(fitter: Fitter, residual: Array, z: Array) -> Array:
    """To the best of the linear model, its prior weighed anew where it arrives."""
    root = np.sqrt(fitter.weights(fitter.mean_square(residual)))[:, None, :]
    rows = (fitter.jacobian * root).reshape(len(z), residual.size).astype(float)
    square = rows @ rows.T
    pull, found = square @ z - rows @ (residual * root).reshape(-1), z
    for _ in range(_INNER):
        normal = square + np.diag((_TAIL + 1.0) / (_TAIL + found * found))
        factor = np.linalg.cholesky(normal).T
        found = lsq_linear(factor, np.linalg.solve(factor.T, pull), (-_REACH, _REACH), method="bvls").x
    return found - z


def spoken_for(fitter: Fitter, effects: Sequence[Effect], z: Array, count: int) -> list[tuple[Effect, Array, Array]]:
    """Starts for the effects that change one of the numbers that go farthest, beyond what a nominal number may.

    Each is an effect, its values, which change that number as far, and all numbers, where those that the effect
    changes are as modelled. ``z`` (nz,) is of `fit_loosely`; ``count`` the numbers that are heard.
    """
    far = [i for i in np.argsort(-np.abs(z)) if abs(z[i]) > BOX][:count]
    if not far:
        return []
    changes = _changes_of_numbers(fitter, z)
    found: dict[int, tuple[Effect, Array, Array]] = {}
    tried = [(e, s, _changes_of(fitter, e, np.array(s))) for e in effects for s in e.starts()]
    for i in far:
        for effect, start, entries in tried:
            if not changes[i] or not changes[i].keys() <= entries.keys() or id(effect) in found:
                continue
            first = max(changes[i], key=lambda entry: abs(changes[i][entry]))
            share = changes[i][first] / entries[first]
            values = effect.times(share, start) if share > 0.0 else None
            if values is not None:
                found[id(effect)] = effect, np.array(values), _without_own(np.clip(z, -BOX, BOX), changes, entries)
    return list(found.values())


def with_own_as_modelled(
    fitter: Fitter, starts: Sequence[tuple[Effect, Array]], z: Array
) -> list[tuple[Effect, Array, Array]]:
    """Effects with their values beside numbers ``z`` (nz,), of which those that an effect changes are as modelled.

    What fits without an effect may have bent just these, and hides it. Of an effect that changes none there is nothing.
    """
    changes = _changes_of_numbers(fitter, z)
    found = []
    for effect, x in starts:
        rest = _without_own(z, changes, _changes_of(fitter, effect, x))
        if not np.array_equal(rest, z):
            found.append((effect, x, rest))
    return found


def own_moved_into(fitter: Fitter, effect: Effect, x: Array, z: Array) -> tuple[Array, Array]:
    """Nearly the same model, where what numbers change as an effect does is the effect's: its values, and all numbers.

    A number that may be a little off and an effect without a prior are hardly told apart by data, and the number costs
    least as modelled; on rough ground no slope leads there. It may change a little more than the effect: the ground's
    friction is that of bellies too.
    """
    if not effect.one_size:
        return x, z
    entries, rest, more = _changes_of(fitter, effect, x), z.copy(), 0.0
    for i in np.flatnonzero(z).tolist():
        change = _changed(fitter.base.model, _with_number(fitter, i, float(z[i])))
        shares = [change[e] / entries[e] for e in change if e in entries]
        if entries and entries.keys() <= change.keys() and len(change) <= 2 * len(entries) and np.ptp(shares) < _ALIKE:
            rest[i], more = 0.0, more + float(np.mean(shares))
    values = effect.times(1.0 + more, x) if more else None
    return (x, z) if values is None else (np.array(values), rest)


def _without_own(z: Array, changes: Sequence[dict[Entry, float]], entries: dict[Entry, float]) -> Array:
    """Numbers ``z`` (nz,), where those that change nothing but ``entries`` are as modelled."""
    own = [bool(change) and change.keys() <= entries.keys() for change in changes]
    return np.where(own, 0.0, z)


def _changes_of_numbers(fitter: Fitter, z: Array) -> list[dict[Entry, float]]:
    """What each number changes as far off as in ``z`` (nz,), or by a deviation."""
    reach = np.maximum(np.abs(z), 1.0) * np.where(z < 0.0, -1.0, 1.0)
    return [_changed(fitter.base.model, _with_number(fitter, i, float(r))) for i, r in enumerate(reach)]


def _changes_of(fitter: Fitter, effect: Effect, x: Array) -> dict[Entry, float]:
    """What an effect changes, of the model that is otherwise as modelled."""
    variant = fitter.variant(Hypothesis((effect,)), x, np.zeros(len(fitter.nuisances)))
    return _changed(fitter.base.model, variant.model)


def _with_number(fitter: Fitter, which: int, z: float) -> mujoco.MjModel:
    made = fitter.base.copy()
    fitter.nuisances[which].apply(made, z)
    return made.model


def _changed(nominal: mujoco.MjModel, model: mujoco.MjModel) -> dict[Entry, float]:
    """The numbers that differ, and how far: of positive ones the logarithm of their ratio."""
    found: dict[Entry, float] = {}
    for field in _FIELDS:
        old, new = np.ravel(getattr(nominal, field)), np.ravel(getattr(model, field))
        for k in np.flatnonzero(np.abs(new - old) > _SIZES):
            both = old[k] > 0.0 and new[k] > 0.0 and field != "body_ipos"
            found[field, int(k)] = float(np.log(new[k] / old[k]) if both else new[k] - old[k])
    return found
