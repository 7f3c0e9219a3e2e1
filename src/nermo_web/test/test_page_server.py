"""One port for the page, its line and the scene; who may come in and who may not."""

from __future__ import annotations

import http.client
import time
from collections.abc import Callable, Iterator

import pytest
import viser
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from nermo_description.robots import load_any_robot
from nermo_web.door import LONGEST_TEXT
from nermo_web.page_server import Event, PageServer
from nermo_web.robot_shape import RobotShape
from nermo_web.scene import Scene

TOKEN = "a-token"


@pytest.fixture(scope="module")
def scene() -> Iterator[Scene]:
    made = Scene(RobotShape(load_any_robot("nermo_lite")))
    yield made
    made.close()


@pytest.fixture
def server(scene: Scene) -> Iterator[PageServer]:
    made = PageServer("127.0.0.1", 0, "", scene.port)
    yield made
    made.close()


@pytest.fixture
def guarded(scene: Scene) -> Iterator[PageServer]:
    made = PageServer("0.0.0.0", 0, TOKEN, scene.port)
    yield made
    made.close()


def get(server: PageServer, path: str, **headers: str) -> tuple[int, bytes, str]:
    """Status, body and cookie."""
    line = http.client.HTTPConnection("127.0.0.1", server.port, timeout=30)
    line.request("GET", path, headers=headers)
    answer = line.getresponse()
    return answer.status, answer.read(), answer.getheader("Set-Cookie", "").partition(";")[0]


def join(server: PageServer, path: str = "/line", **options: object) -> ClientConnection:
    return connect(f"ws://127.0.0.1:{server.port}{path}", proxy=None, **options)


def event(server: PageServer) -> Event:
    return server.events.get(timeout=30)


def until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 30.0
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def flood(line: ClientConnection) -> None:
    while True:
        line.send("{}")


def test_pictures_have_numbers_and_their_own_kind(server: PageServer, guarded: PageServer) -> None:
    png = b"\x89PNG\r\n\x1a\n..."
    server.pictures, guarded.pictures = [b"\xff\xd8\xff...", png], [png]
    assert get(server, "/camera/1")[:2] == (200, png)
    for number in ("2", "", "-1", "x", "1" * 400):
        assert get(server, f"/camera/{number}")[0] == 404, number
    assert get(guarded, "/camera/0")[0] == 403
    server.pictures = []
    assert get(server, "/camera/0")[0] == 404


def test_it_serves_the_page_and_the_scene(server: PageServer) -> None:
    assert b"<title>Nermo</title>" in get(server, "/")[1]
    assert b"use strict" in get(server, "/page.js")[1]
    assert get(server, "/page.css")[0] == 200
    assert len(get(server, "/3d/")[1]) > 100_000
    for path in ("/nothing", "/../door.py", "/%2e%2e/door.py", "/..%2fdoor.py", "/.hidden", "//etc/passwd"):
        assert get(server, path)[0] == 404


def test_the_scene_behind_it_is_vivid(server: PageServer, scene: Scene) -> None:
    protocol = f"viser-v{viser.__version__}"
    with join(server, "/3d", subprotocols=[protocol], max_size=None) as line:
        assert line.subprotocol == protocol
        assert len(line.recv(timeout=30)) > 10_000, "the meshes"
    with pytest.raises(InvalidStatus, match="404"):
        join(server, "/elsewhere")


def test_a_line_tells_what_a_browser_does(server: PageServer) -> None:
    with join(server) as line:
        came = event(server)
        assert (came.text, came.here) == (None, True)
        line.send('{"kind": "stop"}')
        assert event(server).text == '{"kind": "stop"}'
        server.say("for all")
        server.say("for you", came.viewer)
        server.say("for somebody else", came.viewer + 1)
        assert [line.recv(timeout=30), line.recv(timeout=30)] == ["for all", "for you"]
    went = event(server)
    assert (went.viewer, went.text, went.here) == (came.viewer, None, False)


def test_who_sends_too_much_is_cut_off(server: PageServer) -> None:
    with join(server) as line:
        event(server)
        with pytest.raises(ConnectionClosed):
            flood(line)
    until(lambda: server.events.qsize() > 0)
    with join(server) as line:
        line.send("x" * (LONGEST_TEXT + 1))
        with pytest.raises(ConnectionClosed):
            line.recv(timeout=30)


def test_pages_from_elsewhere_are_refused(server: PageServer) -> None:
    own = f"127.0.0.1:{server.port}"
    assert get(server, "/", Origin=f"http://{own}")[0] == 200
    assert get(server, "/", Host=f"localhost:{server.port}")[0] == 200
    assert get(server, "/", Origin="http://evil.example")[0] == 403
    assert get(server, "/", Host=f"evil.example:{server.port}")[0] == 403
    assert get(server, "/", Host="127.0.0.1.evil.example")[0] == 403
    with pytest.raises(InvalidStatus, match="403"):
        join(server, origin="http://evil.example")


def test_others_need_the_token(guarded: PageServer) -> None:
    for path in ("/", "/page.js", "/3d/", "/?token=", "/?token=another"):
        assert get(guarded, path)[0] == 403
    for path in ("/line", "/3d", "/line?token=another"):
        with pytest.raises(InvalidStatus, match="403"):
            join(guarded, path)
    status, _, cookie = get(guarded, f"/?token={TOKEN}")
    assert status == 200 and cookie
    assert get(guarded, "/page.js", Cookie=cookie)[0] == 200
    assert get(guarded, "/page.js", Cookie=cookie[:-1])[0] == 403
    with join(guarded, additional_headers={"Cookie": cookie}):
        assert event(guarded).here
    assert all(address.endswith(f"/?token={TOKEN}") for address in guarded.addresses)


def test_where_it_cannot_be_is_said(server: PageServer, scene: Scene) -> None:
    with pytest.raises(ValueError, match="needs a token"):
        PageServer("0.0.0.0", 0, "", scene.port)
    with pytest.raises(ValueError, match=f"the page cannot be on 127.0.0.1:{server.port}: "):
        PageServer("127.0.0.1", server.port, "", scene.port)
