"""The twin as a ROS node: servo commands in; clock, sensor data and ground truth out. It is the graph's clock."""

from __future__ import annotations

import sys
import time
from pathlib import Path

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.task import Future
from std_srvs.srv import SetBool

from nermo_description.command_follower import Following
from nermo_description.emergency_stops import EmergencyStops
from nermo_description.robots import load_any_robot
from nermo_description.servo_command import ServoCommandDoor
from nermo_description.silence import HOLD
from nermo_interfaces.msg import ServoCommand
from nermo_interfaces.srv import PushRobot, ResetSimulation, StepSimulation
from nermo_node.command_input import CommandInput
from nermo_node.diagnostics import ERROR, OK, WARN, Diagnostics, Status
from nermo_node.emergency_stop_input import EmergencyStopInput
from nermo_node.parameters import declare
from nermo_node.run import run
from nermo_node.time import to_message, to_nanoseconds
from nermo_sim.divergence import SimulationDivergedError
from nermo_sim.nodes.sensor_publishers import SensorPublishers
from nermo_sim.nodes.views import open_views
from nermo_sim.pacing import Latency, Pacer, Patience
from nermo_sim.sensor_data import TYPICAL_NOISE, SensorData
from nermo_sim.sim_parameters import SimParameters
from nermo_sim.twin import Twin

REPEAT_AFTER = 0.25
"""In stepped mode, a tick that nobody has answered for so long [s] is published again: a node may have come late."""

BUSY_NS = 20_000_000
"""As fast as possible still means to listen to the graph every so often."""
REMEMBERED_TICKS = 400
UNSEEN_RAD = 0.5e-3
"""[rad] So far beyond its range a servo is held without a word: rounding at the edge, and less than the words show."""
LARGEST_STEP = 1_000_000


