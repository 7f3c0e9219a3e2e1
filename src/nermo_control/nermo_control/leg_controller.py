"""The leg controller: foot positions to servo positions (N 5.4.1)."""

from __future__ import annotations

from collections.abc import Sequence

from nermo_control.legs.kinematics import LegKinematics
from nermo_description.parameters import LEGS, RobotParameters


class LegController:
    """Inverse kinematics of the four legs, clamped to the workspace and to the servos' ranges."""

    def __init__(self, robot: RobotParameters) -> None:
        index = {name: number for number, name in enumerate(robot.servos)}
        front, rear = LegKinematics(robot.front_leg, "front"), LegKinematics(robot.rear_leg, "rear")
        self._legs = []
        for leg, kinematics in zip(LEGS, (front, front, rear, rear), strict=True):
            hip, knee = f"{leg}_hip", f"{leg}_knee"
            limits = (
                robot.servos[hip].lower,
                robot.servos[hip].upper,
                robot.servos[knee].lower,
                robot.servos[knee].upper,
            )
            warning = f"{leg}: foot target out of reach, clamped"
            self._legs.append((kinematics.inverse, index[hip], index[knee], limits, warning))

    def step(self, x: Sequence[float], z: Sequence[float], servos: list[float], warnings: list[str]) -> None:
        """Writes the leg servos' positions [rad] for feet at x, z [m] in their leg planes into `servos`.

        What had to be clamped is added to `warnings`.
        """
        for leg in range(len(LEGS)):
            if self.place(leg, x[leg], z[leg], servos):
                warnings.append(self._legs[leg][-1])

    def place(self, leg: int, x: float, z: float, servos: list[float]) -> bool:
        """The same of one leg; whether something had to be clamped."""
        inverse, hip, knee, (hip_lower, hip_upper, knee_lower, knee_upper), _ = self._legs[leg]
        q1, q2, clamped = inverse(x, z)
        servos[hip] = hip_lower if q1 < hip_lower else hip_upper if q1 > hip_upper else q1
        servos[knee] = knee_lower if q2 < knee_lower else knee_upper if q2 > knee_upper else q2
        return clamped or servos[hip] != q1 or servos[knee] != q2
