"""A test's own place in a ROS graph: a node that is served, what is waited for, processes that are ended."""

from __future__ import annotations

import signal
import subprocess
import time
from collections.abc import Callable, Sequence
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

PATIENCE_S = 90.0
"""How long a condition is waited for before the test fails; on an idle machine all hold within two seconds."""
LEAVING_S = 20.0
"""So long a process may take to end."""
LAST_WORDS_S = 1.0
"""So long what a process said is waited for after it has ended."""


class GraphBench:
    """A node in a context of its own, and the processes that a test started beside it."""

    def __init__(self, name: str = "bench", executor: type = SingleThreadedExecutor, **node: Any) -> None:
        self._context = Context()
        rclpy.init(context=self._context)
        self.node = Node(name, context=self._context, **node)
        self._executor = executor(context=self._context)
        self._executor.add_node(self.node)
        self._processes: list[subprocess.Popen[str]] = []

    def begin(self, command: Sequence[str], **settings: Any) -> subprocess.Popen[str]:
        """Starts a process whose output is kept; where it ends by itself, what is waited for fails with that."""
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
        process = subprocess.Popen(command, **{**pipes, **settings})
        self._processes.append(process)
        return process

    def stop(self, process: subprocess.Popen[str], number: int = signal.SIGINT) -> tuple[int, str]:
        """Exit status and output of a process after a signal, or as it has ended by itself."""
        process.send_signal(number)
        output, _ = process.communicate(timeout=PATIENCE_S)
        self._processes.remove(process)
        return process.returncode, output

    def alive(self, what: str) -> None:
        """Fails when a process has ended by itself."""
        for process in self._processes:
            assert process.poll() is None, f"{process.args} ended before {what}: {process.communicate()[0]}"

    def spin_once(self, timeout: float = 0.02) -> None:
        """Serves the node."""
        self._executor.spin_once(timeout_sec=timeout)

    def until(self, condition: Callable[[], Any], what: str, patience: float = PATIENCE_S) -> None:
        """Serves the node until something holds; the test fails when it does not, or when a process ends."""
        deadline = time.monotonic() + patience
        while not condition():
            if any(process.poll() is not None for process in self._processes) and not self._hears(condition):
                self.alive(what)
            assert time.monotonic() < deadline, f"waited {patience:g} s in vain until {what}"
            self.spin_once()

    def call(self, kind: Any, service: str, request: Any) -> Any:
        """Response of a service."""
        client = self.node.create_client(kind, service)
        self.until(client.service_is_ready, f"{service} is there")
        future = client.call_async(request)
        self.until(future.done, f"{service} answers")
        self.node.destroy_client(client)
        return future.result()

    def close(self) -> None:
        """Ends all processes and leaves the graph.

        Whoever is killed does not say that it leaves, and would be taken for a node of the next test for some seconds.
        """
        for process in self._processes:
            process.terminate()
        for process in self._processes:
            try:
                process.communicate(timeout=LEAVING_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.communicate()
        self._executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self._context)

    def _hears(self, condition: Callable[[], Any]) -> bool:
        """Whether something holds by what a process that has ended said last, which may be heard after its end."""
        deadline = time.monotonic() + LAST_WORDS_S
        while not condition() and time.monotonic() < deadline:
            self.spin_once()
        return bool(condition())
