"""Measured inputs are measured: their errors are forgiven as far as they go, and no further."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray
from robots import ARM

from simgap.data.align import align
from simgap.data.mapping import parse_map
from simgap.data.noise_floor import noise_floor
from simgap.data.plant import build_plant
from simgap.data.recording import recording_from_table
from simgap.inference.residual import Residuals, channel_gap
from simgap.simulation.replay import Replayer
from simgap.simulation.variant import Variant
from simgap.simulation.windows import cut

Array = NDArray[np.float64]
PASSIVE = ARM[: ARM.index("<actuator>")] + "</mujoco>"
MAP = {
    "time": {"column": "t", "unit": "s"},
    "inputs": [
        {"column": f"tau{i}", "unit": "N m", "joint": j, "kind": "torque", "measured": True}
        for i, j in enumerate(("shoulder", "elbow"))
    ],
    "outputs": [
        {"column": f"q{i}", "unit": "rad", "joint": j, "quantity": "position"}
        for i, j in enumerate(("shoulder", "elbow"))
    ],
}


def _torques(error: float, friction: float = 0.0) -> dict[str, Array]:
    """A swinging arm whose torques are read with a slow error of ``error`` root mean squares, and a little noise."""
    model = mujoco.MjModel.from_xml_string(PASSIVE)
    model.dof_frictionloss[:] = friction
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    n, period = 1600, 0.005
    t = period * np.arange(n)
    tau = np.stack([1.2 * np.sin(2.1 * t) + 0.8 * np.sin(5.3 * t), 0.5 * np.sin(3.3 * t) + 0.3 * np.sin(7.9 * t)], 1)
    angles = np.empty((n, 2))
    for k in range(n):
        data.qfrc_applied[:] = tau[k]
        angles[k] = data.qpos + 2e-4 * rng.standard_normal(2)
        for _ in range(2):
            mujoco.mj_step(model, data)
    wander = np.cumsum(rng.standard_normal((n, 2)), axis=0)
    smooth = np.stack([np.convolve(w, np.hanning(61) / np.hanning(61).sum(), mode="same") for w in wander.T], 1)
    smooth = np.diff(smooth, axis=0, prepend=smooth[:1])
    read = tau + error * tau.std(axis=0) * smooth / smooth.std(axis=0) + 0.002 * rng.standard_normal((n, 2))
    return {"t": t, "tau0": read[:, 0], "tau1": read[:, 1], "q0": angles[:, 0], "q1": angles[:, 1]}


def _gap(table: dict[str, Array]) -> tuple[float, float]:
    """(gap of the nominal model, size that the wander of the torques is taken to have)."""
    plant = build_plant(mujoco.MjSpec.from_string(PASSIVE), parse_map(MAP))
    aligned = align(recording_from_table(table, plant), plant)
    replayer = Replayer(plant, aligned, cut(aligned), noise_floor(aligned), 1)
    nominal = Variant.nominal(plant)
    residuals = Residuals.build(replayer, nominal)
    return float(channel_gap(residuals.of([nominal])[0], residuals.mask).max()), residuals.input_error


def test_errors_of_measured_torques_are_no_gap() -> None:
    exact, small = _gap(_torques(0.0))
    noisy, large = _gap(_torques(0.04))
    assert exact < 1.3 and noisy < 2.0
    assert large > small


def test_friction_is_no_error_of_the_torques() -> None:
    gap, _ = _gap(_torques(0.01, friction=0.08))
    assert gap > 2.0
