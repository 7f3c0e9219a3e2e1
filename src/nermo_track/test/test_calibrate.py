"""A camera calibrated from a film of the board that is drawn through its lens."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from nermo_description.results import CommandError
from nermo_track.bench.studio import Print, Studio, save_film
from nermo_track.camera import Camera, load_camera
from nermo_track.cli import track_app
from nermo_track.pose import Placement

LENS = Camera(width=480, height=360, fx=450.0, fy=451.0, cx=241.5, cy=178.0, distortion=(-0.25, 0.08, 1e-3, -5e-4, 0.0))


def film_board(path: Path, views: int, spread: float, tilt: float, near: float = 0.35) -> Path:
    """The board in some places, held still for two pictures each; ``spread`` of the picture, ``tilt`` [deg], from
    ``near`` [m] on."""
    random = np.random.default_rng(0)
    studio = Studio(LENS, Placement(Rotation.identity(), np.zeros(3)), [], [Print.of_board()])

    def pictures():
        for _ in range(views):
            middle = np.array([LENS.width, LENS.height]) * (0.5 + spread * random.uniform(-0.5, 0.5, 2))
            place = LENS.rays(middle[None])[0] * random.uniform(near, near + 0.15)
            angles = [180.0 + tilt * random.uniform(-1, 1), tilt * random.uniform(-1, 1), 20.0 * random.uniform(-1, 1)]
            turn = Rotation.from_euler("xyz", angles, degrees=True)

            def poses(time, place=place, turn=turn):
                count = len(np.atleast_1d(time))
                return np.tile(place, (count, 1)), Rotation.concatenate([turn] * count)

            yield studio.picture(poses, 0.0)
            yield studio.picture(poses, 0.0)

    save_film(pictures(), path, LENS, 10.0)
    return path


def test_the_lens_is_found(tmp_path: Path) -> None:
    film = film_board(tmp_path / "board.avi", 20, 0.6, 35.0)
    out, facts = tmp_path / "camera.yaml", tmp_path / "facts.json"
    arguments = ["calibrate", str(film), "--out", str(out), "--line-delay", "2e-5", "--exposure", "0.004"]
    told = CliRunner().invoke(track_app, [*arguments, "--json", str(facts)])
    assert told.exit_code == 0, told.output
    assert "reprojection error" in told.output
    found = load_camera(out)
    assert (found.fx, found.fy) == pytest.approx((LENS.fx, LENS.fy), rel=0.005)
    assert (found.cx, found.cy) == pytest.approx((LENS.cx, LENS.cy), abs=2.5)
    assert (found.line_delay, found.exposure) == (2e-5, 0.004)
    assert found.rms is not None and found.rms < 0.3
    # What counts is where rays go, wherever the board was seen.
    inner = np.array([[x, y] for x in range(40, 441, 50) for y in range(30, 331, 50)], dtype=np.float64)
    assert np.abs(found.project(LENS.rays(inner))[0] - inner).max() < 1.5


@pytest.mark.parametrize(
    ("views", "spread", "near", "words"),
    [(5, 0.6, 0.35, "needed: 8"), (24, 0.25, 0.40, "hold it into the corners")],
)
def test_a_film_that_does_not_tell_is_refused(
    tmp_path: Path, views: int, spread: float, near: float, words: str
) -> None:
    film = film_board(tmp_path / "board.avi", views, spread, 30.0, near)
    out = tmp_path / "camera.yaml"
    told = CliRunner().invoke(track_app, ["calibrate", str(film), "--out", str(out)])
    assert isinstance(told.exception, CommandError)
    assert words in str(told.exception) and told.exception.status == 1
    assert not out.exists()
