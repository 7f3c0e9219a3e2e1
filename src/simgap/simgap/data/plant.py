"""The nominal model as a map sees it: the MJCF compiled once, with every input and output channel resolved."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from simgap.data.channels import (
    InputChannel,
    OutputChannel,
    find,
    input_channel,
    model_names,
    output_channel,
    sensor_of,
)
from simgap.data.errors import GapInputError
from simgap.data.known import Known, known_signals, thermometers
from simgap.data.mapping import GainRow, Map
from simgap.data.mounting import Mounting, mounting
from simgap.data.setup import AS_MODELLED, Setup, setups
from simgap.data.unrecorded import leave_out_unrecorded

Array = NDArray[np.float64]
Obj = mujoco.mjtObj


@dataclass
class Plant:
    """The nominal model with its channels."""

    model: mujoco.MjModel
    inputs: tuple[InputChannel, ...]
    outputs: tuple[OutputChannel, ...]
    map: Map
    warnings: list[str] = field(default_factory=list)
    free: frozenset[str] = frozenset()
    """Joints that are never put where they were measured: where a cable holds a spring, a noise deviation of slack
    would let it go."""
    late: frozenset[str] = frozenset()
    """Joints that are put where they were measured only just before a window starts. What drives them has a memory (an
    integrator), which has to come from how they follow their commands: held, it would wind up."""
    setups: tuple[Setup, ...] = (AS_MODELLED,)
    """In what runs differ; that of the model first."""
    setup_of: dict[float | str, int] = field(default_factory=dict)
    """Which of them a run has, by its number; that of the model where it is not named."""
    known: tuple[Known, ...] = ()
    """What the map knows of the ways of signals; every variant begins there."""
    mounting: Mounting | None = None
    """The same model on mounts that can tilt, where it stands fixed."""

    def read(self, sensordata: Array) -> Array:
        """Output channels (..., no) from sensordata (..., nsensordata)."""
        values: Array = sensordata[..., [o.address for o in self.outputs]]
        for i, output in enumerate(self.outputs):
            if output.euler >= 0:
                quaternion = sensordata[..., output.address : output.address + 4]
                values[..., i] = euler_angles(quaternion)[..., output.euler]
        return values

    def names(self, kind: mujoco.mjtObj) -> list[str]:
        """Names of all objects of a kind, by id."""
        return model_names(self.model, kind)


def euler_angles(quaternion: Array) -> Array:
    """Roll, pitch, yaw [rad] (..., 3) of quaternions (..., 4) w x y z; intrinsic z-y'-x'' as in REP-103."""
    w, x, y, z = np.moveaxis(quaternion, -1, 0)
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2 * (w * y - z * x), -1.0, 1.0))
    yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return np.stack([roll, pitch, yaw], axis=-1)


def load_spec(path: str | Path) -> mujoco.MjSpec:
    """Read an MJCF (or URDF).

    Raises:
        GapInputError: the file is missing, or MuJoCo rejects it or a file that it names.
    """
    if not Path(path).is_file():
        raise GapInputError(f"{path}: no such model file")
    try:
        spec = mujoco.MjSpec.from_file(str(path))
    except ValueError as error:
        raise GapInputError(
            f"{path}: MuJoCo cannot read the model ({' '.join(str(error).split())}); it must be an MJCF or URDF"
        ) from error
    try:
        spec.compile()
    except ValueError as error:
        raise GapInputError(
            f"{path}: MuJoCo cannot compile the model ({' '.join(str(error).split())}); meshes and included files are "
            "looked for from the folder of the model"
        ) from error
    return spec


def load_model(path: str | Path) -> mujoco.MjModel:
    """Read and compile an MJCF (or URDF); raises as `load_spec`."""
    return load_spec(path).compile()


