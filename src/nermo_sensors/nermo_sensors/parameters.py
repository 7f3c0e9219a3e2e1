"""Parameters of a tactile foot, one YAML file a robot: its cells, their calibration, the filters' covariances."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import Field

from nermo_description.parameter_files import ParameterError, merged, read_yaml, validate
from nermo_description.parameters import Finite, NonNegative, Parameters, Positive
from nermo_sensors.cells import Cells
from nermo_sensors.cells.cell import CellParameters

__all__ = ["ParameterError", "load_tactile", "tactile_names"]

Negative = Annotated[float, Field(lt=0, allow_inf_nan=False)]
Variance = Annotated[float, Field(gt=0, le=1e12, allow_inf_nan=False)]

Cell = TypeVar("Cell", bound=CellParameters)

_FOLDER = Path(str(files("nermo_sensors"))) / "parameters"
_DEFAULT = "nermo_lite"


class SigmoidParameters(Parameters):
    """a, b, c, d of (4.20)."""

    a: Finite
    b: Finite
    c: Finite
    d: Finite


class PairCalibration(Parameters):
    """(4.21), for F1 and F2."""

    rising: SigmoidParameters
    falling: SigmoidParameters
    switch: Negative
    """[s/N]"""


class MemoryCalibration(Parameters):
    """The piezoresistive cell with its memory, for the memory filter; symbols as in `cells`."""

    sensitivity: Positive
    base_conductance: Finite
    saturation_force: Positive
    rounding: Positive
    hysteresis_width: NonNegative
    """Half of the loop's width [N]."""
    reversal_force: Positive
    """[N]"""
    creep_gain: NonNegative
    """[1/N]"""
    creep_time: Positive
    """[s]"""
    feedback_resistance: Positive
    reference_voltage: Positive


class RateCalibration(Parameters):
    """For F1."""

    gain: Finite
    offset: Finite = 0.0


class RateAccelerationCalibration(Parameters):
    """For F2, and for the memory filter where it fits better."""

    rate_gain: Finite
    rate_decay: Positive
    acceleration_gain: Finite
    acceleration_decay: Positive
    offset: Finite = 0.0


class ChargeCalibration(Parameters):
    """For the memory filter."""

    gain: Finite
    leak: Positive
    lag: Finite = 0.0
    offset: Finite = 0.0


class Calibration(Parameters):
    """What `nermo sensors fit` found."""

    pair: PairCalibration
    memory: MemoryCalibration
    rate: RateCalibration
    rate_acceleration: RateAccelerationCalibration
    charge: ChargeCalibration
    law: Literal["charge", "rate_acceleration"]
    """The law of the piezoelectric cell that fits better, and that the memory filter uses."""


class RateNoise(Parameters):
    """Covariances of F1: process variances a second, and those of the two readings."""

    force: Variance
    """[N^2/s]"""
    rate: Variance
    """[(N/s)^2/s]"""
    bias: Variance
    """[V^2/s]"""
    piezoresistive: Variance
    """[V^2]"""
    piezoelectric: Variance
    """[V^2]"""


class AccelerationNoise(RateNoise):
    """Covariances of F2."""

    acceleration: Variance
    """[(N/s^2)^2/s]"""
    frequency: Variance
    """[(rad/s)^2/s]"""
    frequency_reading: Variance
    """[(rad/s)^2]"""


class MemoryNoise(Parameters):
    """Covariances of the memory filter."""

    rate: Variance
    """[(N/s)^2/s]"""
    acceleration: Variance
    """[(N/s^2)^2/s]"""
    hysteresis: Variance
    """Of the place of each of its plays over the play's slack [1/s]."""
    creep: Variance
    """[1/s]"""
    load_error: Variance
    """What the model of the piezoresistive cell gets wrong, lasting for `load_error_time` [N^2]."""
    load_error_time: Annotated[float, Field(gt=0, le=1e4)]
    """[s]"""
    bias: Variance
    """What the model of the piezoelectric cell gets wrong, lasting for `bias_time` [V^2]."""
    bias_time: Annotated[float, Field(gt=0, le=1e4)]
    """[s]"""
    piezoresistive: Variance
    """[V^2]"""
    piezoelectric: Variance
    """[V^2]"""


class Noises(Parameters):
    """What `nermo sensors tune` chose."""

    f1: RateNoise
    f2: AccelerationNoise
    memory: MemoryNoise


class TactileParameters(Parameters):
    """Everything about the tactile feet of one robot."""

    name: str
    sampling_frequency: Positive
    """[Hz], of the readings that the filters get."""
    cells: Cells
    contact_force: Positive
    """A foot is in contact above this load [N]."""
    calibration: Calibration
    """Of C's two cells, whose memory the filters carry in their states; any other cell has its numbers in its entry."""
    noises: Noises

    def cell(self, kind: type[Cell]) -> Cell:
        """The foot's cell of a kind. Raises ParameterError where it has none."""
        for cell in self.cells.present.values():
            if isinstance(cell, kind):
                return cell
        raise ParameterError(
            f"feet {self.name!r} have no {kind.__name__.removesuffix('Parameters').lower()} cell, which this needs; "
            f"they have {', '.join(self.cells.present)}"
        )


def tactile_names() -> tuple[str, ...]:
    """Feet that come with the package."""
    return tuple(sorted(path.stem for path in _FOLDER.glob("*.yaml")))


def load_tactile(name_or_path: str | Path) -> TactileParameters:
    """Parameters of a robot's feet, by the robot's name or from a YAML file. Raises ParameterError."""
    path = Path(name_or_path)
    if path.suffix not in (".yaml", ".yml"):
        if str(name_or_path) not in tactile_names():
            raise ParameterError(
                f"tactile feet of {str(name_or_path)!r} are unknown; known are {', '.join(tactile_names())}, "
                "or give a .yaml file"
            )
        path = _FOLDER / f"{name_or_path}.yaml"
    return validate(_with_base(read_yaml(path), path), path, TactileParameters)


def tactile_of_robot(robot: str) -> TactileParameters:
    """Parameters for a robot by its name; one without a file of its own has the feet of nermo_lite."""
    return load_tactile(robot if robot in tactile_names() else _DEFAULT)


def _with_base(data: Any, path: Path) -> Any:
    if not isinstance(data, dict) or "base" not in data:
        return data
    if data["base"] not in tactile_names() or data["base"] == path.stem:
        raise ParameterError(f"{path}: base: is {data['base']!r}; it must be one of {', '.join(tactile_names())}")
    own = {field: value for field, value in data.items() if field != "base"}
    return merged(read_yaml(_FOLDER / f"{data['base']}.yaml"), own)
