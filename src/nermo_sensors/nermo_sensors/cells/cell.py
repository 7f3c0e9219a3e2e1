"""What every tactile cell has: its numbers in the foot's file, and an object that reads volts for a force."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Protocol

from pydantic import Field, model_validator

from nermo_description.parameters import Finite, NonNegative, Parameters
from nermo_sensors.models.amplifier import Converter


class Cell(Protocol):
    """One cell of one foot of the twin, with all that it remembers."""

    def read(self, force: float, period: float, frequency: float, temperature: float, offset: float = 0.0) -> float:
        """[V] after `period` [s] in which the force went to `force` [N], at a temperature [degC].

        `frequency` [rad/s] of the load is for laws that depend on it; `offset` [V] is added before the converter.
        """

    def clear(self) -> None:
        """Forgets the past."""


class ConverterParameters(Parameters):
    """Analog to digital converter of one channel."""

    lower: Finite
    """[V]"""
    upper: Finite
    """[V]"""
    bits: Annotated[int, Field(ge=1, le=32)]

    @model_validator(mode="after")
    def _ordered(self) -> ConverterParameters:
        if self.upper <= self.lower:
            raise ValueError(f"upper = {self.upper} V: must be above lower = {self.lower} V")
        return self

    def make(self) -> Converter:
        """The converter."""
        return Converter(self.lower, self.upper, self.bits)


class CellParameters(Parameters):
    """What the file of a foot says of any cell. A new kind is a subclass that `Cells` names (`cells/__init__.py`)."""

    feels_rest: ClassVar[bool] = True
    """Whether it feels a load that rests, and not only its changes."""

    noise: NonNegative
    """Standard deviation of each sample [V]."""
    bias: NonNegative = 0.0
    """Standard deviation of the constant offset, drawn once a run [V]."""
    reference_temperature: Finite = 23.0
    """[degC], where the other numbers hold."""
    converter: ConverterParameters

    def make(self) -> Cell:
        """The cell of one foot of the twin."""
        raise NotImplementedError

    def expected(self, load: Any) -> tuple[Any, Any]:
        """[V] under loads (B,) [N], and by how much it rises with them [V/N]: what the estimator goes by.

        Not asked of the cells that the filters themselves have a model of.
        """
        raise NotImplementedError

    @property
    def variance(self) -> float:
        """Of a reading about what is expected [V^2]."""
        return self.noise**2 + self.bias**2
