"""What N claims in chapter 6, row by row beside ours.

`summary` gives the rows {claim, kind, topic, half, thesis, ours, ratio, band, within}; `score` counts them.
"""

from nermo_sim.experiments.claims.board import Claims, score
from nermo_sim.experiments.claims.comparison import comparison
from nermo_sim.experiments.claims.summary import summary

__all__ = ["Claims", "comparison", "score", "summary"]
