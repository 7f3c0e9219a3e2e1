"""The cells of the feet, one file a kind, and the list of all kinds."""

from __future__ import annotations

from pydantic import model_validator

from nermo_description.parameters import Parameters
from nermo_sensors.cells.cell import CellParameters
from nermo_sensors.cells.piezoelectric import PiezoelectricParameters
from nermo_sensors.cells.piezoresistive import PiezoresistiveParameters


class Cells(Parameters):
    """The cells of a foot: every kind that there is, of which a robot has those that its file says. In their order."""

    piezoresistive: PiezoresistiveParameters | None = None
    piezoelectric: PiezoelectricParameters | None = None

    @model_validator(mode="after")
    def _some(self) -> Cells:
        if not self.present:
            raise ValueError(f"there is none; known are {', '.join(type(self).model_fields)}")
        return self

    @property
    def present(self) -> dict[str, CellParameters]:
        """Those that the robot has, by name."""
        cells = {name: getattr(self, name) for name in type(self).model_fields}
        return {name: cell for name, cell in cells.items() if cell is not None}