def build_plant(spec: mujoco.MjSpec, mapping: Map) -> Plant:
    """Compile the nominal model with the sensors and controllers that the map asks for.

    ``spec`` is changed: sensors are added for outputs given by joint, body, site or tendon, a motor with ``gains``
    becomes a position servo of these gains, and what the map knows nothing of is left out (`leave_out_unrecorded`).

    Raises:
        GapInputError: a name that the model lacks (with the nearest valid names), a unit that does not fit, a kind of
            input that the actuator cannot take, or no input at all.
    """
    if not mapping.inputs:
        raise GapInputError(
            f"{mapping.source}: inputs: neither commanded nor measured inputs are given; a replay would be a guess"
        )
    if not mapping.outputs:
        raise GapInputError(f"{mapping.source}: outputs: nothing measured is given, so there is nothing to compare")
    base = _compile(spec, mapping)
    unrecorded = leave_out_unrecorded(spec, base, mapping)
    base = _compile(spec, mapping) if unrecorded else base
    for name, row in mapping.gains.items():
        _close_loop(spec, base, name, row, mapping)
    sensors = [sensor_of(spec, base, row, f"{mapping.source}: outputs[{i}]") for i, row in enumerate(mapping.outputs)]
    model = _compile(spec, mapping)
    on_mounts = mounting(spec, model)
    inputs = tuple(
        input_channel(model, row, f"{mapping.source}: inputs[{i}] ({row.column})", mapping)
        for i, row in enumerate(mapping.inputs)
    )
    outputs = tuple(
        output_channel(model, row, sensor, f"{mapping.source}: outputs[{i}] ({row.column})")
        for i, (row, sensor) in enumerate(zip(mapping.outputs, sensors, strict=True))
    )
    warnings = []
    if unrecorded:
        warnings.append(
            f"{', '.join(unrecorded)} and what hangs there are left out: the map names nothing of them, so that nobody "
            "knows where they were"
        )
    told = {c.actuator for c in inputs}
    for i, name in enumerate(model_names(model, Obj.mjOBJ_ACTUATOR)):
        if i not in told and not any(c.measured for c in inputs):
            warnings.append(f"actuator {name} has no input in the map; its control is held at 0")
    # Commands are clamped when they are read, so that a signal effect may act on the control without being cut off.
    for channel in inputs:
        if channel.actuator >= 0:
            model.actuator_ctrllimited[channel.actuator] = 0
    known = known_signals(model, inputs, outputs, mapping)
    thermometers(model, mapping)
    ways = *setups(model, mapping), known, on_mounts
    return Plant(model, inputs, outputs, mapping, warnings, frozenset(), frozenset(), *ways)


def _compile(spec: mujoco.MjSpec, mapping: Map) -> mujoco.MjModel:
    try:
        return spec.compile()
    except ValueError as error:
        raise GapInputError(f"{mapping.source}: the model does not compile ({' '.join(str(error).split())})") from error


def _close_loop(spec: mujoco.MjSpec, model: mujoco.MjModel, name: str, row: GainRow, mapping: Map) -> None:
    """Turn a motor into the robot's own position servo: joint torque = kp (u - q) - kd dq/dt, u in joint units."""
    where = f"{mapping.source}: gains.{name}"
    index = find(model, Obj.mjOBJ_ACTUATOR, name, "actuator", where)
    actuator = spec.actuators[index]
    if model.actuator_biastype[index] != mujoco.mjtBias.mjBIAS_NONE:
        raise GapInputError(f"{where}: actuator {name!r} has a controller of its own; gains are for plain motors")
    gear, gain = float(model.actuator_gear[index, 0]), float(model.actuator_gainprm[index, 0])
    if model.actuator_ctrllimited[index]:
        low, high = sorted(gain * model.actuator_ctrlrange[index])
        actuator.forcerange = [low, high]
        actuator.forcelimited = 1
        actuator.ctrllimited = 0
    actuator.gaintype = mujoco.mjtGain.mjGAIN_FIXED
    actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
    actuator.gainprm = [row.kp / gear, *[0.0] * 9]
    actuator.biasprm = [0.0, -row.kp / gear**2, -row.kd / gear**2, *[0.0] * 7]
