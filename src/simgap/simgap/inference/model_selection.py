"""Which of several fits is preferred: the one-standard-error rule, equals in order, what one effect more must earn."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from simgap.effects.base import Effect
from simgap.effects.link import Late
from simgap.inference.deviations import NORMAL_90, parameter_deviation
from simgap.inference.hypothesis import Fit
from simgap.inference.scores import PER_PARAMETER, Scored, Scores
from simgap.inference.thresholds import MOST

Array = NDArray[np.float64]

EVIDENCE = 4.0
"""An effect must earn this many nats beyond the price of having looked at many candidates (the log of their number)."""
EVIDENCE_MORE = 16.0
"""Any further effect so many: what the first one's law does not get quite right is cheap for some other to take."""
ENOUGH = 1.2
"""[noise floors] With no more left than that in a typical window, and no nominal number at the end of its box, no
further effect is looked for."""
RELEVANT = 0.10
"""An effect must take at least this share of the gap, or MOST of what is left of it above the noise floor (or as much
strain off the priors as EVIDENCE). Healthy robots of the blind set 2511261945 leave up to 1.23 floors, and no effect
takes more than 15 % of what is above 1; soft ankles of a mouse take 70 % of 0.11. Or it takes that share of the error
of stretches that are not put back to the measurement (`Stretches`): of a double pendulum's friction windows show 3 % of
the gap and stretches 57 %, of a late clock, which imitates it, 4 %; in 28 healthy robots no effect takes more than
4 %."""
MORE = 0.3
"""Any further effect must take this share of what the typical window is left with above the noise floor."""
FURTHER = 0.1
"""Or this share of what the first effect earns: as much as two laws may differ by that are told apart with a
probability of 0.9 (`thresholds.LAW_ERROR`). Real robots have several causes, and no law that leaves little."""
_OUT = 3.0
"""Unless it takes so many times what any other effect takes in its place: the misfit of a law has no such favourite."""
BEST_OF_SEVERAL = 3.4
"""Standard deviations by which the best of ten that differ by chance is in front of an eleventh one time in twenty."""
TIE = 0.5
"""[nats] Closer than this, two hypotheses predict the same."""
CLOSE, LEAD = 3.0, 0.1
"""Rivals nearer than so many nats, or than this share of what the winner explains, are not told apart, whatever the
bootstrap says: no effect of a library is quite what a robot has, and the wrong one may bend a little better."""
LAW_LEAD = 0.03
"""A law must explain this much more than its special case: seen with friction that has Stribeck's peak 8 % and more,
with Coulomb's, which the law then only imitates, less than nothing (blind sets 79341278 and 27027990)."""
FINALISTS = 5


def indistinct(gain: float) -> float:
    """How far [nats] behind a winner that gains ``gain`` a rival is not told from it."""
    return max(CLOSE, LEAD * gain)


def _extremities(fit: Fit) -> Array:
    """How far each parameter of a fit is from neutral, in its strongest try."""
    away: Array = np.abs(fit.hypothesis.away(fit.x)) / np.maximum(fit.hypothesis.vector("strong"), 1e-300)
    return away


def _kinds(fit: Fit) -> list[str]:
    return sorted(e.name for e in fit.hypothesis.effects)


def by_chance(fit: Fit) -> bool:
    """Whether an effect of a fit is a matter of chance."""
    return any(isinstance(e, Late) for e in fit.hypothesis.effects)


def special_case(simple: Fit, rich: Fit) -> bool:
    """Whether two fits differ in one effect, at one site, whose law the rich one generalises."""
    one, two = ({e.key: e for e in fit.hypothesis.effects} for fit in (simple, rich))
    lost, gained = set(one) - set(two), set(two) - set(one)
    return len(lost) == len(gained) == 1 and generalises(two[gained.pop()], one[lost.pop()])


def generalises(law: Effect, special: Effect) -> bool:
    """Whether an effect is that of another at the same site, of whose law its own is more general."""
    return law.special_case == special.name and law.site.name == special.site.name


