"""The twin beside the robot: its colours, and that it comes and goes."""

from __future__ import annotations

import numpy as np
import pytest

from nermo_description.robots import load_any_robot
from nermo_web.gap_colours import AGREES, DIFFERS, FAR, SAME, UNKNOWN, colour_of, gaps_of
from nermo_web.robot_shape import RobotShape
from nermo_web.scene import Scene


def test_gaps_are_what_the_monitor_says_in_numbers() -> None:
    told = {
        "front_left_leg_gap": "0.4",
        "body_gap": "nan",
        "spine_gap": "far",
        "restarts": "3",
        "rear_left_leg_gap": "9",
    }
    assert gaps_of(told) == {"front_left_leg": 0.4, "rear_left_leg": 9.0}


@pytest.mark.parametrize(
    ("body", "colour"),
    [
        ("front_left_paw", AGREES),
        ("rear_left_knee_pulley", DIFFERS),
        ("spine_3", tuple(round(0.5 * (a + b)) for a, b in zip(AGREES, DIFFERS, strict=True))),
        ("torso", DIFFERS),
        ("front_right_upper", UNKNOWN),
    ],
)
def test_a_body_has_the_colour_of_its_part(body: str, colour: tuple[int, int, int]) -> None:
    gaps = {"front_left_leg": 0.5 * SAME, "rear_left_leg": 10.0 * FAR, "spine": 0.5 * (SAME + FAR), "body": FAR}
    assert colour_of(body, gaps) == colour


def test_a_ghost_is_brought_moved_and_taken_away() -> None:
    shape = RobotShape(load_any_robot("nermo_lite"))
    scene = Scene(shape)
    try:
        scene.hide_ghost()
        assert not scene.ghost_seen
        colours = dict.fromkeys(shape.bodies, AGREES)
        placed = shape.place(np.array([0.3, 0.1, 0.05]), np.array([1.0, 0.0, 0.0, 0.0]), {})
        scene.show_ghost(placed, colours)
        scene.show_ghost(placed, colours | {"torso": DIFFERS})
        assert scene.ghost_seen
        assert scene._ghost is not None
        np.testing.assert_allclose(scene._ghost_skeleton.frames["torso"].position, placed.position["torso"])
        assert {mesh.color for body, mesh in scene._ghost_meshes if body == "torso"} == {DIFFERS}
        scene.hide_ghost()
        assert not scene.ghost_seen
    finally:
        scene.close()
