"""The in-process loop: controller and twin stepped in turn, deterministic, as fast as the processor allows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Generic, Protocol, TypeVar

from nermo_control.controller import Controller
from nermo_control.gait.knowledge_base import GaitParameters
from nermo_control.types import ControlCommand, Imu, LegLoads, MotionOutput, Odometry
from nermo_description.parameters import RobotParameters
from nermo_sim.run_table import Recorder, Recording
from nermo_sim.sensor_data import SensorData
from nermo_sim.twin import Twin

Script = Callable[[int], ControlCommand | None]
"""The operator: the command at a time [ns], or None."""


Feel = Callable[[SensorData, MotionOutput], LegLoads | None]
"""What is felt of the loads after a tick: from an estimator, or from the truth."""

REPEAT_NS = 50_000_000
"""An operator says the same again this often, not each tick: the controller looks at a new command only once."""


def constant(command: ControlCommand) -> Script:
    """An operator who keeps saying the same."""
    said = command

    def script(stamp: int) -> ControlCommand:
        nonlocal said
        if said is command or not 0 <= stamp - said.stamp < REPEAT_NS:
            said = replace(command, stamp=stamp)
        return said

    return script


def schedule(commands: Sequence[tuple[float, ControlCommand]]) -> Script:
    """An operator who says each command from its time [s] on, until the next one; nothing before the first.

    Raises ValueError where the times do not rise.
    """
    times = [time for time, _ in commands]
    if sorted(set(times)) != times:
        raise ValueError(f"times = {times}: must rise from one command to the next")

    steps = [(round(time * 1e9), constant(command)) for time, command in commands]

    def script(stamp: int) -> ControlCommand | None:
        current: Script | None = None
        for begin, saying in steps:
            if stamp < begin:
                break
            current = saying
        return None if current is None else current(stamp)

    return script


class Steps(Protocol):
    """A controller: of the mouse, or of a robot with pantograph legs."""

    def step(
        self,
        stamp: int,
        control_command: ControlCommand | None,
        odometry: Odometry | None,
        servo_positions: Sequence[float],
        imu: Imu | None = None,
        loads: LegLoads | None = None,
    ) -> MotionOutput:
        """One control tick at `stamp` [ns]."""
        ...


ControllerType = TypeVar("ControllerType", bound=Steps)


class Loop(Generic[ControllerType]):
    """One twin under one controller. `tick` is all there is to it."""

    def __init__(self, twin: Twin[Any], controller: ControllerType, feel: Feel | None = None) -> None:
        """`feel` tells the controller the loads of the feet, where it wants them."""
        self.twin, self.controller, self._feel = twin, controller, feel
        self.sensors: SensorData = twin.sensors()
        self._loads: LegLoads | None = None

    @classmethod
    def build(cls, robot: RobotParameters, gait_parameters: GaitParameters, scene: str = "flat") -> Loop[Controller]:
        """A loop with everything at its defaults."""
        twin = Twin(robot, scene)
        return Loop(twin, Controller(robot, gait_parameters, twin.period_ns))

    def tick(self, command: ControlCommand | None, recorder: Recorder | None = None) -> MotionOutput:
        """One control tick: the controller answers the newest sensor data, the twin obeys. Returns the answer.

        Raises SimulationDivergedError.
        """
        twin, sensors = self.twin, self.sensors
        output = self.controller.step(
            sensors.stamp, command, twin.odometry(), sensors.servo_positions, sensors.imu, self._loads
        )
        self.sensors = twin.step(output.servo_positions)
        if self._feel is not None:
            self._loads = self._feel(self.sensors, output)
        if recorder is not None:
            recorder.add(self.sensors, output)
        return output

    def run(
        self,
        script: Script,
        duration: float,
        *,
        record: bool = True,
        until: Callable[[Twin[Any]], bool] | None = None,
        before_tick: Callable[[], None] | None = None,
    ) -> Recording:
        """Runs for a time [s], or until a condition on the twin holds.

        before_tick is called before each tick, for disturbances. Without `record` the recording stays empty.

        Raises SimulationDivergedError.
        """
        ticks = round(duration * 1e9 / self.twin.period_ns)
        recorder = Recorder(self.twin, ticks if record else 0)
        for _ in range(ticks):
            if before_tick is not None:
                before_tick()
            self.tick(script(self.sensors.stamp), recorder if record else None)
            if until is not None and until(self.twin):
                break
        return recorder.recording()
