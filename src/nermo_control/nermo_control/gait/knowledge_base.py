"""The gait knowledge-base (k_g, N A.1.4): every number that shapes a gait, in one validated place.

Leg planes: origin at the hip or shoulder axis, x forward, z up. N's own frame has forward at -y, so its neutral stride
position of -0.005 m (table A.7) is +0.005 m here.
"""

from __future__ import annotations

import difflib
import math
import os
import re
from pathlib import Path
from typing import Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from nermo_control.gait.gaits import GAITS, GaitDefinition
from nermo_control.types import TurningStrategy
from nermo_description.parameter_files import ParameterError, read_yaml, validate, write_yaml

MIN_GAIT_FREQUENCY = 0.1
"""Lowest gait frequency that is accepted [Hz]."""
MAX_GAIT_FREQUENCY = 3.0
"""Highest gait frequency that is accepted [Hz]."""

OUR_SETS = Path(__file__).parent / "sets"
"""What comes with the package: N's parameters as printed, and those that `nermo optimize` found."""
_SET_NAME = re.compile(r"[A-Za-z0-9_-]{1,64}")


class _Frozen(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


FootPath = Literal["splines", "locus"]
"""Which curves a foot follows between its control points."""


class LegStride(_Frozen):
    """Shape of the foot path of one leg pair (N table A.7), in the leg plane."""

    swing_amplitude: float = Field(
        0.01, ge=0.0, le=0.03, description="a_sw, height of the swing arc", json_schema_extra={"unit": "m"}
    )
    stance_amplitude: float = Field(
        0.005, ge=0.0, le=0.02, description="a_st, depth of the stance arc", json_schema_extra={"unit": "m"}
    )
    max_stride_length: float = Field(
        0.06, ge=0.0, le=0.1, description="Largest stride length l_s", json_schema_extra={"unit": "m"}
    )
    neutral_stance_height: float = Field(
        ge=-0.12,
        le=-0.01,
        description="l_nsh, z of the standing foot, negative below the axis",
        json_schema_extra={"unit": "m"},
    )
    neutral_stride_position: float = Field(
        ge=-0.05,
        le=0.05,
        description="l_nsp, x of the standing foot, positive forward of the axis",
        json_schema_extra={"unit": "m"},
    )
    touch_down_angle: float = Field(
        math.pi / 2.0,
        ge=0.8,
        le=2.4,
        description="theta_td of the foot path `locus` (C table 3.1); above pi/2 the leg retracts before touch-down",
        json_schema_extra={"unit": "rad"},
    )
    take_off_angle: float = Field(
        math.pi / 2.0,
        ge=0.8,
        le=2.4,
        description="theta_to of the foot path `locus` (C table 3.1)",
        json_schema_extra={"unit": "rad"},
    )


class GaitParameters(_Frozen):
    """All gait parameters (k_g); mirrors `GaitParameters.msg`. The defaults are N's (tables A.6 and A.7)."""

    gaits: dict[str, GaitDefinition] = Field(
        default=GAITS,
        description="The gaits by name; N's trt, trt1 and lat (table A.6)",
    )
    default_gait: str = Field("trot", description="Gait of a command that names none")
    default_gait_frequency: float = Field(
        0.8,
        ge=MIN_GAIT_FREQUENCY,
        le=MAX_GAIT_FREQUENCY,
        description="Gait frequency of a command that names none (N's fastest test)",
        json_schema_extra={"unit": "Hz"},
    )
    default_turning_strategy: TurningStrategy = Field("leg", description="Strategy of a command that names none")
    front: LegStride = Field(
        default=LegStride(neutral_stance_height=-0.045, neutral_stride_position=0.005),
        description="Foot path of the front legs (N table A.7)",
    )
    rear: LegStride = Field(
        default=LegStride(neutral_stance_height=-0.05, neutral_stride_position=0.0),
        description="Foot path of the rear legs (N table A.7)",
    )
    foot_path: FootPath = Field(
        "splines", description="splines: cubics (N 5.4.2); locus: the quadratic Bezier curves of C 3.2.1"
    )
    turn_response_exponent: float = Field(
        1.0,
        ge=0.0,
        le=10.0,
        description="t of (5.38)-(5.39): 1 is the linear response of (5.36)-(5.37), 0 turns leg modulation off",
        json_schema_extra={"unit": "1"},
    )
    fusion_exponent: float = Field(
        1.0, ge=0.0, le=10.0, description="s of (5.45); 1 in N", json_schema_extra={"unit": "1"}
    )
    max_spine_flexion: float = Field(
        0.1,
        ge=0.0,
        le=0.2,
        description="Largest flexion of one lateral spine joint (N A.4.2)",
        json_schema_extra={"unit": "rad"},
    )
    settle_duration: float = Field(
        0.15,
        ge=0.05,
        le=0.18,
        description="Time to put the swing feet down when stopping; with the 0.3 s of silence that come before it the "
        "mouse stands 0.5 s after the last command",
        json_schema_extra={"unit": "s"},
    )

    @model_validator(mode="after")
    def _default_gait_exists(self) -> Self:
        for name in self.gaits:
            if not _SET_NAME.fullmatch(name):
                raise ValueError(f"the gait name {name!r} must be letters, digits, - and _")
        if self.default_gait not in self.gaits:
            raise ValueError(f"default_gait = {self.default_gait!r}: not one of the gaits {', '.join(self.gaits)}")
        return self

    @property
    def longest_stride(self) -> float:
        """Stride length that all legs can make [m]."""
        return min(self.front.max_stride_length, self.rear.max_stride_length)

    def fastest(self, gait: str, frequency: float) -> float:
        """No-slip speed [m/s] of a gait with the longest stride (5.21)-(5.22)."""
        return gait_speed(frequency, self.longest_stride, self.gaits[gait].gait_factor)

    def stride(self, leg: int) -> LegStride:
        """Foot path parameters of leg 0...3."""
        return self.front if leg < 2 else self.rear


def gait_speed(frequency: float, stride_length: float, gait_factor: float) -> float:
    """No-slip speed s_m [m/s] of a gait: s_m = f_g g_f l_s (5.21)-(5.22)."""
    return frequency * gait_factor * stride_length


def stride_length(velocity: float, frequency: float, duty_factor: float) -> float:
    """Stride l_s [m] that a foot makes in its stance phase at a no-slip speed [m/s]: (5.21)-(5.22) solved for l_s."""
    return velocity * duty_factor / frequency


def frequency_error(frequency: float) -> str | None:
    """What is wrong with a gait frequency [Hz], in words; None where nothing is."""
    if MIN_GAIT_FREQUENCY <= frequency <= MAX_GAIT_FREQUENCY:
        return None
    return f"gait_frequency = {frequency} Hz: allowed {MIN_GAIT_FREQUENCY} to {MAX_GAIT_FREQUENCY} Hz"


def read_gait_parameters(path: Path) -> GaitParameters:
    """Gait parameters of a YAML file; what it leaves out keeps its default, but a leg pair or a gait is given whole.

    Raises ParameterError naming file, field, value and what is allowed.
    """
    return validate(read_yaml(path), path, GaitParameters)


def write_gait_parameters(parameters: GaitParameters, path: Path) -> None:
    """Writes the YAML file at once or not at all. Raises ParameterError."""
    write_yaml(parameters.model_dump(mode="json"), path)


class GaitKnowledgeBase:
    """The present gait parameters, how often they changed, and named sets of them in a directory of YAML files.

    Sets that come with the package can be loaded too; one that is saved under the same name stands before it.
    """

    def __init__(self, directory: Path, parameters: GaitParameters | None = None) -> None:
        self._directory = directory
        self._parameters = parameters or GaitParameters()
        self._revision = 0

    @property
    def parameters(self) -> GaitParameters:
        """The present parameters."""
        return self._parameters

    @property
    def revision(self) -> int:
        """Number of changes since the start."""
        return self._revision

    def change(self, parameters: GaitParameters) -> None:
        """Makes `parameters` the present ones."""
        if parameters != self._parameters:
            self._parameters = parameters
            self._revision += 1

    def save(self, name: str, overwrite: bool = False) -> Path:
        """Saves the present parameters under a name; returns the file. Raises ParameterError."""
        path = self._path(name)
        if path.exists() and not overwrite:
            raise ParameterError(f"{path}: the set {name!r} exists; ask to overwrite it")
        try:
            self._directory.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ParameterError(f"{self._directory}: cannot be made: {error.strerror}") from error
        write_gait_parameters(self._parameters, path)
        return path

    def load(self, name: str) -> GaitParameters:
        """The parameters saved under a name; `change` makes them the present ones. Raises ParameterError."""
        path, ours = self._path(name), OUR_SETS / f"{name}.yaml"
        if not path.exists() and not ours.exists():
            near = difflib.get_close_matches(name, self.names(), n=1)
            hint = f"did you mean {near[0]}?" if near else f"there are: {', '.join(self.names())}"
            raise ParameterError(f"{path}: no saved set {name!r}; {hint}")
        return read_gait_parameters(path if path.exists() else ours)

    def names(self) -> list[str]:
        """Names of all sets that can be loaded, sorted."""
        files = (*self._directory.glob("*.yaml"), *OUR_SETS.glob("*.yaml"))
        return sorted({path.stem for path in files if _SET_NAME.fullmatch(path.stem)})

    @staticmethod
    def check_name(name: str) -> None:
        """Nothing for a name that a set may have. Raises ParameterError."""
        if not _SET_NAME.fullmatch(name):
            raise ParameterError(f"set name {name!r}: allowed are 1 to 64 letters, digits, - and _")

    def _path(self, name: str) -> Path:
        self.check_name(name)
        return self._directory / f"{name}.yaml"


def default_sets_folder() -> Path:
    """Where the named sets are kept, by the XDG rules."""
    data = os.environ.get("XDG_DATA_HOME") or "~/.local/share"
    return Path(data).expanduser() / "nermo" / "gaits"
