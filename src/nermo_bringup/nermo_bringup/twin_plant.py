"""The MuJoCo twin behind the emulated electronics: the emulated robot walks."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from nermo_description.parameters import RobotParameters
from nermo_hw.device.fault_injection import FaultError
from nermo_hw.device.plant import STEP, PlantSensors
from nermo_sensors.models.foot import TactileFeet
from nermo_sensors.parameters import tactile_of_robot
from nermo_sim.twin import BaseState, Twin

Array = NDArray[np.float64]

TRUTH_EVERY = 20
"""Steps."""


class TwinPlant:
    """A `nermo_hw` plant. Begins crouched, as a robot lies there whose servos have no power.

    on_truth: is told where base_link is, every `TRUTH_EVERY` steps.
    """

    def __init__(
        self, robot: RobotParameters, scene: str = "flat", on_truth: Callable[[BaseState], None] | None = None
    ) -> None:
        self._on_truth, self._steps = on_truth, 0
        self._twin = Twin(robot, scene, period_ns=round(STEP * 1e9))
        self._twin.reset("crouch")
        self._feet = TactileFeet(tactile_of_robot(robot.name))
        self._energised: NDArray[np.bool_] = np.ones(len(self._twin.layout.actuators), dtype=bool)
        self._felt_at = self._twin.time_ns

    def step(self, targets: Array, energised: NDArray[np.bool_]) -> None:
        """As `Plant` says: a servo without power has no torque, but the friction of its gears."""
        self._energised = energised.copy()
        self._twin.power(energised)
        here = self._twin.data.sensordata[self._twin.layout.servo_position]
        self._twin.step(np.where(energised, targets, here).tolist())
        self._steps += 1
        if self._on_truth is not None and self._steps % TRUTH_EVERY == 0:
            self._on_truth(self._twin.base_state())

    def sensors(self) -> PlantSensors:
        """As `Plant` says; the feet feel over the time since they were last asked."""
        sensors = self._twin.sensors()
        period = max(sensors.stamp - self._felt_at, 1_000_000) * 1e-9
        self._felt_at = sensors.stamp
        return PlantSensors(
            positions=np.array(sensors.servo_positions),
            velocities=np.array(sensors.servo_velocities),
            torques=np.where(self._energised, np.array(sensors.servo_torques), 0.0),
            knee_angles=np.array(sensors.knee_encoders),
            cells={cell: np.array(volts) for cell, volts in self._feet.read(sensors.foot_forces, period).items()},
            orientation=np.array(sensors.orientation),
            angular_velocity=np.array(sensors.angular_velocity),
            linear_acceleration=np.array(sensors.linear_acceleration),
        )

    def move_by_hand(self, servo: int, position: float) -> None:
        """Nobody's hand reaches into the simulation. Raises FaultError."""
        raise FaultError("the twin's servos cannot be turned by hand")
