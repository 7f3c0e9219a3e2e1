"""A start for laws with several parameters that fits by sensitivities do not find: how a stop bounces, for one."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from simgap.inference.fit import Fitter
from simgap.inference.hypothesis import Hypothesis

Array = NDArray[np.float64]


def simplex_search(fitter: Fitter, hypothesis: Hypothesis, which: int, x: Array, z: Array, most: int) -> Array:
    """Parameters of a hypothesis of whose effect number ``which`` the last ones are not in ``x``.

    All of that effect are sought by true replays, with a simplex of ``most`` of them, from the best combination of the
    tries of the new ones; what belongs to other effects and the nuisances ``z`` stay.
    """
    own = hypothesis.effects[which].parameters
    further = own[len(own) - (hypothesis.size - len(x)) :]
    first = Hypothesis(hypothesis.effects[:which]).size
    at = slice(first, first + len(own))
    tried = [np.insert(x, at.stop - len(further), t) for t in product(*(p.tries for p in further))]
    costs = fitter.data_cost(fitter.mean_square(fitter.replay(hypothesis, [(point, z) for point in tried])))
    start = tried[int(np.argmin(costs))]
    scale = np.array([p.scale for p in own])

    def cost(values: Array) -> float:
        point = start.copy()
        point[at] = values * scale
        return float(fitter.data_cost(fitter.mean_square(fitter.replay(hypothesis, [(point, z)])[0])))

    bounds = [(p.low / p.scale, p.high / p.scale) for p in own]
    options = {"maxfev": most, "xatol": 1e-3, "fatol": 0.1}
    found = minimize(cost, start[at] / scale, method="Nelder-Mead", bounds=bounds, options=options)
    start[at] = found.x * scale
    return start
