"""From the competition to a graded verdict, and why."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import mujoco
import numpy as np
from numpy.typing import NDArray

from simgap.inference.decision import Class, Evidence, classes, names
from simgap.inference.hypothesis import Fit
from simgap.inference.model_selection import earns, places, takes_a_part
from simgap.inference.nuisance import BOX
from simgap.inference.scores import Scored, Scores
from simgap.inference.screen import angle, projected_response
from simgap.inference.select import REPEATED, Selector
from simgap.inference.selection import Selection
from simgap.inference.thresholds import MOST, MUCH, REMAINS, REMAINS_CHANNEL, REST, SURE, UNEXPLAINED

Array = NDArray[np.float64]


@dataclass
class Verdict:
    """The verdict with its reasons.

    Attributes:
        kind: no_gap, calibration, effect, ambiguous, partial or unknown.
        probability: that the causes named are those, and no others that were looked at.
        explained: share (0 to 1) of the gap above the noise floor that recalibration and the named causes explain.
        classes: hypotheses that name the same causes, with their probabilities, the likeliest first.
        evidence: what the probabilities rest on.
        equivalent: classes of effects (name@site) that the data cannot tell apart.
        angles: {pair: angle [deg]} between what rivals change, nuisances taken out.
        open: fits between which the next experiment should decide, the winner first.
    """

    kind: str
    best: Scored
    probability: float = 0.0
    explained: float = 0.0
    classes: list[Class] = field(default_factory=list)
    evidence: Evidence | None = None
    reasons: list[str] = field(default_factory=list)
    equivalent: list[list[str]] = field(default_factory=list)
    angles: dict[str, float] = field(default_factory=dict)
    open: list[Fit] = field(default_factory=list)

    @property
    def sure(self) -> float:
        """Probability that the verdict is right.

        That its causes are those; of one that is ambiguous, that they are among the rivals it names; of one that is
        unknown, that what was found is not the whole of it.
        """
        if self.kind == "unknown":
            return 1.0 - self.explained * self.probability
        if self.kind == "ambiguous":
            told = [names(self.best.fit), *(names(f) for f in self.open)]
            return sum(c.probability for c in self.classes if any(c.holds(t) for t in told))
        return self.probability


def judge(selector: Selector, selection: Selection) -> Verdict:
    """Decide what may be said of a competition's outcome."""
    best, reference, scores = selection.best, selection.reference, selector.scores
    gain = min((g for g, _, _ in selection.gains), default=0.0)
    blocks = selector.fitter.windows.block
    pool = [best, *selection.rivals, *selection.singles]
    found, evidence = classes(pool, reference, gain, places(selector.effects), scores, blocks, selector.seed)
    verdict = Verdict("no_gap", best, classes=found, evidence=evidence)
    verdict.probability = sum(c.probability for c in found if c.holds(names(best.fit)))
    verdict.explained = _from_nominal(selector, selection, best)
    if best is reference:
        if scores.written > 0.0 or not selector.fitter.lands:
            # A cause that would take a trifle contradicts no such verdict: of 21 blind cases that were told to have
            # none, all were right. Of mice, which hide what is wrong with them in numbers, 15 of 29 were.
            trifles = sum(c.probability for c in found if c.names and _trifle(selector, selection, c))
            verdict.probability = min(verdict.probability + trifles, 1.0)
        _without_effect(verdict, selector, selection)
    else:
        _with_effects(verdict, selector, selection)
        if verdict.kind == "unknown" and verdict.equivalent and not _doubts(selector, selection):
            _name_what_rivals_share(verdict, selector, selection)
    return verdict


def _explained(before: float, after: float) -> float:
    """Share of a gap above one noise floor that is gone."""
    return float(np.clip(1.0 - max(after - 1.0, 0.0) / max(before - 1.0, 1e-9), 0.0, 1.0))


