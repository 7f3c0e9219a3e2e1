"""What the torque balance of a joint says by itself, on arms whose truth is known over decades."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from robots import aligned_of, simulate

from simgap.analysis.diagnose import diagnose
from simgap.analysis.options import Options
from simgap.analysis.torque_balance import EXPLAINED, Balance, balances, hints
from simgap.data.recording import recording_from_table
from simgap.simulation.state import measured_state

GAIN, FRICTION = 0.05, 0.15


def _soft(model: mujoco.MjModel) -> None:
    """Servos twenty times softer than the model says, with dry friction."""
    model.actuator_gainprm[:, 0] *= GAIN
    model.actuator_biasprm[:, 1:3] *= GAIN
    model.dof_frictionloss[:] += FRICTION


def _found(seconds: float = 12.0, noise: float = 2e-4, **changes: object) -> list[Balance]:
    table = simulate("arm", seconds, noise=noise, **changes)  # type: ignore[arg-type]
    plant, aligned, floor = aligned_of("arm", table)
    return balances(plant, aligned, measured_state(plant, aligned, floor))


def test_gains_that_are_wrong_by_a_factor_of_twenty_and_friction_are_told() -> None:
    found = _found(change=_soft)
    assert [b.joint for b in found] == ["shoulder", "elbow"]
    for b in found:
        assert b.explained > 0.9 > b.nominal, b
        assert b.gain == pytest.approx(GAIN, rel=0.25) and b.friction == pytest.approx(FRICTION, rel=0.35)


@pytest.mark.parametrize(("gain", "told"), [(0.1, 0.02), (0.1, 0.05), (0.03, 0.2), (0.02, 0.2)])
def test_of_joints_that_hardly_follow_losses_tell_the_decade_of_the_gain(gain: float, told: float) -> None:
    """Small commands, held by friction: no motion takes a torque that could be told from it."""

    def soft(model: mujoco.MjModel) -> None:
        model.actuator_gainprm[:, 0] *= gain
        model.actuator_biasprm[:, 1:3] *= gain
        model.dof_frictionloss[:] += FRICTION

    found = _found(change=soft, told=told)
    assert all(b.borrowed and b.told()["gain"] is None for b in found)
    assert gain / 4 < found[0].gain < 4 * gain and all(b.friction < 2 * FRICTION for b in found)


@pytest.mark.parametrize(("damping", "late"), [(0.1, 0.0), (0.4, 0.03), (0.2, 0.06)])
def test_damping_and_lag_are_told(damping: float, late: float) -> None:
    def dragging(model: mujoco.MjModel) -> None:
        _soft(model)
        model.dof_frictionloss[:] = 0.0
        model.dof_damping[:] += damping

    def delayed(table: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        steps = round(late / 0.005)
        return {k: v if k == "t" else np.r_[np.full(steps, v[0]), v[: len(v) - steps]] for k, v in table.items()}

    for b in _found(change=dragging, signal=delayed):
        assert b.damping == pytest.approx(damping, abs=0.05 + 0.2 * damping)
        assert b.lag == pytest.approx(late, abs=0.012)


def test_what_a_model_has_itself_is_not_told_again_where_a_torque_drives() -> None:
    """A cart with the damping of its model, pushed by a motor."""
    plant, aligned, floor = aligned_of("cart_pole", simulate("cart_pole", 12.0))
    (slide,) = balances(plant, aligned, measured_state(plant, aligned, floor))
    assert slide.joint == "slide" and not slide.servo
    assert slide.gain == pytest.approx(1.0, abs=0.1) and slide.damping == pytest.approx(0.0, abs=0.15)
    assert slide.nominal > 0.9 and hints([slide]) == []


@pytest.mark.parametrize("told", [0.1, 0.3, 1.0])
def test_a_model_that_is_right_is_spoken_of_by_no_hint(told: float) -> None:
    assert hints(_found(told=told)) == []


def test_hints_speak_for_every_joint_and_begin_with_what_carries_most() -> None:
    spoken = hints(_found(change=_soft))
    assert [site for name, site, _ in spoken if name == "coulomb_friction"] == ["shoulder", "elbow"]
    assert spoken[0][0] == "servo_gain", "its logarithm is the largest"
    assert len({name for name, _, _ in spoken}) < len(spoken)


def test_a_balance_that_explains_little_is_not_believed() -> None:
    def pushed(data: mujoco.MjData) -> None:
        data.qfrc_applied[:] = 3.0 * np.sin(11.0 * data.time)

    assert all(b.explained < EXPLAINED or b.nominal > 0.0 for b in _found(push=pushed)) or hints(_found()) == []


def test_both_causes_are_found_together_and_told_at_once() -> None:
    table = simulate("arm", 14.0, change=_soft)
    plant, _, _ = aligned_of("arm", table)
    options = Options(only=("servo_gain", "coulomb_friction", "viscous_friction", "servo_delay"), threads=1)
    report = diagnose([recording_from_table(table, plant)], plant, options).report
    assert {e["name"] for e in report["effects"]} == {"servo_gain", "coulomb_friction"}
    assert report["verdict"] == "effect"
    for effect in report["effects"]:
        truth = GAIN if effect["name"] == "servo_gain" else FRICTION
        assert all(p["value"] == pytest.approx(truth, rel=0.1) for p in effect["parameters"].values())
    assert [row["joint"] for row in report["torque_balance"]] == ["shoulder", "elbow"]
