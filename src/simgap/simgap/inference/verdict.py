"""From the competition to a verdict: no gap, an effect, an ambiguity, or something unknown; and why."""

from __future__ import annotations

from dataclasses import dataclass, field

import mujoco
import numpy as np
from numpy.typing import NDArray

from simgap.inference.hypothesis import Fit
from simgap.inference.model_selection import FINALISTS, UNEXPLAINED, indistinct, special_case
from simgap.inference.nuisance import BOX
from simgap.inference.scores import Scored
from simgap.inference.screen import angle, projected_response
from simgap.inference.select import REPEATED, Selection, Selector

Array = NDArray[np.float64]

SMALL = 4.0
"""A gap below this many noise floors is not worth a verdict of unknown."""
REMAINS = 1.6
"""A typical window that is left with a gap of this many noise floors is no case of no gap, whatever it looks like. In
the blind set 79341278 healthy robots leave 1.24 at most there, slipping feet that nothing explained 1.7."""
REMAINS_CHANNEL = 2.5
"""Nor is a channel that is left with so many over all windows: healthy robots of the blind sets 79341278 and 27027990
leave 2.2 at most (58 of them), a drag at one joint of a quadruped that nothing explained 4.0."""
STRUCTURE = 0.35
"""Share of the residual's power that must be predictable for it to count as structure."""
LEFT = 0.35
"""Share of the gap that may be left by an effect that explains it."""
HIDDEN = 0.15
"""Another effect hides in nominal numbers at the end of what their priors allow where letting them go further is worth
this share of what the effect that was found is worth."""
LEFT_TYPICAL, LEFT_OVERALL = 0.15, 0.1
"""An effect that is the cause leaves a typical window with UNEXPLAINED noise floors, or with no more than this share
of what nominal numbers alone leave; or all windows together with no more than the last (a stop that is seldom
met changes few windows, but much in these)."""
MUCH = 7.0
"""And with no more noise floors than this, however small a share of a large gap that is. All windows together that
are left with more are no case of no gap, though it be few of them."""
GUESSED = 2.0
"""A typical window that depends by so many noise floors on where a joint is guessed to be proves no effect. A double
pendulum whose elbow's angle is not recorded: 98; a mouse whose servos and spine are not: 1e-7."""
UNSTABLE = 0.5
"""Spread of a parameter between folds, relative to its distance from neutral."""


@dataclass
class Verdict:
    """The verdict with its reasons.

    Attributes:
        kind: no_gap, effect, ambiguous or unknown.
        equivalent: classes of effects (name@site) that the data cannot tell apart.
        angles: {pair: angle [deg]} between what rivals change, nuisances taken out.
        open: fits between which the next experiment should decide, the winner first.
    """

    kind: str
    best: Scored
    reasons: list[str] = field(default_factory=list)
    equivalent: list[list[str]] = field(default_factory=list)
    angles: dict[str, float] = field(default_factory=dict)
    open: list[Fit] = field(default_factory=list)


def judge(selector: Selector, selection: Selection, structure: float) -> Verdict:
    """Decide. ``structure`` is the predictable share of the residual that the best hypothesis leaves."""
    best, reference = selection.best, selection.reference
    verdict = Verdict("no_gap", best)
    if best is reference:
        typical, worst = selector.scores.typical(best.fit.held), selector.scores.worst_channel(best.fit.held)
        remains = typical > REMAINS or worst > REMAINS_CHANNEL or best.gap > MUCH
        if remains or (best.gap > SMALL and structure > STRUCTURE):
            verdict.kind = "unknown"
            verdict.open = [s.fit for s in selection.singles[:2]] + [reference.fit]
            verdict.reasons.append(
                f"no known effect earns its place, yet a gap of {best.gap:.1f} noise floors remains ({typical:.1f} in "
                f"a typical window, {worst:.1f} in the worst channel) and {100 * structure:.0f} % of it is predictable"
            )
        else:
            left = f"{best.gap:.1f} noise floors are left, {worst:.1f} in the worst channel"
            verdict.reasons.append(
                f"nominal numbers within their priors predict held-out data as well as repeating the experiment: {left}"
                if worst <= REPEATED
                else f"no effect improves the prediction of held-out data beyond what priors explain: {left}"
            )
        return verdict
    verdict.kind = "effect"
    doubts = _doubts(selector, selection, structure)
    verdict.equivalent = _equivalents(selector, selection, verdict)
    if doubts:
        verdict.kind, verdict.reasons = "unknown", doubts
        if not verdict.open:
            verdict.open = [best.fit, *(r.fit for r in selection.rivals[1:3])]
    elif verdict.equivalent:
        verdict.kind = "ambiguous"
        verdict.reasons.append("held-out data do not tell these apart: " + ", ".join(verdict.equivalent[0]))
    else:
        gain, low, high = selection.gains[-1]
        verdict.reasons.append(f"{best.key} gains {gain:.0f} nats on held-out data (90 %: {low:.0f} to {high:.0f})")
    # What is the same change under another name is always listed.
    for effect in best.fit.hypothesis.effects:
        if effect.aliases:
            verdict.equivalent.append([effect.key, *effect.aliases])
    return verdict


