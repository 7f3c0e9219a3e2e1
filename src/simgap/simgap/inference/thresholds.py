"""The ten numbers that decide a verdict, each with its origin.

They judge what was fitted. What is fitted at all is the search's matter, which has prices of its own
(`model_selection.py`): it may miss a hypothesis, it judges none.
"""

from __future__ import annotations

from simgap.inference.calibrated import calibrated

TAIL = 4.0
"""Degrees of freedom nu of windows about their channel's scale: the usual choice of robust regression (Lange, Little,
Taylor 1989), under which a window that is far off counts less than its square but never nothing."""
LAW_ERROR = calibrated().law_error
"""Share of an effect's own gain by which another law may fit better by chance of its form (`calibrated.yaml`)."""
SPARSITY = calibrated().sparsity
"""How much the number, kinds and places of effects count: 1 where all kinds are equally likely, each wherever it can
act (`calibrated.yaml`)."""
SURE = 0.9
"""Probability from which a hypothesis stands alone: a user's setting by nature."""
MOST = 0.5
"""Share of the gap that named causes must explain to be a good part of the answer: more than all the rest."""
REST = 0.15
"""Causes that leave a typical window with more than UNEXPLAINED have explained the gap where they leave no more than
this share of what nominal numbers leave. And another effect hides in nominal numbers at the end of what their priors
allow where letting them go further is worth this share of what the effect that was found is worth. Sealed sets."""
REMAINS = 1.6
"""[noise floors] A typical window that is left with more is no case of no gap, whatever it looks like. In the blind set
79341278 healthy robots leave 1.24 at most there, slipping feet that nothing explained 1.7."""
REMAINS_CHANNEL = 2.5
"""[noise floors] Nor is a channel that is left with so many over all windows: healthy robots of the blind sets 79341278
and 27027990 leave 2.2 at most (58 of them), a drag at one joint of a quadruped that nothing explained 4.0."""
UNEXPLAINED = 2.0
"""[noise floors] Causes that leave a typical window with no more have explained it. And a typical window that depends
by more on where a joint is guessed to begin proves no effect: a double pendulum whose elbow's angle is not recorded has
98, a mouse whose servos and spine are not 1e-7."""
MUCH = 7.0
"""[noise floors] All windows together that are left with more are no case of no gap, though it be few of them; nor is a
typical one explained, however small a share of a large gap that is."""
