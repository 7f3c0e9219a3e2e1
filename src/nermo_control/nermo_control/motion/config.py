"""Settings of the motion module that are no gait parameters."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

from nermo_control.head import GazeMode
from nermo_control.oscillators.legs import Coordination, OscillatorSettings
from nermo_control.tail import TailMode
from nermo_description.silence import WALK


class MotionModuleConfig(BaseModel):
    """Settings of the motion module that are no gait parameters."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    silence_timeout: float = Field(
        WALK.after,
        ge=0.05,
        le=1.0,
        description="Silence of the command or of a node after which the mouse stops; a longer gap between ticks "
        "counts as a restart",
        json_schema_extra={"unit": "s", "readOnly": True},
    )
    posture_velocity: float = Field(
        3.0,
        ge=0.1,
        le=10.0,
        description="Fastest servo in a change of posture",
        json_schema_extra={"unit": "rad/s", "readOnly": True},
    )
    gaze: GazeMode = Field(
        "spine",
        description="How the neck cancels the gait's swing in the cameras' view: by the spine's command (yaw), by the "
        "IMU (yaw, and pitch where the head tilts), or off",
    )
    tail: TailMode = Field("off", description="spine: the tail bends against the spine and points straight back")
    tail_angle: float = Field(
        0.0,
        ge=-1.5,
        le=1.5,
        description="Bend of the whole tail while on four feet, positive left",
        json_schema_extra={"unit": "rad"},
    )
    arch: float = Field(
        0.0,
        ge=0.0,
        le=0.2,
        description="Vertical flexion of each lumbar joint while on four feet, positive arches the back; without a "
        "lumbar servo it does nothing",
        json_schema_extra={"unit": "rad"},
    )
    coordination: Coordination = Field(
        "timed",
        description="Who lifts a foot: the gait's clock, coupled oscillators (cpg), or the legs' loads (tegotae)",
        json_schema_extra={"readOnly": True},
    )
    oscillators: OscillatorSettings = OscillatorSettings()
    lockstep: bool = Field(
        False,
        description="The robot waits for each answer, so nothing is ever silent",
        json_schema_extra={"readOnly": True},
    )