def _doubts(selector: Selector, selection: Selection, structure: float) -> list[str]:
    """Reasons not to believe the winner."""
    best, reference = selection.best, selection.reference
    doubts = []
    replayer = selector.fitter.residuals.replayer
    guessed = replayer.guesswork()
    if guessed > GUESSED:
        joints = replayer.plant.names(mujoco.mjtObj.mjOBJ_JOINT)
        unseen = [joints[j] for j in replayer.unseen()]
        more = f" and {len(unseen) - 3} joints more" if len(unseen) > 3 else ""
        doubts.append(
            f"nothing measures where {', '.join(unseen[:3])}{more} is, and a typical window changes by {guessed:.0f} "
            f"noise floors with where it is guessed to begin, so that {best.key} may explain the guess: record it"
        )
    left = max(best.gap - 1.0, 0.0) / max(selection.nominal_gap - 1.0, reference.gap - 1.0, 1e-9)
    if best.gap > SMALL and left > LEFT and structure > STRUCTURE:
        doubts.append(
            f"the best hypothesis ({best.key}) leaves {100 * left:.0f} % of the gap, "
            f"and {100 * structure:.0f} % of that is predictable: the cause is not in the library"
        )
    typical, reference_typical = (selector.scores.typical(s.fit.held) for s in (best, reference))
    share = (typical - 1.0) / max(reference_typical - 1.0, 1e-9)
    overall = (best.gap - 1.0) / max(reference.gap - 1.0, 1e-9)
    much = typical > MUCH or (typical > UNEXPLAINED and share > LEFT_TYPICAL and overall > LEFT_OVERALL)
    if much and not doubts:
        doubts.append(
            f"the best hypothesis ({best.key}) leaves {typical:.1f} noise floors in a typical window, "
            f"{100 * share:.0f} % of what nominal numbers leave: the cause is not in the library"
        )
    strained = [selector.fitter.nuisances[i].name for i in best.fit.strained]
    if strained:
        share = selector.hidden(selection)
        if share > HIDDEN:
            doubts.append(
                f"beside {best.key}, {' and '.join(strained)} would have to be off by more than {BOX:g} prior "
                f"deviations (worth {100 * share:.0f} % of what the effect is): another effect hides in them"
            )
    position = 0
    for effect in best.fit.hypothesis.effects:
        for parameter in effect.parameters:
            value, spread = best.fit.x[position], best.fit.fold_x[:, position]
            position += 1
            if effect.name == "tendon_detached":
                continue
            width = 1e-3 * (parameter.high - parameter.low)
            outer = [b for b in (parameter.low, parameter.high) if abs(b - parameter.neutral) > width]
            if any(abs(value - b) <= width for b in outer) and len(effect.parameters) == 1:
                doubts.append(f"{effect.key}: {parameter.name} sits on its bound {value:.3g} {parameter.unit}")
            far = abs(value - parameter.neutral)
            if (
                len(effect.parameters) == 1
                and len(spread) > 1
                and far > 0
                and float(np.ptp(spread)) > 2 * UNSTABLE * far
            ):
                doubts.append(f"{effect.key}: {parameter.name} changes from fold to fold ({_listed(spread)})")
    return doubts


def _listed(values: Array) -> str:
    return ", ".join(f"{v:.3g}" for v in values)


def _equivalents(selector: Selector, selection: Selection, verdict: Verdict) -> list[list[str]]:
    """The class of hypotheses that cannot be told from the winner; empty where it stands alone."""
    best = selection.best
    winner = projected_response(selector.fitter, best.fit, selection.reference.fit)
    mine = _names(best.fit)
    close = indistinct(min(gain for gain, _, _ in selection.gains))
    alike, seen = [], [mine]
    for rival in selection.rivals[: 2 * FINALISTS]:
        if rival is best or _names(rival.fit) in seen:
            continue
        seen.append(_names(rival.fit))
        if rival.fit.likelihood is None and rival.score >= selection.reference.score:
            continue  # Explains no more than nominal numbers do.
        response = projected_response(selector.fitter, rival.fit, selection.reference.fit)
        verdict.angles[f"{best.key} | {rival.key}"] = angle(winner, response)
        gain, low, _ = selector.scores.difference(rival.fit, best.fit)
        if (gain < close or low <= 0.0) and not special_case(best.fit, rival.fit):
            alike.append(rival)
    if not alike:
        return []
    verdict.open = [best.fit, *(r.fit for r in alike)]
    different = [sorted(_names(r.fit) - mine) for r in alike]
    changed = sorted(mine - set[str].intersection(*(_names(r.fit) for r in alike)))
    return [[" + ".join(changed) or best.key, *(" + ".join(d) for d in different if d)]]


def _names(fit: Fit) -> set[str]:
    return {e.key for e in fit.hypothesis.effects}
