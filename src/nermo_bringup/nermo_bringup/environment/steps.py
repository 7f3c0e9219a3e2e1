"""Saying and doing the steps of a set-up: what, how long, and why it failed. Standard library only."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager

SIGN_OF_LIFE_S = 10.0
"""So often a long step says that it goes on."""


class SetupError(Exception):
    """Set-up cannot go on; the text is one sentence for the user."""


def say(text: str) -> None:
    """Tells the user on stderr, so that the output of commands stays clean."""
    print(f"nermo: {text}", file=sys.stderr, flush=True)


def step(
    what: str,
    command: Sequence[str],
    environment: Mapping[str, str] | None = None,
    on_line: Callable[[str], None] | None = None,
    present: Callable[[], str] = lambda: "",
) -> None:
    """Runs one command of the set-up, quietly, and says what it does and how long it took.

    Args:
        what: The step in plain words, as in "installing 180 Python packages".
        command: Program and arguments.
        environment: Its environment variables; None hands on ours.
        on_line: Called with each line of its output.
        present: Tells what it is doing now; asked every `SIGN_OF_LIFE_S`.

    Raises:
        SetupError: It failed. The end of its output has been shown.
    """
    say(f"{what} ...")
    started = time.monotonic()
    lines: list[str] = []
    try:
        process = subprocess.Popen(
            command,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
        )
    except OSError as error:
        raise SetupError(f"{what} failed: {command[0]}: {error.strerror}.") from error
    with process, _signs_of_life(started, present):
        assert process.stdout is not None
        for line in process.stdout:
            lines.append(line.rstrip())
            if on_line is not None:
                on_line(lines[-1])
    took = time.monotonic() - started
    if process.returncode != 0:
        for line in lines[-40:]:
            print(f"    {line}", file=sys.stderr)
        reason = next((line.strip() for line in reversed(lines) if line.strip()), "no output")
        raise SetupError(f"{what} failed after {took:.0f} s: {reason}")
    say(f"{what}: {took:.0f} s")


@contextmanager
def _signs_of_life(started: float, present: Callable[[], str]) -> Iterator[None]:
    """Says what is done and since when, every `SIGN_OF_LIFE_S` while the block runs."""
    ended = threading.Event()

    def tell() -> None:
        while not ended.wait(SIGN_OF_LIFE_S):
            if doing := present():
                say(f"  {doing} ({time.monotonic() - started:.0f} s)")

    teller = threading.Thread(target=tell, daemon=True)
    teller.start()
    try:
        yield
    finally:
        ended.set()
        teller.join()