def only_larger_group(small: Fit, large: Fit) -> bool:
    """Whether a fit differs from another in that one effect acts at more parts, at none of which it shows.

    So friction at the elbow is the same answer as friction at all joints, of which the 90 % intervals of all but the
    elbow's reach nothing.
    """
    one, two = ({e.key: e for e in fit.hypothesis.effects} for fit in (small, large))
    lost, gained = set(one) - set(two), set(two) - set(one)
    if not (len(lost) == len(gained) == 1) or not large.covariance.size:
        return False
    part, group = one[lost.pop()], two[gained.pop()]
    parts = group.site.targets
    if part.name != group.name or not set(part.site.targets) < set(parts) or len(group.parameters) != len(parts):
        return False
    position = sum(len(e.parameters) for e in large.hypothesis.effects[: large.hypothesis.effects.index(group)])
    reach = NORMAL_90 * parameter_deviation(large)
    return all(
        abs(float(large.x[number]) - parameter.neutral) <= reach[number]
        for number, (target, parameter) in enumerate(zip(parts, group.parameters, strict=True), position)
        if target not in part.site.targets
    )


def _parts(fit: Fit) -> int:
    """How many parts of the robot or its surroundings (the ground, gravity) the effects of a fit change."""
    return sum(max(len(e.site.targets), 1) for e in fit.hypothesis.effects)


def places(effects: Sequence[Effect]) -> Counter[str]:
    """At how many sites each kind of effect can act."""
    return Counter(name for name, _ in {(e.name, e.site.name) for e in effects})


def surprise(fit: Fit, sites: Counter[str]) -> float:
    """[nats] All kinds of effects are equally likely, each wherever it can act; what is twice as extreme half as much.

    So a cable's friction, of which a robot with one cable has one place, is likelier than friction at just that one of
    four joints which the cable moves; and drag at a knee is, than at the hip six times what a strong one would be.
    """
    kinds = sum(np.log(max(sites[e.name], 1)) for e in fit.hypothesis.effects)
    return float(kinds + np.log(np.maximum(_extremities(fit), 1.0)).sum())


def simplest(scores: Scores, scored: Sequence[Scored], without: Scored, sites: Counter[str]) -> Scored | None:
    """One-standard-error rule: of those within one standard error of the best, the one with fewest parameters.

    And of the same effects at fewer parts, any that cannot be told from it: values for joints that have nothing
    take up what nominal numbers are off, and so seem to earn a little. Of equals the one that is less of a surprise:
    ``sites`` says at how many `places` each kind can act. Likewise the special case of a law before the law, and
    before a link of chance what is late without it: chance has to show (`Chance`).
    """
    if not scored:
        return None
    best = scored[0]
    chosen = best
    for rival in scored[1:FINALISTS]:
        gain = scores.costs(rival.fit) - scores.costs(best.fit)
        simpler = rival.fit.hypothesis.size < chosen.fit.hypothesis.size
        if simpler and gain[0] <= float(gain[1:].std()) + PER_PARAMETER:
            chosen = rival
    close = best.score + indistinct(without.score - best.score)
    for rival in scored[1:FINALISTS]:
        if _kinds(rival.fit) == _kinds(chosen.fit) and _parts(rival.fit) < _parts(chosen.fit):
            chosen = rival if rival.score < close else chosen
    # Names for the same change: the one at fewer parts, or that has to be less extreme.
    for rival in scored[:FINALISTS]:
        same, tie = rival.fit.hypothesis.size == chosen.fit.hypothesis.size, rival.score < chosen.score + TIE
        fewer = _parts(rival.fit) - _parts(chosen.fit)
        milder = _extremities(rival.fit).max(initial=0.0) < 0.7 * _extremities(chosen.fit).max(initial=0.0)
        if tie and ((same and fewer < 0) or (fewer == 0 and milder)):
            chosen = rival
    for rival in scored[:FINALISTS]:
        same = _parts(rival.fit) == _parts(chosen.fit)
        less = surprise(chosen.fit, sites) - surprise(rival.fit, sites)
        if same and less > 0.0 and rival.score < chosen.score + min(less, CLOSE):
            chosen = rival
    lead = max(CLOSE, LAW_LEAD * (without.score - best.score))
    for rival in scored[1:FINALISTS]:
        law = rival.score < chosen.score + lead and special_case(rival.fit, chosen.fit)
        sure = rival.score < chosen.score + CLOSE and by_chance(chosen.fit) and not by_chance(rival.fit)
        if law or sure:
            chosen = rival
    return chosen


