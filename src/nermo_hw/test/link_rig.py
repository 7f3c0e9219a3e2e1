"""For tests: the robot's end as a process without ROS, between a real link and a device on a pseudo-terminal."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import yaml
from emulated import until

from nermo_description.robots import load_robot
from nermo_hw.device.emulator import Emulator
from nermo_hw.device.setup import EmulatorSettings, make_emulator
from nermo_hw.link import stamp
from nermo_hw.link.clock import SteadyClock
from nermo_hw.link.config import DEFAULT, Side, Topic, load_link
from nermo_hw.link.end import LinkEnd
from nermo_hw.link.keys import make_keys
from nermo_hw.link.messages import decode_diagnostics, encode_command
from nermo_hw.link.transport import LinkError

PATIENCE_S = 60.0
ROBOT = load_robot("nermo_lite")
SERVOS = list(ROBOT.servos)
WITHOUT_ROS = "import sys; sys.modules['rclpy'] = None; from nermo_hw.robot_end import main; sys.exit(main())"


class Workstation:
    """Sees what the robot says and answers each tick with a command, as the controller does."""

    def __init__(self, link: Path, name: str = "desk") -> None:
        self.states = 0
        self.tail = 0.0
        self.walking = True
        self.told: dict[str, dict[str, str]] = {}
        self._last = 0
        self._end = LinkEnd(load_link(link), Side.WORKSTATION, self._on_message, SteadyClock(), name=name)
        self._end.open()

    def _on_message(self, topic: Topic, payload: bytes, _: str) -> None:
        if topic.name == "/diagnostics":
            self.told |= decode_diagnostics(payload)
        if topic.name == "servo_states":
            self.states += 1
            at = stamp.read(payload)
            if self.walking and at > self._last:
                self._last = at
                positions = [servo.neutral for servo in ROBOT.servos.values()]
                positions[SERVOS.index("tail")] = self.tail
                self._end.send("servo_command", encode_command(at, SERVOS, positions))

    def stop(self, pressed: bool, source: str = "pad") -> None:
        self._end.stops.say(source, pressed)
        self._end.beat()

    def release(self) -> str | None:
        try:
            return self._end.ask_release(1.0)
        except LinkError:
            return None

    def close(self) -> None:
        self._end.close()


class Rig:
    """Device, robot's end and workstation. The device lives here, so that it outlives the robot's end."""

    def __init__(self, folder: Path, *, workstation: bool = True, bus: str = "servo_boards") -> None:
        self.folder = folder
        make_keys(folder / "keys", ["robot", "workstation"])
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("127.0.0.1", 0))
            endpoint = f"quic/127.0.0.1:{probe.getsockname()[1]}?rel=0"
        settings = yaml.safe_load(DEFAULT.read_text())
        settings["keys"] = "keys"
        settings["robot"]["endpoints"] = settings["workstation"]["endpoints"] = [endpoint]
        self.link = folder / "link.yaml"
        self.link.write_text(yaml.safe_dump(settings))
        self.emulator: Emulator = make_emulator(
            EmulatorSettings(robot="nermo_lite", bus=bus, link=str(folder / "mouse"))
        )
        self._thread = threading.Thread(target=self.emulator.run)
        self._thread.start()
        self.log = folder / "states.jsonl"
        self.process = self.start()
        self.workstation: Any = Workstation(self.link) if workstation else None

    def start(self) -> subprocess.Popen[bytes]:
        arguments = ["--port", str(self.folder / "mouse"), "--link", str(self.link), "--log", str(self.log)]
        return subprocess.Popen([sys.executable, "-c", WITHOUT_ROS, *arguments])

    def states(self) -> list[dict[str, object]]:
        return [json.loads(line) for line in self.log.read_text().splitlines()] if self.log.is_file() else []

    def state(self) -> str:
        states = self.states()
        return str(states[-1]["state"]) if states else ""

    def energised(self) -> bool:
        return bool(self.emulator.device.state()["energised"])

    def release(self) -> None:
        """A busy machine may hold up the emulated line, which makes the robot limp: then it takes another release."""
        until(lambda: self.workstation.release() == "" and self.state() == "follow" and self.energised(), "it follows")

    def move_tail(self, to: float) -> None:
        """Commands the tail to an angle [rad] until it is there; released again where it is limp meanwhile."""
        self.workstation.tail = to

        def there() -> bool:
            if not self.energised():
                self.workstation.release()
            return abs(self.tail() - to) < 0.01

        until(there, "the tail is there")

    def tail(self) -> float:
        return float(self.emulator.device.plant.sensors().positions[SERVOS.index("tail")])

    def close(self) -> None:
        if self.workstation is not None:
            self.workstation.close()
        self.process.kill()
        self.process.wait()
        self.emulator.stop()
        self._thread.join()
