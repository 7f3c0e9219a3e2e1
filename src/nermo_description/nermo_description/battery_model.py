"""The battery of the mouse: a two-cell lithium-polymer pack, as N tables 4.1 and A.3 list it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class BatteryModel:
    """What the pack is. Voltages are those of any two-cell pack; N gives the nominal voltage and the capacity."""

    capacity: float = 0.5
    """[A h]: 500 mAh in Nermo-Lite, 1000 mAh in Nermo."""
    full: float = 8.4
    """Open-circuit voltage when full [V]."""
    empty: float = 6.6
    """Open-circuit voltage when empty [V]; 7.4 V is the nominal voltage between the two."""
    resistance: float = 0.1
    """[ohm]"""
    idle_power: float = 1.0
    """Microcontroller and radio [W]; assumed."""
    efficiency: float = 0.5
    """Of a small geared servo, electrical to mechanical; assumed."""


class Battery:
    """State of charge over time."""

    def __init__(self, model: BatteryModel | None = None) -> None:
        self.model = model or BatteryModel()
        self.charge = 1.0
        """Share of the capacity left, [0, 1]."""
        self.current = 0.0
        """Drawn now [A]."""

    @property
    def voltage(self) -> float:
        """At the terminals [V]."""
        model = self.model
        return model.empty + self.charge * (model.full - model.empty) - self.current * model.resistance

    def draw(self, mechanical_power: float, duration: float) -> None:
        """Feeds servos of a mechanical power [W] for a while [s]."""
        power = self.model.idle_power + max(mechanical_power, 0.0) / self.model.efficiency
        self.current = power / self.voltage
        self.charge = max(0.0, self.charge - self.current * duration / (3600.0 * self.model.capacity))
