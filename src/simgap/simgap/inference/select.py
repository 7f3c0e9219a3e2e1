"""Which hypothesis: a competition on held-out scores, forward selection with swaps."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from simgap.effects.base import Effect
from simgap.inference.budget import SEARCH, Budget, OutOfTimeError
from simgap.inference.candidates import FAVOURITES, Candidates, Hint, by_score
from simgap.inference.effort import Effort, Progress
from simgap.inference.fit import Fitter
from simgap.inference.hypothesis import Hypothesis
from simgap.inference.leaders import Leaders
from simgap.inference.model_selection import (
    ENOUGH,
    EVIDENCE,
    EVIDENCE_MORE,
    FURTHER,
    earns,
    places,
    simplest,
    stands_out,
)
from simgap.inference.nuisance import BOX
from simgap.inference.partners import Partners
from simgap.inference.proposals import Proposals
from simgap.inference.revision import Revision
from simgap.inference.scores import Scored, Scores
from simgap.inference.screen import Screened
from simgap.inference.selection import Selection
from simgap.inference.thresholds import UNEXPLAINED

Array = NDArray[np.float64]

_BEHIND = 0.9
"""Share of what the causes earn that single parts speak for together: of a single effect that earns less, no search
begins. Where the truth is one effect, it earns about all of it."""
_FAR_BEHIND = 0.7
"""Where the first half of single effects earn less than this share by rough fits, the others, which promised less, are
not fitted, and of these the best alone is refined. And where what single parts speak for earns less than this share of
what as many effects do, or fewer, no search begins with it: of a camera with an elastic drive it earned 69 of 2538
nats, and building on it took half of the diagnosis."""
REPEATED = 1.0
"""[noise floors] With no more left than that in any channel, nominal numbers predict the robot as well as repeating the
experiment does, and no effect is looked for: what is finer than the noise shows in how it was estimated."""


class Selector:
    """Runs the competition on one recording."""

    def __init__(
        self,
        fitter: Fitter,
        effects: Sequence[Effect],
        seed: int = 0,
        progress: Progress | None = None,
        effort: Effort | None = None,
        budget: Budget | None = None,
        hints: Sequence[Hint] = (),
        heard: Callable[[Selection], None] | None = None,
        left: float = math.inf,
        before: Fitter | None = None,
    ) -> None:
        """``before``: of the model that this one corrects, in the same windows."""
        self._hints, self._heard, self._before = list(hints), heard, before
        self._effort, self.budget = effort or Effort(), budget or Budget()
        self.fitter, self.effects, self.seed = fitter, list(effects), seed
        self.scores = Scores(fitter, seed, left, in_sample=self._effort.twice and fitter.lands)
        fitter.budget = self.budget
        self.candidates = Candidates(fitter, self.effects, self.scores, self._effort, self.budget.watch(progress))
        self.proposals = Proposals(fitter, self.effects, self._effort, self.candidates.say)
        self._sites = places(self.effects)
        self._reached: dict[str, float] = {}
        """Best scores of the sets of effects to which one after the other led."""
        self._leaders = Leaders(self.candidates, self.scores, self._effort, self._sites)
        self.partners = Partners(self.candidates, self.scores)
        self._revision = Revision(self.candidates, self.scores)

    def hidden(self, selection: Selection) -> float:
        """What the data would gain if nominal numbers might be off twice as far, as a share of what the effect gains.

        Their priors stay.
        """
        fit = selection.best.fit
        if fit.likelihood is not None:
            return fit.hidden
        wider = self.fitter.fit(fit.hypothesis, fit.x, fit.z, 4, fit.residual, box=2.0 * BOX)
        return (fit.cost - wider.cost) / max(selection.gains[-1][0], 1e-9)

    def run(self) -> Selection:
        """The whole competition, or as much of it as there is time for.

        ``heard`` is told, whenever that changes, what would be answered if the time were over.
        """
        fitter = self.fitter
        fit = fitter.fit_nuisances(lambda share: self.candidates.say("nuisances", share))
        before = self._uncorrected()
        reference = self.scores.scored(fitter.cross_validate(fit))
        if before is not None:
            self.scores.written = max(self.scores.difference(before.fit, reference.fit)[0], 0.0)
        self._found = Selection(reference, self._nominal_gap(), reference, before=before)
        try:
            with self.budget.until(SEARCH):
                begun = self._begun_near(self._found)
                found = self._compete(reference, begun)
                if begun is not None:
                    found = self._compared(begun, found)
        except OutOfTimeError as spent:
            self.budget.ended(str(spent))
            found = self._judged_anew(self._hurried())
        if found.best is not found.reference:
            self._leaders.settle(found, bool(self.budget.left_out))
            if not self.budget.left_out:
                try:
                    with self.budget.until(SEARCH):
                        self._revision.part(found)
                        self._revision.grow(found)
                except OutOfTimeError as spent:
                    self.budget.ended(str(spent))
        if self._heard:
            self._heard(found)
        return found

    def _uncorrected(self) -> Scored | None:
        """The model that this one corrects, with its numbers fitted, by the same likelihood."""
        if self._before is None:
            return None
        self._before.budget = self.budget
        fit = self._before.fit_nuisances()
        # One count of independent samples for both.
        self._before.likelihood = self.fitter.likelihood
        return self.scores.scored(self._before.cross_validate(fit))

    @property
    def _found(self) -> Selection:
        """The best so far."""
        return self._so_far

    @_found.setter
    def _found(self, found: Selection) -> None:
        self._so_far = found
        if self._heard:
            self._heard(self._hurried())

    def _begun_near(self, result: Selection) -> Selection | None:
        """Begun with all that single parts speak for, together: real robots have several causes, each cheap alone."""
        first = self.candidates.together(self._hints, result.reference)
        if first is None:
            return None
        several = len(first.fit.hypothesis.effects)
        # So many sets of so many effects could have been spoken for.
        if not earns(self.scores, result.reference, first, len(self.effects) ** several):
            return None
        gain = self.scores.difference(result.reference.fit, first.fit)
        found = replace(result, best=first, singles=[], rivals=[first], gains=[gain], unrivalled=set())
        # Where the time is over while needless ones are taken out, what is left of them by then is the best so far.
        self._found = found
        self._revision.drop(found)
        self._found = replace(found)
        return found

    @staticmethod
    def _better(one: Selection, other: Selection) -> bool:
        """Whether a selection is to be preferred; one with more effects has to be so by more."""
        more = len(one.best.fit.hypothesis.effects) > len(other.best.fit.hypothesis.effects)
        return one.best.score < other.best.score - (EVIDENCE_MORE if more else EVIDENCE)

    def _nominal_gap(self) -> float:
        """Gap of the nominal model as it is, and its mean squares, as starts are judged now."""
        fitter = self.fitter
        nothing = np.zeros(0), np.zeros(len(fitter.nuisances))
        self.nominal_square = fitter.mean_square(fitter.replay(Hypothesis(), [nothing])[0])
        return float(self.scores.gaps(self.nominal_square)[0])

    def _hurried(self) -> Selection:
        """The best so far, where the time is over."""
        found = self._found
        if found.best is not found.reference or not found.singles:
            return found
        winner = simplest(self.scores, found.singles, found.reference, self._sites)
        if winner is None or not earns(self.scores, found.reference, winner, len(self.effects)):
            return found
        gains = [self.scores.difference(found.reference.fit, winner.fit)]
        return replace(found, best=winner, rivals=found.singles, gains=gains)

    def _judged_anew(self, found: Selection) -> Selection:
        """What was found scored as starts of windows are judged by now, where that changed before the time was over."""
        gap = self._nominal_gap()
        if np.isclose(gap, found.nominal_gap):
            return found

        def again(scored: Scored) -> Scored:
            if scored.fit.likelihood is not None:
                return scored
            fit = self.fitter.fit(scored.fit.hypothesis, scored.fit.x, scored.fit.z, iterations=1)
            return self.scores.scored(self.fitter.cross_validate(fit))

        reference = again(found.reference)
        best = reference if found.best is found.reference else again(found.best)
        rivals = [best if s is found.best else again(s) for s in found.rivals]
        gains = found.gains
        if best is not reference and len(gains) == 1:
            gains = [self.scores.difference(reference.fit, best.fit)]
        return replace(found, reference=reference, nominal_gap=gap, best=best, rivals=rivals, gains=gains)

    def _keep(self, result: Selection) -> None:
        """Remember it where it is the best so far, and not only begun with what did not earn its place alone."""
        earned = earns(self.scores, result.reference, result.best, len(self.effects))
        if result.best.score <= self._found.best.score and earned:
            self._found = replace(result)

    def _compared(self, begun: Selection, found: Selection) -> Selection:
        """The better of what was begun with single parts, scored as the others are by now, and what was found.

        Where as many effects, or fewer, are far ahead, building on what was begun would find them again.
        """
        old = begun.best.fit
        again = self.fitter.fit(old.hypothesis, old.x, old.z, iterations=1)
        best = self.candidates.to_the_end(self.scores.scored(self.fitter.cross_validate(again)))
        fewer = len(found.best.fit.hypothesis.effects) <= len(old.hypothesis.effects)
        if fewer and self._outdone(best, found, found.reference, _FAR_BEHIND):
            return found
        gain = self.scores.difference(found.reference.fit, best.fit)
        rivals = sorted([best, *(s for s in found.singles if s.key != best.key)], key=by_score)
        other = replace(found, best=best, rivals=rivals, gains=[gain], unrivalled=set())
        while len(other.best.fit.hypothesis.effects) <= self._effort.max_effects:
            if self.scores.typical(other.best.fit.held) < ENOUGH or not self.add(other, found.screened):
                break
        self._revision.drop(other)
        return other if self._better(other, found) else found

    def _compete(self, reference: Scored, begun: Selection | None) -> Selection:
        beside, screened = self.proposals.about(reference.fit), self.proposals.about_nominal()
        self._found = replace(self._found, screened=screened)
        starts = self.proposals.most_promising(screened, beside, reference.fit)
        starts = [*self.candidates.hinted(self._hints), *starts]
        first = len(starts) if begun is None else len(starts) - len(starts) // 2
        singles = self.candidates.fitted(starts[:first], reference)
        # Fits with the nominal model's sensitivities are rough, but not by so much.
        outdone = bool(begun and singles and self._outdone(singles[0], begun, reference, _FAR_BEHIND))
        self._found = replace(self._found, singles=singles)
        if not outdone and first < len(starts):
            singles = sorted([*singles, *self.candidates.fitted(starts[first:], reference)], key=by_score)
            self._found = replace(self._found, singles=singles)
        singles, reference = self.candidates.finals(
            singles, reference, screened[:FAVOURITES], [begun.best.fit] if begun else [], outdone
        )
        self.proposals.forget()
        gap = self._nominal_gap()
        result = replace(self._found, reference=reference, nominal_gap=gap, best=reference, singles=singles)
        self._found = replace(result)
        winner = simplest(self.scores, singles, reference, self._sites)
        if self.scores.worst_channel(reference.fit.held) <= REPEATED:
            return result
        if winner is not None and begun is not None and self._outdone(winner, begun, reference):
            self._keep(begun)
            gain = self.scores.difference(reference.fit, winner.fit)
            return replace(result, best=winner, rivals=singles, gains=[gain])
        refused: list[Scored] = []
        if winner is not None and self._promises(reference, winner):
            singles, winner = self._leaders.followed(singles, winner, reference)
            singles, winner = self._leaders.ended(singles, winner, reference)
            if self._effort.twice:
                reference = self.candidates.without([winner], reference)
                result = self._found = replace(result, reference=reference, best=reference, singles=singles)
                if not earns(self.scores, reference, winner, len(self.effects)):
                    refused, winner = [winner], None
        else:
            winner = None
        if winner is not None:
            result = self._found = self._forward(result, singles, winner, screened)
            overtaken = begun is not None and self._better(begun, result)
            if self.scores.typical(result.best.fit.held) > ENOUGH and not overtaken:
                result = self._begun_elsewhere(result, screened)
            if self.scores.typical(result.best.fit.held) > UNEXPLAINED and not self._effort.twice:
                result = self._begun_in_pairs(result, screened)
        else:
            if self.scores.worst_channel(reference.fit.held) > UNEXPLAINED:
                # Beside numbers that fit other effects show than about the nominal ones.
                self.add(result, screened)
            much = self.scores.typical(reference.fit.held) > UNEXPLAINED
            if result.best is reference and (much or refused):
                result = self._only_together(result, screened, [] if much else refused)
        return result

    def _promises(self, reference: Scored, first: Scored) -> bool:
        """Whether a first effect is worth a fit to the end: where ends are a matter of chance, before it is judged."""
        if self._effort.twice:
            return reference.score - first.score > EVIDENCE + math.log(len(self.effects))
        return earns(self.scores, reference, first, len(self.effects))

    @staticmethod
    def _outdone(one: Scored, other: Selection, reference: Scored, share: float = _BEHIND) -> bool:
        """Whether what one hypothesis earns is so far behind another that building on it would find that again."""
        return reference.score - one.score < share * (reference.score - other.best.score)

    def _forward(
        self, result: Selection, singles: list[Scored], first: Scored, screened: Sequence[Screened]
    ) -> Selection:
        """One effect after the other, beginning with ``first``, as long as that is worth it."""
        gain = self.scores.difference(result.reference.fit, first.fit)
        found = replace(result, best=first, singles=singles, rivals=singles, gains=[gain], unrivalled=set())
        self._keep(found)
        while len(found.best.fit.hypothesis.effects) < self._effort.max_effects:
            if not self._leaves_much(found.best) or not self.add(found, screened):
                break
            self._keep(found)
            if self._been_there(found.best):
                return found
        self._revision.drop(found)
        return found

    def _been_there(self, reached: Scored) -> bool:
        """Whether these effects were reached from another first one, and no worse: what comes after them is known."""
        before = self._reached.get(reached.key, math.inf)
        self._reached[reached.key] = min(before, reached.score)
        return not self._effort.twice and reached.score > before - EVIDENCE

    def _leaves_much(self, scored: Scored) -> bool:
        """Whether a further effect is looked for.

        Many numbers that are a little off take most of what it leaves: its windows are at their floors while it earns
        what is asked. There no floor is told by.
        """
        held = scored.fit.held
        much = self.scores.typical(held) >= ENOUGH or self.scores.leaves_more(held)
        return self._effort.twice or much or bool(scored.fit.strained)

    def _begun_elsewhere(self, result: Selection, screened: Sequence[Screened]) -> Selection:
        """The same with another first effect, where much is left: the first may only have imitated two others.

        Begun with each of the later ones, which were found beside it.
        """
        full, found = result.best.fit, result
        sizes = np.cumsum([0, *(len(e.parameters) for e in full.hypothesis.effects)])
        for i, effect in enumerate(full.hypothesis.effects[1:], 1):
            own = full.x[sizes[i] : sizes[i + 1]]
            alone = self.fitter.fit(Hypothesis((effect,)), own, np.zeros_like(full.z))
            first = self.scores.scored(self.fitter.polish(alone))
            if not earns(self.scores, result.reference, first, len(self.effects)):
                continue
            other = self._forward(result, result.singles, first, screened)
            found, left = (other, found) if self._better(other, found) else (found, other)
            if len(left.best.fit.hypothesis.effects) == len(found.best.fit.hypothesis.effects):
                known = {r.key for r in found.rivals}
                found.rivals = sorted([*found.rivals, *(r for r in left.rivals if r.key not in known)], key=by_score)
        return found

    def _begun_in_pairs(self, result: Selection, screened: Sequence[Screened]) -> Selection:
        """The same with two first effects of different kinds at once, where much is left.

        Of a leg whose servos are weak and rub, friction that grows with load explains most, and beside that neither
        earns its place.
        """
        pair = self.candidates.paired(result.singles)
        several = len(self.effects) ** 2
        if pair is None or not earns(self.scores, result.reference, pair, several):
            return result
        other = self._forward(result, result.singles, pair, screened)
        return other if self._better(other, result) else result

    def _only_together(
        self, result: Selection, screened: Sequence[Screened], firsts: Sequence[Scored] = ()
    ) -> Selection:
        """Effects of which none earns its place alone: each may show only beside the other.

        Begun with each of ``firsts``, by default with the best of each kind.
        """
        found = result
        kinds = {s.fit.hypothesis.effects[0].name: s for s in reversed(result.singles)}
        for first in firsts or sorted(kinds.values(), key=by_score)[:FAVOURITES]:
            other = self._forward(result, result.singles, first, screened)
            several = len(other.best.fit.hypothesis.effects)
            better = several > 1 and other.best.score < found.best.score
            # So many sets of so many effects could have been found.
            if better and earns(self.scores, result.reference, other.best, len(self.effects) ** several):
                found = other
        return found

    def add(self, result: Selection, screened: Sequence[Screened]) -> bool:
        """Add one effect more, or swap older ones; True where that was worth it."""
        base = result.best
        pairs = self.partners.one_more(base, self.proposals.beside, result.singles, screened)
        best = simplest(self.scores, pairs, base, self._sites)
        if best is None:
            return False
        if self._effort.twice:
            # Where ends are a matter of chance, it is fitted to its own before it is judged, as a first effect is.
            best = self._leaders.restarted(self.candidates.to_the_end(best))
        present = {e.key for e in base.fit.hypothesis.effects}
        others, unrivalled = sum(e.key not in present for e in self.effects), stands_out(base.fit, best.fit, pairs)
        first = result.gains[0][0] if result.gains else np.inf
        if not earns(self.scores, base, best, others, unrivalled, first):
            added = " + ".join(sorted({e.key for e in best.fit.hypothesis.effects} - present))
            asked = max(EVIDENCE_MORE + np.log(max(others, 1)), FURTHER * first if np.isfinite(first) else 0.0)
            result.rejected = added, self.scores.difference(base.fit, best.fit)[0], float(asked)
            return False
        result.rejected = None
        if unrivalled:
            result.unrivalled |= {e.key for e in best.fit.hypothesis.effects} - present
        result.gains.append(self.scores.difference(base.fit, best.fit))
        if not self._effort.twice:
            best = self._leaders.restarted(self.candidates.to_the_end(best))
        pairs = sorted([best, *(p for p in pairs if p.fit.hypothesis is not best.fit.hypothesis)], key=by_score)
        result.best, result.rivals = best, pairs
        return True
