"""What to fit first: effects screened about nominal numbers and about those that fit, compared by a few steps."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from simgap.effects.base import Effect
from simgap.inference.effort import Effort
from simgap.inference.fit import Fitter
from simgap.inference.hypothesis import Fit, Hypothesis
from simgap.inference.loose_numbers import fit_loosely, spoken_for, with_own_as_modelled
from simgap.inference.screen import WINDOWS, Glance, Screened, informative_windows, screen

Array = NDArray[np.float64]
Start = tuple[Effect, Array, Array]
"""An effect, the values of its parameters (beside others, after theirs), and those of all nuisances."""

COMPARED = 10
"""Windows of the usual length in which what is proposed is compared, where much is."""
_GLIMPSE, _SECOND = 2, 0.3
"""Steps of a fit after which what is proposed is compared, and the share that takes as many more."""
_HALFWAY, _FAR_OFF = 0.5, 8.0
"""Share of the numbers that fit from which what is proposed begins too, and what [nats] they must cost for that. Beside
a mouse's own, a shifted COM gained 4 nats in a rough fit; from halfway back 64."""
_LEADING, _AKIN = 3, 8
"""Of so many that lead where effects are compared, of partners the first, so many next to them are compared too."""
_LOOSE = 4
"""Nominal numbers that are heard of those that go far where they may."""