def stands_out(without: Fit, with_: Fit, others: Sequence[Scored]) -> bool:
    """Whether one effect more takes far more, in sample, than any other would in its place."""
    mine = {e.key for e in with_.hypothesis.effects}
    rest = [without.cost - o.fit.cost for o in others if {e.key for e in o.fit.hypothesis.effects} != mine]
    return without.cost - with_.cost > _OUT * max([EVIDENCE_MORE, *rest])


def earns(
    scores: Scores,
    without: Scored,
    with_: Scored,
    looked_at: int,
    unrivalled: bool = False,
    first: float = np.inf,
) -> bool:
    """Whether the larger hypothesis is worth having.

    Of one effect more, a good part of what is left above the noise floor is asked, or of what the ``first`` effect
    earned [nats]: nothing is quite as its model says (a friction's law, a servo's), and there is always some effect
    that takes a little of that; not of one that is ``unrivalled``. Of a corrected model every effect is one more.
    """
    several = bool(without.fit.hypothesis.effects) or scores.written > 0.0
    if scores.written > 0.0:
        first = max(scores.written, first) if np.isfinite(first) else scores.written
    gain, low, _ = scores.difference(without.fit, with_.fit)
    if without.fit.likelihood is None and with_.fit.likelihood is None:
        # In sample flatters: what is not earned there is an accident of the folds.
        gain = min(gain, without.fit.cost - with_.fit.cost)
    strain = without.fit.prior - with_.fit.prior
    if several:
        shares = _shares(scores, without, with_)
        relevant = any(less - 1.0 < (1.0 - MORE) * (much - 1.0) for much, less in shares)
        relevant |= gain > FURTHER * first
        # About corrected numbers strain says nothing: they are where a fit ended, and not what anybody drew.
        strained = bool(without.fit.strained) and strain > EVIDENCE and scores.written == 0.0
        relevant |= unrivalled or strained
    else:
        relevant = takes_a_part(scores, without, with_)
    price = float(np.log(max(looked_at, 1)))
    if gain <= max((EVIDENCE_MORE if several else EVIDENCE) + price, BEST_OF_SEVERAL * scores.roughness):
        return False
    # What shows in two pieces of a recording only is left out by many draws of blocks, but no accident of one of them.
    if low <= 0.0 and scores.without_best(without.fit, with_.fit) <= EVIDENCE_MORE + price:
        return False
    return relevant or (not several and _predicts(scores, without.fit, with_.fit))


def takes_a_part(scores: Scores, without: Scored, with_: Scored) -> bool:
    """Whether a first effect takes a part of the gap that is worth a name, windows being what shows it."""
    strain = without.fit.prior - with_.fit.prior
    before, after = (scores.left(s.fit) for s in (without, with_))
    shares = [*_shares(scores, without, with_), (scores.gap(before), scores.gap(after))]
    taken = any(less < (1.0 - RELEVANT) * much for much, less in shares) or strain > EVIDENCE
    return taken or any(less - 1.0 < (1.0 - MOST) * (much - 1.0) for much, less in shares if much > 1.0)


def _shares(scores: Scores, without: Scored, with_: Scored) -> list[tuple[float, float]]:
    """[noise floors] What two fits leave, by two measures of a typical window."""
    before, after = (scores.left(s.fit) for s in (without, with_))
    return [(measure(before), measure(after)) for measure in (scores.typical, scores.overall)]


def _predicts(scores: Scores, without: Fit, with_: Fit) -> bool:
    """Whether what runs on is predicted better by a good part, though windows show little of it."""
    if with_.likelihood is not None or with_.hypothesis.grows:
        return False
    before, after = (scores.free_error(f) for f in (without, with_))
    return after < (1.0 - RELEVANT) * before
