"""Serves the page of a diagnosis on a port: its files, its events as they come, the report when it is there.

Whoever opens it only reads, unless a player was handed in: then a hand on the page's button is taken too.
"""

from __future__ import annotations

import contextlib
import hmac
import http
import itertools
import mimetypes
import secrets
import select
import socket
import threading
import time
import urllib.parse
from collections.abc import Iterator
from http.cookies import CookieError, SimpleCookie
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from typing import Any

from pydantic import ValidationError

from simgap.data.errors import GapInputError
from simgap.live.player import Hand, Player
from simgap.live.story import Story

LOOPBACK = ("127.0.0.1", "::1", "localhost")
HEARTBEAT_S = 5.0
"""Between two signs of life to a browser to which there is nothing to tell: one that is gone is noticed."""
STUCK_S = 20.0
"""A browser that takes nothing for so long is gone."""
LONGEST_HAND = 200
"""Bytes of what a browser says of a hand."""
_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; connect-src 'self'; "
    "img-src 'self' data:; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)


class PageServer:
    """The page on a port, in threads of its own.

    Args:
        host: Where to listen. Anything but this machine itself gives the address a token, without which nothing is
            served.
        port: 0: any that is free.
        player: What a hand on the page's button is for; None: nothing is taken.

    Raises:
        GapInputError: it cannot listen there.
    """

    def __init__(self, story: Story, page: str, host: str, port: int, player: Player | None = None) -> None:
        self.story, self.page, self.report, self.player = story, page.encode(), b"", player
        self.numbers = itertools.count(1)
        """Of the browsers that follow."""
        self.token = "" if host in LOOPBACK else secrets.token_urlsafe(16)
        self._host, self._readers, self._left = host, 0, threading.Condition()
        try:
            family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
            self._server = _Server((host, port), family, self)
        except (OSError, OverflowError) as error:
            why = getattr(error, "strerror", None) or str(error)
            raise GapInputError(
                f"--web: the page cannot be on {host}:{port}: {why.lower()}; give another --web-port, or 0 for any"
            ) from error
        self.port = int(self._server.server_address[1])
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.1,), name="page", daemon=True)
        self._thread.start()

    @property
    def address(self) -> str:
        """What to open."""
        host = socket.gethostname() if self._host in ("0.0.0.0", "::") else self._host
        token = f"?token={self.token}" if self.token else ""
        return f"http://{f'[{host}]' if ':' in host else host}:{self.port}/{token}"

    @contextlib.contextmanager
    def reading(self) -> Iterator[int]:
        """While a browser follows; its number."""
        with self._left:
            self._readers += 1
            viewer = next(self.numbers)
        if self.player:
            self.player.join(viewer)
        try:
            yield viewer
        finally:
            if self.player:
                self.player.leave(viewer)
            with self._left:
                self._readers -= 1
                self._left.notify_all()

    @property
    def readers(self) -> int:
        """How many browsers follow."""
        return self._readers

    def close(self, patience: float) -> None:
        """End, as soon as every browser that follows has all it needs; at the latest after ``patience`` [s]."""
        with self._left:
            self._left.wait_for(lambda: self._readers == 0, patience)
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    block_on_close = False

    def __init__(self, address: tuple[str, int], family: int, owner: PageServer) -> None:
        self.address_family, self.owner = family, owner
        super().__init__(address, _Handler)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A browser that goes away in the middle is none of the terminal's business."""


