"""The robot's end of a link in a process of its own, and somebody who sends it commands."""

from __future__ import annotations

import contextlib
import json
import random
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import zenoh

from nermo_hw.link.config import DEFAULT, LinkConfig, Side, load_link
from nermo_hw.link.messages import encode_command
from nermo_hw.link.session import zenoh_settings

PATIENCE_S = 60.0


def free_port() -> int:
    """A port that the system gives to nobody who asks for any, so that it stays free while the robot is away."""
    while True:
        port = random.randint(20_000, 32_000)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe, contextlib.suppress(OSError):
            probe.bind(("127.0.0.1", port))
            return port


def config(keys: Path | None, endpoint: str, **more: object) -> LinkConfig:
    overrides = [
        ("keys", None if keys is None else str(keys)),
        ("robot.endpoints", [endpoint]),
        ("workstation.endpoints", [endpoint]),
        *more.items(),
    ]
    return load_link(DEFAULT, overrides)


DOOR = """
import sys, time
from pathlib import Path
from nermo_hw.link.clock import SteadyClock
from nermo_hw.link.config import LinkConfig, Side
from nermo_hw.link.end import LinkEnd

def say(text):
    sys.stderr.write(text + "\\n")
    sys.stderr.flush()

config = LinkConfig.model_validate_json(sys.argv[1])
end = LinkEnd(config, Side.ROBOT, lambda topic, payload, _: say("got: " + topic.name), SteadyClock())
end.tell_refused(lambda sentence: say("away: " + sentence))
with end:
    say("ready")
    sys.stdin.read()
"""


class Door:
    """A robot's end in a process of its own; its lines are who was turned away and what came through."""

    def __init__(self, settings: LinkConfig) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-c", DOOR, settings.model_dump_json()],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )
        self.lines: list[str] = []
        self.until("ready")

    def until(self, start: str) -> str:
        assert self.process.stderr is not None
        for line in self.process.stderr:
            self.lines.append(line.strip())
            if line.startswith(start):
                return line.strip()
        raise AssertionError(f"the robot's end has ended: {self.lines}")

    def close(self) -> None:
        self.process.communicate(timeout=PATIENCE_S)


class Intruder:
    """Somebody with a zenoh of their own who sends commands, over and over."""

    def __init__(self, settings: LinkConfig, tls: dict[str, object]) -> None:
        plain = zenoh.Config()
        for path, value in zenoh_settings(settings, Side.WORKSTATION).items():
            if path not in ("transport/link/tls", "access_control"):
                plain.insert_json5(path, json.dumps(value))
        plain.insert_json5("transport/link/tls", json.dumps(tls))
        self._session = zenoh.open(plain)
        self._publisher = self._session.declare_publisher("nermo/servo_command", express=True)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._send)
        self._thread.start()

    def _send(self) -> None:
        while not self._stop.wait(0.05):
            self._publisher.put(encode_command(time.time_ns(), ["tail"], [0.5]))

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self._session.close()
