"""The robot's twin, where `gap_monitor` runs one: drawn through the robot, in colours of how far each part is off."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from numpy.typing import NDArray
from rclpy.node import Node
from sensor_msgs.msg import JointState

from nermo_description.robots import AnyRobot
from nermo_web.gap_colours import colour_of, gaps_of
from nermo_web.nodes.latest import Latest
from nermo_web.robot_shape import RobotShape
from nermo_web.scene import Scene

FRESH_S = 0.5
"""A twin that has not moved for so long is none."""
MONITOR = "gap_monitor: gap"


class Ghost:
    """Follows the twin and the gap; the robot's own place is the twin's, for a twin by itself walks away."""

    def __init__(
        self, node: Node, robot: AnyRobot, scene_name: str, scene: Scene, refuse: Callable[[str], None]
    ) -> None:
        self._robot, self._scene_name, self._scene = robot, scene_name, scene
        self._joints = Latest(node, JointState, "twin/joint_states", refuse)
        self._shape: RobotShape | None = None
        self._moved_at = -math.inf
        self._gaps: dict[str, float] = {}

    def on_status(self, status: DiagnosticStatus) -> None:
        """What the monitor says of the gap, part by part."""
        if status.name.endswith(MONITOR):
            self._gaps = gaps_of({pair.key: pair.value for pair in status.values})

    def draw(self, position: NDArray[np.float64], turn: NDArray[np.float64]) -> None:
        """Moves it to where the robot is, or takes it away where nobody tells of a twin."""
        now = time.monotonic()
        if (joints := self._joints.take()) is None:
            if now - self._moved_at > FRESH_S:
                self._scene.hide_ghost()
            return
        self._moved_at = now
        if self._shape is None:
            # Its own: joints that one of the two does not name stay where they were.
            self._shape = RobotShape(self._robot, self._scene_name)
        placed = self._shape.place(position, turn, dict(zip(joints.name, joints.position, strict=False)))
        self._scene.show_ghost(placed, {body: colour_of(body, self._gaps) for body in self._shape.bodies})
