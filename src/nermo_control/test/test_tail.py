"""The tail: its chain, and what it does against the spine."""

from __future__ import annotations

import numpy as np
import pytest

from nermo_control.tail import JOINTS, TailController
from nermo_description.robots import load_robot

PERIOD_NS = 5_000_000
ROBOT = load_robot("nermo_lite")


def settled(tail: TailController, *arguments: object) -> float:
    return [tail.step(*arguments) for _ in range(800)][-1]  # type: ignore[arg-type]


def test_the_bend_is_that_of_least_energy() -> None:
    """Independent of the formula: of all joint angles with this tendon length, the springs choose the cheapest."""
    offsets = ROBOT.tail.tendon_offset * np.linspace(1.0, 1.0 / 3.0, 2 * JOINTS + 1)[1::2]
    pulled = ROBOT.tail.pulley_radius * 0.5
    angles = np.linalg.lstsq(offsets[None], np.array([pulled]), rcond=None)[0]
    assert 0.5 * TailController(ROBOT, PERIOD_NS).angle_per_servo == pytest.approx(angles.sum(), rel=1e-9)


def test_the_tail_bends_as_told_within_the_servo() -> None:
    tail = TailController(ROBOT, PERIOD_NS)
    assert settled(tail, "off", 0.8, 0.1) * tail.angle_per_servo == pytest.approx(0.8, abs=1e-6)
    assert settled(tail, "off", 99.0, 0.0) == ROBOT.servos["tail"].upper


def test_the_tail_bends_against_the_spine() -> None:
    tail = TailController(ROBOT, PERIOD_NS)
    assert settled(tail, "spine", 0.0, 0.1) * tail.angle_per_servo == pytest.approx(-0.4, abs=1e-6)
    assert settled(tail, "off", 0.0, 0.1) == pytest.approx(0.0, abs=1e-6)
