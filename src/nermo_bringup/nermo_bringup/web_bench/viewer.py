"""A viewer that draws nothing: it takes what a browser takes, and counts it."""

from __future__ import annotations

import multiprocessing
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from multiprocessing.process import BaseProcess
from typing import Any

import msgspec
import viser
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect
from websockets.sync.connection import Connection
from websockets.typing import Subprotocol

CONNECT_S = 30.0
CAMERA = {
    "type": "ViewerCameraMessage",
    "wxyz": (1.0, 0.0, 0.0, 0.0),
    "position": (0.0, -1.0, 0.5),
    "fov": 0.8,
    "near": 0.01,
    "far": 100.0,
    "image_height": 720,
    "image_width": 1280,
    "look_at": (0.0, 0.0, 0.0),
    "up_direction": (0.0, 0.0, 1.0),
}
"""Where it looks from: who has not said so counts as no viewer to viser, and nothing is drawn for him."""


class Viewer:
    """A process that looks at the page on a port of this machine, until it is closed."""

    def __init__(self, port: int) -> None:
        fresh = multiprocessing.get_context("spawn")
        self._count = fresh.Value("Q", 0)
        self._process: BaseProcess = fresh.Process(target=_watch, args=(port, self._count), daemon=True)
        self._process.start()

    @property
    def received(self) -> int:
        """Bytes that came so far, those of the scene as it was found among them."""
        return int(self._count.value)

    @property
    def watches(self) -> bool:
        """Whether it is still there."""
        return self._process.is_alive()

    def close(self) -> None:
        """Let it go."""
        self._process.terminate()
        self._process.join(10.0)


@contextmanager
def watched(port: int, count: int) -> Iterator[list[Viewer]]:
    """So many viewers."""
    with ExitStack() as stack:
        viewers = []
        for _ in range(count):
            viewers.append(Viewer(port))
            stack.callback(viewers[-1].close)
        yield viewers


def _watch(port: int, count: Any) -> None:
    """Counts what comes on the page's line and on the scene's; ``count`` is a Synchronized integer."""

    def take(line: Connection) -> None:
        with suppress(ConnectionClosed):
            for message in line:
                with count.get_lock():
                    count.value += len(message)

    with _line(port, "/line") as line, _line(port, "/3d", f"viser-v{viser.__version__}") as scene:
        scene.send(msgspec.msgpack.encode(CAMERA))
        threading.Thread(target=take, args=(scene,), daemon=True).start()
        take(line)


def _line(port: int, path: str, *protocols: str) -> Connection:
    return connect(
        f"ws://127.0.0.1:{port}{path}",
        subprotocols=[Subprotocol(name) for name in protocols] or None,
        compression=None,
        max_size=None,
        open_timeout=CONNECT_S,
        proxy=None,
    )
