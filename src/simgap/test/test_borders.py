"""Parts whose both ends are measured, looked at by themselves: what stands out among its likes, and is right."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from simgap.analysis.borders import Border, borders, hints
from simgap.data.align import align
from simgap.data.mapping import parse_map
from simgap.data.noise_floor import noise_floor
from simgap.data.plant import Plant, build_plant
from simgap.data.recording import recording_from_table

Array = NDArray[np.float64]

SERVOS, PERIOD = 4, 0.01
_BALL = '<geom type="sphere" size="0.02" pos="0 0 -0.1" mass="0.01"/>'


def _parts(text: str, count: int) -> str:
    """The text once for each part, with its number for #."""
    return "".join(text.replace("#", str(i)) for i in range(count))


FOUR = f"""
<mujoco><worldbody>
{_parts(f'<body pos="0 # 0"><joint name="j#" type="hinge" axis="0 1 0" damping="0.01"/>{_BALL}</body>', SERVOS)}
</worldbody><actuator>{_parts('<position name="s#" joint="j#" kp="2" kv="0.05"/>', SERVOS)}</actuator></mujoco>"""
MAP = {
    "time": {"column": "t", "unit": "s"},
    "inputs": [{"column": f"c{i}", "unit": "rad", "actuator": f"s{i}", "kind": "position"} for i in range(SERVOS)],
    "outputs": [
        {"column": f"q{i}", "unit": "rad", "joint": f"j{i}", "quantity": "position", "resolution": 0.001}
        for i in range(SERVOS)
    ],
}
CABLE = f"""
<mujoco><worldbody>
{_parts(f'<body pos="0 # 0"><joint name="j#" type="hinge" axis="0 1 0"/>{_BALL}</body>', 3)}
</worldbody><tendon>{_parts('<fixed name="t#"><joint joint="j#" coef="0.01"/></fixed>', 3)}</tendon>
<actuator>{_parts('<position name="s#" tendon="t#" kp="200"/>', 3)}</actuator>
<sensor>{_parts('<actuatorpos name="report#" actuator="s#"/>', 3)}</sensor></mujoco>"""


def _four(late: float = 0.0, off: float = 0.0, gear: float = 1.0) -> tuple[Plant, list[Border]]:
    """Four servos that follow steps and are told ``gear`` times the angle; the second ``late`` [s], ``off`` [rad]."""
    rng, n = np.random.default_rng(1), 3000
    model = FOUR.replace('kp="2"', f'gear="{gear}" kp="2"')
    plant = build_plant(mujoco.MjSpec.from_string(model), parse_map(MAP))
    told = np.repeat(rng.uniform(-0.5, 0.5, (n // 60, SERVOS)), 60, axis=0)
    said = np.zeros_like(told)
    for i in range(SERVOS):
        steps = 3 + (round(late / PERIOD) if i == 1 else 0)
        said[:, i] = np.concatenate([np.full(steps, told[0, i]), told[:-steps, i]]) + (off if i == 1 else 0.0)
    said += 0.001 * rng.standard_normal(said.shape)
    table = {"t": PERIOD * np.arange(n)}
    table |= {f"c{i}": gear * told[:, i] for i in range(SERVOS)} | {f"q{i}": said[:, i] for i in range(SERVOS)}
    aligned = align(recording_from_table(table, plant), plant)
    return plant, borders(plant, aligned, noise_floor(aligned))


def test_where_all_are_alike_nothing_stands_out() -> None:
    _, found = _four()
    assert [b.part for b in found] == ["s0", "s1", "s2", "s3"] and not any(b.stands_out for b in found)
    assert hints(found) == []
    for b in found:
        assert b.lag == pytest.approx(0.03, abs=0.003) and b.offset == pytest.approx(0.0, abs=1e-3)


def test_a_late_servo_and_one_that_is_off_speak_for_that_with_its_size() -> None:
    _, found = _four(late=0.04, off=0.1)
    assert [b.part for b in found if b.stands_out] == ["s1"] and set(found[1].stands_out) == {"offset", "lag"}
    said = {(name, site): value for name, site, value in hints(found)}
    assert said[("servo_delay", "s1")] == pytest.approx(0.04, abs=0.004)
    assert said[("servo_offset", "s1")] == pytest.approx(0.1, abs=2e-3)


def test_an_offset_is_told_in_the_unit_of_the_command_as_the_effect_is() -> None:
    """A servo behind a gear of two is told twice the angle of its joint."""
    _, found = _four(off=0.1, gear=2.0)
    (said,) = hints(found)
    assert said[:2] == ("servo_offset", "s1") and said[2] == pytest.approx(0.2, abs=4e-3)


def test_a_row_of_the_report_holds_no_nan() -> None:
    told = Border("x", "cable", 0.1, float("nan"), 0.01, "m").told()
    assert told["lag_s"] is None and told["offset"] == 0.1


def test_a_cable_that_stretches_shows_between_its_ends() -> None:
    rng, n = np.random.default_rng(2), 2000
    data = {
        "time": {"column": "t", "unit": "s"},
        "inputs": [{"column": f"c{i}", "unit": "m", "actuator": f"s{i}", "kind": "position"} for i in range(3)],
        "outputs": [{"column": f"q{i}", "unit": "rad", "joint": f"j{i}", "quantity": "position"} for i in range(3)]
        + [{"column": f"r{i}", "unit": "m", "sensor": f"report{i}"} for i in range(3)],
    }
    plant = build_plant(mujoco.MjSpec.from_string(CABLE), parse_map(data))
    t = PERIOD * np.arange(n)
    table = {"t": t}
    for i in range(3):
        q = 0.5 * np.sin((2.0 + i) * t)
        stretch = 4e-4 * np.sin(3.0 * t) if i == 2 else 0.0
        table |= {
            f"c{i}": 0.01 * q,
            f"q{i}": q + 1e-4 * rng.standard_normal(n),
            f"r{i}": 0.01 * q + stretch + 1e-6 * rng.standard_normal(n),
        }
    aligned = align(recording_from_table(table, plant), plant)
    cables = [b for b in borders(plant, aligned, noise_floor(aligned)) if b.kind == "cable"]
    assert [b.part for b in cables] == ["r0", "r1", "r2"] and [b.part for b in cables if b.stands_out] == ["r2"]
    assert cables[2].spread == pytest.approx(4e-4 / np.sqrt(2.0), rel=0.05)
