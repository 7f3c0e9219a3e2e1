"""Effects in their other forms: another law at the same place, of which only a fit to the end tells which it is."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from simgap.effects.base import Effect
from simgap.inference.effort import Effort
from simgap.inference.fit import Fitter
from simgap.inference.hypothesis import Fit, Hypothesis
from simgap.inference.model_selection import generalises
from simgap.inference.scores import Scored, Scores
from simgap.inference.simplex_search import simplex_search


class Forms:
    """Fits hypotheses in other forms of their effects, on one recording."""

    def __init__(self, fitter: Fitter, effects: Sequence[Effect], scores: Scores, effort: Effort) -> None:
        self._fitter, self._effects, self._scores, self._effort = fitter, list(effects), scores, effort

    def best(self, fit: Fit, which: Sequence[int] | None = None) -> Fit:
        """The same, or one of its effects in another form with as many parameters, where that says more in sample.

        ``which``: numbers of the effects that are looked at; None for all.

        Friction that holds, above all: of a real arm it is worth more than what is added later. In sample none of two
        such forms flatters; held out, folds are predicted by slopes, by which what sticks is not.
        """
        own = fit.hypothesis
        looked = range(len(own.effects)) if which is None else which
        others = [h for i in looked for h in self._in_other_forms(own, i) if h.size == own.size]
        fits = [self._fitter.fit(hypothesis, fit.x, fit.z, roughly=True) for hypothesis in others]
        return min([fit, *fits], key=lambda fit: fit.cost)

    def of(self, fit: Fit) -> list[Scored]:
        """The same effects, one of them in another form or by a law that contains its own; fitted from the same values.

        Such laws are close, and which is the robot's shows only when each is fitted to the end.
        """
        found: list[Scored | None] = []
        for i, effect in enumerate(fit.hypothesis.effects):
            found += self.others(fit, i)
            found += [self._generalised(fit, i, law) for law in self._effects if generalises(law, effect)]
        return [f for f in found if f is not None]

    def others(self, fit: Fit, which: int) -> list[Scored]:
        """A fit with effect number ``which`` in each of its other forms, begun from the same values."""
        found = []
        for changed in self._in_other_forms(fit.hypothesis, which):
            x = fit.x
            if changed.size > len(x):
                x = simplex_search(self._fitter, changed, which, x, fit.z, self._effort.sought)
            found.append(self._scores.scored(self._fitter.cross_validate(self._fitter.fit(changed, x, fit.z))))
        return found

    def _in_other_forms(self, hypothesis: Hypothesis, which: int) -> list[Hypothesis]:
        """A hypothesis with effect number ``which`` in each of its other forms."""
        effects = hypothesis.effects
        effect = effects[which]
        names = [p.name for p in effect.parameters]
        same = [o for o in self._effects if o.key == effect.key and [p.name for p in o.parameters] == names]
        others = [*(o for o in same if o.form != effect.form), *effect.alternatives()]
        return [Hypothesis((*effects[:which], other, *effects[which + 1 :])) for other in others]

    def _generalised(self, fit: Fit, which: int, law: Effect) -> Scored | None:
        """A fit with a law instead of its special case, effect number ``which``; from the best of the law's starts."""
        effects = fit.hypothesis.effects
        first = Hypothesis(effects[:which]).size
        own = fit.x[first : first + len(effects[which].parameters)]
        starts = law.starts_from(own.tolist())
        if not starts:
            return None
        made = [Hypothesis((*effects[:which], form, *effects[which + 1 :])) for form in (law, *law.alternatives())]
        after = fit.x[first + len(own) :]
        points = [(np.concatenate([fit.x[:first], start, after]), fit.z) for start in starts]
        fits = []
        for hypothesis in made:
            squares = self._fitter.mean_square(self._fitter.replay(hypothesis, points))
            x, z = points[int(np.argmin(self._fitter.data_cost(squares)))]
            fits.append(self._fitter.fit(hypothesis, x, z))
        return self._scores.scored(self._fitter.cross_validate(min(fits, key=lambda f: f.cost)))
