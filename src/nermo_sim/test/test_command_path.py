"""What becomes of commands in a mouse that deviates."""

import numpy as np
import pytest

from nermo_description.effects import EFFECTS
from nermo_description.parameters import Deviation
from nermo_description.robots import load_robot
from nermo_sim.command_path import CommandPath

SERVOS = ["front_left_hip", "front_left_knee"]
PERIOD = 0.005


def path_of(effect: str, **values: float) -> CommandPath:
    robot = load_robot("nermo_lite")
    deviation = Deviation.at(effect, "front_left_hip", **values)
    return CommandPath(robot.model_copy(update={"deviations": (deviation,)}), SERVOS, PERIOD)


def passed(path: CommandPath, told: list[float], position: float = 10.0) -> tuple[list[float], list[float]]:
    """Both servos are told the same; the second one does not deviate."""
    out = [path(np.array([t, t]), np.array([position, position])) for t in told]
    return [float(o[0]) for o in out], [float(o[1]) for o in out]


def test_a_robot_as_described_has_a_neutral_path():
    assert CommandPath(load_robot("nermo_lite"), SERVOS, PERIOD).neutral
    assert not path_of("servo_delay", delay=0.01).neutral


CASES = [
    ("servo_delay", {"delay": 0.010}, [0.0, 1.0, 2.0, 3.0, 4.0], [0.0, 0.0, 0.0, 1.0, 2.0]),
    ("servo_delay", {"delay": 0.0075}, [0.0, 1.0, 2.0, 3.0], [0.0, 0.0, 0.5, 1.5]),
    ("servo_offset", {"offset": 0.25}, [0.0, 1.0], [0.25, 1.25]),
    ("servo_rate_limit", {"limit": 100.0}, [0.0, 1.0, 1.0, 1.0, 1.0], [0.0, 0.5, 1.0, 1.0, 1.0]),
    ("servo_backlash", {"width": 1.0}, [0.0, 1.0, 2.0, 1.6, 1.0, 0.0], [0.0, 0.5, 1.5, 1.5, 1.5, 0.5]),
    ("servo_dead_band", {"half_width": 0.3}, [9.8, 9.5, 10.2], [10.0, 9.5, 10.0]),
]


def test_every_effect_on_commands_has_a_case():
    assert {effect for effect, *_ in CASES} == {kind.name for kind in EFFECTS.values() if kind.acts_on == "commands"}


@pytest.mark.parametrize(("effect", "values", "told", "expected"), CASES)
def test_each_deviation_does_what_it_says_to_its_servo_alone(effect, values, told, expected):
    first, second = passed(path_of(effect, **values), told)
    assert first == pytest.approx(expected)
    assert second == pytest.approx(told)


def test_after_a_reset_the_past_is_forgotten():
    path = path_of("servo_delay", delay=0.02)
    passed(path, [1.0, 1.0, 1.0])
    path.clear()
    assert passed(path, [3.0])[0] == pytest.approx([3.0])
