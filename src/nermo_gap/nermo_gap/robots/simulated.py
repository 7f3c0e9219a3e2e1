"""Recordings made in process: a changed twin walks under the controller, and its channels are written as a table."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from nermo_control.controller import Controller
from nermo_control.gait.knowledge_base import GaitParameters
from nermo_control.types import ControlCommand
from nermo_description.markers import MARKERS
from nermo_description.model import build_model
from nermo_description.parameters import LEGS, RobotParameters
from nermo_gap.robots.channels import GYRO, TRACKER, command, encoder, marker, phase, position, torque
from nermo_sim.loop import Loop, Script, schedule
from nermo_sim.sensor_data import SensorData
from nermo_sim.twin import Twin

Array = NDArray[np.float64]
Change = Callable[[mujoco.MjModel], None]
Servos = Callable[[int, Array], Array]
"""What the servos make of their commands: (tick, commands [rad]) -> commands [rad]."""


@dataclass(frozen=True)
class Noise:
    """Standard deviations of the sensors' white noise."""

    position: float = 1.5e-3
    """[rad], of servos and knee encoders: 12 bits"""
    torque: float = 3e-3
    """[N m]"""
    gyro: float = 0.01
    """[rad/s]"""
    place: float = 2e-4
    """[m], of the tracker"""
    turn: float = 2e-3
    """[rad], of the tracker"""
    hidden: float = 0.02
    """Share of the time for which the tracker does not see a marker."""


def excitation(seconds: float, speed: float = 0.08) -> Script:
    """Walks that move everything: straight, curves to both sides, slow and fast, in turn."""
    commands: list[tuple[float, ControlCommand]] = []
    pattern = ((1.0, 0.0), (0.8, 0.4), (1.0, 0.0), (0.6, -0.4), (0.8, 0.0))
    period = 4.0
    for k in range(int(np.ceil(seconds / period))):
        forward, turn = pattern[k % len(pattern)]
        commands.append((k * period, ControlCommand(0, forward_velocity=forward * speed, turn_rate=turn)))
    return schedule(commands)


def simulate(
    robot: RobotParameters,
    seconds: float,
    *,
    change: Change | None = None,
    servos: Servos | None = None,
    script: Script | None = None,
    noise: Noise | None = None,
    seed: int = 0,
    gait_parameters: GaitParameters | None = None,
) -> dict[str, Array]:
    """A table of the twin walking for a time [s], with all channels that any mouse has.

    change: edits the compiled model of the twin. servos: what becomes of the commands on their way; the table holds
    them as they were given.

    Raises SimulationDivergedError.
    """
    model = build_model(robot)
    if change is not None:
        change(model)
        mujoco.mj_setConst(model, mujoco.MjData(model))
    twin = Twin(robot, model=model)
    loop = Loop(twin, Controller(robot, gait_parameters or GaitParameters(), twin.period_ns))
    script, noise = script or excitation(seconds), noise or Noise()
    ticks = round(seconds * 1e9 / twin.period_ns)
    rows = Rows(twin)
    for tick in range(ticks):
        sensors = loop.sensors
        output = loop.controller.step(
            sensors.stamp, script(sensors.stamp), twin.odometry(), sensors.servo_positions, sensors.imu
        )
        rows.add(sensors, output.servo_positions, output.leg_states.phases)
        told = np.array(output.servo_positions)
        loop.sensors = twin.step((told if servos is None else servos(tick, told)).tolist())
    return rows.table(noise, np.random.default_rng(seed))


HIDDEN = 0.1
"""[s] for which a marker is hidden at a time, in the mean: a leg passes before it."""


class Rows:
    """What is measured of a twin and told to it, tick by tick, with all channels that any mouse has.

    ``glued`` (markers, 3) [m] is where the markers are in the frames where they should be, in the order of `MARKERS`;
    None where there are none.
    """

    def __init__(self, twin: Twin[RobotParameters], glued: Array | None = None) -> None:
        self._twin, self._servos = twin, list(twin.robot.servos)
        self._rows: list[list[float]] = []
        self._glued = None if glued is None else dict(zip(MARKERS, glued, strict=True))

    def add(self, sensors: SensorData, told: Sequence[float], phases: Sequence[float]) -> None:
        """One tick, before the twin obeys."""
        state = self._twin.base_state()
        self._rows.append(
            [
                sensors.stamp * 1e-9,
                *told,
                *sensors.servo_positions,
                *sensors.servo_torques,
                *sensors.knee_encoders,
                *sensors.angular_velocity,
                *state.position,
                *state.quaternion,
                *phases,
                *self._seen(),
            ]
        )

    def _seen(self) -> list[float]:
        """Where the markers are [m]."""
        if self._glued is None:
            return []
        data, seen = self._twin.data, []
        for place, (kind, name) in MARKERS.items():
            frame = data.site(name) if kind == "site" else data.body(name)
            seen += list(frame.xpos + frame.xmat.reshape(3, 3) @ self._glued[place])
        return seen

    def table(self, noise: Noise, random: np.random.Generator) -> dict[str, Array]:
        """All ticks, with the sensors' noise."""
        columns = [
            "t",
            *(command(s) for s in self._servos),
            *(position(s) for s in self._servos),
            *(torque(s) for s in self._servos),
            *(encoder(leg) for leg in LEGS),
            *GYRO,
            *TRACKER,
            *(phase(leg) for leg in LEGS),
            *(column for place in self._glued or () for column in marker(place)),
        ]
        table = dict(zip(columns, np.array(self._rows).T, strict=True))
        _add_noise(table, self._servos, noise, random)
        if self._glued is not None:
            _watch(table, noise, random)
        return table


def _add_noise(table: dict[str, Array], servos: Sequence[str], noise: Noise, random: np.random.Generator) -> None:
    for servo in servos:
        table[position(servo)] = table[position(servo)] + noise.position * random.standard_normal(len(table["t"]))
        table[torque(servo)] = table[torque(servo)] + noise.torque * random.standard_normal(len(table["t"]))
    for leg in LEGS:
        table[encoder(leg)] = table[encoder(leg)] + noise.position * random.standard_normal(len(table["t"]))
    for names, deviation in ((GYRO, noise.gyro), (TRACKER[:3], noise.place), (TRACKER[3:], 0.5 * noise.turn)):
        for name in names:
            table[name] = table[name] + deviation * random.standard_normal(len(table["t"]))


def _watch(table: dict[str, Array], noise: Noise, random: np.random.Generator) -> None:
    """A tracker's noise on markers, and the times for which it does not see one."""
    time = table["t"]
    for place in MARKERS:
        lost = np.zeros(len(time), bool)
        for begin in random.uniform(time[0], time[-1], random.poisson(noise.hidden * np.ptp(time) / HIDDEN)):
            lost |= (time >= begin) & (time < begin + random.exponential(HIDDEN))
        for column in marker(place):
            seen = table[column] + noise.place * random.standard_normal(len(time))
            table[column] = np.where(lost, np.nan, seen)
