"""The winner fitted once more in long windows, of robots that do not enlarge an error of their start.

A window of half a second begins where the robot was. An error that is slow or steady (a sag under load, a zero, the
drag of a slow motion) shows little in it, and all of it in a run that nobody puts back to the measurement, which is
what a user of the corrected model gets. Which effects act was decided in short windows; here only their numbers and
the nominal ones are fitted again, from where they are.

Nobody draws damping, friction, armature or a servo's gain: datasheets are silent, and models hold guesses. How much
wider than usual their priors are is chosen by what the fits predict of runs that they have not seen.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simgap.data.align import Aligned, Run
from simgap.inference.budget import OutOfTimeError
from simgap.inference.deviations import nuisance_deviation
from simgap.inference.fit import LITTLE, Fitter
from simgap.inference.hypothesis import Fit, Hypothesis
from simgap.inference.nuisance import BOX, Nuisance
from simgap.inference.residual import Residuals
from simgap.simulation.horizon import forgets
from simgap.simulation.replay import Replayer
from simgap.simulation.variant import Variant
from simgap.simulation.windows import FOLDS, MAX_WINDOWS, Windows, covering, cut

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

HORIZONS = (20.0, 10.0, 5.0, 2.4)
"""[s] of the long windows: the first of which the runs hold as many seconds as of the short ones, or nearly."""
WIDER = (1.0, 4.0, 16.0)
"""Times as wide as usual are the priors of what nobody draws. The last leaves a factor of seven either way."""
UNDRAWN = ("timing", "damping", "friction", "stiffness", "tendon", "armature", "gain", "rate gain", "zero")
"""First words of the names of numbers that no drawing holds."""
_LOOKED_AT = 8
"""Windows in which it is asked what becomes of an error of the start."""
_KEPT = 1.0
"""Share of an error of the start that may be left at the end of a long window: friction holds it, chaos enlarges it."""
_ROUNDS, _STEPS = 3, 6
"""Of sensitivities taken anew, at most, and of steps by them."""
_SAVES = 0.5
"""Share of the long windows, at most, that are few enough to begin with. The SO-101's seven runs of a minute or two are
four times what its short windows cover, and each of its 61 numbers asks for a replay of them."""
_NEAR = 0.5
"""Where that is done, in what is told of the whole."""
_SETTLED = 0.5
"""A round that gains less [nats], or less than the share LITTLE of what all have gained, is the last by its
sensitivities."""


@dataclass(frozen=True)
class LongWindows:
    """What long windows say of the winner's numbers, in the units of the short windows' fit.

    Attributes:
        horizon: [s] of a window; ``windows``: how many.
        wider: how many times as wide as usual the priors of undrawn numbers were.
        gain: what it gains on held-out long windows over the short windows' numbers [nats].
        fit: the winner with the new numbers; its residuals and held-out costs are those of long windows.
        deviation: (nz,) standard errors of z.
        box: (nz,) how far z may go.
    """

    horizon: float
    windows: int
    wider: float
    gain: float
    fit: Fit
    deviation: Array
    box: Array

    def told(self) -> dict[str, Any]:
        """``long_windows`` of the report."""
        return {
            "horizon_s": self.horizon,
            "windows": self.windows,
            "prior_wider": self.wider,
            "gain": self.gain,
            "gain_unit": "nats on held-out data",
        }


def refit(fitter: Fitter, fit: Fit, say: Callable[[float], None] = lambda share: None) -> LongWindows | None:
    """Fit the winner in long windows; None where they say no more, or this recording has none.

    At least FOLDS runs are asked that are held out whole: neighbouring windows of one run are too much alike. Effects
    that grow or are a matter of chance keep the numbers of short windows. Where runs are much longer than what short
    windows cover, `some` long ones choose the prior and bring the numbers near, from where all settle them.

    Args:
        fitter: of the short windows.
        fit: cross-validated in them.
        say: is told how far it is.
    """
    if fit.likelihood is not None or fit.hypothesis.grows:
        return None
    windows, base = _windows(fitter), fitter.residuals.replayer
    if windows is None:
        return None
    run = np.searchsorted([r.start for r in base.aligned.runs], windows.start, side="right")
    few = some(windows, run, len(fitter.windows) * fitter.windows.length)
    replayer = Replayer(base.plant, base.aligned, windows if few is None else few, base.floor, base.threads)
    if not forgets(replayer, _variant(fitter, fit), _KEPT, _LOOKED_AT):
        return None
    if few is None:
        return _by_priors(fitter, fit, replayer, fit, WIDER, say)
    near = _by_priors(fitter, fit, replayer, fit, WIDER, lambda share: say(_NEAR * share))
    if near is None:
        return None
    replayer = Replayer(base.plant, base.aligned, windows, base.floor, base.threads)

    def further(share: float) -> None:
        say(_NEAR + (1.0 - _NEAR) * share)

    try:
        return _by_priors(fitter, fit, replayer, near.fit, (near.wider,), further)
    except OutOfTimeError:
        fitter.budget.ended("all long windows")
        return near


def some(windows: Windows, run: Ints, rows: int) -> Windows | None:
    """About as many windows as hold so many rows, at least one of each ``run`` (nw,); None where that saves little."""
    share = rows / (len(windows) * windows.length)
    keep = np.zeros(len(windows), bool)
    for stretch in np.split(np.arange(len(windows)), np.flatnonzero(np.diff(run)) + 1):
        for part in np.array_split(stretch, max(int(share * len(stretch)), 1)):
            keep[part[len(part) // 2]] = True
    return windows.of(keep) if keep.mean() <= _SAVES else None


def _by_priors(
    fitter: Fitter,
    fit: Fit,
    replayer: Replayer,
    begun: Fit,
    widths: Sequence[float],
    say: Callable[[float], None],
) -> LongWindows | None:
    """The winner by the prior that predicts best; None where none predicts better than the short windows' ``fit``.

    ``begun``: from whose numbers the first goes; each wider one where the last ended, which is nearer.
    """
    residuals = Residuals.build(replayer, _variant(fitter, fit))
    plain = Fitter(residuals, fitter.nuisances, fitter.base)
    plain.budget = fitter.budget
    short = plain.replay(fit.hypothesis, [(fit.x, fit.z)])[0]
    plain.estimate_independent(short)
    before = _held_cost(plain, fit)
    best: LongWindows | None = None
    x, z, taught, slope = begun.x, begun.z, None, None
    for k, wider in enumerate(widths):
        share = np.array([wider if undrawn(n) else 1.0 for n in fitter.nuisances])
        own = Fitter(residuals, [n.scaled(s) for n, s in zip(fitter.nuisances, share, strict=True)], fitter.base)
        own.likelihood, own.budget = plain.likelihood, fitter.budget
        if taught is not None:
            own.jacobian = (taught * share[:, None, None, None]).astype(np.float32)
        # Begun near the end, rounds gain little beside all that was gained since the short windows' numbers.
        first = None if begun is fit else own.cost(short, fit.z / share) + fit.hypothesis.tied(fit.x)

        def tell(done: float, k: int = k) -> None:
            say((k + done) / len(widths))

        try:
            found = settled(own, fit.hypothesis, x, np.clip(z / share, -BOX, BOX), slope, tell, first)
        except OutOfTimeError:
            if best is None:
                raise
            fitter.budget.ended("wider priors")
            return best
        x, z, slope = found.x, share * found.z, found.effect_jacobian
        taught = own.jacobian / share[:, None, None, None]
        gain = before - (float(np.nansum(found.held_cost)) + found.prior)
        if gain > (best.gain if best else 0.0):
            sd = share * nuisance_deviation(own, found)
            mine = replace(found, z=share * found.z, fold_z=share * found.fold_z)
            windows = replayer.windows
            horizon = windows.length * replayer.aligned.period
            best = LongWindows(horizon, len(windows), wider, gain, mine, sd, share * BOX)
    return best


def undrawn(nuisance: Nuisance) -> bool:
    """Whether a number is one that no drawing holds."""
    return nuisance.name.startswith(UNDRAWN)


def _windows(fitter: Fitter) -> Windows | None:
    """Long windows, each run in the fold it has in short ones; None where there are none."""
    base, short = fitter.residuals.replayer, fitter.windows
    folds = folds_of_runs(base.aligned, short)
    if folds is None:
        return None
    horizon = covering(base.aligned, HORIZONS, short.warm_up * base.aligned.period)
    if horizon is None or horizon <= 1.5 * short.length * base.aligned.period:
        return None
    windows = cut(base.aligned, horizon, short.warm_up * base.aligned.period, MAX_WINDOWS)
    fold = np.full(len(windows), -1, np.int64)
    for run in base.aligned.runs:
        inside = (windows.start >= run.start) & (windows.start < run.stop)
        fold[inside] = folds[run.label]
    found = replace(windows, fold=fold)
    return found if set(fold.tolist()) == set(range(short.folds)) else None


def folds_of_runs(aligned: Aligned, short: Windows) -> dict[float, int] | None:
    """The fold of each run's label; None where runs lie in several, or are named by the map to be held out."""
    labels = sorted({run.label for run in aligned.runs})
    if len(labels) < FOLDS or aligned.held_out:
        return None
    found = {}
    for number, label in enumerate(labels):
        seen = {f for run in aligned.runs if run.label == label for f in _of(short, run)}
        if len(seen) > 1:
            return None
        # No fit has seen a run without short windows.
        found[label] = seen.pop() if seen else number % short.folds
    return found


