"""The frames of the scene, one in the other, put every body where it is, and only what moved is told."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from nermo_description.robots import load_any_robot
from nermo_web.robot_shape import Placed, RobotShape
from nermo_web.skeleton import SAME_TURN, Skeleton

UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])


class Frame:
    """A frame that counts what it is told."""

    def __init__(self) -> None:
        self.__dict__.update(told=0, position=np.zeros(3), wxyz=UPRIGHT)

    def __setattr__(self, name: str, value: np.ndarray) -> None:
        self.__dict__["told"] += 1
        self.__dict__[name] = np.array(value)


class Frames:
    """As much of viser's scene as a skeleton asks for."""

    def __init__(self) -> None:
        self.made: dict[str, Frame] = {}

    def add_frame(self, place: str, show_axes: bool) -> Frame:
        assert not show_axes
        return self.made.setdefault(place, Frame())

    def world(self, place: str) -> tuple[np.ndarray, np.ndarray]:
        """Where the frame at a path is, its carriers' poses one after the other."""
        position, turn = np.zeros(3), UPRIGHT.copy()
        steps = place.split("/")
        for k in range(2, len(steps) + 1):
            if (frame := self.made.get("/".join(steps[:k]))) is not None:
                before, turned = position.copy(), turn.copy()
                mujoco.mju_mulPose(position, turn, before, turned, frame.position, frame.wxyz)
        return position, turn


def _placed(shape: RobotShape, random: np.random.Generator) -> Placed:
    angles = {name: float(random.uniform(-0.3, 0.3)) for name in shape._joints}
    turn = np.array([1.0, *random.uniform(-0.3, 0.3, 3)])
    return shape.place(random.uniform(-0.5, 0.5, 3), turn, angles)


@pytest.mark.parametrize("name", ["nermo_lite", "nermo", "cheetah_cub"])
def test_every_body_is_where_it_is_through_all_that_carry_it(name: str) -> None:
    shape, frames, random = RobotShape(load_any_robot(name)), Frames(), np.random.default_rng(3)
    skeleton = Skeleton(frames, "/ground", shape)  # type: ignore[arg-type]
    for _ in range(3):
        placed = _placed(shape, random)
        skeleton.move(placed)
        for body in shape.bodies:
            position, turn = frames.world(skeleton.paths[body])
            assert position == pytest.approx(placed.position[body], abs=2e-3), body
            assert abs(turn @ placed.turn[body]) == pytest.approx(1.0, abs=len(shape.bodies) * SAME_TURN**2), body


def test_only_what_moved_is_told() -> None:
    shape, frames = RobotShape(load_any_robot("nermo_lite")), Frames()
    skeleton = Skeleton(frames, "/ground", shape)  # type: ignore[arg-type]
    here, there = np.array([0.0, 0.0, 0.05]), np.array([0.01, 0.0, 0.05])
    skeleton.move(shape.place(here, UPRIGHT, {}))
    for frame in frames.made.values():
        frame.__dict__["told"] = 0
    skeleton.move(shape.place(there, UPRIGHT, {}))
    assert {name for name, frame in skeleton.frames.items() if frame.told} == {"torso"}, "it took the others along"
    skeleton.move(shape.place(there, UPRIGHT, {"front_left_knee_joint": 1.1}))
    moved = {name for name, frame in skeleton.frames.items() if frame.told} - {"torso"}
    assert moved == {"front_left_lower"}
    assert shape.carriers["front_left_paw"] == "front_left_lower" and shape.carriers["torso"] == ""
