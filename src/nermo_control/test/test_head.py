"""The neck: what it cancels, what it leaves alone, and bad input."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from nermo_control.head import GazeController, GazeMode, Swing
from nermo_control.types import Imu
from nermo_description.robots import load_robot

PERIOD_NS = 5_000_000
PERIOD = PERIOD_NS * 1e-9
FREQUENCY = 0.8
STILL = (0.0, 0.0, 0.0)


def imu(stamp: int, yaw: float = 0.0, pitch: float = 0.0, roll: float = 0.0) -> Imu:
    x, y, z, w = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_quat()
    return Imu(stamp, (w, x, y, z), STILL)


@given(st.floats(-2.0, 2.0), st.floats(-0.5, 0.5), st.floats(0.05, 0.3), st.sampled_from([0.5, 0.8, 1.0, 2.0]))
def test_swing_keeps_what_repeats_and_drops_constant_and_slope(
    constant: float, slope: float, amplitude: float, frequency: float
) -> None:
    swing, cycle = Swing(PERIOD), 1.0 / frequency
    times = np.arange(0.0, 3.0 * cycle, PERIOD)
    waves = amplitude * np.sin(2.0 * math.pi * frequency * times + 0.3)
    found = [swing.step(constant + slope * t + wave, cycle) for t, wave in zip(times, waves, strict=True)]
    last = times > 2.0 * cycle
    assert np.array(found)[last] == pytest.approx(waves[last], abs=1e-9 + 2e-2 * amplitude)


def test_a_cycle_that_changes_does_not_make_the_swing_jump() -> None:
    swing = Swing(PERIOD)
    found = [swing.step(0.1 * math.sin(5.0 * tick * PERIOD), 1.25 if tick < 800 else 0.33) for tick in range(1600)]
    assert np.abs(np.diff(found)).max() < 0.006


@given(st.floats(-0.25, 0.25), st.floats(-0.15, 0.15), st.floats(-0.15, 0.15), st.floats(-3.0, 3.0))
def test_nermo_looks_level_along_the_mean_heading(yaw: float, pitch: float, roll: float, heading: float) -> None:
    """The optical axis by rotation matrices: the body swung by yaw, pitch and roll, the neck with pan, then tilt."""
    controller = GazeController(load_robot("nermo"), PERIOD_NS)
    for tick in range(400):
        controller.step(tick * PERIOD_NS, "imu", imu(tick * PERIOD_NS, heading), 0.0, FREQUENCY)
    stamp = 400 * PERIOD_NS
    pan, tilt = controller.step(stamp, "imu", imu(stamp, heading + yaw, pitch, roll), 0.0, FREQUENCY)
    assert tilt is not None
    axis = (Rotation.from_euler("ZYX", [heading + yaw, pitch, roll]) * Rotation.from_euler("ZY", [pan, tilt])).apply(
        [1.0, 0.0, 0.0]
    )
    # The swing takes half of a single step in yaw for a turn; a whole cycle of it is cancelled altogether.
    expected = heading + 0.5 * yaw + yaw * 0.5 / 250
    assert axis[2] == pytest.approx(0.0, abs=1e-6)
    assert math.remainder(math.atan2(axis[1], axis[0]) - expected, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("mode", ["spine", "imu"])
def test_the_pan_goes_against_the_swing_and_not_against_a_turn(mode: GazeMode) -> None:
    controller, pans = GazeController(load_robot("nermo_lite"), PERIOD_NS), []
    for tick in range(1000):
        wave = 0.1 * math.sin(2.0 * math.pi * FREQUENCY * tick * PERIOD)
        sample = imu(tick * PERIOD_NS, 0.3 * tick * PERIOD + wave)
        pan, tilt = controller.step(tick * PERIOD_NS, mode, sample, 0.05 + wave, FREQUENCY)
        assert tilt is None
        pans.append(pan)
    wave = np.sin(2.0 * math.pi * FREQUENCY * np.arange(1000) * PERIOD)
    assert np.mean(pans[500:]) == pytest.approx(0.0, abs=1e-3)
    assert np.corrcoef(pans[500:], wave[500:])[0, 1] < -0.999


def test_the_neck_rests_without_mode_without_imu_and_with_a_broken_one() -> None:
    controller = GazeController(load_robot("nermo"), PERIOD_NS)
    for tick in range(300):
        stamp = tick * PERIOD_NS
        broken = Imu(stamp, (math.nan, 0.0, 0.0, 0.0), STILL)
        assert controller.step(stamp, "imu", broken, 0.0, FREQUENCY) == (0.0, 0.0)
        assert controller.step(stamp, "imu", None, 0.0, FREQUENCY) == (0.0, 0.0)
    for tick in range(300, 600):
        stamp = tick * PERIOD_NS
        assert controller.step(stamp, "off", imu(stamp, 0.2, 0.1), 0.1, FREQUENCY) == (0.0, 0.0)


def test_an_imu_that_falls_silent_brings_the_neck_back_smoothly() -> None:
    controller, tilts = GazeController(load_robot("nermo"), PERIOD_NS), []
    for tick in range(800):
        sample = imu(min(tick, 300) * PERIOD_NS, 0.0, 0.2)
        tilts.append(controller.step(tick * PERIOD_NS, "imu", sample, 0.0, FREQUENCY)[1] or 0.0)
    assert tilts[300] == pytest.approx(-0.2, abs=1e-3)
    assert tilts[-1] == pytest.approx(0.0, abs=1e-6)
    assert np.abs(np.diff(tilts)).max() < 0.01
