"""For tests: a robot that stands and is well."""

from __future__ import annotations

import numpy as np

from nermo_description.robots import load_robot
from nermo_hw.sbcp.boards import TACTILE_CHANNELS
from nermo_hw.types import Fault, SensorSample

ROBOT = load_robot("nermo_lite")
SERVOS = tuple(ROBOT.servos)
NEUTRAL = np.array([servo.neutral for servo in ROBOT.servos.values()])
BEGIN = 1_700_000_000_000_000_000
"""[ns]"""

SAMPLE = SensorSample(
    stamp=BEGIN,
    elapsed=0.005,
    servo_positions=NEUTRAL,
    servo_velocities=np.zeros(len(SERVOS)),
    servo_currents=np.full(len(SERVOS), 0.1),
    knee_angles=np.zeros(4),
    cells={cell: np.zeros(4) for cell in TACTILE_CHANNELS},
    orientation=np.array([1.0, 0.0, 0.0, 0.0]),
    angular_velocity=np.zeros(3),
    linear_acceleration=np.array([0.0, 0.0, 9.81]),
    battery_voltage=7.6,
    battery_current=0.3,
    faults=Fault(0),
    limp=False,
)
