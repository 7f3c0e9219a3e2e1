"""Effects of the sensors: what is recorded is not what happened."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from simgap.data.plant import Plant
from simgap.effects.base import Context, Effect, Parameter, Site, amount, ratio
from simgap.simulation.variant import Variant

ALL_RATES = "all:velocity"
"""Site of all sensors of joints' speeds: servos of one kind report them alike."""


def rate_outputs(plant: Plant) -> list[int]:
    """Outputs that are the speed of a joint."""
    return [i for i, channel in enumerate(plant.outputs) if channel.dof >= 0]


def sensor_sites(plant: Plant) -> list[Site]:
    """One site for each output: `name[:quantity][:component]`.

    The name is that of the sensor, or of the joint, body, site or tendon that the map names in its place; then a
    quantity that is not its position follows, and the component of one that has several.
    """
    sites: dict[str, Site] = {}
    for i, channel in enumerate(plant.outputs):
        name = channel.sensor
        if name.startswith("gap:"):
            _, _, name, quantity = name.split(":", 3)
            name += "" if quantity == "position" else f":{quantity}"
        name += f":{channel.part}" if channel.part else ""
        if name in sites:
            name = f"{name}:{channel.column}"
        sites[name] = Site(name, (i,))
    return list(sites.values())


class SensorBias(Effect):
    """The sensor adds a constant."""

    name = "sensor_bias"

    @classmethod
    def candidates(cls, context: Context) -> Iterable[Effect]:
        for site in sensor_sites(context.plant):
            size = 0.1 * float(context.scales.output_rms[site.targets[0]])
            unit = context.plant.outputs[site.targets[0]].unit
            if size > 0:
                yield cls(site, [amount("bias", unit, size, (-1.0, -0.3, 0.3, 1.0), low=-20.0)])

    def apply(self, variant: Variant, values: Sequence[float]) -> None:
        variant.outputs.bias[list(self.site.targets)] += values[0]


class SensorScale(Effect):
    """The sensor's scale is wrong by a factor."""

    name = "sensor_scale"

    @classmethod
    def candidates(cls, context: Context) -> Iterable[Effect]:
        for site in sensor_sites(context.plant):
            yield cls(site, [ratio(tries=(0.75, 0.92, 1.08, 1.3))])

    def apply(self, variant: Variant, values: Sequence[float]) -> None:
        variant.outputs.scale[list(self.site.targets)] *= values[0]


class SensorDelay(Effect):
    """The sensor's value is old when it is recorded: late by a constant time, or filtered (first order)."""

    name = "sensor_delay"

    @classmethod
    def candidates(cls, context: Context) -> Iterable[Effect]:
        rates = rate_outputs(context.plant)
        together = [Site(ALL_RATES, tuple(rates))] if len(rates) > 1 else []
        for site in [*sensor_sites(context.plant), *together]:
            for form in ("late", "filtered"):
                yield cls(site, [Parameter("delay", "s", 0.0, 0.0, 0.12, (0.006, 0.02, 0.05), 0.01)], form)

    def apply(self, variant: Variant, values: Sequence[float]) -> None:
        path = variant.outputs.lag if self.form == "filtered" else variant.outputs.delay
        path[list(self.site.targets)] += values[0]


class SensorSaturation(Effect):
    """The sensor reads no more than a limit."""

    name = "sensor_saturation"

    @classmethod
    def candidates(cls, context: Context) -> Iterable[Effect]:
        for site in sensor_sites(context.plant):
            top = float(context.scales.output_extreme[site.targets[0]])
            unit = context.plant.outputs[site.targets[0]].unit
            if top > 0:
                yield cls(
                    site, [Parameter("limit", unit, 2.0 * top, 0.3 * top, 2.0 * top, (top, 0.9 * top), 0.1 * top)]
                )

    def apply(self, variant: Variant, values: Sequence[float]) -> None:
        targets = list(self.site.targets)
        variant.outputs.limit[targets] = np.minimum(variant.outputs.limit[targets], values[0])


class SensorMisalignment(Effect):
    """A sensor of three axes is mounted askew, by a small rotation about x, y and z."""

    name = "sensor_misalignment"

    @classmethod
    def candidates(cls, context: Context) -> Iterable[Effect]:
        axes: dict[str, dict[int, int]] = {}
        for i, channel in enumerate(context.plant.outputs):
            if channel.quantity in ("angular_velocity", "acceleration", "force", "velocity") and channel.dof < 0:
                axes.setdefault(channel.sensor, {})[channel.component] = i
        for name, found in axes.items():
            if set(found) == {0, 1, 2}:
                site = Site(name, (found[0], found[1], found[2]))
                yield cls(site, [amount(a, "rad", 0.1, (0.5,), low=-8.0, high=8.0) for a in ("x", "y", "z")])

    def starts(self) -> list[tuple[float, ...]]:
        return [tuple(s * 0.1 * (i == k) for i in range(3)) for k in range(3) for s in (-1.0, 1.0)]

    def apply(self, variant: Variant, values: Sequence[float]) -> None:
        x, y, z = values
        skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        angle = float(np.linalg.norm(values))
        turn = np.eye(3)
        if angle > 0:
            turn = turn + np.sin(angle) / angle * skew + (1 - np.cos(angle)) / angle**2 * skew @ skew
        a, b, c = self.site.targets
        variant.outputs.turns = (*variant.outputs.turns, ((a, b, c), turn))