def _of(windows: Windows, run: Run) -> set[int]:
    """Folds of the windows of a run."""
    return {int(f) for f in windows.fold[(windows.start >= run.start) & (windows.start < run.stop)]}


def _variant(fitter: Fitter, fit: Fit) -> Variant:
    return fitter.variant(fit.hypothesis, fit.x, fit.z)


def _held_cost(fitter: Fitter, fit: Fit) -> float:
    """Cost [nats] of long windows under the short windows' fits that have not seen them, and of their prior."""
    points = list(zip(fit.fold_x, fit.fold_z, strict=True))
    squares = fitter.mean_square(fitter.replay(fit.hypothesis, points))
    fold = fitter.windows.fold
    held = squares[fold, np.arange(len(fold))]
    return float(np.nansum(fitter.likelihood.held_out(held, fold, squares))) + fit.prior


def settled(
    fitter: Fitter,
    hypothesis: Hypothesis,
    x: Array,
    z: Array,
    slope: Array | None,
    say: Callable[[float], None] = lambda share: None,
    first: float | None = None,
) -> Fit:
    """Fit from these numbers until it settles, and cross-validate.

    Sensitivities are taken anew only where those that are there, and what steps taught about them, lead no further:
    each number asks for a replay. ``slope``: those to the effects' parameters, None where none are there. ``say`` is
    told how far it is. ``first``: the cost of what all rounds began with, where that is not here.
    """
    say(0.0)
    residual = fitter.replay(hypothesis, [(x, z)])[0]
    here = fitter.cost(residual, z) + hypothesis.tied(x)
    first = here if first is None else first
    found = None if slope is None else fitter.descend(hypothesis, x, z, _STEPS, residual, slope)
    for round_ in range(_ROUNDS):
        say(round_ / _ROUNDS)
        if found:
            x, z, residual = found.x, found.z, found.residual
        before = found.cost if found else here
        fitter.refresh(hypothesis, x, z, residual)
        found = fitter.descend(hypothesis, x, z, _STEPS, residual, fitter.sensitivities(hypothesis, x, z, residual))
        if before - found.cost < max(_SETTLED, LITTLE * (first - found.cost)):
            break
    assert found is not None
    return fitter.cross_validate(found)
