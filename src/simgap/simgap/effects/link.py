"""Effects of the link between controller and robot, and of the clocks at its two ends."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Sequence

from simgap.effects.base import Context, Effect, Parameter, Site
from simgap.simulation.lateness import Lateness
from simgap.simulation.variant import Variant


def _commands(context: Context) -> list[int]:
    """Input channels that come over the link."""
    return [i for i, c in enumerate(context.plant.inputs) if not c.measured]


class LinkLatency(Effect):
    """Every command arrives late by the same time."""

    name = "link_latency"

    @property
    def aliases(self) -> tuple[str, ...]:
        """A delay of all servos is the same."""
        return ("servo_delay@all",)

    @classmethod
    def candidates(cls, context: Context) -> Iterable[Effect]:
        channels = _commands(context)
        # With one actuator the delay is called the servo's.
        if len({context.plant.inputs[i].actuator for i in channels}) > 1:
            yield cls(Site("all", tuple(channels)), [Parameter("delay", "s", 0.0, 0.0, 0.2, (0.006, 0.02, 0.06), 0.01)])

    def apply(self, variant: Variant, values: Sequence[float]) -> None:
        variant.inputs.delay[list(self.site.targets)] += values[0]


class Late(Effect):
    """Which command acts is a matter of chance: replayed is the one that acts on average, the rest is `Chance`'s."""

    _update: tuple[float, ...] = ()
    """[s] between two updates of each command."""

    @classmethod
    def _at_all(cls, context: Context, parameter: Parameter) -> Iterable[Effect]:
        if channels := _commands(context):
            effect = cls(Site("all", tuple(channels)), [parameter])
            effect._update = tuple(float(context.scales.input_update[i]) for i in channels)
            yield effect

    @abstractmethod
    def law(self, value: float) -> Lateness:
        """The lateness of the link's commands at a value of the parameter."""

    def lag(self, period: float) -> int:
        """Rows between two updates, on a grid of ``period`` [s]."""
        return max(round(min(self._update) / period), 1)


class LinkJitter(Late):
    """Commands come late by times that differ from one to the next, ``spread`` on average; none undoes a newer one."""

    name = "link_jitter"

    @classmethod
    def candidates(cls, context: Context) -> Iterable[Effect]:
        return cls._at_all(context, Parameter("spread", "s", 0.0, 0.0, 0.4, (0.01, 0.04, 0.12), 0.02))

    def apply(self, variant: Variant, values: Sequence[float]) -> None:
        channels = list(self.site.targets)
        variant.inputs.jitter[channels], variant.inputs.update[channels] = values[0], self._update

    def law(self, value: float) -> Lateness:
        return Lateness(0.0, value / min(self._update))


class LinkLoss(Late):
    """Some commands never arrive, and the one before acts on."""

    name = "link_loss"

    @classmethod
    def candidates(cls, context: Context) -> Iterable[Effect]:
        # One that loses nine of ten is noticed by whoever looks at its log; what asks for more is something else.
        return cls._at_all(context, Parameter("share", "1", 0.0, 0.0, 0.9, (0.3, 0.6, 0.85), 0.1))

    def apply(self, variant: Variant, values: Sequence[float]) -> None:
        channels = list(self.site.targets)
        variant.inputs.loss[channels], variant.inputs.update[channels] = values[0], self._update

    def law(self, value: float) -> Lateness:
        return Lateness(value, 0.0)


class ClockOffset(Effect):
    """The clocks of inputs and outputs differ: what was told or measured as input has too late a stamp.

    For commands only this direction is told from a delay; for measured inputs, which act at once, both are.
    """

    name = "clock_offset"

    @classmethod
    def candidates(cls, context: Context) -> Iterable[Effect]:
        inputs = context.plant.inputs
        exact = all(c.measured or c.actuator < 0 for c in inputs)
        tries, high = ((-0.04, -0.012, 0.012, 0.04), 0.2) if exact else ((-0.04, -0.012), 0.0)
        yield cls(Site("inputs", tuple(range(len(inputs)))), [Parameter("offset", "s", 0.0, -0.2, high, tries, 0.01)])

    def apply(self, variant: Variant, values: Sequence[float]) -> None:
        variant.inputs.delay += values[0]
