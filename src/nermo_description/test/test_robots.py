"""Parameter files: what comes with the package, and what is said of files that cannot be used."""

from __future__ import annotations

import copy
import math
from pathlib import Path
from typing import Any

import pytest
import yaml

from nermo_description.parameter_files import ParameterError, read_yaml
from nermo_description.parameters import SERVOS
from nermo_description.robots import load_robot, robot_names

LITE = Path(__file__).parents[1] / "nermo_description" / "robots" / "nermo_lite.yaml"


def write(folder: Path, path: str, value: Any) -> Path:
    """nermo_lite with one field changed, or taken away with `...`."""
    data = copy.deepcopy(read_yaml(LITE))
    *way, last = path.split(".")
    place = data
    for part in way:
        place = place[part]
    if value is ...:
        del place[last]
    else:
        place[last] = value
    file = folder / "mouse.yaml"
    file.write_text(yaml.safe_dump(data))
    return file


def test_robots_that_come_with_the_package():
    assert robot_names() == ("nermo", "nermo_lite")
    assert len(load_robot("nermo").servos) == 13  # N table 4.2
    assert len(load_robot("nermo_lite").servos) == 11  # N table A.3


def test_servos_are_in_their_order():
    for name in robot_names():
        assert list(load_robot(name).servos) == [servo for servo in SERVOS if servo in load_robot(name).servos]


def test_nermo_says_only_what_differs():
    nermo, lite = load_robot("nermo"), load_robot("nermo_lite")
    assert nermo.front_leg == lite.front_leg
    assert nermo.spine == lite.spine
    assert nermo.masses.total == 0.275  # N table 4.1
    assert lite.masses.total == 0.270  # N table A.3
    assert math.degrees(nermo.front_leg_dynamics.caddy_tilt) == pytest.approx(45.0)  # N A.2.1
    assert math.degrees(nermo.rear_leg_dynamics.caddy_tilt) == pytest.approx(30.0)
    assert lite.front_leg_dynamics.caddy_tilt == lite.rear_leg_dynamics.caddy_tilt == 0.0
    assert nermo.spine_dynamics.vertical is not None
    assert lite.spine_dynamics.vertical is None
    assert nermo.servos["tail"].integral_gain > 0.0 == lite.servos["tail"].integral_gain


def test_a_file_of_ones_own(tmp_path):
    assert load_robot(write(tmp_path, "stiffness_scale", 0.9)).stiffness_scale == 0.9


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        ("front_leg.upper_lenght", 0.03, ["front_leg.upper_lenght", "no such field", "'upper_length'"]),
        ("spine_dynamics.lateral.stifness", 1.0, ["spine_dynamics.lateral.stifness", "'stiffness'"]),
        ("servos.tail.lowr", 1.0, ["servos.tail.lowr", "'lower'"]),
        ("servo_type.max_torqe", 1.0, ["servo_type.max_torqe", "'max_torque'"]),
        ("servo_type.max_torque", ..., ["servo_type.max_torque", "missing"]),
        ("masses", ..., ["masses", "missing"]),
        ("front_leg.upper_length", -0.03, ["front_leg.upper_length", "-0.03", "greater than 0"]),
        ("front_leg.upper_length", math.nan, ["front_leg.upper_length", "finite"]),
        ("servo_type.max_torque", math.inf, ["servo_type.max_torque", "inf", "finite"]),
        ("front_leg.tendon_type", "type_4", ["front_leg.tendon_type", "type_4", "type_3"]),
        ("hip_positions", [[0, 0, 0]], ["hip_positions"]),
        ("servos.tail.neutral", 3.0, ["servos.tail", "neutral 3.0", "[-1.2, 1.2]"]),
        ("servos.nose", {"lower": -1.0, "upper": 1.0, "neutral": 0.0}, ["unknown nose", "head_pan"]),
        ("servos.tail", ..., ["missing tail"]),
        ("postures.sit.tail", 9.0, ["postures.sit.tail", "9.0", "[-1.2, 1.2]"]),
        ("postures.sit.nose", 0.0, ["postures.sit", "nose"]),
        ("masses.total", 0.07, ["masses", "nothing for the torsos"]),
        ("base", "dog", ["base", "'dog'", "nermo"]),
    ],
)
def test_errors_name_file_field_value_and_what_is_allowed(tmp_path, path, value, words):
    file = write(tmp_path, path, value)
    with pytest.raises(ParameterError) as error:
        load_robot(file)
    assert all(word in str(error.value) for word in [str(file), *words]), str(error.value)


def test_one_wrong_field_is_one_line(tmp_path):
    with pytest.raises(ParameterError) as error:
        load_robot(write(tmp_path, "servo_type.armature", -1.0))
    assert len(str(error.value).splitlines()) == 1


@pytest.mark.parametrize("text", ["a: [", "- 1\n- 2", "", "\x00"])
def test_what_is_not_a_robot_is_an_error(tmp_path, text):
    file = tmp_path / "mouse.yaml"
    file.write_text(text)
    with pytest.raises(ParameterError, match=str(file)):
        load_robot(file)


def test_names_and_files_that_do_not_exist(tmp_path):
    with pytest.raises(ParameterError, match="nermo_lite"):
        load_robot("nermo_light")
    with pytest.raises(ParameterError, match="cannot be read"):
        load_robot(tmp_path / "none.yaml")
