"""Node `serial_driver`: servo_command [c] -> device -> servo_states, imu/data_raw, tactile, battery, joint_states [d].

It is the clock of the graph, as the twin is: each cycle it asks the device and publishes what came back; whoever
answers that tick is heard in the next cycle.
"""

from __future__ import annotations

import sys
import threading
import time
from pathlib import Path

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from nermo_description.command_follower import CommandFollower
from nermo_description.robots import load_robot
from nermo_description.servo_command import ServoCommandDoor
from nermo_description.silence import HOLD
from nermo_hw.nodes.sample_publishers import SamplePublishers
from nermo_hw.safety.servo_limits import ServoLimits
from nermo_hw.serial.calibration import load_calibration
from nermo_hw.serial.driver import REPLY_TIMEOUT, Driver
from nermo_hw.serial.schedule import FixedStepSchedule
from nermo_hw.types import LATCHED, LineError, LineLostError, SensorSample, ServoTargets, SilentLineError
from nermo_interfaces.msg import ServoCommand
from nermo_node import qos
from nermo_node.command_input import CommandInput
from nermo_node.complaints import Complaints
from nermo_node.diagnostics import ERROR, OK, WARN, Diagnostics, Status
from nermo_node.inputs import Inputs
from nermo_node.parameters import blame, declare
from nermo_node.run import run
from nermo_node.time import to_nanoseconds

RETRY_AFTER = 0.5
"""Time between two tries to open the port [s]."""


