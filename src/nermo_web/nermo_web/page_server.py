"""Serves the page on one port: its files, its line to the graph, and viser's scene behind it.

viser listens on this machine alone; whoever may see the page reaches it through here, so that there is one address, and
one place that judges who may come in.
"""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import http
import mimetypes
import socket
import threading
import time
import urllib.parse
import urllib.request
from collections.abc import Callable, Sequence
from http.cookies import CookieError, SimpleCookie
from importlib.resources import files
from queue import SimpleQueue
from typing import NamedTuple

from websockets.asyncio.client import connect
from websockets.asyncio.connection import Connection
from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed, WebSocketException
from websockets.http11 import Request, Response
from websockets.typing import Subprotocol

from nermo_web.door import LONGEST_TEXT, MOST_MESSAGES
from nermo_web.pictures import kind_of

LOOPBACK = ("127.0.0.1", "::1", "localhost")
SCENE, LINE, CAMERA = "/3d/", "/line", "/camera/"
"""Paths of viser's page, whose own line is the same without its last slash, of the line to the graph, and of a camera's
picture, which has its number there."""
START_S = 10.0
PING_S = 5.0
"""A browser that does not answer for so long is gone."""
ONLY_THE_PICTURE = b"""<style>.mantine-Notifications-root, .mantine-Paper-root, [data-portal],
[data-dock-root] > :not(:first-child) { display: none !important; }</style>"""
"""Of viser's own page only the picture is shown: its panel and its notes are not for drivers."""
VISER_BYTES = 50 * 1024 * 1024
"""The longest message of viser, as viser has it."""
MOST_BEHIND = 64 * 1024
"""Bytes that wait for a browser; one that is further behind misses what is said meanwhile."""


class Event(NamedTuple):
    """What a browser did, for whoever owns the page."""

    viewer: int
    at: float
    """[s] of the monotonic clock."""
    text: str | bytes | None
    """What it sent; None: it came, or it went."""
    here: bool = True
    """Whether it is still there."""


