"""An emulated device on a real pseudo-terminal, as a process of its own."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

from nermo_hw.device.emulator import Control, control_path

PATIENCE = 60.0
"""How long a condition may take [s]; on an idle machine all hold within two."""


class EmulatedDevice:
    """The process, and what breaks it on purpose."""

    def __init__(self, folder: Path, *arguments: str) -> None:
        self.link = folder / "device"
        self._arguments = arguments
        self.start()

    def start(self) -> None:
        command = [sys.executable, "-m", "nermo_hw", "emulate", "--link", str(self.link), *self._arguments]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        assert self.process.stdout is not None
        self.greeting = self.process.stdout.readline()
        assert "is at" in self.greeting, self.greeting + self.process.stdout.read()
        self.control = Control(control_path(self.link))

    def kill(self) -> None:
        self.control.close()
        self.process.kill()
        self.process.communicate()

    def end(self) -> int:
        self.control.close()
        self.process.terminate()
        self.process.communicate(timeout=PATIENCE)
        return self.process.returncode


def until(condition: Callable[[], object], what: str) -> None:
    """Waits for something to hold."""
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline, f"waited {PATIENCE} s in vain until {what}"
        time.sleep(0.002)
