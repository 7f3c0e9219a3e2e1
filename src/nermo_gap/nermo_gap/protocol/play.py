"""A protocol played in process: a twin, or a mouse that differs from it, does what the pieces say."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from nermo_control.controller import Controller
from nermo_control.gait.knowledge_base import GaitParameters
from nermo_control.types import ControlCommand, Posture
from nermo_description.markers import MARKERS
from nermo_description.model import build_model
from nermo_description.parameters import LEGS, RobotParameters
from nermo_description.stand import Stand
from nermo_gap.protocol.types import REST, Piece, Segment
from nermo_gap.robots.simulated import Noise, Rows
from nermo_sim.loop import Script, schedule
from nermo_sim.twin import Twin

Array = NDArray[np.float64]

SETTLE = 1.0
"""[s] of the stand before a segment is recorded."""


@dataclass
class Body:
    """A mouse to play with.

    Attributes:
        robot: what its controller believes.
        model: makes what it really is.
        servos: makes what its servos make of their commands, anew for each segment: commands (n,) -> commands (n,).
        forces: makes what pulls at its bodies, anew for each segment, asked before each tick.
        noise: of its sensors.
    """

    robot: RobotParameters
    model: Callable[[], mujoco.MjModel]
    servos: Callable[[], Callable[[Array], Array]] | None = None
    forces: Callable[[], Callable[[mujoco.MjModel, mujoco.MjData], None]] | None = None
    noise: Noise = field(default_factory=Noise)
    markers: Array | None = None
    """(markers, 3) [m] Where markers are glued, beside the frames where they should be; None where it wears none."""

    @classmethod
    def twin(cls, robot: RobotParameters, markers: bool = False) -> Body:
        """The twin as it is."""
        return cls(robot, lambda: build_model(robot), markers=np.zeros((len(MARKERS), 3)) if markers else None)


def play(
    segment: Segment, body: Body, stand: Stand, rest: Array, random: np.random.Generator
) -> tuple[dict[str, Array], list[str]]:
    """A table of the segment as `simgap` reads it, the piece's number as column `run`; and what the operator is told.

    ``rest`` (7,) of the stand's spring.

    Raises:
        SimulationDivergedError: the mouse's simulation broke down.
    """
    model = body.model()
    if segment.scene == "hung":
        stand.enter(model, rest)
    twin = Twin(body.robot, model=model)
    if segment.scene == "hung":
        root = twin.layout.root_position
        twin.data.qpos[root : root + 7] = stand.pose()
        mujoco.mj_forward(twin.model, twin.data)
    servos = body.servos() if body.servos is not None else _unchanged
    forces = body.forces() if body.forces is not None else _no_forces
    rows, runs = Rows(twin, body.markers), []
    neutral = np.array([servo.neutral for servo in body.robot.servos.values()])
    for _ in range(round(SETTLE * 1e9 / twin.period_ns)):
        forces(twin.model, twin.data)
        twin.step(servos(neutral).tolist())
    for number, piece in enumerate(segment.pieces):
        driver = _Driver(piece, body.robot, twin)
        for tick in range(round(piece.seconds * 1e9 / twin.period_ns)):
            sensors = twin.sensors()
            told, phases = driver.at(tick * twin.period_ns * 1e-9)
            rows.add(sensors, told.tolist(), phases)
            runs.append(float(number))
            forces(twin.model, twin.data)
            twin.step(servos(told).tolist())
    table = rows.table(body.noise, random)
    table["t"] = table["t"] - table["t"][0]
    return table | {"run": np.array(runs)}, [segment.tell, *(piece.tell for piece in segment.pieces)]


class _Driver:
    """What the servos are told in a piece: its waves, or what the mouse's controller makes of its commands."""

    def __init__(self, piece: Piece, robot: RobotParameters, twin: Twin[RobotParameters]) -> None:
        self._piece, self._robot, self._twin = piece, robot, twin
        self._controller, self._script = None, None
        if piece.commands:
            self._controller = Controller(robot, GaitParameters(), twin.period_ns)
            self._script = script_of(piece, twin.time_ns)

    def at(self, t: float) -> tuple[Array, list[float]]:
        """Servo angles (n,) [rad] in the robot's order at ``t`` [s], and the legs' phases."""
        if self._controller is None or self._script is None:
            return np.array(list(self._piece.targets(t, self._robot).values())), [0.0] * len(LEGS)
        twin = self._twin
        sensors = twin.sensors()
        output = self._controller.step(
            sensors.stamp, self._script(sensors.stamp), twin.odometry(), sensors.servo_positions, sensors.imu
        )
        return np.array(output.servo_positions), list(output.leg_states.phases)


def script_of(piece: Piece, begin_ns: int = 0) -> Script:
    """What the operator says in a piece that begins at a time [ns]: stand, the commands, stand."""
    stand = ControlCommand(0, posture=Posture.STAND)
    says = [(0.0, stand), *((REST + t, c) for t, c in piece.commands), (piece.seconds - REST, stand)]
    return schedule([(begin_ns * 1e-9 + t, replace(command, stamp=0)) for t, command in says])


def _unchanged(commands: Array) -> Array:
    return commands


def _no_forces(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    pass
