"""Runs one node as a process: what it does, how it ends, and what it says when something is wrong."""

from __future__ import annotations

import signal
import sys
import time
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import rclpy
from rclpy.exceptions import InvalidParameterException, InvalidParameterTypeException
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.logging import get_logger
from rclpy.node import Node

from nermo_node.parameters import ParameterError

try:
    from rclpy.experimental.events_executor import EventsExecutor as EventsExecutor
except ImportError:  # a ROS without it
    EventsExecutor = SingleThreadedExecutor

DONE, FAILED, WRONG_USAGE = 0, 1, 2
"""Exit status of a node process."""
SIGNAL_S = 0.5
"""From a signal to the end of the context, at most."""

_USAGE_ERRORS = (ParameterError, InvalidParameterException, InvalidParameterTypeException)


def run(factory: Callable[[], Node], args: Sequence[str] | None = None) -> int:
    """Runs the node that `factory` makes until SIGINT, SIGTERM or an error; returns the exit status.

    0 after a signal; its code after a SystemExit, by which a node ends itself; 1 when the node, a callback or its
    `destroy_node` failed; 2 when a parameter or an argument is bad, also where only a ValueError of the node's making
    shows that: started again, it would end so again. What went wrong is logged in one sentence, its traceback at
    debug level.
    """
    name = Path(sys.argv[0]).stem
    signal.signal(signal.SIGINT, _once_quietly)
    try:
        rclpy.init(args=args)
    except Exception as error:
        sys.stderr.write(f"{name}: bad arguments: {_sentence(error)}\n")
        return WRONG_USAGE
    node: Node | None = None
    status = DONE
    try:
        node = _make(factory)
        _spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else DONE
    except Exception as error:
        # After a signal the context is gone, and whatever a callback was just doing fails for that: no fault.
        if not _signalled():
            status = _report(node, name, error)
    try:
        if node is not None:
            node.destroy_node()
    except KeyboardInterrupt:
        pass
    except Exception as error:
        status = _report(node, name, error)
    rclpy.try_shutdown()
    return status


def _once_quietly(number: int, frame: object) -> None:
    """SIGINT does what SIGTERM does: rclpy ends the context. The next one interrupts what hangs.

    A KeyboardInterrupt comes up wherever Python happens to be, also in a finaliser or half-way through the making of
    an object of rclpy, where nothing can be caught and a traceback is printed.
    """
    signal.signal(signal.SIGINT, signal.default_int_handler)


def _make(factory: Callable[[], Node]) -> Node:
    try:
        return factory()
    except ParameterError:
        raise
    except ValueError as error:
        raise ParameterError(str(error)) from error


def _spin(node: Node) -> None:
    executor: Executor = EventsExecutor()
    executor.add_node(_silenced(node))
    # `spin` of the events executor runs no timers and does not stop on SIGTERM; `spin_once` with a time-out does both.
    while rclpy.ok():
        executor.spin_once(timeout_sec=1.0)


def _signalled() -> bool:
    """Whether a signal has ended the context. A thread of rclpy sees to that, a moment after what was interrupted."""
    deadline = time.monotonic() + SIGNAL_S
    while rclpy.ok() and time.monotonic() < deadline:
        time.sleep(0.01)
    return not rclpy.ok()


def _report(node: Node | None, name: str, error: Exception) -> int:
    logger = node.get_logger() if node is not None else get_logger(name)
    logger.fatal(_sentence(error))
    logger.debug("".join(traceback.format_exception(error)))
    return WRONG_USAGE if isinstance(error, _USAGE_ERRORS) else FAILED


def _sentence(error: Exception) -> str:
    text = " ".join(str(error).split())
    known = isinstance(error, (ValueError, OSError, RuntimeError)) and text
    return text if known else f"{type(error).__name__}: {text}"


class _QuietLogger:
    """A node's logger without the traceback that the events executor writes; `run` says it in one sentence."""

    def __init__(self, logger: Any) -> None:
        self._logger = logger

    def __getattr__(self, name: str) -> Any:
        return getattr(self._logger, name)

    def fatal(self, message: str, **options: Any) -> bool:
        return not message.startswith("Exception in '") and bool(self._logger.fatal(message, **options))

    def warn(self, message: str, **options: Any) -> bool:
        return not message.startswith("Error occurred at:") and bool(self._logger.warning(message, **options))


def _silenced(node: Node) -> Node:
    quiet = _QuietLogger(node.get_logger())
    setattr(node, "get_logger", lambda: quiet)  # noqa: B010 - a method of this one node
    return node