def _taken(scores: Scores, before: Scored, after: Scored) -> float:
    """Share of the gap that one fit leaves which is gone with the other, in a typical window or over all."""
    typical = _explained(scores.typical(before.fit.held), scores.typical(after.fit.held))
    return max(typical, _explained(before.gap, after.gap))


def _from_nominal(selector: Selector, selection: Selection, after: Scored) -> float:
    """The same of what the model leaves as it is."""
    scores = selector.scores
    typical = _explained(scores.typical(selector.nominal_square), scores.typical(after.fit.held))
    return max(typical, _explained(selection.nominal_gap, after.gap))


def written(scores: Scores, selection: Selection) -> float:
    """Share of the gap that causes explain which an earlier diagnosis found, and which the model has by now."""
    return _taken(scores, selection.before, selection.reference) if selection.before else 0.0


def _trifle(selector: Selector, selection: Selection, one: Class) -> bool:
    """Whether causes take no part of the gap that is worth a name; of a corrected model, do not earn their place."""
    scores, reference = selector.scores, selection.reference
    likeliest = scores.scored(one.fits[0])
    if scores.written > 0.0:
        return not earns(scores, reference, likeliest, len(selector.effects))
    return not takes_a_part(scores, reference, likeliest)


def remains(scores: Scores, square: Array) -> bool:
    """Whether mean squares (nw, nl) of windows are no case of no gap."""
    much = scores.typical(square) > REMAINS or float(scores.gaps(square)[0]) > MUCH
    return much or scores.worst_channel(square) > REMAINS_CHANNEL or scores.leaves_more(square)


def _without_effect(verdict: Verdict, selector: Selector, selection: Selection) -> None:
    """The verdict where no effect earns its place."""
    reference, scores = selection.reference, selector.scores
    held = reference.fit.held
    typical, worst = scores.typical(held), scores.worst_channel(held)
    left = f"{reference.gap:.1f} noise floors are left, {worst:.1f} in the worst channel"
    moved = ", ".join(selector.fitter.nuisances[i].name for i in reference.fit.strained)
    if remains(scores, held):
        share = written(scores, selection)
        verdict.kind = "partial" if max(verdict.explained, share) >= MOST else "unknown"
        verdict.open = [s.fit for s in selection.singles[:2]] + [reference.fit]
        verdict.reasons.append(
            f"no known effect earns its place, yet a gap of {reference.gap:.1f} noise floors remains ({typical:.1f} in "
            f"a typical window, {worst:.1f} in the worst channel); nominal numbers within their tolerances explain "
            f"{100 * verdict.explained:.0f} % of what there was"
        )
        if selection.before:
            verdict.reasons.append(
                f"what an earlier diagnosis found and the model has by now explains {100 * share:.0f} % of what the "
                "model before it leaves of this recording, its numbers fitted"
            )
    elif (moved and scores.written == 0.0) or remains(scores, selector.nominal_square):
        # Corrected numbers are where a fit ended: that they might move on is told, and is no verdict.
        verdict.kind = "calibration"
        verdict.reasons.append(
            f"nominal numbers within their tolerances explain {100 * verdict.explained:.0f} % of the gap: {left}"
            + (f"; {moved} are as far off as they may be" if moved else "")
        )
    elif worst <= REPEATED:
        verdict.reasons.append(
            f"nominal numbers within their priors predict held-out data as well as repeating the experiment: {left}"
        )
    else:
        verdict.reasons.append(f"no effect improves the prediction of held-out data beyond what priors explain: {left}")


