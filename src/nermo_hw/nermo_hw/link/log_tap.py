"""What zenoh only writes to its log: who was turned away at the door. Read from the log, told as diagnostics."""

from __future__ import annotations

import os
import re
import sys
import threading
import time
from collections.abc import Callable

import zenoh

FILTER = "warn,zenoh::net::routing::interceptor::access_control=trace"
"""Refusals of the access list are only logged as trace, and so is every message that it admits."""
_PERIOD = 0.05
"""Between two looks into the log [s]: one pass over many lines costs less than a pass over each."""
_COLOUR = re.compile(r"\x1b\[[0-9;]*m")
_NAMED = re.compile(r"(\w+) on \S*CertCommonName\(([^)]*)\)")
_REFUSED = re.compile(r"Using cached result: (\w+) is unauthorized to (Put|Delete|Query) \(ingress\) on (\S+)")
"""What somebody tried. Without "cached" it only says what they would not be allowed to."""
_FAILED = (
    ("sent no certificate", "a peer without a certificate was turned away"),
    ("UnknownIssuer", "a peer whose certificate is not ours was turned away"),
    ("xpired", "a peer whose certificate has ended was turned away"),
    ("invalid peer certificate", "a peer with an unusable certificate was turned away"),
    ("BadSignature", "a peer whose certificate is not ours was turned away"),
)
_NOISE = ("Gossip is disabled", "Scouting delay elapsed")


class LogTap:
    """Takes this process's stdout over, to which zenoh's log goes, and reads it. One a process.

    refused: called with a sentence, from a thread of its own, each time that somebody was turned away. Everything else
    that is written goes to stderr.
    """

    def __init__(self, refused: Callable[[str], None]) -> None:
        self._refused = refused
        self._names: dict[str, str] = {}
        self._rest = b""
        sys.stdout.flush()
        self._read, write = os.pipe()
        os.dup2(write, 1)
        os.close(write)
        os.environ.setdefault("RUST_LOG", FILTER)
        zenoh.try_init_log_from_env()
        threading.Thread(target=self._run, name="zenoh log", daemon=True).start()

    def _run(self) -> None:
        while data := os.read(self._read, 1 << 16):
            lines = (self._rest + data).split(b"\n")
            self._rest = lines.pop()[-4096:]
            for line in lines:
                if b" is authorized to " not in line or b"CertCommonName" in line:
                    self.line(line.decode(errors="replace"))
            time.sleep(_PERIOD)

    def line(self, text: str) -> None:
        """One line of the log."""
        text = _COLOUR.sub("", text)
        if "access_control" in text:
            if named := _NAMED.search(text):
                self._names[named[1]] = named[2]
            if refused := _REFUSED.search(text):
                name = self._names.get(refused[1], refused[1])
                self._refused(f"{name} may not {refused[2].lower()} {refused[3]}")
            return
        for sign, sentence in _FAILED:
            if sign in text:
                self._refused(sentence)
                return
        if text.strip() and not any(noise in text for noise in _NOISE):
            sys.stderr.write(text + "\n")
