"""Serves the page of a diagnosis on a port: its files, its events as they come, the report when it is there.

Whoever opens it only reads: there is nothing here that a browser could change.
"""

from __future__ import annotations

import contextlib
import hmac
import http
import mimetypes
import secrets
import select
import socket
import threading
import time
import urllib.parse
from http.cookies import CookieError, SimpleCookie
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from typing import Any

from simgap.data.errors import GapInputError
from simgap.live.story import Story

LOOPBACK = ("127.0.0.1", "::1", "localhost")
HEARTBEAT_S = 5.0
"""Between two signs of life to a browser to which there is nothing to tell: one that is gone is noticed."""
STUCK_S = 20.0
"""A browser that takes nothing for so long is gone."""
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

    Raises:
        GapInputError: it cannot listen there.
    """

    def __init__(self, story: Story, page: str, host: str, port: int) -> None:
        self.story, self.page, self.report = story, page.encode(), b""
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
    def reading(self) -> Any:
        """While a browser follows."""
        with self._left:
            self._readers += 1
        try:
            yield
        finally:
            with self._left:
                self._readers -= 1
                self._left.notify_all()

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
            with owner.reading():
                self._events()
        elif path == "/report.html" and owner.report:
            self._answer(owner.report, "text/html")
        else:
            name = path.lstrip("/")
            file = files("simgap.live") / "page" / name
            if "/" in name or not name.endswith((".js", ".css")) or not file.is_file():
                self._answer(f"there is no page {path}\n".encode(), "text/plain", http.HTTPStatus.NOT_FOUND)
            else:
                self._answer(file.read_bytes(), mimetypes.guess_type(name)[0] or "text/plain")

    def _answer(self, body: bytes, kind: str, status: http.HTTPStatus = http.HTTPStatus.OK) -> None:
        self._head(kind, status)
        self.send_header("Content-Length", str(len(body)))
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

    def _events(self) -> None:
        """All events from the first on, or from where this browser was cut off; until it goes, or has the last."""
        story, last = self.server.owner.story, self.headers.get("Last-Event-ID", "")
        number = int(last) + 1 if last.isdecimal() and len(last) < 10 else 0
        self._head("text/event-stream")
        self.end_headers()
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