def _with_effects(verdict: Verdict, selector: Selector, selection: Selection) -> None:
    """The verdict on effects that earned their place."""
    best, reference, scores = selection.best, selection.reference, selector.scores
    verdict.kind = "effect"
    verdict.equivalent = _equivalents(selector, selection, verdict)
    doubts = _doubts(selector, selection)
    typical, by_causes = scores.typical(best.fit.held), _taken(scores, reference, best)
    more = typical > UNEXPLAINED or scores.leaves_more(best.fit.held)
    incomplete = typical > MUCH or (more and by_causes < 1.0 - REST)
    hidden = _hidden(selector, selection)
    if doubts:
        verdict.kind, verdict.reasons = "unknown", doubts
    elif incomplete or hidden:
        worst = scores.worst_channel(best.fit.held)
        left = f"{typical:.1f} noise floors are left in a typical window and {worst:.1f} in the worst channel"
        parts = bool(verdict.equivalent) and all(names(f) < names(best.fit) for f in verdict.open[1:])
        # It has to be likelier than all of them together.
        parts &= verdict.probability >= MOST
        if by_causes >= MOST and (parts or not verdict.equivalent):
            # Whoever says a part of it does not contradict it.
            verdict.kind, verdict.equivalent = "partial", []
            verdict.reasons.append(
                f"{best.key} explains {100 * by_causes:.0f} % of what nominal numbers leave; {left}, which nothing in "
                "the library explains"
                + (f"; that all of these causes act has a probability of {verdict.probability:.2f}" if parts else "")
            )
        else:
            verdict.kind = "unknown"
            verdict.reasons.append(
                f"the best hypothesis ({best.key}) explains {100 * by_causes:.0f} % of what nominal numbers leave, and "
                f"{left}"
                + (f"; {verdict.open[1].hypothesis.key} does about as well" if verdict.equivalent else "")
                + ": the cause is not in the library"
            )
        if hidden:
            verdict.reasons.append(hidden)
    elif verdict.equivalent:
        verdict.kind = "ambiguous"
        alike = verdict.equivalent[0]
        verdict.reasons.append(
            f"the data do not tell these apart: {', '.join(alike)}"
            if len(alike) > 1
            else f"the data do not tell whether {alike[0]} acts at all"
        )
    else:
        gain, low, high = selection.gains[-1]
        verdict.reasons.append(
            f"{best.key} gains {gain:.0f} {scores.unit} (90 %: {low:.0f} to {high:.0f}); its probability among "
            f"all that was tried is {verdict.probability:.2f}"
        )
    if verdict.kind != "effect" and not verdict.open:
        verdict.open = [best.fit, *(r.fit for r in selection.rivals[1:3])]
    # What is the same change under another name is always listed.
    verdict.equivalent += _aliases(best)


def _aliases(scored: Scored) -> list[list[str]]:
    """Names for the same change as effects that were found."""
    return [[effect.key, *effect.aliases] for effect in scored.fit.hypothesis.effects if effect.aliases]


def shared(found: Sequence[Class]) -> tuple[frozenset[str], float]:
    """Effects that all of the likeliest classes name which together are `SURE`, and with which probability they act."""
    leading, reached = [], 0.0
    for one in sorted(found, key=lambda c: -c.probability):
        leading.append(one.names)
        reached += one.probability
        if reached >= SURE:
            break
    common = frozenset[str].intersection(*leading) if leading else frozenset()
    return common, sum(c.probability for c in found if common <= c.names)


def _name_what_rivals_share(verdict: Verdict, selector: Selector, selection: Selection) -> None:
    """A partial answer where rivals differ in a further cause only: what they share, if that is most of the gap."""
    common, probability = shared(verdict.classes)
    fits = [s for s in [*selection.singles, *selection.rivals] if names(s.fit) == common and len(s.fit.fold_x)]
    if not common or not fits:
        return
    kept, scores, reference = min(fits, key=lambda s: s.score), selector.scores, selection.reference
    explained = _taken(scores, reference, kept)
    if explained < MOST:
        return
    further = ", ".join(" + ".join(sorted(names(f) - common)) for f in verdict.open if names(f) > common)
    verdict.kind, verdict.best, verdict.probability, verdict.equivalent = "partial", kept, probability, _aliases(kept)
    verdict.reasons = [
        f"{kept.key} explains {100 * explained:.0f} % of what nominal numbers leave, and every hypothesis that is "
        f"likely has it; of what is left some is explained by one of {further}: this recording does not tell which"
    ]
    verdict.explained = _from_nominal(selector, selection, kept)
    selection.best, selection.gains = kept, [scores.difference(reference.fit, kept.fit)]
    selection.rivals = [kept, *(s for s in selection.rivals if s is not kept)]


