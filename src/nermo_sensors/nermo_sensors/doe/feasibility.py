"""Is a piezoresistive cell good enough for a given foot (C 4.2.3)?"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from nermo_sensors.doe.screening import RESPONSES, THESIS_TERMS, AdditiveModel, CellDesign, analyse, load_table
from nermo_sensors.models.amplifier import NonInvertingAmplifier

REQUIRED_FORCE_N = 20.0
"""Upper end of the range that the sensor must cover (C table 4.1)."""


@dataclass(frozen=True, slots=True)
class Feasibility:
    """What the additive models predict for one cell and its amplifier."""

    sensitivity_s_per_n: float
    base_conductance_s: float
    saturation_force_n: float
    unloaded_resistance_ohm: float
    saturated_resistance_ohm: float
    unloaded_voltage_v: float
    saturated_voltage_v: float

    @property
    def covers_required_force(self) -> bool:
        """Whether the cell saturates above the 20 N that table 4.1 asks for."""
        return self.saturation_force_n >= REQUIRED_FORCE_N


_VELOSTAT = 0.1e-3, 1000.0
_COPPER = 0.035e-3, 8960.0
"""Usual thickness [m] and density [kg/m^3] of a sheet of each; C gives none."""


def cell_weight_g(cell: CellDesign) -> float:
    """Weight of the Velostat and of two electrodes that cover all of it [g]: an upper bound, without the glue."""
    area = cell.length_mm * cell.width_mm * 1e-6
    return 1e3 * area * (cell.layers * _VELOSTAT[0] * _VELOSTAT[1] + 2.0 * _COPPER[0] * _COPPER[1])


def thesis_models() -> dict[str, AdditiveModel]:
    """The three models of table 4.5, refitted from table 4.4 with the terms that C keeps."""
    table = load_table()
    return {response: analyse(table, response, THESIS_TERMS[response]) for response in RESPONSES}


def assess(cell: CellDesign, amplifier: NonInvertingAmplifier, models: Mapping[str, AdditiveModel]) -> Feasibility:
    """Predicted response of a cell with this amplifier.

    Raises:
        ValueError: the models predict a conductance that is not positive, so there is no such cell.
    """
    sensitivity, base, saturation = (models[response].predict(cell) for response in RESPONSES)
    saturated = base + sensitivity * saturation
    if base <= 0 or saturated <= 0:
        raise ValueError(f"cell: the models predict a conductance of {base:.3g} S, which is not above 0")
    return Feasibility(
        sensitivity_s_per_n=sensitivity,
        base_conductance_s=base,
        saturation_force_n=saturation,
        unloaded_resistance_ohm=1 / base,
        saturated_resistance_ohm=1 / saturated,
        unloaded_voltage_v=amplifier.voltage(base),
        saturated_voltage_v=amplifier.voltage(saturated),
    )