class PageServer:
    """The page on a port, in a thread of its own.

    Args:
        host: Where to listen. Anything but this machine itself wants a token.
        port: 0: any that is free.
        token: What the address must bring along; empty: nothing. Then only pages of this machine itself may connect.
        scene_port: Where viser listens on this machine.

    Raises:
        ValueError: It cannot listen there, or is open to others without a token.
    """

    def __init__(self, host: str, port: int, token: str, scene_port: int) -> None:
        if host not in LOOPBACK and not token:
            raise ValueError(f"the page on {host} needs a token, or everybody who reaches it drives the robot")
        self._token, self._scene_port = token, scene_port
        self.events: SimpleQueue[Event] = SimpleQueue()
        """What browsers did, in order."""
        self.pictures: list[bytes] = []
        """Of cameras, in an order that the page is told; to be replaced whole."""
        self._lines: dict[int, ServerConnection] = {}
        self._last_viewer = 0
        self._scene_page = b""
        self._socket = _listening(host, port)
        self.host, self.port = host, int(self._socket.getsockname()[1])
        self._loop = asyncio.new_event_loop()
        self._end: asyncio.Event | None = None
        self._started = threading.Event()
        self._thread = threading.Thread(target=self._run, name="page", daemon=True)
        self._thread.start()
        if not self._started.wait(START_S):
            raise ValueError(f"the page does not start on {host}:{port}")

    @property
    def addresses(self) -> list[str]:
        """What to open, from where."""
        hosts = _own_names() if self.host in ("0.0.0.0", "::") else [self.host]
        token = f"?token={self._token}" if self._token else ""
        return [f"http://{f'[{host}]' if ':' in host else host}:{self.port}/{token}" for host in hosts]

    def say(self, text: str, viewer: int | None = None) -> None:
        """Sends a text to one browser, or to all."""
        self._call(lambda: self._send(text, viewer))

    def drop(self, viewer: int, why: str) -> None:
        """Ends the line to a browser."""

        def end() -> None:
            if (line := self._lines.get(viewer)) is not None:
                self._keep(asyncio.ensure_future(line.close(1008, why[:100])))

        self._call(end)

    def close(self) -> None:
        """Ends all lines and the server."""

        def end() -> None:
            if self._end is not None:
                self._end.set()

        self._call(end)
        self._thread.join(START_S)

    # In the thread

    def _call(self, what: Callable[[], None]) -> None:
        if not self._loop.is_closed():
            self._loop.call_soon_threadsafe(what)

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        self._loop.run_until_complete(self._serve())
        self._loop.close()

    async def _serve(self) -> None:
        self._end = asyncio.Event()
        self._tasks: set[asyncio.Future[None]] = set()
        address = f"http://127.0.0.1:{self._scene_port}/"
        before, end, after = (await asyncio.to_thread(_get, address)).rpartition(b"</head>")
        self._scene_page = before + ONLY_THE_PICTURE + end + after
        server: Server
        async with serve(
            self._connected,
            sock=self._socket,
            process_request=self._answer,
            select_subprotocol=_viser_protocol,
            compression=None,
            max_size=LONGEST_TEXT,
            ping_interval=PING_S,
            ping_timeout=PING_S,
            close_timeout=1.0,
        ) as server:
            self._started.set()
            await self._end.wait()
            server.close()

    def _keep(self, task: asyncio.Future[None]) -> None:
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def _send(self, text: str, viewer: int | None) -> None:
        for number, line in self._lines.items():
            if viewer in (None, number) and line.transport.get_write_buffer_size() < MOST_BEHIND:
                self._keep(asyncio.ensure_future(_send(line, text)))

    async def _connected(self, line: ServerConnection) -> None:
        assert line.request is not None
        if _path(line.request) == LINE:
            await self._hear(line)
        else:
            await self._relay(line)

    async def _hear(self, line: ServerConnection) -> None:
        """Takes what one browser sends until it is gone."""
        self._last_viewer += 1
        viewer = self._last_viewer
        self._lines[viewer] = line
        self.events.put(Event(viewer, time.monotonic(), None))
        second, count = 0, 0
        try:
            async for text in line:
                now = time.monotonic()
                second, count = (second, count + 1) if int(now) == second else (int(now), 1)
                if count > MOST_MESSAGES:
                    await line.close(1008, f"more than {MOST_MESSAGES} messages in a second")
                    break
                self.events.put(Event(viewer, now, text))
        except ConnectionClosed:
            pass
        finally:
            del self._lines[viewer]
            self.events.put(Event(viewer, time.monotonic(), None, here=False))

    async def _relay(self, outer: ServerConnection) -> None:
        """Carries viser's messages both ways."""
        protocols = [outer.subprotocol] if outer.subprotocol else None
        address = f"ws://127.0.0.1:{self._scene_port}"
        try:
            async with connect(
                address, subprotocols=protocols, compression=None, max_size=VISER_BYTES, ping_interval=None, proxy=None
            ) as inner:
                ways = [asyncio.ensure_future(_carry(outer, inner)), asyncio.ensure_future(_carry(inner, outer))]
                try:
                    await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
                finally:
                    for way in ways:
                        way.cancel()
                    await asyncio.gather(*ways, return_exceptions=True)
        except (OSError, WebSocketException):
            await outer.close(1011, "the scene is not there")

    def _answer(self, line: ServerConnection, request: Request) -> Response | None:
        """The answer to a request; None lets a line through."""
        if (refusal := self._refusal(request)) is not None:
            return line.respond(http.HTTPStatus.FORBIDDEN, refusal + "\n")
        path = _path(request)
        if request.headers.get("Upgrade", "").lower() == "websocket":
            if path in (LINE, SCENE.rstrip("/")):
                return None
            return line.respond(http.HTTPStatus.NOT_FOUND, f"there is no line {path}\n")
        if path == SCENE:
            return self._page(self._scene_page, "text/html")
        if path.startswith(CAMERA):
            number, pictures = path.removeprefix(CAMERA), self.pictures
            if number.isdecimal() and len(number) < 3 and int(number) < len(pictures):
                picture = pictures[int(number)]
                return self._page(picture, kind_of(picture))
            return line.respond(http.HTTPStatus.NOT_FOUND, f"there is no camera {number}\n")
        name = path.lstrip("/") or "index.html"
        file = files("nermo_web") / "page" / name
        if "/" in name or name.startswith(".") or not file.is_file():
            return line.respond(http.HTTPStatus.NOT_FOUND, f"there is no page {path}\n")
        return self._page(file.read_bytes(), mimetypes.guess_type(name)[0] or "application/octet-stream")

    def _page(self, body: bytes, kind: str) -> Response:
        headers = Headers(
            [
                ("Content-Type", f"{kind}; charset=utf-8" if kind.startswith("text/") else kind),
                ("Content-Length", str(len(body))),
                ("Cache-Control", "no-cache"),
                ("X-Content-Type-Options", "nosniff"),
                ("Content-Security-Policy", f"frame-ancestors 'self' {self._other_names}"),
                ("Referrer-Policy", "no-referrer"),
                ("Connection", "close"),
            ]
        )
        if self._token:
            # The page's own requests, those of viser's page among them, bring it along by themselves.
            headers["Set-Cookie"] = f"{self._cookie}={self._token}; HttpOnly; SameSite=Strict; Path=/"
        return Response(200, "OK", headers, body)

    @property
    def _other_names(self) -> str:
        """Pages of this machine itself, which may show the scene under its other name."""
        return " ".join(f"http://{name}:{self.port}" for name in ("127.0.0.1", "localhost"))

    @property
    def _cookie(self) -> str:
        """Cookies know no ports, and there may be several mice."""
        return f"nermo_{self.port}"

    def _refusal(self, request: Request) -> str | None:
        host, origin = request.headers.get("Host", ""), request.headers.get("Origin")
        if origin is not None and urllib.parse.urlsplit(origin).netloc != host:
            return "refused: a page from elsewhere may not use this robot"
        if not self._token:
            name = urllib.parse.urlsplit(f"//{host}").hostname
            # A name that somebody else has made point here would let his page in.
            return None if name in LOOPBACK else "refused: open it as 127.0.0.1 or localhost"
        given = urllib.parse.parse_qs(urllib.parse.urlsplit(request.path).query).get("token", [])
        try:
            cookie = SimpleCookie(request.headers.get("Cookie", "")).get(self._cookie)
        except CookieError:
            cookie = None
        offered = [*given, *([cookie.value] if cookie is not None else [])]
        if any(hmac.compare_digest(one.encode(), self._token.encode()) for one in offered):
            return None
        return "refused: open the whole address that was printed, with its token"


