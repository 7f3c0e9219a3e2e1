"""One effect more beside those that were found, or in the place of one of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from simgap.inference.candidates import (
    FAVOURITES,
    HOPELESS,
    MANY_PARAMETERS,
    Candidates,
    by_score,
)
from simgap.inference.effort import PARTNERS
from simgap.inference.hypothesis import Fit, Hypothesis
from simgap.inference.model_selection import EVIDENCE_MORE
from simgap.inference.proposals import Start
from simgap.inference.scores import Scored, Scores
from simgap.inference.screen import Screened

_ANOTHER_NAME = 0.995
"""Two effects whose sensitivities have this cosine are one change under two names."""
_MANY = 12
"""Beside so many parameters, or more, the first further effect is the only one that is fitted to its end."""
_UNTOUCHED = 1
"""Effects that are also tried beside untouched nominal numbers, where those are bent far."""


class Partners:
    """Fits what was found with one effect more, on one recording."""

    def __init__(self, candidates: Candidates, scores: Scores) -> None:
        self._candidates, self._scores = candidates, scores
        self._fitter, self._effort = candidates.fitter, candidates.effort

    def one_more(
        self,
        base: Scored,
        propose: Callable[[Fit], list[Start]],
        singles: Sequence[Scored],
        screened: Sequence[Screened],
    ) -> list[Scored]:
        """``base`` with each of the effects that promise most beside it, or with older ones swapped; best first.

        ``propose`` says which those are, ``singles`` were fitted alone, ``screened`` about the nominal model.
        """
        fitter = self._fitter
        fitter.refresh(base.fit.hypothesis, base.fit.x, base.fit.z, base.fit.residual)
        partners = propose(base.fit)
        pairs = self._candidates.fitted(partners, base)
        if base.fit.hypothesis.size >= _MANY:
            return self._first_ended(base, pairs)
        if base.fit.strained:
            again = sorted([*pairs, *self.beside_untouched(base.fit, singles)], key=by_score, reverse=True)
            pairs = sorted({p.key: p for p in again}.values(), key=by_score)
        if not pairs:
            return []
        pairs = self._swapped(pairs, screened)
        margin = self._candidates.hopeless(base, pairs[0])
        hopeful = [p for p in pairs[:2] if p.score < pairs[0].score + margin]
        # Fits start where the older effect's nominal numbers are, and may stop short; not where partners were compared.
        favourites = partners[: 0 if self._effort.twice else FAVOURITES]
        promising = {base.fit.hypothesis.with_effect(effect).key for effect, _, _ in favourites}
        hopeful += [p for p in pairs if p.key in promising and p not in hopeful]
        polished = [self._scores.scored(fitter.polish(p.fit)) for p in hopeful]
        polished += [
            self._scores.scored(fitter.polish(f.fit))
            for f in self._candidates.forms.of(min(polished, key=by_score).fit)
        ]
        keys = {p.key for p in polished}
        found = [*polished, *(p for p in pairs if p.key not in keys)]
        return sorted((p for p in found if not self._says_again(p.fit)), key=by_score)

    def _first_ended(self, base: Scored, found: list[Scored]) -> list[Scored]:
        """The first of those ``found`` beside many parameters fitted to its end, if it promises anything.

        Fits began with sensitivities about ``base``: what is nothing by these is nothing at its end.
        """
        for i, scored in enumerate(found):
            if base.fit.cost - scored.fit.cost < EVIDENCE_MORE:
                return found[i:]
            last = len(scored.fit.hypothesis.effects) - 1
            ended = self._fitter.polish(self._candidates.forms.best(scored.fit, [last]))
            if not self._says_again(ended):
                return sorted([self._scores.scored(ended), *found[i + 1 :]], key=by_score)
        return []

    def _says_again(self, fit: Fit) -> bool:
        """Whether the last effect of a fit changes just what an earlier one does: friction of a cable and of its joint.

        Two of these fit a little better than one only because two constraints are stiffer.
        """
        last = len(fit.hypothesis.effects[-1].parameters)
        root = np.sqrt(self._fitter.weights(self._fitter.mean_square(fit.residual)))[:, None, :]
        rows = (self._fitter.complete(fit).effect_jacobian * root).reshape(len(fit.x), -1)
        rows /= np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-300)
        return bool((np.abs(rows[:-last] @ rows[-last:].T) > _ANOTHER_NAME).any())

    def beside_untouched(self, base: Fit, singles: Sequence[Scored]) -> list[Scored]:
        """Fits of one effect more that begin where it was alone, and nominal numbers untouched.

        Those that are bent far may have swallowed it. Sensitivities are the nominal model's: by those about the other
        effect, a play, fits had stopped short.
        """
        fitter, z = self._fitter, np.zeros_like(base.z)
        found = []
        present = {e.key for e in base.hypothesis.effects}
        alone = [s.fit for s in singles if s.fit.hypothesis.effects[0].key not in present]
        with fitter.sensitivities_kept():
            fitter.jacobian = fitter.nominal_jacobian
            for i, single in enumerate(alone[:_UNTOUCHED]):
                self._candidates.say("fit beside untouched", i / _UNTOUCHED)
                hypothesis = base.hypothesis.with_effect(single.hypothesis.effects[0])
                fit = fitter.fit(hypothesis, np.concatenate([base.x, single.x]), z)
                found.append(self._scores.scored(fitter.cross_validate(fit)))
        return found

    def _swapped(self, pairs: list[Scored], screened: Sequence[Screened]) -> list[Scored]:
        """Replace each older effect of the best pair by the candidates that screened best."""
        lead = pairs[0].fit
        present = {e.key for e in lead.hypothesis.effects}
        spare = [s for s in screened[:PARTNERS] if s.effect.key not in present][: self._effort.swapped]
        if lead.hypothesis.size > MANY_PARAMETERS:
            spare = []  # what was begun together has been looked at together
        extra = []
        for position in range(len(lead.hypothesis.effects) - 1):
            sizes = [len(e.parameters) for e in lead.hypothesis.effects]
            parts = np.split(lead.x, np.cumsum(sizes)[:-1])
            for s in spare:
                effects, values = list(lead.hypothesis.effects), list(parts)
                effects[position], values[position] = s.effect, s.x
                fit = self._fitter.fit(Hypothesis(tuple(effects)), np.concatenate(values), lead.z)
                far = fit.cost > lead.cost + HOPELESS  # in sample, which flatters
                self._fitter.score_in_sample(fit) if far else self._fitter.cross_validate(fit)
                extra.append(self._scores.scored(fit))
        return sorted([*pairs, *extra], key=by_score)