class Proposals:
    """Says with which effects to begin, and from which numbers. It may miss one, and judges none."""

    def __init__(
        self, fitter: Fitter, effects: Sequence[Effect], effort: Effort, say: Callable[[str, float], None]
    ) -> None:
        """``say`` is told the stage and its share that is done."""
        self._fitter, self._effects, self._effort, self._say = fitter, list(effects), effort, say
        self._glance = Glance()

    def forget(self) -> None:
        """Starts of windows are judged anew: what was seen at a glance was whitened by their errors as before."""
        self._glance = Glance()

    def about_nominal(self) -> list[Screened]:
        """Screen about the untouched nominal model: the nuisances' best fit may have swallowed half of an effect."""
        fitter = self._fitter
        assert fitter.nominal is not None
        with fitter.sensitivities_kept():
            fitter.jacobian = fitter.nominal_jacobian
            return self._screened(fitter.nominal, (0.5 if self._effort.twice else 0.0, 1.0))

    def about(self, reference: Fit) -> list[Screened]:
        """Screen about the nominal numbers' best fit, where the effort says so.

        Of what lands a change is not what it is about nominal numbers. If this is done first, the glance of the other
        screening takes changes from here, and differs in what it holds them against.
        """
        return self._screened(reference, (0.0, 0.5)) if self._effort.twice else []

    def most_promising(self, screened: Sequence[Screened], beside: Sequence[Screened], reference: Fit) -> list[Start]:
        """The starts to fit: the best of a screening, or the best of a comparison where there is one ``beside`` it."""
        starts = [(s.effect, s.x, s.z) for s in screened[: self._effort.survivors]]
        if not self._effort.twice:
            return starts
        foremost = [s for one in (screened, beside) for s in _foremost(one, self._effort.survivors)]
        # What numbers a screening promises an effect is a guess; beside those that fit without it, it often shows more.
        starts = [(s.effect, s.x, z) for s in foremost for z in (s.z, reference.z)]
        starts += with_own_as_modelled(self._fitter, [(s.effect, s.x) for s in foremost], reference.z)
        self._say("compare", 0.0)
        starts += spoken_for(self._fitter, self._effects, fit_loosely(self._fitter), _LOOSE)
        found = self._compared_with_akin(starts, reference, _LEADING, "compare")
        return [(f.hypothesis.effects[0], f.x, f.z) for f in found[: self._effort.survivors]]

    def beside(self, base: Fit) -> list[Start]:
        """The starts to fit of ``base`` with one effect more, the best first; sensitivities are those about it."""
        present = {e.key for e in base.hypothesis.effects}
        screened = screen(
            self._fitter,
            base,
            [e for e in self._effects if e.key not in present],
            lambda share: self._say("screen partners", share),
            self._effort.hopeful,
            windows=COMPARED if self._effort.twice else WINDOWS,
            glance=self._glance if self._effort.twice else None,
        )
        if not self._effort.twice:
            return [(s.effect, np.concatenate([base.x, s.x]), s.z) for s in screened[: self._effort.partners]]
        foremost = screened[: self._effort.survivors]
        starts = [(s.effect, s.x, z) for s in foremost for z in (s.z, base.z)]
        starts += with_own_as_modelled(self._fitter, [(s.effect, s.x) for s in foremost], base.z)
        found = self._compared_with_akin(starts, base, 1, "compare partners")
        return [(f.hypothesis.effects[-1], f.x, f.z) for f in found[: self._effort.partners]]

    def _akin(self, leaders: Sequence[Effect]) -> list[Effect]:
        """Of each of the ``leaders``, other laws of its kind at its parts, and its own at some of them or at more.

        What is screened beside numbers that are all a little off may be the law or the part next to the right one.
        """
        found: list[Effect] = []
        for leader in leaders:
            parts = set(leader.site.targets)
            near = [e for e in self._effects if _family(e) == _family(leader) and parts & set(e.site.targets)]
            near.sort(key=lambda e: (e.site.name != leader.site.name, e.name != leader.name))
            found += [e for e in near if e is not leader][:_AKIN]
        return list({id(e): e for e in found}.values())

    def _compared_with_akin(self, starts: Sequence[Start], base: Fit, leading: int, stage: str) -> list[Fit]:
        """The ``starts`` compared, then what is akin to so many that are ``leading`` by then, all of them in order."""
        found = self._compared(starts, base, stage)
        known = {id(effect) for effect, _, _ in starts}
        present = {e.key for e in base.hypothesis.effects}
        akin = self._akin([f.hypothesis.effects[-1] for f in found[:leading]])
        new = [e for e in akin if id(e) not in known and e.key not in present]
        found += self._compared([(e, np.array(x), base.z) for e in new for x in e.starts()], base, stage)
        return sorted(found, key=lambda f: f.cost)

    def _compared(self, starts: Sequence[Start], base: Fit, stage: str) -> list[Fit]:
        """``base`` with each effect from the better of its starts, as far as a few steps of a fit take it; leaders on.

        And from halfway back to nominal numbers, where the base's are far off: they hide what they made up for, and no
        slope leads back. By the sensitivities about the nominal numbers or about the base's, whichever are nearer.
        """
        fitter = self._fitter
        assert fitter.nominal is not None
        chosen = informative_windows(fitter, fitter.nominal, COMPARED)
        select = chosen if len(chosen) < len(fitter.windows) else None

        def fitted(hypothesis: Hypothesis, x: Array, z: Array, known: Array) -> Fit:
            with fitter.sensitivities_kept():
                if np.linalg.norm(z) < np.linalg.norm(z - base.z):
                    fitter.jacobian = fitter.nominal_jacobian
                return fitter.fit(hypothesis, x, z, _GLIMPSE, known, select=select, roughly=True)

        half = _HALFWAY * base.z
        if base.prior > _FAR_OFF:
            own_starts = {(id(e), tuple(x)): (e, x, half) for e, x, _ in starts}
            starts = [*starts, *own_starts.values()]
        best: dict[tuple[int, bool], tuple[float, tuple[Hypothesis, Array, Array, Array]]] = {}
        for i, (effect, own, z) in enumerate(starts):
            self._say(stage, 0.2 * i / len(starts))
            hypothesis, x = base.hypothesis.with_effect(effect), np.concatenate([base.x, own])
            residual = fitter.replay(hypothesis, [(x, z)], select)[0]
            cost, which = fitter.cost(residual, z, select), (id(effect), z is half)
            if which not in best or cost < best[which][0]:
                best[which] = cost, (hypothesis, x, z, residual)
        begun = []
        for i, (_, start) in enumerate(best.values()):
            self._say(stage, 0.2 + 0.6 * i / len(best))
            begun.append(fitted(*start))
        begun.sort(key=lambda f: -f.cost)
        fits = sorted({f.hypothesis.key: f for f in begun}.values(), key=lambda f: f.cost)
        leaders = fits[: max(round(_SECOND * len(fits)), self._effort.survivors)]
        further = []
        for i, fit in enumerate(leaders):
            self._say(stage, 0.8 + 0.2 * i / len(leaders))
            known = fit.residual if select is None else fit.residual[select]
            further.append(fitted(fit.hypothesis, fit.x, fit.z, known))
        return sorted(further, key=lambda f: f.cost)

    def _screened(self, fit: Fit, span: tuple[float, float]) -> list[Screened]:
        low, high = span
        return screen(
            self._fitter,
            fit,
            self._effects,
            lambda share: self._say("screen", low + (high - low) * share),
            self._effort.hopeful,
            thorough=self._effort.twice,
            windows=COMPARED if self._effort.twice else WINDOWS,
            glance=self._glance,
        )


def _family(effect: Effect) -> str:
    """Effects of one family act on the same kind of part: friction on joints, gains on servos."""
    return type(effect).__module__


def _foremost(screened: Sequence[Screened], count: int) -> list[Screened]:
    """So many of those that were screened, the best first, and the best of each kind of effect."""
    kinds = {s.effect.name: s for s in reversed(screened)}
    first = list(screened[:count])
    return [*first, *(s for s in kinds.values() if not any(s is f for f in first))]