class SerialDriverParameters(BaseModel):
    """Parameters of the node."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    robot: str = Field("nermo_lite", description="Name of the robot, or path of its parameter file")
    port: str = Field(
        "/dev/ttyUSB0",
        min_length=1,
        description="A device path, usb:VID:PID[:SERIAL], or a URL such as socket://host:port",
    )
    calibration: str = Field("", description="File that `nermo hw calibrate` wrote; empty: the robot sits as drawn")
    control_rate: float = Field(
        200.0,
        ge=20.0,
        le=500.0,
        description="Rate of servo_states and of trajectory points",
        json_schema_extra={"unit": "Hz"},
    )
    cycle_rate: float = Field(
        0.0,
        ge=0.0,
        le=500.0,
        description="Rate of exchanges with the device, a multiple of control_rate; 0: control_rate",
        json_schema_extra={"unit": "Hz"},
    )
    rate_lead: float = Field(
        100.0,
        ge=0.0,
        le=10_000.0,
        description="How much faster the driver cycles than it says, so that the device never waits for a point",
        json_schema_extra={"unit": "ppm"},
    )
    joint_rate: float = Field(
        50.0, gt=0.0, le=500.0, description="Rate of joint_states", json_schema_extra={"unit": "Hz"}
    )
    battery_rate: float = Field(1.0, gt=0.0, le=500.0, description="Rate of battery", json_schema_extra={"unit": "Hz"})
    reply_timeout: float = Field(
        REPLY_TIMEOUT,
        ge=0.0005,
        le=1.0,
        description="How long the device may take to answer",
        json_schema_extra={"unit": "s"},
    )
    auto_release: bool = Field(
        True,
        description="Give the servos power when the device is there, and again after its watchdog or a brown-out; "
        "otherwise only when ~/release is called",
    )
    frame_prefix: str = Field("", description="In front of every frame name, as in mouse_1/")

    @model_validator(mode="after")
    def _rates_fit(self) -> SerialDriverParameters:
        period_ms = 1e3 / self.control_rate
        if abs(period_ms - round(period_ms)) > 1e-9:
            raise ValueError(f"control_rate = {self.control_rate} Hz: a period must be whole milliseconds")
        for name, rate, of in (
            ("cycle_rate", self.cycle_rate or self.control_rate, 1.0 / self.control_rate),
            ("joint_rate", self.control_rate, 1.0 / self.joint_rate),
            ("battery_rate", self.control_rate, 1.0 / self.battery_rate),
        ):
            ratio = rate * of
            if ratio < 1.0 - 1e-6 or abs(ratio - round(ratio)) > 1e-6:
                raise ValueError(
                    f"{name} = {getattr(self, name)} Hz does not go with control_rate = {self.control_rate} Hz: "
                    f"{'it must be a multiple' if name == 'cycle_rate' else 'it must divide it'}"
                )
        return self


class SerialDriverNode(Node):
    """A thread talks to the device; the executor takes commands. What both touch is behind a lock."""

    def __init__(self) -> None:
        super().__init__("serial_driver")
        self._thread: threading.Thread | None = None
        self._settings = settings = declare(self, SerialDriverParameters)
        with blame("robot"):
            robot = load_robot(settings.robot)
        with blame("calibration"):
            calibration = load_calibration(Path(settings.calibration), robot) if settings.calibration else None
        self._driver = Driver(
            robot,
            settings.port,
            calibration=calibration,
            point_period=1.0 / settings.control_rate,
            reply_timeout=settings.reply_timeout,
            clock=lambda: self.get_clock().now().nanoseconds,
        )
        cycle_rate = settings.cycle_rate or settings.control_rate
        self._every = round(cycle_rate / settings.control_rate)
        self._schedule = FixedStepSchedule(1.0 / (cycle_rate * (1.0 + settings.rate_lead * 1e-6)))
        self._follower = CommandFollower(np.array(list(robot.posture("crouch").values())))
        self._limits = ServoLimits(robot)
        self._clamped = 0
        self._door = ServoCommandDoor(self._driver.names, HOLD.after)
        self._outputs = SamplePublishers(
            self,
            robot,
            settings.frame_prefix,
            {
                "joint_states": round(settings.control_rate / settings.joint_rate),
                "battery": round(settings.control_rate / settings.battery_rate),
            },
        )
        self._lock = threading.Lock()
        self._refused = Complaints(self, "refused")
        self._sample: SensorSample | None = None
        self._trouble = "not opened yet"
        self._release_wanted = settings.auto_release
        self._reconnects = self._silent = 0
        self._told: tuple[int, int] = (0, 0)
        self._point_at = time.monotonic_ns()
        self._ending = threading.Event()
        self._failure: Exception | None = None

        self._power = True
        """What the safety supervisor wants; without one there is power."""
        # The door judges the stamps.
        self._commands = CommandInput(
            self, lambda text: self._refused.add([text]), lambda: self.get_clock().now().nanoseconds, oldest=None
        )
        self._commands.subscribe(ServoCommand, "servo_command", self._on_command)
        Inputs(self, self._refused.add_one).subscribe(Bool, "servo_power", self._on_power, qos.LATCHED)
        self.create_service(Trigger, "~/release", self._on_release)
        self._diagnostics = Diagnostics(
            self,
            hardware_id=f"{robot.name} at {settings.port}",
            parts={
                "line": self._line_status,
                "device": self._device_status,
                "messages": self._refused.status,
                "owner": self._commands.status,
            },
        )
        self.create_timer(0.5, self._watch, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._thread = threading.Thread(target=self._live, name="line", daemon=True)
        self._thread.start()

    def destroy_node(self) -> None:
        """Lets the line go; the device's watchdog then makes the servos limp."""
        if self._thread is not None:
            self._ending.set()
            self._thread.join(timeout=5.0)
        super().destroy_node()

    # The executor's side

    def _on_command(self, message: ServoCommand) -> None:
        stamp, now = to_nanoseconds(message.header.stamp), self.get_clock().now().nanoseconds
        positions = np.array(self._door.open(stamp, message.name, message.position, now))
        inside = self._limits.position(positions)
        self._clamped += bool((inside != positions).any())
        with self._lock:
            self._follower.command(inside)

    def _on_power(self, message: Bool) -> None:
        self._power = bool(message.data)

    def _on_release(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._release_wanted = True
        response.success = self._driver.is_open
        response.message = "the servos get power" if response.success else self._trouble
        return response

    def _line_status(self) -> Status:
        counters, schedule = self._driver.counters, self._schedule
        jitter = schedule.jitter()
        values = {
            "port": self._settings.port,
            "exchanges": counters.exchanges,
            "frames_lost": counters.lost,
            "frames_late": counters.late,
            "frames_corrupt": counters.corrupt,
            "garbage_bytes": counters.garbage_bytes,
            "answers_refused": counters.refused,
            "exchanges_without_answer": self._silent,
            "reconnects": self._reconnects,
            "cycles": schedule.cycles,
            "overruns": schedule.overruns,
            "steps_missed": schedule.missed,
            "jitter_p50_ms": f"{jitter['p50'] * 1e3:.3f}",
            "jitter_p99_ms": f"{jitter['p99'] * 1e3:.3f}",
            "jitter_max_ms": f"{jitter['max'] * 1e3:.3f}",
        }
        bad, overruns = counters.lost + counters.late + counters.corrupt, schedule.overruns
        news = (bad - self._told[0], overruns - self._told[1])
        self._told = (bad, overruns)
        if not self._driver.is_open:
            return ERROR, self._trouble, values
        if news[0] > 0 or news[1] > 0:
            return WARN, f"in the last second: {max(news[0], 0)} bad frames, {news[1]} overruns", values
        return OK, "running", values

    def _device_status(self) -> Status:
        sample = self._sample
        if sample is None or not self._driver.is_open:
            return WARN, "no data", {"following": self._follower.state.value}
        values = {
            "faults": ", ".join(str(fault.name) for fault in sample.faults) or "none",
            "limp": sample.limp,
            "silent_servos": ", ".join(sample.silent_servos),
            "over_current_servos": ", ".join(sample.over_current_servos),
            "missing_boards": ", ".join(sample.missing),
            "battery_v": f"{sample.battery_voltage:.2f}",
            "following": self._follower.state.value,
            "commands_clamped": self._clamped,
        }
        if sample.missing or sample.silent_servos:
            return ERROR, f"silent: {', '.join((*sample.missing, *sample.silent_servos))}", values
        if sample.faults:
            return WARN, str(values["faults"]), values
        return OK, self._follower.state.value, values

    # The line's side

    def _live(self) -> None:
        while not self._ending.is_set():
            try:
                if not self._driver.is_open:
                    self._connect()
                self._cycle()
            except SilentLineError as error:
                self._silent += 1
                self._trouble = str(error)
            except LineLostError as error:
                self._reconnects += 1
                self._give_up(error)
            except LineError as error:
                self._give_up(error)
            except Exception as error:
                self._failure = error
                self._ending.set()
        self._driver.close()

    def _watch(self) -> None:
        """What ends the thread ends the node."""
        if self._failure is not None:
            raise self._failure

    def _give_up(self, error: LineError) -> None:
        """Until the next try; said once, not with every try."""
        self._driver.close()
        if str(error) != self._trouble:
            self.get_logger().warning(f"{error}; trying again every {RETRY_AFTER:g} s")
        self._trouble = str(error)
        self._ending.wait(RETRY_AFTER)

    def _connect(self) -> None:
        identity = self._driver.open()
        self.get_logger().info(
            f"{identity.robot} at {identity.url}: {', '.join(identity.boards)}, SBCP {identity.protocol_version}"
        )
        if identity.robot != self._driver.robot.name:
            self.get_logger().warning(
                f"the device says that it is built into {identity.robot}, not {self._driver.robot.name}"
            )
        self._release_wanted = self._settings.auto_release
        with self._lock:
            self._follower.rest()
        self._sample = None
        self._schedule.restart()

    def _cycle(self) -> None:
        tick = self._schedule.wait()
        point = tick.number % self._every == 0 or tick.missed >= self._every
        sample, targets = self._sample, None
        if sample is not None and not sample.faults & LATCHED and point:
            with self._lock:
                positions = self._follower.step(self._since_point(), sample.servo_positions)
                if not self._power:
                    self._follower.rest()
            targets = None if positions is None else ServoTargets(positions)
            if not self._power:
                targets = ServoTargets(np.nan_to_num(sample.servo_positions), energised=False)
        if self._release_wanted and (sample is None or sample.faults & LATCHED):
            self._driver.release()
        self._sample = sample = self._driver.exchange(targets)
        if sample.faults & LATCHED:
            with self._lock:
                self._follower.rest()
        else:
            self._release_wanted = self._settings.auto_release
        if point and self.context.ok():
            self._outputs.publish(sample)

    def _since_point(self) -> int:
        """Time since the last trajectory point [ns]."""
        now = time.monotonic_ns()
        elapsed, self._point_at = now - self._point_at, now
        return elapsed


def main() -> int:
    """Runs the node."""
    return run(SerialDriverNode)


if __name__ == "__main__":
    sys.exit(main())