class MujocoSim(Node):
    """Steps the twin: at its pace, or in stepped mode whenever a tick has been answered."""

    def __init__(self) -> None:
        super().__init__("mujoco_sim")
        self._settings = parameters = declare(self, SimParameters)
        noise = TYPICAL_NOISE.times(parameters.sensor_noise) if parameters.sensor_noise > 0.0 else None
        self._twin = Twin(
            load_any_robot(parameters.robot),
            parameters.scene,
            period_ns=round(1e9 / parameters.control_rate),
            noise=noise,
            seed=parameters.seed,
            dump_folder=Path(parameters.dump_folder) if parameters.dump_folder else None,
        )
        self._follows_clock = not parameters.publish_clock
        self._sensors: SensorData = self._twin.reset(parameters.keyframe)
        self._keyframe = parameters.keyframe
        self._outputs = SensorPublishers(
            self, self._twin, parameters.frame_prefix, parameters.rates(), parameters.publish_clock
        )
        self._pacer = Pacer(self._twin.period_ns, parameters.real_time_factor)
        self._patience = Patience(parameters.patience)
        self._door = ServoCommandDoor(self._twin.layout.servos, HOLD.after)
        servos = self._twin.robot.servos
        self._ranges = [(name, servos[name].lower, servos[name].upper) for name in self._twin.layout.servos]
        self._paused = False
        self._steps_left = 0
        self._step_done: Future | None = None
        self._pending: list[float] | None = None
        self._published_at: dict[int, int] = {}
        self._tick_wall = 0

        self._age = Latency()
        self._missed = self._ticks = self._refused = 0
        self._refused_before = 0
        self._last_refusal = ""
        self._rate_from = (time.monotonic_ns(), self._twin.time_ns)
        self._wall = Clock(clock_type=ClockType.STEADY_TIME)
        self._views = open_views(self, self._twin, parameters.viewer, parameters.camera_rate, parameters.frame_prefix)
        # The door judges the stamps: in stepped mode an answer may come to a tick that was published twice.
        self._commands = CommandInput(self, self._refuse, lambda: self._twin.time_ns, oldest=None)
        self._commands.subscribe(ServoCommand, "servo_command", self._on_command)
        self._stops = EmergencyStops()
        self._stop_input = EmergencyStopInput(self, self._stops, self._obey_stops, self._release)
        self._diagnostics = Diagnostics(
            self,
            hardware_id=f"{self._twin.robot.name} twin",
            parts={"twin": self._diagnose, "owner": self._commands.status},
        )
        self.create_service(SetBool, "~/pause", self._on_pause)
        self.create_service(StepSimulation, "~/step", self._on_step)
        self.create_service(ResetSimulation, "~/reset", self._on_reset)
        self.create_service(PushRobot, "~/push", self._on_push)
        # The timer looks twice a period, so that a late tick is followed by one on time.
        period = 0.5e-9 * self._twin.period_ns / max(parameters.real_time_factor, 0.1)
        if parameters.real_time_factor == 0.0:
            period = 1e-3
        self._timer = self.create_timer(period, self._on_timer, clock=self._wall)

    # Stepping

    def _on_timer(self) -> None:
        if self._tick_wall == 0 and not self._begin():
            return
        if self._settings.stepped:
            self._step_if_answered()
            if time.monotonic_ns() - self._tick_wall > REPEAT_AFTER * 1e9 and not self._idle():
                self._outputs.repeat()
                self._tick_wall = time.monotonic_ns()
            return
        self._advance()

    def _advance(self) -> None:
        """Takes the tick that is due, or as many as fit where time does not matter."""
        until = time.monotonic_ns() + BUSY_NS
        while not self._idle() and not self._waits() and self._is_due():
            self._tick()
            if self._settings.real_time_factor > 0.0 or time.monotonic_ns() > until:
                break

    def _waits(self) -> bool:
        return self._pending is None and self._patience.waits(time.monotonic_ns() - self._tick_wall)

    def _begin(self) -> bool:
        """Publishes the first tick; false as long as the clock that this node follows has not started."""
        if self._follows_clock:
            now = self.get_clock().now().nanoseconds
            if now == 0:
                return False
            self._twin.time_ns = now
            self._sensors = self._twin.reset(self._keyframe)
        self._pacer.restart(time.monotonic_ns())
        self._publish()
        return True

    def _idle(self) -> bool:
        return self._twin.diverged is not None or (self._paused and self._steps_left == 0)

    def _is_due(self) -> bool:
        if self._follows_clock:
            return self.get_clock().now().nanoseconds >= self._twin.time_ns + self._twin.period_ns
        return self._pacer.due(time.monotonic_ns())

    def _step_if_answered(self) -> None:
        if self._pending is not None and not self._idle() and self._is_due():
            self._tick()

    def _tick(self) -> None:
        command, self._pending = self._pending, None
        if command is None and self._twin.command_state is Following.FOLLOWING:
            self._missed += 1
        self._patience.tick(answered=command is not None)
        try:
            self._sensors = self._twin.step(command)
        except SimulationDivergedError as error:
            self.get_logger().fatal(f"{error}; call ~/reset to go on")
            self._finish_steps()
            return
        self._ticks += 1
        self._publish()
        if self._steps_left > 0:
            self._steps_left -= 1
            if self._steps_left == 0:
                self._finish_steps()

    def _publish(self) -> None:
        self._outputs.publish(self._sensors)
        for view in self._views:
            view.show(self._twin)
        self._tick_wall = self._published_at[self._sensors.stamp] = time.monotonic_ns()
        if len(self._published_at) > REMEMBERED_TICKS:
            del self._published_at[next(iter(self._published_at))]

    # Commands

    def _on_command(self, message: ServoCommand) -> None:
        arrived, stamp = time.monotonic_ns(), to_nanoseconds(message.header.stamp)
        if self._settings.stepped and stamp < self._twin.time_ns and stamp in self._published_at:
            return  # the answer to a tick that was published twice
        self._pending = self._door.open(stamp, message.name, message.position, self._twin.time_ns)
        self._say_beyond(self._pending)
        if stamp in self._published_at:
            self._age.add(arrived - self._published_at[stamp])
        if self._tick_wall != 0:
            if self._settings.stepped:
                self._step_if_answered()
            else:
                self._advance()

    def _obey_stops(self) -> None:
        self._twin.power(not self._stops.active)

    def _release(self) -> str:
        left = self._stops.release()
        self._obey_stops()
        return left

    def _refuse(self, text: str) -> None:
        self._refused += 1
        self._last_refusal = text
        self.get_logger().warning(text, throttle_duration_sec=1.0, throttle_time_source_type=self._wall)

    def _say_beyond(self, positions: list[float]) -> None:
        """MuJoCo holds each servo to its range; whoever asked for more is told."""
        for position, (name, lower, upper) in zip(positions, self._ranges, strict=True):
            if not lower - UNSEEN_RAD <= position <= upper + UNSEEN_RAD:
                self.get_logger().warning(
                    f"servo command: {name} = {position:.3f} rad is held to its range, {lower:g} to {upper:g} rad",
                    throttle_duration_sec=1.0,
                    throttle_time_source_type=self._wall,
                )

    # Services

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        if self._paused and not request.data:
            self._pacer.restart(time.monotonic_ns())
            self._finish_steps()
        self._paused = bool(request.data)
        response.success = True
        response.message = "paused" if self._paused else "running"
        return response

    async def _on_step(
        self, request: StepSimulation.Request, response: StepSimulation.Response
    ) -> StepSimulation.Response:
        if not self._paused:
            response.message = "the simulation is running: pause it first"
        elif not 1 <= request.ticks <= LARGEST_STEP:
            response.message = f"ticks = {request.ticks}: must be within 1 and {LARGEST_STEP}"
        elif self._steps_left > 0:
            response.message = f"busy: {self._steps_left} ticks of an earlier call are left"
        elif self._twin.diverged is not None:
            response.message = f"{self._twin.diverged}; call ~/reset first"
        else:
            before = self._ticks
            self._steps_left = request.ticks
            self._step_done = Future()
            self._pacer.restart(time.monotonic_ns())
            await self._step_done
            response.success = self._ticks - before >= request.ticks
            response.message = f"{self._ticks - before} ticks"
        response.time = to_message(self._twin.time_ns)
        return response

    def _finish_steps(self) -> None:
        self._steps_left = 0
        if self._step_done is not None:
            self._step_done.set_result(None)
            self._step_done = None

    def _on_reset(
        self, request: ResetSimulation.Request, response: ResetSimulation.Response
    ) -> ResetSimulation.Response:
        diverged = self._twin.diverged is not None
        try:
            self._sensors = self._twin.reset(request.keyframe or "stand")
        except ValueError as error:
            response.message = str(error)
            return response
        self._outputs.clear()
        self._pending = None
        self._pacer.restart(time.monotonic_ns())
        if diverged and self._settings.stepped:
            self._tick()  # the last tick has been answered already, so somebody has to begin
        response.success = True
        response.message = f"the robot is in {request.keyframe or 'stand'}"
        return response

    def _on_push(self, request: PushRobot.Request, response: PushRobot.Response) -> PushRobot.Response:
        force = request.force
        try:
            self._twin.push((force.x, force.y, force.z), request.duration, request.body or "torso")
        except ValueError as error:
            response.message = str(error)
            return response
        response.success = True
        response.message = "pushed"
        return response

    # Diagnostics

    def _diagnose(self) -> Status:
        wall, simulated = self._rate_from
        self._rate_from = (time.monotonic_ns(), self._twin.time_ns)
        factor = (self._rate_from[1] - simulated) / max(self._rate_from[0] - wall, 1)
        wanted = self._settings.real_time_factor
        values = {
            "real_time_factor": f"{factor:.3f}",
            "ticks": self._ticks,
            "ticks_missed": self._missed,
            "ticks_dropped": self._pacer.dropped,
            "command_age_p50_ms": f"{self._age.percentile_ms(50.0):.3f}",
            "command_age_p99_ms": f"{self._age.percentile_ms(99.0):.3f}",
            "command_age_max_ms": f"{self._age.maximum_ms:.3f}",
            "commands": self._age.count,
            "commands_refused": self._refused,
            "last_refusal": self._last_refusal,
            "servos": self._twin.command_state.value,
        }
        if self._twin.diverged is not None:
            return ERROR, str(self._twin.diverged), values
        if self._stops.active:
            self._stop_input.forget_the_gone()
            return ERROR, f"limp: emergency_stop ({self._stops})", values
        if self._refused > self._refused_before:
            self._refused_before = self._refused
            return WARN, self._last_refusal, values
        if self._paused:
            return OK, "paused", values
        state = self._twin.command_state.value
        if wanted > 0.0 and not self._settings.stepped and factor < 0.9 * wanted:
            return WARN, f"{state}, too slow: {factor:.2f} x real time, {wanted} wanted", values
        return OK, state, values


def main() -> int:
    """Runs the node."""
    return run(MujocoSim)


if __name__ == "__main__":
    sys.exit(main())