def _doubts(selector: Selector, selection: Selection) -> list[str]:
    """Reasons not to believe the winner at all."""
    best = selection.best
    doubts = []
    replayer = selector.fitter.residuals.replayer
    guessed = replayer.guesswork()
    if guessed > UNEXPLAINED:
        joints = replayer.plant.names(mujoco.mjtObj.mjOBJ_JOINT)
        unseen = [joints[j] for j in replayer.unseen()]
        more = f" and {len(unseen) - 3} joints more" if len(unseen) > 3 else ""
        doubts.append(
            f"nothing measures where {', '.join(unseen[:3])}{more} is, and a typical window changes by {guessed:.0f} "
            f"noise floors with where it is guessed to begin, so that {best.key} may explain the guess: record it"
        )
    position = 0
    for effect in best.fit.hypothesis.effects:
        for parameter in effect.parameters:
            value, spread = float(best.fit.x[position]), best.fit.fold_x[:, position]
            position += 1
            if effect.name == "tendon_detached" or len(effect.parameters) > 1:
                continue
            width = 1e-3 * (parameter.high - parameter.low)
            outer = [b for b in (parameter.low, parameter.high) if abs(b - parameter.neutral) > width]
            if any(abs(value - b) <= (1e-3 * b if parameter.log else width) for b in outer):
                doubts.append(f"{effect.key}: {parameter.name} sits on its bound {value:.3g} {parameter.unit}")
            far = abs(parameter.away(value))
            away = [parameter.away(float(v)) for v in spread]
            if len(spread) > 1 and far > 0 and float(np.ptp(away)) > far:
                doubts.append(f"{effect.key}: {parameter.name} changes from fold to fold ({_listed(spread)})")
    return doubts


def _hidden(selector: Selector, selection: Selection) -> str:
    """What is hidden in nominal numbers at the end of their boxes, in words; empty where nothing is."""
    best = selection.best
    strained = [selector.fitter.nuisances[i].name for i in best.fit.strained]
    if not strained or (share := selector.hidden(selection)) <= REST:
        return ""
    return (
        f"beside {best.key}, {' and '.join(strained)} would have to be off by more than {BOX:g} prior deviations "
        f"(worth {100 * share:.0f} % of what the effect is): another effect hides in them"
    )


def _listed(values: Array) -> str:
    return ", ".join(f"{v:.3g}" for v in values)


def _equivalents(selector: Selector, selection: Selection, verdict: Verdict) -> list[list[str]]:
    """The class of hypotheses that cannot be told from the winner; empty where it stands alone."""
    best, mine = selection.best, names(selection.best.fit)
    winner = projected_response(selector.fitter, best.fit, selection.reference.fit)
    if verdict.probability >= SURE:
        return []
    alike, reached = [], verdict.probability
    for rival in verdict.classes:
        if rival.holds(mine) or not rival.names:
            continue
        alike.append(rival)
        response = projected_response(selector.fitter, rival.fits[0], selection.reference.fit)
        verdict.angles[f"{best.key} | {rival.fits[0].hypothesis.key}"] = angle(winner, response)
        reached += rival.probability
        if reached >= SURE:
            break
    if not alike:
        return []
    verdict.open = [best.fit, *(r.fits[0] for r in alike)]
    different = [sorted(r.names - mine) for r in alike]
    changed = sorted(mine - frozenset[str].intersection(*(r.names for r in alike)))
    return [[" + ".join(changed) or best.key, *(" + ".join(d) for d in different if d)]]
