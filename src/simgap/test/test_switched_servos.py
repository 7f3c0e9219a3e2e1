"""Servos that were without power for a part of the recording: what ends with it is told from what stays."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from robots import plant_of, simulate

from simgap.analysis.diagnose import diagnose
from simgap.analysis.options import Options
from simgap.analysis.torque_balance import Balance, hints
from simgap.data.recording import recording_from_table

DAMPING = 0.2
"""[N m s/rad]"""


def _report(servo: float, joint: float) -> dict[str, object]:
    """Of a pendulum whose servo and joint have more damping than the model, switched off for 0.8 s in every 2 s."""
    own: list[mujoco.MjModel] = []
    kept: list[np.ndarray] = []

    def change(model: mujoco.MjModel) -> None:
        model.dof_damping[:] += joint
        model.actuator_biasprm[:, 2] -= servo
        own.append(model)
        kept.extend([model.actuator_gainprm.copy(), model.actuator_biasprm.copy()])

    def switch(data: mujoco.MjData) -> None:
        off = (int(data.time / 0.005 + 1e-6) * 0.005) % 2.0 > 1.201
        own[-1].actuator_gainprm[:], own[-1].actuator_biasprm[:] = (0.0, 0.0) if off else (kept[0], kept[1])

    table = simulate("pendulum", 20.0, change=change, push=switch)
    table["on"] = (table["t"] % 2.0 <= 1.201).astype(float)
    plant = plant_of("pendulum", lambda data: data.update({"enabled": {"column": "on"}}))
    options = Options(only=("servo_damping", "viscous_friction"), threads=1, baselines=False)
    return diagnose([recording_from_table(table, plant)], plant, options).report


@pytest.mark.parametrize(
    ("name", "servo", "joint"), [("servo_damping", DAMPING, 0.0), ("viscous_friction", 0.0, DAMPING)]
)
def test_braking_that_ends_with_the_power_is_the_servos_and_else_the_joints(
    name: str, servo: float, joint: float
) -> None:
    report = _report(servo, joint)
    (effect,) = report["effects"]  # type: ignore[misc]
    assert effect["name"] == name
    assert effect["parameters"]["damping"]["value"] == pytest.approx(DAMPING, rel=0.1)


def test_the_balance_speaks_for_the_servo_only_where_it_was_switched() -> None:
    carries = {"friction": 0.0, "damping": 0.5, "offset": 0.0}
    balance = Balance("hinge", "servo", 3.0, 0.0, 1.5, 0.0, 0.0, 1.0, 0.8, 0.2, carries, servo=True)
    assert ("servo_damping", "servo", 1.5) in hints([balance], switched=True)
    spoken = {name for name, _, _ in hints([balance])}
    assert "servo_damping" not in spoken and "viscous_friction" in spoken
