"""A person at a terminal: types keys into a command and reads what it shows."""

from __future__ import annotations

import fcntl
import os
import pty
import re
import signal
import struct
import subprocess
import termios
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import psutil

PATIENCE_S = 90.0
"""How long something is waited for before the test fails, also on a busy machine."""

_ESCAPE = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]|\r")


class Terminal:
    """A command on a pseudo-terminal of 100 columns and 40 lines."""

    def __init__(self, command: Sequence[str], folder: Path, **environment: str) -> None:
        self._controller, self._terminal = pty.openpty()
        fcntl.ioctl(self._terminal, termios.TIOCSWINSZ, struct.pack("HHHH", 40, 100, 0, 0))
        os.set_blocking(self._controller, False)
        self._before = termios.tcgetattr(self._terminal)
        self.text = ""
        """All that was shown, without colours and cursor movements."""
        self._told = 0
        """Place in the text behind what `says` has found last."""
        self.process = subprocess.Popen(
            command,
            cwd=folder,
            stdin=self._terminal,
            stdout=self._terminal,
            stderr=self._terminal,
            env={**os.environ, "TERM": "xterm", **environment},
            start_new_session=True,
        )

    def type(self, keys: str) -> None:
        os.write(self._controller, keys.encode())

    def read(self) -> str:
        """All that was shown up to now."""
        try:
            while chunk := os.read(self._controller, 65536):
                self.text += _ESCAPE.sub("", chunk.decode(errors="replace"))
        except BlockingIOError:
            pass
        return self.text

    def until(self, condition: Callable[[], bool], what: str, meanwhile: Callable[[], None] = lambda: None) -> None:
        """Waits until something holds; what happens meanwhile is done four times a second."""
        deadline = time.monotonic() + PATIENCE_S
        while self.read() is not None and not condition():
            assert self.process.poll() is None, f"ended before {what}:\n{self.text}"
            assert time.monotonic() < deadline, f"waited {PATIENCE_S:g} s in vain until {what}:\n{self.text[-4000:]}"
            meanwhile()
            time.sleep(0.25)

    def shows(self, words: str) -> bool:
        """Whether the newest lines have these words: for a screen that is drawn again and again."""
        return words in self.read()[-3000:]

    def says(self, words: str) -> bool:
        """Whether these words came after those found before: for what is said once, however much came since."""
        place = self.read().find(words, self._told)
        if place < 0:
            return False
        self._told = place + len(words)
        return True

    def end(self, patience: float = PATIENCE_S) -> int:
        """Waits for the command's end; its exit status. Its terminal is as it was."""
        deadline = time.monotonic() + patience
        while self.process.poll() is None:
            assert time.monotonic() < deadline, f"does not end:\n{self.read()[-4000:]}"
            self.read()
            time.sleep(0.05)
        self.read()
        assert termios.tcgetattr(self._terminal) == self._before
        return self.process.returncode

    def close(self) -> None:
        """Ends the command, whatever it is doing."""
        if self.process.poll() is None:
            os.killpg(self.process.pid, signal.SIGKILL)
            self.process.wait()
        os.close(self._controller)
        os.close(self._terminal)


def left_running(domain: str) -> list[str]:
    """Command lines of ROS nodes that run in a ROS domain."""
    found = []
    for process in psutil.process_iter():
        try:
            if "--ros-args" in process.cmdline() and process.environ().get("ROS_DOMAIN_ID") == domain:
                found.append(" ".join(process.cmdline()))
        except psutil.Error:
            continue
    return found
