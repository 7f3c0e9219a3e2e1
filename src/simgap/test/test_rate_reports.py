"""Reports of joints' speeds against the slopes of their positions: late, of another unit, or right."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from simgap.analysis.rate_reports import Rate, rate_hints, rate_reports, rate_warnings
from simgap.data.align import align
from simgap.data.mapping import parse_map
from simgap.data.plant import Plant, build_plant
from simgap.data.recording import recording_from_table
from simgap.effects.sensor import ALL_RATES

Array = NDArray[np.float64]

JOINTS = 3
_BALL = '<geom type="sphere" size="0.02" pos="0 0 -0.1" mass="0.01"/>'
_BODIES = "".join(f'<body pos="0 {i} 0"><joint name="j{i}" axis="0 1 0"/>{_BALL}</body>' for i in range(JOINTS))
ARM = f'<mujoco><worldbody>{_BODIES}</worldbody><actuator><position name="s0" joint="j0" kp="2"/></actuator></mujoco>'


def _plant(unit: str = "rad") -> Plant:
    rates = [{"column": f"v{i}", "unit": "rad/s", "joint": f"j{i}", "quantity": "velocity"} for i in range(JOINTS)]
    positions = [{"column": f"q{i}", "unit": unit, "joint": f"j{i}", "quantity": "position"} for i in range(JOINTS)]
    inputs = [{"column": "c0", "unit": "rad", "actuator": "s0", "kind": "position"}]
    rows = {"time": {"column": "t", "unit": "s"}, "inputs": inputs, "outputs": [*positions, *rates]}
    return build_plant(mujoco.MjSpec.from_string(ARM), parse_map(rows))


def _found(
    late: tuple[float, ...], scale: tuple[float, ...] = (1.0, 1.0, 1.0), period: float = 0.02, noise: float = 1e-3
) -> list[Rate]:
    """Three joints that swing for 40 s, of two waves each, counted by encoders; their speeds late [s] and scaled."""
    rng, t = np.random.default_rng(3), np.arange(0.0, 40.0, period)
    table: dict[str, Array] = {"t": t, "c0": np.sin(t)}
    for i in range(JOINTS):
        waves = ((0.4, 1.3 + 0.4 * i), (0.2, 3.1 + 0.3 * i))
        q = sum(size * np.sin(w * t) for size, w in waves)
        v = sum(size * w * np.cos(w * (t - late[i])) for size, w in waves)
        table |= {f"q{i}": np.round(q / noise) * noise, f"v{i}": scale[i] * v + 0.03 * rng.standard_normal(len(t))}
    plant = _plant()
    return rate_reports(plant, align(recording_from_table(table, plant), plant))


def test_reports_that_are_right_say_nothing() -> None:
    found = _found((0.0, 0.0, 0.0))
    assert [r.part for r in found] == ["j0:velocity", "j1:velocity", "j2:velocity"]
    assert all(r.lag == 0.0 and r.scale == 1.0 for r in found)
    assert rate_hints(found) == [] and rate_warnings(found) == []
    assert found[0].told() == {
        "part": "j0:velocity", "kind": "rate", "lag_s": 0.0, "scale": 1.0, "stands_out": []
    }  # fmt: skip


@settings(max_examples=12, deadline=None)
@given(st.floats(0.012, 0.08), st.sampled_from([0.005, 0.01, 0.02]))
def test_a_common_lag_is_found_between_samples_and_is_that_of_all(lag: float, period: float) -> None:
    found = _found((lag, lag, lag), period=period)
    assert all(r.lag == pytest.approx(lag, abs=2e-3) and r.scale == 1.0 for r in found)
    ((name, site, value),) = rate_hints(found)
    assert (name, site) == ("sensor_delay", ALL_RATES) and value == pytest.approx(lag, abs=2e-3)
    (told,) = rate_warnings(found)
    assert all(f"v{i} {1e3 * r.lag:.0f}" in told for i, r in enumerate(found))


def test_one_late_report_is_its_sensors_own() -> None:
    found = _found((0.0, 0.03, 0.0))
    ((name, site, value),) = rate_hints(found)
    assert (name, site) == ("sensor_delay", "j1:velocity") and value == pytest.approx(0.03, abs=2e-3)
    assert [r.told()["stands_out"] for r in found] == [[], ["lag"], []]


@pytest.mark.parametrize("factor", [0.43, 2.33])
def test_a_report_in_another_unit_is_told_with_its_factor(factor: float) -> None:
    found = _found((0.0, 0.0, 0.02), (1.0, 1.0, factor))
    spoken = {(name, site): value for name, site, value in rate_hints(found)}
    assert spoken[("sensor_scale", "j2:velocity")] == pytest.approx(factor, rel=0.02)
    assert "'v2'" in rate_warnings(found)[0] and "'q2'" in rate_warnings(found)[0]


def test_noise_alone_is_no_scale_and_no_lag() -> None:
    """Coarse encoders flatten a regression on their slope, and steepen the other."""
    assert all(r.scale == 1.0 and r.lag == 0.0 for r in _found((0.0, 0.0, 0.0), period=0.005, noise=0.05))


def test_what_does_not_move_says_nothing() -> None:
    plant, t = _plant(), np.arange(0.0, 20.0, 0.02)
    table = {"t": t, "c0": np.sin(t)} | {f"q{i}": np.sin(t) for i in range(JOINTS)}
    table |= {f"v{i}": np.cos(t) for i in range(JOINTS)} | {"q2": np.zeros_like(t), "v2": np.zeros_like(t)}
    found = rate_reports(plant, align(recording_from_table(table, plant), plant))
    assert [r.part for r in found] == ["j0:velocity", "j1:velocity"]
