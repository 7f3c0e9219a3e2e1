"""What the commands of the mouse share."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import simgap.console
from simgap.console import fail

PROGRAM = ("nermo", "gap")


@contextlib.contextmanager
def refusals() -> Iterator[None]:
    """Input or a robot that cannot be used ends the command with its sentence and status 2."""
    from nermo_description.robots import ParameterError

    try:
        with simgap.console.refusals():
            yield
    except ParameterError as error:
        fail(str(error), 2)
