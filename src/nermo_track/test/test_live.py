"""A camera that films now: a drawn film comes over a real socket, and poses are read out of what was kept."""

from __future__ import annotations

import shutil
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from nermo_description.results import CommandError
from nermo_track import live
from nermo_track.bench.studio import Studio, look_at
from nermo_track.camera import Camera, save_camera
from nermo_track.cli import track_app
from nermo_track.errors import TrackError
from nermo_track.film import Film, times_file
from nermo_track.layout import load_layout
from nermo_track.live import Source, film_live

CAMERA = Camera(width=480, height=360, fx=450.0, fy=450.0, cx=239.5, cy=179.5)
RATE = 15.0
SPEED = 0.02
"""[m/s] By which the drawn mouse goes ahead in the server's own time."""


@pytest.fixture(scope="module")
def drawn() -> list[bytes]:
    """JPEG pictures of tags that go ahead."""
    from scipy.spatial.transform import Rotation

    studio = Studio.of_layout(CAMERA, look_at((0.05, -0.35, 0.5), (0.05, 0.0, 0.0)), load_layout())

    def poses(when: np.ndarray) -> tuple[np.ndarray, Rotation]:
        along = SPEED * np.atleast_1d(when)
        return np.column_stack([along, 0.0 * along, 0.045 + 0.0 * along]), Rotation.identity(len(along))

    pictures = (studio.picture(poses, number / RATE) for number in range(45))
    return [cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes() for picture in pictures]


@contextmanager
def camera_at(pictures: list[bytes], hang: bool = False) -> Iterator[str]:
    """A camera on this machine that sends pictures, and then no more; ``hang``: without saying that it ends."""
    end = threading.Event()

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=picture")
            self.end_headers()
            try:
                for picture in pictures:
                    head = f"--picture\r\nContent-Type: image/jpeg\r\nContent-Length: {len(picture)}\r\n\r\n"
                    self.wfile.write(head.encode() + picture + b"\r\n")
                    if end.wait(1.0 / RATE):
                        return
                if hang:
                    end.wait()
            except (BrokenPipeError, ConnectionResetError):
                pass

        def log_message(self, *words: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}/video"
    finally:
        end.set()
        server.shutdown()
        server.server_close()


def test_poses_are_read_out_of_what_came_over_a_socket(drawn: list[bytes], tmp_path: Path) -> None:
    out, camera, poses = tmp_path / "walk.mkv", tmp_path / "camera.yaml", tmp_path / "poses.csv"
    save_camera(CAMERA, camera)
    with camera_at(drawn * 3) as url:
        told = CliRunner().invoke(track_app, ["live", url, "--seconds", "1.5", "--out", str(out)])
    assert told.exit_code == 0, told.output
    assert "tags seen: 0, 20" in told.output and "dropped" in told.output
    times = [when for when, _ in Film(out).pictures()]
    stamps = np.loadtxt(times_file(out), skiprows=1, dtype=np.int64)
    np.testing.assert_allclose(times, (stamps - stamps[0]) * 1e-9, atol=1e-9)
    assert abs(stamps[-1] * 1e-9 - time.time()) < 600.0
    tracked = CliRunner().invoke(track_app, ["film", str(out), "--camera", str(camera), "--out", str(poses)])
    assert tracked.exit_code == 0, tracked.output
    table = np.genfromtxt(poses, delimiter=",", names=True)
    assert len(table) > 0.8 * len(times)
    assert np.abs(table["base_y"]).max() < 3e-3
    assert np.abs(table["base_z"] - 0.045).max() < 5e-3
    assert table["base_x"].max() < SPEED * 3.1 + 3e-3


def test_nothing_of_a_picture_is_lost(drawn: list[bytes], tmp_path: Path) -> None:
    with camera_at(drawn) as url:
        source = Source(url)
        kept = []
        original = source.next

        def watched() -> tuple[int, np.ndarray] | None:
            got = original()
            kept.extend([] if got is None else [got[1]])
            return got

        source.next = watched  # type: ignore[method-assign]
        filmed = film_live(source, tmp_path / "walk.mkv", load_layout())
    assert filmed.ended is not None and "stopped sending" in filmed.ended
    read = [picture for _, picture in Film(tmp_path / "walk.mkv").pictures()]
    assert len(read) == len(kept) == filmed.said.pictures > 10
    assert all((one == other).all() for one, other in zip(read, kept, strict=True))


