"""Node `device_emulator`: Nermo's electronics at the other end of a serial line; nothing of it goes through topics."""

from __future__ import annotations

import sys
import threading

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from nermo_hw.device.plant import ServoPlant
from nermo_hw.device.setup import EmulatorSettings, PlantFactory, make_emulator
from nermo_node.diagnostics import OK, WARN, Diagnostics, Status
from nermo_node.parameters import ParameterError, declare
from nermo_node.run import run


class DeviceEmulatorNode(Node):
    """Runs an emulator in a thread. `plant` makes what its servos move; `kind` has its parameters."""

    def __init__(self, plant: PlantFactory = ServoPlant, kind: type[EmulatorSettings] = EmulatorSettings) -> None:
        super().__init__("device_emulator")
        self._thread: threading.Thread | None = None
        settings = declare(self, kind)
        try:
            self._emulator = make_emulator(settings, plant)
        except ValueError as error:
            raise ParameterError(str(error)) from error
        self._failure: Exception | None = None
        Diagnostics(self, f"emulated {settings.robot}", {"device": self._status})
        self.create_timer(0.5, self._watch, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._thread = threading.Thread(target=self._live, name="device", daemon=True)
        self._thread.start()
        where = [settings.link] if settings.link else []
        where += [f"socket://{settings.tcp_host}:{self._emulator.port}"] if settings.tcp_port >= 0 else []
        self.get_logger().info(f"an emulated {settings.robot} is at {' and '.join(where)}")

    def destroy_node(self) -> None:
        """Takes the line away."""
        if self._thread is not None:
            self._emulator.stop()
            self._thread.join(timeout=5.0)
        super().destroy_node()

    def _live(self) -> None:
        try:
            self._emulator.run()
        except Exception as error:
            self._failure = error

    def _watch(self) -> None:
        """What ends the thread ends the node."""
        if self._failure is not None:
            raise self._failure

    def _status(self) -> Status:
        device = self._emulator.device
        values = {
            "voltage_v": f"{device.battery.voltage:.2f}",
            **device.facts(),
            "skipped_s": f"{device.skipped * 1e-9:.2f}",
        }
        if device.skipped:
            return WARN, "the machine is too slow: time was skipped", values
        return OK, "running", values


def main() -> int:
    """Runs the node."""
    return run(DeviceEmulatorNode)


if __name__ == "__main__":
    sys.exit(main())