async def _carry(source: Connection, target: Connection) -> None:
    async for message in source:
        await target.send(message)


async def _send(line: ServerConnection, text: str) -> None:
    with contextlib.suppress(ConnectionClosed):
        await line.send(text)


def _viser_protocol(line: ServerConnection, offered: Sequence[Subprotocol]) -> Subprotocol | None:
    return next((one for one in offered if one.startswith("viser-")), None)


def _path(request: Request) -> str:
    return urllib.parse.urlsplit(request.path).path


def _get(address: str) -> bytes:
    # Around whatever proxy the environment names: it is this machine.
    opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
    with opener.open(address, timeout=START_S) as answer:
        page: bytes = answer.read()
    return page


def _listening(host: str, port: int) -> socket.socket:
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        return socket.create_server((host, port), family=family)
    except OSError as error:
        why = str(error.strerror).partition(" (")[0].lower()
        raise ValueError(f"the page cannot be on {host}:{port}: {why}; name another port, or 0 for any") from None


def _own_names() -> list[str]:
    """Addresses of this machine at which others may find it, its own name last."""
    found = {str(entry[4][0]) for entry in _look_up(socket.gethostname())}
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # a documentation address; nothing is sent
            found.add(str(probe.getsockname()[0]))
        except OSError:
            pass
    return sorted(one for one in found if not one.startswith(("127.", "::1", "fe80"))) or [socket.gethostname()]


def _look_up(name: str) -> list[tuple[int, int, int, str, tuple[str | int, ...]]]:
    try:
        return list(socket.getaddrinfo(name, None, family=socket.AF_INET))  # type: ignore[arg-type]
    except OSError:
        return []
