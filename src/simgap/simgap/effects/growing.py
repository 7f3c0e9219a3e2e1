"""An effect that grows with time: servos that drift, joints that tire."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from simgap.effects.base import Context, Effect, Parameter
from simgap.simulation.variant import Variant

MIN_DURATION = 25.0
"""[s] A shorter recording does not show growth."""


class Growing(Effect):
    """Another effect whose one parameter changes in a straight line over the recording.

    Its first parameter is that of the effect in the middle of the recording, the second its growth per second.
    """

    grows = True

    def __init__(self, inner: Effect, duration: float) -> None:
        (parameter,) = inner.parameters
        reach = (parameter.high - parameter.low) / duration
        scale = 2.0 * parameter.scale / duration
        growth = Parameter("growth", f"{parameter.unit}/s", 0.0, -reach, reach, (scale,), scale)
        super().__init__(inner.site, (parameter, growth), " ".join(filter(None, [inner.form, "growing"])))
        self.name, self._inner = inner.name, inner

    @property
    def aliases(self) -> tuple[str, ...]:
        """Those of the effect that grows."""
        return self._inner.aliases

    @classmethod
    def candidates(cls, context: Context) -> Iterable[Effect]:
        """None: growth is tried on what has been found."""
        return ()

    def apply(self, variant: Variant, values: Sequence[float]) -> None:
        parameter = self._inner.parameters[0]
        now = np.clip(values[0] + values[1] * variant.moment, parameter.low, parameter.high)
        self._inner.apply(variant, (float(now),))
