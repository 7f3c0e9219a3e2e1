"""What the page shows of the graph: topics in, scene and figures out."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from sensor_msgs.msg import BatteryState, JointState

from nermo_description.robots import AnyRobot
from nermo_interfaces.msg import ControlCommand, FootForces, LegLoads, ServoStates
from nermo_node import qos
from nermo_node.time import to_nanoseconds
from nermo_web.nodes.ghost import Ghost
from nermo_web.nodes.latest import Latest
from nermo_web.robot_shape import RobotShape
from nermo_web.scene import Scene
from nermo_web.trail import Speedometer, Trail

FRESH_S = 0.5
"""A command that is older commands no more."""
TROUBLE_S = 3.0
"""So long a warning is shown."""
RECORDER_S = 5.0
"""A recorder that has not spoken for so long is none; it speaks once a second."""
WAY_PERIOD_S = 0.5
"""Between two drawings of the way, which is sent whole."""


class ShownTopics:
    """Follows the topics, moves the scene, and says how the mouse fares.

    Args:
        node: Whose subscriptions these are.
        robot: Which robot it is.
        scene: Name or MJCF file of the scene that it is in.
        refuse: Gets a sentence for every message that is refused.
    """

    def __init__(self, node: Node, robot: AnyRobot, scene: str, refuse: Callable[[str], None]) -> None:
        self._shape = RobotShape(robot, scene)
        self.scene = Scene(self._shape)
        self._ghost = Ghost(node, robot, scene, self.scene, refuse)
        self._trail, self._speed = Trail(), Speedometer()
        self._way_at = 0.0
        self._angles: dict[str, float] = {}
        self._forces = np.zeros((4, 3), np.float32)
        self._loads: list[float] | None = None
        self._battery: float | None = None
        self._odometry: Odometry | None = None
        self._turn_rate = 0.0
        self._command = 0.0, 0.0
        """Forward [m/s] and turning [rad/s], as whoever drives said last."""
        self._command_at = -math.inf
        self._trouble: dict[str, tuple[float, str]] = {}
        self._power, self._pace = "", ""
        self._recorded: tuple[float, int | None] = -math.inf, None
        """When the recorder has spoken, and how many messages it has written; None: it waits."""

        def latest(kind: type, topic: str) -> Latest:
            return Latest(node, kind, topic, refuse)

        self._odom, self._joints = latest(Odometry, "odom"), latest(JointState, "joint_states")
        self._servo_states = latest(ServoStates, "servo_states")
        self._foot_forces = latest(FootForces, "truth/foot_forces")
        self._leg_loads, self._batteries = latest(LegLoads, "leg_loads"), latest(BatteryState, "battery")
        self._commands = Latest(node, ControlCommand, "control_command", refuse, qos.COMMAND)
        self._twists = Latest(node, TwistStamped, "cmd_vel", refuse, qos.COMMAND)
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 50)

    def draw(self) -> None:
        """Follows the mouse, and moves the scene if anybody sees it; to be called some 20 times a second."""
        if (odometry := self._odom.take()) is None:
            return
        self._odometry = odometry
        place, q = odometry.pose.pose.position, odometry.pose.pose.orientation
        turn = np.array([q.w, q.x, q.y, q.z])
        if not np.linalg.norm(turn) > 0.5:
            return
        yaw = math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))
        self._speed.add(to_nanoseconds(odometry.header.stamp), place.x, place.y, yaw)
        self._turn_rate += 0.1 * (odometry.twist.twist.angular.z - self._turn_rate)
        self._trail.add(place.x, place.y)
        if not self.scene.watched:
            return
        if (servos := self._servo_states.take()) is not None:
            self._angles |= self._shape.by_servos(dict(zip(servos.name, servos.position, strict=False)))
        if (joints := self._joints.take()) is not None:
            self._angles |= dict(zip(joints.name, joints.position, strict=False))
        if (forces := self._foot_forces.take()) is not None:
            self._forces = np.array([(each.x, each.y, each.z) for each in forces.force], np.float32)
        position = np.array([place.x, place.y, place.z])
        placed = self._shape.place(position, turn, self._angles)
        self.scene.show(placed, self._forces, (place.x, place.y))
        self._ghost.draw(position, turn)
        if self._trail.news and time.monotonic() - self._way_at > WAY_PERIOD_S:
            self._way_at, self._trail.news = time.monotonic(), False
            self.scene.show_way(self._trail)

    def told(self) -> dict[str, Any]:
        """What the page's figures say, as JSON has it."""
        now = time.monotonic()
        if (twist := self._twists.take()) is not None:
            self._command, self._command_at = (twist.twist.linear.x, twist.twist.angular.z), now
        if (command := self._commands.take()) is not None:
            self._command, self._command_at = (command.forward_velocity, command.turn_rate), now
        if (loads := self._leg_loads.take()) is not None:
            self._loads = [round(float(one), 3) for one in loads.load]
        if (battery := self._batteries.take()) is not None:
            self._battery = round(battery.voltage, 2) if math.isfinite(battery.voltage) else None
        forward, turning = self._command if now - self._command_at < FRESH_S else (0.0, 0.0)
        pose = self._odometry.pose.pose.position if self._odometry is not None else None
        return {
            "commanded_m_s": round(forward, 4),
            "commanded_rad_s": round(turning, 3),
            "speed_m_s": round(self._speed.forward, 4),
            "turn_rad_s": round(self._turn_rate, 3),
            "place_m": None if pose is None else [round(pose.x, 3), round(pose.y, 3), round(pose.z, 3)],
            "loads_n": self._loads,
            "battery_v": self._battery,
            "power": self._power,
            "pace": self._pace,
            "recorder": now - self._recorded[0] < RECORDER_S,
            "recorded": self._recorded[1],
            "trouble": [text for at, text in sorted(self._trouble.values()) if now - at < TROUBLE_S][-3:],
        }

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            self._ghost.on_status(status)
            node = status.name.partition(":")[0].rpartition("/")[2]
            if status.level in (DiagnosticStatus.WARN, DiagnosticStatus.ERROR):
                self._trouble[status.name] = time.monotonic(), f"{node}: {status.message}"[:300]
            if status.name.endswith(("mujoco_sim: twin", "safety_supervisor: supervisor", "robot_end: supervisor")):
                values = {pair.key: pair.value for pair in status.values}
                self._power = status.message[:300]
                self._pace = values.get("real_time_factor", "")
            if status.name.endswith("recorder: recording"):
                written = {pair.key: pair.value for pair in status.values}.get("messages_written", "")
                self._recorded = time.monotonic(), int(written) if written.isdecimal() else None
        if len(self._trouble) > 100:
            self._trouble.clear()


def as_text(kind: str, **values: Any) -> str:
    """A message to the page."""
    return json.dumps({"kind": kind, **values}, allow_nan=False, separators=(",", ":"))
