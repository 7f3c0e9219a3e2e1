"""Who leads, and who could not be told from it: fitted to their ends before they are compared."""

from __future__ import annotations

from collections import Counter

import numpy as np

from simgap.inference.candidates import HOPELESS, Candidates, by_score
from simgap.inference.effort import Effort
from simgap.inference.model_selection import ENOUGH, FINALISTS, indistinct, simplest
from simgap.inference.scores import Scored, Scores
from simgap.inference.selection import Selection

_EXCHANGED = 3
"""The first so many begin from the same nominal numbers."""
_KINDS = 6
"""And of so many kinds of effects the best one."""
_SETTLED_TOO = 2.0 * HOPELESS
"""[nats] So far behind the winner they go through the last fit as well."""


class Leaders:
    """Takes leaders further, on one recording.

    Where feet land, ends of fits are a matter of chance (``effort.twice``), and who is near has the same chances.
    """

    def __init__(self, candidates: Candidates, scores: Scores, effort: Effort, sites: Counter[str]) -> None:
        self._candidates, self._scores, self._effort, self._sites = candidates, scores, effort, sites
        self._fitter = candidates.fitter

    def followed(self, scored: list[Scored], winner: Scored, without: Scored) -> tuple[list[Scored], Scored]:
        """Those that cannot be told from the best fitted to the end, best first; and which of them wins then."""
        close = scored[0].score + indistinct(without.score - scored[0].score)
        tied = [i < FINALISTS and (s.score < close or s is winner) for i, s in enumerate(scored)]
        again = sorted(
            (self._candidates.to_the_end(s) if t else s for s, t in zip(scored, tied, strict=True)), key=by_score
        )
        if self._effort.twice:
            again = self._exchanged(again, without)
        chosen = simplest(self._scores, again, without, self._sites)
        assert chosen is not None
        return again, chosen

    def _exchanged(self, scored: list[Scored], without: Scored) -> list[Scored]:
        """The first few, and the best of each kind, begun from the leader's nominal numbers too; best first.

        Numbers that are fitted about one effect are open to all. Beside its own a mouse's soft ankles had stopped 200
        nats behind a shifted COM, of whose kind they are not; beside the COM's they ended 64 in front.
        """
        kinds = {s.fit.hypothesis.effects[0].name: s for s in reversed(scored)}
        chosen = {s.key for s in (*scored[:_EXCHANGED], *sorted(kinds.values(), key=by_score)[:_KINDS])}
        first, *others = scored
        reach = self._candidates.hopeless(without, first)
        begun = [self._candidates.begun_from(s, first, reach) if s.key in chosen else s for s in others]
        return sorted([first, *begun], key=by_score)

    def ended(self, scored: list[Scored], winner: Scored, without: Scored) -> tuple[list[Scored], Scored]:
        """The winner begun anew, and so who could not be told from it before that; and who wins then.

        Where ends are a matter of chance, more beginnings find a better one, whoever is right. And what a winner finds
        there is as open to who stood beside it: they begin from its numbers too.
        """
        if not self._effort.twice:
            return scored, self.restarted(winner)
        others = [s for s in scored if s.key != winner.key]
        close = indistinct(without.score - winner.score)
        near = [min(s.score - winner.score, s.fit.cost - winner.fit.cost) < close for s in others[: _EXCHANGED - 1]]
        winner = self.restarted(winner)
        reach = self._candidates.hopeless(without, winner)
        begun = [self._candidates.begun_from(s, winner, reach) if n else s for s, n in zip(others, near, strict=False)]
        others = [self.restarted(s) if n else s for s, n in zip(begun, near, strict=True)] + others[len(near) :]
        ended = sorted([winner, *others], key=by_score)
        return ended, simplest(self._scores, ended, without, self._sites) or winner

    def restarted(self, scored: Scored) -> Scored:
        """A winner that leaves much, begun anew from values about its own."""
        return self._candidates.restarted(scored) if self._scores.typical(scored.fit.held) > ENOUGH else scored

    def settle(self, result: Selection, hurried: bool) -> None:
        """Fit the winner once more with all nuisance sensitivities its own: its intervals rest on them.

        Where ends are a matter of chance that may take it much further, so the first few go as far before they are
        compared, however far behind: 30 nats became 3 on a mouse. Not where the time is over (``hurried``).
        """
        old = result.best
        near = [r for r in result.rivals if r.key != old.key][: _EXCHANGED - 1]
        near = [r for r in near if r.score < old.score + _SETTLED_TOO]
        if hurried or not self._effort.twice:
            near = []
        best, *settled = (self._settled(s) for s in (old, *near))
        ahead = [self._scores.difference(best.fit, s.fit)[0] for s in settled]
        if max(ahead, default=0.0) > 0.0:
            leader = settled[int(np.argmax(ahead))]
            settled, best = [best, *(s for s in settled if s is not leader)], leader
            if len(best.fit.hypothesis.effects) == 1:
                result.gains = [self._scores.difference(result.reference.fit, best.fit)]
        left = [r for r in result.rivals if r is not old and r not in near]
        result.best, result.rivals = best, sorted([best, *settled, *left], key=by_score)

    def _settled(self, scored: Scored) -> Scored:
        begun = self._candidates.told_apart(scored).fit
        # Where the time ended after starts were judged anew, what the fit remembers is judged as before.
        residual = self._fitter.replay(begun.hypothesis, [(begun.x, begun.z)])[0]
        self._fitter.refresh(begun.hypothesis, begun.x, begun.z, residual)
        fit = self._fitter.fit(begun.hypothesis, begun.x, begun.z, known=residual)
        fit = self._fitter.cross_validate(fit)
        fit.covariance = self._fitter.covariance(fit, thorough=True)
        return self._scores.scored(fit)
