"""Orientation noise (N 6.2.1, figures 6.7-6.9, A.7-A.9): mean, deviation and amplitude of roll, pitch and yaw."""

from __future__ import annotations

from typing import Any

import numpy as np

from nermo_sim.run_table import Moved, Recording

AXES = ("roll", "pitch", "yaw")
CYCLES_DRAWN = 2
"""N figures 6.7 to 6.9."""


def orientation_noise(moved: Moved, frequency: float) -> dict[str, float]:
    """Mean, standard deviation and amplitude [deg] of each axis over the steady part of a run.

    The first gait cycle is left out. The amplitude is half the range within a gait cycle, averaged over all cycles.
    """
    angles = np.degrees(steady_angles(moved, frequency))
    cycle = max(1, round(1.0 / (frequency * tick(moved))))
    count = max(1, len(angles) // cycle)
    cycles = angles[: count * cycle].reshape(count, -1, 3) if len(angles) >= cycle else angles[None]
    amplitude = 0.5 * np.ptp(cycles, axis=1).mean(axis=0)
    noise: dict[str, float] = {}
    for axis, name in enumerate(AXES):
        noise[f"{name}_mean_deg"] = float(angles[:, axis].mean())
        noise[f"{name}_sd_deg"] = float(angles[:, axis].std())
        noise[f"{name}_amplitude_deg"] = float(amplitude[axis])
    return noise


def mean_cycles(recording: Recording, frequency: float) -> dict[str, Any]:
    """Two gait cycles for a figure: roll, pitch, yaw [deg] and the spine servo [rad], from the end of the run."""
    ticks = round(CYCLES_DRAWN / (frequency * tick(recording)))
    angles = np.degrees(recording.roll_pitch_yaw[-ticks:])
    angles[:, 2] -= angles[:, 2].mean()
    spine = recording.servo_positions[-ticks:, recording.servos.index("spine_lateral")]
    series = {name: np.round(angles[:, axis], 3).tolist() for axis, name in enumerate(AXES)}
    return {"time_s": np.round(np.arange(ticks) * tick(recording), 4).tolist(), **series, "spine": spine.tolist()}


def steady_angles(moved: Moved, frequency: float) -> Any:
    """Roll, pitch, yaw [rad] without the first gait cycle, (n, 3)."""
    time = moved.time
    return moved.roll_pitch_yaw[time >= min(1.0 / frequency, 0.5 * float(time[-1]))]


def tick(moved: Moved) -> float:
    """[s] From one row to the next."""
    return float(moved.time[1] - moved.time[0])