@pytest.mark.parametrize("hang", [False, True])
def test_a_camera_that_stops_leaves_what_came_before(
    drawn: list[bytes], tmp_path: Path, hang: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live, "SILENT", 1.5)
    out = tmp_path / "walk.mkv"
    with camera_at(drawn[:30], hang) as url:
        told = CliRunner().invoke(track_app, ["live", url, "--out", str(out)])
    assert isinstance(told.exception, CommandError) and told.exception.status == 1
    assert "the camera stopped sending" in str(told.exception) and str(out) in str(told.exception)
    assert len(list(Film(out).pictures())) > 5


class Drawn:
    """A camera that stands in for one: pictures at once, and then what happens."""

    name = "0"

    def __init__(self, then: Callable[[], None] = lambda: None, count: int = 20) -> None:
        self._then, self._left, self.closed = then, count, False

    def next(self) -> tuple[int, np.ndarray] | None:
        self._left -= 1
        if self._left < 0:
            self._then()
            return None
        return 10**18 + (20 - self._left) * 33_000_000, np.full((48, 64), 10 * self._left, np.uint8)

    def close(self) -> None:
        self.closed = True


def test_ctrl_c_ends_a_film_well(tmp_path: Path) -> None:
    def interrupt() -> None:
        raise KeyboardInterrupt

    camera = Drawn(interrupt)
    filmed = film_live(camera, tmp_path / "walk.mkv", load_layout())  # type: ignore[arg-type]
    assert filmed.ended is None and filmed.said.pictures == 20 and camera.closed
    times, pictures = zip(*Film(filmed.path).pictures(), strict=True)
    np.testing.assert_allclose(times, 0.033 * np.arange(20), atol=1e-9)
    assert [int(picture[0, 0]) for picture in pictures] == [10 * left for left in range(19, -1, -1)]


def test_a_disk_that_fills_ends_a_film_in_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    free = iter([1e10] * 12)
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: SimpleNamespace(free=next(free, 1e6)))
    filmed = film_live(Drawn(), tmp_path / "walk.mkv", load_layout())  # type: ignore[arg-type]
    assert filmed.ended is not None and "the disk is full" in filmed.ended
    assert len(list(Film(filmed.path).pictures())) == 12


def test_pictures_that_did_not_come_are_counted(tmp_path: Path) -> None:
    class Gappy(Drawn):
        def next(self) -> tuple[int, np.ndarray] | None:
            got = super().next()
            return None if got is None else (got[0] + (66_000_000 if self._left < 10 else 0), got[1])

    filmed = film_live(Gappy(), tmp_path / "walk.mkv", load_layout())  # type: ignore[arg-type]
    assert filmed.said.dropped == 2


def test_a_film_is_never_overwritten(tmp_path: Path) -> None:
    (tmp_path / "walk.mkv").write_bytes(b"mine")
    camera = Drawn()
    with pytest.raises(TrackError, match="never overwritten"):
        film_live(camera, tmp_path / "walk.mkv", load_layout())  # type: ignore[arg-type]
    assert (tmp_path / "walk.mkv").read_bytes() == b"mine"


def test_times_of_another_film_are_refused(tmp_path: Path) -> None:
    filmed = film_live(Drawn(), tmp_path / "walk.mkv", load_layout())  # type: ignore[arg-type]
    table = times_file(filmed.path)
    table.write_text("".join(table.read_text("utf-8").splitlines(keepends=True)[:6]), "utf-8")
    with pytest.raises(TrackError, match="has 5 times"):
        list(Film(filmed.path).pictures())
    assert len(list(Film(filmed.path, fps=30.0).pictures())) == 20
    table.write_text("t\nsoon\n", "utf-8")
    with pytest.raises(TrackError, match="stamp_ns"):
        Film(filmed.path)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["97", "--out", "{out}.mkv"], "no camera answers there"),
        (["http://127.0.0.1:9/video", "--out", "{out}.mkv"], "no camera answers there"),
        (["walk.mp4", "--out", "{out}.mkv"], "is no camera"),
        (["http://127.0.0.1:9/video", "--size", "640", "480", "--out", "{out}.mkv"], "are for devices"),
    ],
)
def test_a_camera_that_is_not_there_is_named(tmp_path: Path, arguments: list[str], words: str) -> None:
    told = CliRunner().invoke(track_app, ["live", *(text.format(out=tmp_path / "walk") for text in arguments)])
    assert isinstance(told.exception, CommandError)
    assert words in str(told.exception) and told.exception.status == 2
    assert not list(tmp_path.iterdir())
