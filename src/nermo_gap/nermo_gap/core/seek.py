"""A start for laws with several parameters that fits by sensitivities do not find: how a stop bounces, for one."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from nermo_gap.core.effects.base import Parameter
from nermo_gap.core.fit import Fitter
from nermo_gap.core.hypothesis import Hypothesis

Array = NDArray[np.float64]


def seek(
    fitter: Fitter, hypothesis: Hypothesis, x: Array, z: Array, first: int, further: Sequence[Parameter], most: int
) -> Array:
    """Parameters of a hypothesis whose effect gets ``further`` parameters, by true replays, ``most`` of them.

    ``x`` are the parameters without the further ones, ``first`` says where those of that effect begin; only they are
    sought, with a simplex, from the best of all combinations of the further ones' tries.
    """
    own = next(e for e in hypothesis.effects if e.parameters[-1] is further[-1])
    count = len(own.parameters)
    at = slice(first, first + count)
    tried = np.array([np.insert(x, first + count - len(further), t) for t in product(*(p.tries for p in further))])
    costs = fitter.data_cost(fitter.mean_square(fitter.replay(hypothesis, [(point, z) for point in tried])))
    start = tried[int(np.argmin(costs))]
    scale = np.array([p.scale for p in own.parameters])

    def cost(values: Array) -> float:
        point = start.copy()
        point[at] = values * scale
        return float(fitter.data_cost(fitter.mean_square(fitter.replay(hypothesis, [(point, z)])[0])))

    bounds = [(p.low / p.scale, p.high / p.scale) for p in own.parameters]
    options = {"maxfev": most, "xatol": 1e-3, "fatol": 0.1}
    found = minimize(cost, start[at] / scale, method="Nelder-Mead", bounds=bounds, options=options)
    start[at] = found.x * scale
    return start
