"""Everything of the robot's path as processes of their own: walker, bad network, robot's end, device."""

from __future__ import annotations

import contextlib
import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from nermo_description.parameter_files import read_yaml
from nermo_description.results import CommandError
from nermo_description.robots import load_robot
from nermo_hw.bench.network import ROBOT_IP, Impairment, Network
from nermo_hw.device.emulator import Control, control_path
from nermo_hw.link.config import DEFAULT
from nermo_hw.link.keys import make_keys
from nermo_hw.link.transports import TRANSPORTS
from nermo_hw.types import LineError

PATIENCE_S = 60.0
PORT = 7447


class Rig:
    """The whole path in a folder of its own.

    transport: one of TRANSPORTS. Raises NoNamespacesError where there can be no network
    namespaces, CommandError where a part does not come up.
    """

    def __init__(self, folder: Path, robot: str = "nermo_lite", transport: str = "quic") -> None:
        self.folder = folder
        self._robot_name = robot
        self.robot = load_robot(robot)
        self.network = Network()
        self._device: subprocess.Popen[bytes] | None = None
        self._control: Control | None = None
        try:
            self._write_link(transport)
            self._log = folder / "states.jsonl"
            terminal = folder / "device"
            self._device = subprocess.Popen(
                [sys.executable, "-m", "nermo_hw.bench.device_process", str(terminal), robot]
            )
            self.until(lambda: self._connect(terminal), "the device is there")
            self.start_robot()
            command = [sys.executable, "-m", "nermo_hw.bench.walker", str(self._link), robot]
            self.network.do("start", name="walker", side="workstation", command=command, talks=True)
            if not self.walker("wait", seconds=PATIENCE_S):
                raise CommandError(f"the link did not come up within {PATIENCE_S:g} s: {self.walker('status')}")
        except BaseException:
            self.close()
            raise

    # Parts

    def start_robot(self) -> None:
        """Starts the robot's end."""
        arguments = ["--robot", self._robot_name, "--port", str(self.folder / "device"), "--link", str(self._link)]
        command = [sys.executable, "-m", "nermo_hw.robot_end", *arguments, "--log", str(self._log)]
        self.network.do("start", name="robot_end", side="robot", command=command)

    def signal_robot(self, number: signal.Signals) -> None:
        """Sends the robot's end a signal."""
        self.network.do("signal", name="robot_end", number=int(number))

    def walker(self, word: str, **arguments: Any) -> Any:
        """Has the walker obey a word. Raises CommandError."""
        line = self.network.do("tell", name="walker", line=json.dumps({"do": word, **arguments}) + "\n")
        if not line:
            raise CommandError("the walker has ended")
        answer = json.loads(line)
        if not answer["ok"]:
            raise CommandError(f"the walker: {answer['error']}")
        return answer["result"]

    def device(self, word: str, **arguments: Any) -> Any:
        """Has the device obey a word."""
        assert self._control is not None, "the device is there"
        return self._control.do(word, **arguments)

    def points(self) -> list[tuple[int, np.ndarray]]:
        """Monotonic time [ns] and targets [rad] of what the servos were told since the last call."""
        return [
            (int(at), np.array([np.nan if value is None else value for value in targets]))
            for at, targets in self.device("points")
        ]

    def impair(self, **values: Any) -> None:
        """Makes the wire so, from now on."""
        self.network.impair(Impairment(**values))

    def states(self) -> list[dict[str, Any]]:
        """Changes of state so far."""
        try:
            lines = self._log.read_text(encoding="utf-8").splitlines()
        except FileNotFoundError:
            return []
        return [json.loads(line) for line in lines if line.endswith("}")]

    def state(self) -> str:
        """The present state."""
        states = self.states()
        return str(states[-1]["state"]) if states else ""

    def received(self) -> int:
        """Commands that the robot's end has got since it started. Raises CommandError."""
        parts = self.walker("robot", seconds=5.0)
        if not parts:
            raise CommandError("the robot's diagnostics do not come")
        return int(parts["robot_end: safety"]["commands_received"])

    def release(self) -> None:
        """Releases until the robot follows. Raises CommandError where it does not."""

        def following() -> bool:
            return self.state() == "follow" and bool(self.device("state")["energised"])

        def released() -> bool:
            if not following():
                self.walker("release")
            return following()

        self.until(released, "the robot follows after a release")

    def until(self, condition: Callable[[], object], what: str, patience: float = PATIENCE_S) -> None:
        """Waits for something. Raises CommandError where it does not come."""
        deadline = time.monotonic() + patience
        while not condition():
            if time.monotonic() > deadline:
                raise CommandError(f"waited {patience:g} s in vain until {what}")
            time.sleep(0.005)

    def close(self) -> None:
        """Ends everything."""
        self.network.close()
        if self._control is not None:
            self._control.close()
        if self._device is not None:
            self._device.kill()
            self._device.wait()

    def __enter__(self) -> Rig:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # Inside

    def _write_link(self, transport: str) -> None:
        settings = read_yaml(DEFAULT)
        carrier = TRANSPORTS[transport]
        if carrier.encrypts:
            make_keys(self.folder / "keys", ["robot", "workstation"])
        endpoint = f"{transport}/{ROBOT_IP}:{PORT}{carrier.ending}"
        settings["keys"] = "keys" if carrier.encrypts else None
        settings["robot"]["endpoints"] = settings["workstation"]["endpoints"] = [endpoint]
        self._link = self.folder / "link.yaml"
        self._link.write_text(yaml.safe_dump(settings), encoding="utf-8")

    def _connect(self, terminal: Path) -> bool:
        with contextlib.suppress(LineError):
            self._control = Control(control_path(terminal))
        return self._control is not None
