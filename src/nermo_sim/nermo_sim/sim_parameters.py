"""Parameters of the node `mujoco_sim`."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field, model_validator


def _rate(default: float, what: str) -> float:
    return Field(default, gt=0.0, le=1000.0, description=f"Rate of {what}", json_schema_extra={"unit": "Hz"})


class SimParameters(BaseModel):
    """Parameters of the node."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    robot: str = Field("nermo_lite", description="Name of the robot, or path of its parameter file")
    scene: str = Field("flat", description="Name of the scene")
    keyframe: str = Field("stand", description="Posture in which the robot begins")
    control_rate: float = _rate(200.0, "the control ticks; a whole number of physics steps each")
    real_time_factor: float = Field(
        1.0, ge=0.0, le=100.0, description="Simulated time over wall time; 0 is as fast as possible"
    )
    stepped: bool = Field(False, description="Publish a tick and wait for the servo command that answers it")
    patience: float = Field(
        0.1,
        ge=0.0,
        le=1.0,
        description="Longest wait of a due tick for the command that answers the last one, wall time; 0 is none",
        json_schema_extra={"unit": "s"},
    )
    publish_clock: bool = Field(True, description="Be the /clock; only one node of a graph may")
    frame_prefix: str = Field("", description="In front of every frame name, as in mouse_1/")
    seed: int = Field(0, ge=0, description="Seed of the sensor noise")
    sensor_noise: float = Field(
        0.0, ge=0.0, le=100.0, description="Sensor noise relative to a typical one; 0 is none, 1 is typical"
    )
    imu_rate: float = _rate(200.0, "imu/data_raw")
    joint_rate: float = _rate(50.0, "joint_states")
    tactile_rate: float = _rate(200.0, "tactile")
    foot_force_rate: float = _rate(50.0, "truth/foot_forces")
    battery_rate: float = _rate(1.0, "battery")
    camera_rate: float = Field(
        0.0,
        ge=0.0,
        le=60.0,
        description="Rate of the head cameras' pictures; 0 is off",
        json_schema_extra={"unit": "Hz"},
    )
    viewer: bool = Field(False, description="Open MuJoCo's window; needs a display")
    dump_folder: str = Field("", description="Where model and states go when the simulation diverges; empty: /tmp")

    @model_validator(mode="after")
    def _rates_divide(self) -> SimParameters:
        for name in ("imu_rate", "joint_rate", "tactile_rate", "foot_force_rate", "battery_rate"):
            ratio = self.control_rate / getattr(self, name)
            if ratio < 1.0 or abs(ratio - round(ratio)) > 1e-6:
                raise ValueError(
                    f"{name} = {getattr(self, name)} Hz: must divide control_rate = {self.control_rate} Hz"
                )
        return self

    def rates(self) -> dict[str, float]:
        """Rate of each topic [Hz]; the controller's tick needs servo states and odometry each time."""
        return {
            "servo_states": self.control_rate,
            "truth/odom": self.control_rate,
            "imu/data_raw": self.imu_rate,
            "joint_states": self.joint_rate,
            "tactile": self.tactile_rate,
            "truth/foot_forces": self.foot_force_rate,
            "battery": self.battery_rate,
        }
