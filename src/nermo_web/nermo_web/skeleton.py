"""A robot's bodies as frames of viser's scene, each in the frame of the body that carries it."""

from __future__ import annotations

import mujoco
import numpy as np
import viser

from nermo_web.robot_shape import Placed, RobotShape

SAME_M, SAME_TURN = 1e-5, 1e-3
"""Places [m] and quaternions (2 mrad) that differ by less are the same to the eye."""


class Skeleton:
    """The frames below ``path``, to hang meshes in.

    A joint that turns moves one frame in that of its parent, and a tail that hangs still none: viser takes a tenth of a
    millisecond for each place and each turn that it is told, whether it changed or not.
    """

    def __init__(self, scene: viser.SceneApi, path: str, shape: RobotShape) -> None:
        self.paths: dict[str, str] = {}
        """Where each body is in the scene."""
        for name in shape.bodies:
            self.paths[name] = f"{self.paths.get(shape.carriers[name], path)}/{name}"
        self.frames = {name: scene.add_frame(place, show_axes=False) for name, place in self.paths.items()}
        self._carriers = shape.carriers
        self._places = {name: np.full(3, np.inf) for name in shape.bodies}
        self._turns = {name: np.full(4, np.inf) for name in shape.bodies}

    def move(self, placed: Placed) -> None:
        """Puts every body where it is."""
        place, turn, back, back_turn = np.zeros(3), np.zeros(4), np.zeros(3), np.zeros(4)
        for name, frame in self.frames.items():
            carrier = self._carriers[name]
            place[:], turn[:] = placed.position[name], placed.turn[name]
            if carrier:
                mujoco.mju_negPose(back, back_turn, placed.position[carrier], placed.turn[carrier])
                mujoco.mju_mulPose(place, turn, back, back_turn, placed.position[name], placed.turn[name])
            if np.abs(place - self._places[name]).max() > SAME_M:
                self._places[name][:] = frame.position = place
            if np.abs(turn - self._turns[name]).max() > SAME_TURN:
                self._turns[name][:] = frame.wxyz = turn