class _Handler(BaseHTTPRequestHandler):
    server: _Server
    timeout = STUCK_S
    protocol_version = "HTTP/1.1"  # so that a hand, told of 20 times a second, keeps its connection

    def log_message(self, format: str, *args: Any) -> None:
        """The terminal is the diagnosis's."""

    def do_GET(self) -> None:
        """Answer."""
        owner, path = self.server.owner, urllib.parse.urlsplit(self.path).path
        if refusal := self._refusal():
            self._answer(refusal.encode() + b"\n", "text/plain", http.HTTPStatus.FORBIDDEN)
        elif path == "/":
            self._answer(owner.page, "text/html")
        elif path == "/events":
            with owner.reading() as viewer:
                self._events(viewer)
        elif path == "/report.html" and owner.report:
            self._answer(owner.report, "text/html")
        else:
            name = path.lstrip("/")
            file = files("simgap.live") / "page" / name
            if "/" in name or not name.endswith((".js", ".css")) or not file.is_file():
                self._answer(f"there is no page {path}\n".encode(), "text/plain", http.HTTPStatus.NOT_FOUND)
            else:
                self._answer(file.read_bytes(), mimetypes.guess_type(name)[0] or "text/plain")

    def do_POST(self) -> None:
        """Take a hand on the button; the answer is why it does not count, or nothing."""
        owner, path = self.server.owner, urllib.parse.urlsplit(self.path).path
        length, kind = self.headers.get("Content-Length", ""), self.headers.get("Content-Type", "")
        if refusal := self._refusal() or self._foreign():
            self._answer(refusal.encode() + b"\n", "text/plain", http.HTTPStatus.FORBIDDEN)
        elif path != "/hand" or owner.player is None:
            self._answer(f"there is nothing to say to {path}\n".encode(), "text/plain", http.HTTPStatus.NOT_FOUND)
        elif kind != "application/json" or not (length.isdecimal() and int(length) <= LONGEST_HAND):
            told = f"refused: JSON of at most {LONGEST_HAND} bytes\n"
            self._answer(told.encode(), "text/plain", http.HTTPStatus.BAD_REQUEST)
        else:
            try:
                hand = Hand.model_validate_json(self.rfile.read(int(length)))
            except ValidationError as error:
                first = error.errors(include_url=False)[0]
                told = f"refused: {'.'.join(map(str, first['loc'])) or 'hand'}: {first['msg']}\n"
                self._answer(told.encode(), "text/plain", http.HTTPStatus.BAD_REQUEST)
            else:
                self._answer(owner.player.hold(hand).encode(), "text/plain")

    def _foreign(self) -> str:
        """Why a page may say nothing here; empty where it is ours."""
        origin = self.headers.get("Origin", "")
        if urllib.parse.urlsplit(origin).netloc != self.headers.get("Host", ""):
            return "refused: a page from elsewhere may not move this robot"
        return ""

    def _answer(self, body: bytes, kind: str, status: http.HTTPStatus = http.HTTPStatus.OK) -> None:
        self._head(kind, status)
        self.send_header("Content-Length", str(len(body)))
        if status is not http.HTTPStatus.OK:
            # What else came with it may not have been read.
            self.send_header("Connection", "close")
        self.end_headers()
        self.wfile.write(body)

    def _head(self, kind: str, status: http.HTTPStatus = http.HTTPStatus.OK) -> None:
        owner = self.server.owner
        self.send_response(status)
        self.send_header("Content-Type", f"{kind}; charset=utf-8")
        self.send_header("Cache-Control", "no-store")
        self.send_header("X-Content-Type-Options", "nosniff")
        self.send_header("Content-Security-Policy", _POLICY)
        self.send_header("Referrer-Policy", "no-referrer")
        if owner.token and status is http.HTTPStatus.OK:
            cookie = f"{self._cookie}={owner.token}; HttpOnly; SameSite=Strict; Path=/"
            self.send_header("Set-Cookie", cookie)

    def _events(self, viewer: int) -> None:
        """All events from the first on, or from where this browser was cut off; until it goes, or has the last."""
        story, last = self.server.owner.story, self.headers.get("Last-Event-ID", "")
        number = int(last) + 1 if last.isdecimal() and len(last) < 10 else 0
        self._head("text/event-stream")
        self.send_header("Connection", "close")
        self.end_headers()
        if self.server.owner.player:
            # Without a number of its own: it is for this browser, and is no part of the story.
            self.wfile.write(b"event: you\ndata: %d\n\n" % viewer)
        while not self._gone(0.0):
            events, ended = story.since(number, HEARTBEAT_S)
            for text in events:
                self.wfile.write(b"id: %d\ndata: %b\n\n" % (number, text))
                number += 1
            if not events:
                self.wfile.write(b": still here\n\n")
            if ended:
                # It goes when it has fetched what the last one names.
                self._gone(STUCK_S)
                return

    def _gone(self, patience: float) -> bool:
        """Whether the browser has closed its side, or does so within ``patience`` [s]; it sends nothing else."""
        deadline = time.monotonic() + patience
        while select.select([self.connection], [], [], max(deadline - time.monotonic(), 0.0))[0]:
            if not self.connection.recv(1024):
                return True
        return False

    @property
    def _cookie(self) -> str:
        """Cookies know no ports, and there may be several pages."""
        return f"simgap_{self.server.owner.port}"

    def _refusal(self) -> str:
        """Why this browser gets nothing; empty where it does."""
        host, token = self.headers.get("Host", ""), self.server.owner.token
        if not token:
            try:
                name = urllib.parse.urlsplit(f"//{host}").hostname
            except ValueError:
                name = None
            # A name that somebody else has made point here would let his page read.
            return "" if name in LOOPBACK else "refused: open it as 127.0.0.1 or localhost"
        given = urllib.parse.parse_qs(urllib.parse.urlsplit(self.path).query).get("token", [])
        with contextlib.suppress(CookieError):
            if cookie := SimpleCookie(self.headers.get("Cookie", "")).get(self._cookie):
                given.append(cookie.value)
        if any(hmac.compare_digest(one.encode(), token.encode()) for one in given):
            return ""
        return "refused: open the whole address that was printed, with its token"
