"""Whether a recording holds any motion: without it nothing can be said about what moves."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from simgap.data.align import Aligned
from simgap.data.channels import InputChannel, OutputChannel, model_names
from simgap.data.noise_floor import input_noise
from simgap.data.plant import Plant

Array = NDArray[np.float64]

NOISE_SPREAD = 10.0
"""Noise floors over which 96 % of a channel's values must spread to count as motion; noise alone spreads over 4.1."""
LEAST_SHARE = 0.01
"""And the share of the range of its joint or actuator. A joint without one has 1 rad or 1 m."""
_MOVE = "move each joint through most of its range, back and forth, slowly and fast, and record that"
NOTHING_MOVED = f"nothing was told to move and nothing moved, so that no fault could show: {_MOVE}"
ONE_POSE = f"nothing was told to move and nothing moved, and one pose that differs does not tell why: {_MOVE}"


def still_joints(plant: Plant, aligned: Aligned, floor: Array) -> list[str]:
    """Names of the recorded joints that do not move in any run.

    floor: noise floor of every output, (no,) in the channel's unit.
    """
    spread = _spread(aligned, aligned.outputs, aligned.valid)
    moved: dict[int, bool] = {}
    for i, channel in enumerate(plant.outputs):
        if channel.qpos >= 0:
            enough = max(NOISE_SPREAD * floor[i], LEAST_SHARE * _joint_range(plant, channel))
            moved[channel.qpos] = moved.get(channel.qpos, False) or bool(spread[i] > enough)
    names = model_names(plant.model, mujoco.mjtObj.mjOBJ_JOINT)
    return [names[_joint(plant, qpos)] for qpos, did in moved.items() if not did]


def excited(plant: Plant, aligned: Aligned, floor: Array) -> bool:
    """Whether anything was told to move, or moved.

    A robot that was told to move and did not is one that has been excited: that is a gap. Joints count, or, where none
    is recorded, whatever is.
    """
    told = _spread(aligned, aligned.inputs, np.ones(aligned.inputs.shape, bool))
    noise = input_noise(aligned)
    for i, command in enumerate(plant.inputs):
        if told[i] > max(NOISE_SPREAD * noise[i], LEAST_SHARE * _command_range(plant, command)):
            return True
    recorded = {channel.qpos for channel in plant.outputs if channel.qpos >= 0}
    if recorded:
        return len(still_joints(plant, aligned, floor)) < len(recorded)
    return bool((_spread(aligned, aligned.outputs, aligned.valid) > NOISE_SPREAD * floor).any())


def _spread(aligned: Aligned, values: Array, valid: NDArray[np.bool_]) -> Array:
    """Between the 2nd and the 98th percentile, the largest of all runs, (n,): runs may differ in where they stand."""
    largest = np.zeros(values.shape[1])
    for run in aligned.runs:
        for i in range(values.shape[1]):
            taken = values[run.start : run.stop, i][valid[run.start : run.stop, i]]
            if len(taken):
                largest[i] = max(largest[i], float(np.subtract(*np.percentile(taken, [98, 2]))))
    return largest


def _joint(plant: Plant, qpos: int) -> int:
    return int(np.flatnonzero(plant.model.jnt_qposadr == qpos)[0])


def _joint_range(plant: Plant, channel: OutputChannel) -> float:
    """In the channel's unit."""
    joint = _joint(plant, channel.qpos)
    limited = bool(plant.model.jnt_limited[joint])
    return abs(channel.gear) * (float(np.ptp(plant.model.jnt_range[joint])) if limited else 1.0)


def _command_range(plant: Plant, channel: InputChannel) -> float:
    """In the unit of ctrl; 0 where it has none."""
    limited = channel.actuator >= 0 and bool(plant.model.actuator_ctrllimited[channel.actuator])
    return float(np.ptp(plant.model.actuator_ctrlrange[channel.actuator])) if limited else 0.0
