"""The gaits of a mouse before anything is changed (N table A.6)."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Offset = Annotated[float, Field(ge=0.0, lt=1.0)]


class GaitDefinition(BaseModel):
    """One gait (N table A.6)."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    duty_factor: float = Field(
        ge=0.2, le=0.95, description="Share of the cycle that a foot is on the ground", json_schema_extra={"unit": "1"}
    )
    phase_offsets: tuple[Offset, Offset, Offset, Offset] = Field(
        description="Phase advance of front left, front right, rear left, rear right, each in [0, 1)",
        json_schema_extra={"unit": "1"},
    )

    @property
    def gait_factor(self) -> float:
        """g_f of (5.22), the inverse of the duty factor (N table A.2)."""
        return 1.0 / self.duty_factor


GAITS = {
    "trot": GaitDefinition(duty_factor=0.5, phase_offsets=(0.5, 0.0, 0.0, 0.5)),
    "walking_trot": GaitDefinition(duty_factor=0.6, phase_offsets=(0.5, 0.0, 0.0, 0.5)),
    "lateral_walk": GaitDefinition(duty_factor=0.68, phase_offsets=(0.63, 0.14, 0.0, 0.54)),
}
"""By name: N's trt, trt1 and lat. The default of the knowledge-base's `gaits`."""
