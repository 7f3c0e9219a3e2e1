"""Makes the visual meshes of the mouse: lofts through elliptic sections, written as binary STL.

N imported its CAD model (A.3.3); those files are not public. The meshes carry no mass and touch nothing. The same input
gives the same bytes.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from nermo_description.parameters import LegParameters
from nermo_description.robots import load_robot

Array = NDArray[np.float64]
Section = tuple[float, float, float, float, float]
"""Centre (x, y, z) and half axes across (horizontal, vertical) of an ellipse on a loft, in mm."""

AROUND = 28
"""Points around a section."""
FOLDER = Path(__file__).parents[1] / "meshes"


def loft(sections: list[Section], steps: int, around: int = AROUND) -> Array:
    """Closed skin through elliptic sections, smooth in between: triangles (n, 3, 3) [mm].

    Sections stand across the path of their centres, which lies in a plane of constant y.
    """
    stations = np.array(sections)
    along = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(stations[:, :3], axis=0), axis=1))))
    # Denser towards the ends, which are round.
    at = along[-1] * 0.5 * (1.0 - np.cos(np.linspace(0.0, np.pi, steps)))
    centre, axes = np.split(np.asarray(PchipInterpolator(along, stations)(at)), [3], axis=1)
    tangent = np.gradient(centre, at, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1)[:, None]
    horizontal = np.tile([0.0, 1.0, 0.0], (steps, 1))
    vertical = np.cross(tangent, horizontal)
    angle = np.linspace(0.0, 2.0 * np.pi, around, endpoint=False)
    rings = (
        centre[:, None]
        + np.cos(angle)[None, :, None] * (axes[:, :1] * horizontal)[:, None]
        + np.sin(angle)[None, :, None] * (axes[:, 1:] * vertical)[:, None]
    )
    return _skin(rings, centre[0], centre[-1])


def ellipsoid(half_axes: tuple[float, float, float], bend: float = 0.0, steps: int = 13, around: int = 20) -> Array:
    """An ellipsoid [mm] around the x axis, its middle pushed back by `bend`, which makes a shell of a flat one."""
    polar = np.linspace(0.0, np.pi, steps)[1:-1]
    angle = np.linspace(0.0, 2.0 * np.pi, around, endpoint=False)
    x = np.cos(polar)[:, None] * np.ones_like(angle)
    y, z = np.sin(polar)[:, None] * np.cos(angle), np.sin(polar)[:, None] * np.sin(angle)
    points = np.stack((x, y, z), axis=-1) * half_axes
    points[..., 0] -= bend * (1.0 - y**2 - z**2)
    ends = np.array([[half_axes[0] - bend, 0.0, 0.0], [-half_axes[0] - bend, 0.0, 0.0]])
    return _skin(points, ends[0], ends[1])


def _skin(rings: Array, first: Array, last: Array) -> Array:
    """Triangles around rings (n, m, 3), closed by a fan at either end."""
    here, there = rings[:-1], rings[1:]
    here_next, there_next = np.roll(here, -1, axis=1), np.roll(there, -1, axis=1)
    sides = [
        np.stack((here, here_next, there_next), axis=2).reshape(-1, 3, 3),
        np.stack((here, there_next, there), axis=2).reshape(-1, 3, 3),
    ]
    for ring, tip, order in ((rings[0], first, (0, 2, 1)), (rings[-1], last, (0, 1, 2))):
        fan = np.stack((np.broadcast_to(tip, ring.shape), ring, np.roll(ring, -1, axis=0)), axis=1)
        sides.append(fan[:, order])
    triangles = np.concatenate(sides)
    volume = np.einsum("ij,ij->", triangles[:, 0], np.cross(triangles[:, 1], triangles[:, 2]))
    return triangles if volume > 0.0 else triangles[:, ::-1]


def body_meshes() -> dict[str, Array]:
    """Torsos with bellies, the skin over the spine, head and ears, each in the frame of its body."""
    return {
        "front_torso": loft(
            [
                (-17, 0, 11, 2, 2),
                (-14, 0, 12, 20, 20),
                (-4, 0, 13, 28, 26.5),
                (14, 0, 14, 31.5, 28.5),
                (38, 0, 14, 33, 28),
                (60, 0, 14.5, 32, 26),
                (78, 0, 17.5, 22, 20.5),
                (93, 0, 20, 15, 16.5),
                (99, 0, 21, 10, 11),
                (101, 0, 21, 1, 1),
            ],
            30,
        ),
        "rear_torso": loft(
            [
                (20, 0, 22, 2, 2),
                (17, 0, 22.5, 19, 19),
                (8, 0, 23.5, 31, 27),
                (-8, 0, 25, 38.5, 30),
                (-22, 0, 24.5, 36.5, 28),
                (-33, 0, 24, 25, 21),
                (-40, 0, 24, 13, 12),
                (-46, 0, 24.5, 6.5, 6.2),
                (-50, 0, 25, 4.6, 4.4),
                (-51, 0, 25, 0.6, 0.6),
            ],
            28,
        ),
        "front_belly": ellipsoid((52, 27, 22)) + np.array([36, 0, 5.5]),
        "rear_belly": ellipsoid((30, 30, 22)) + np.array([-10, 0, 16]),
        "spine_skin": loft(
            [
                (13, 0, 17.5, 20, 18),
                (10, 0, 17.5, 27.5, 25.0),
                (4, 0, 17.5, 30.4, 27.0),
                (-4, 0, 17.5, 30.6, 27.2),
                (-10, 0, 17.5, 28.0, 25.4),
                (-13, 0, 17.5, 20, 18),
            ],
            17,
        ),
        "skull": loft(
            [
                (-13, 0, 0, 2, 2),
                (-10, 0, 0.5, 12, 12.5),
                (0, 0, 3, 17, 17),
                (11, 0, 5.2, 18.5, 17.6),
                (22, 0, 5.0, 16.4, 15.2),
                (34, 0, 2.0, 11.5, 10.8),
                (46, 0, -1.4, 7.2, 6.8),
                (55, 0, -3.2, 4.8, 4.6),
                (60, 0, -3.8, 3.0, 2.9),
                (61.5, 0, -3.9, 0.5, 0.5),
            ],
            28,
        ),
        "ear": ellipsoid((1.5, 11.5, 13.5), bend=3.5),
        "ear_inside": ellipsoid((0.8, 9.0, 10.8), bend=2.4),
    }


def leg_meshes(leg: LegParameters, pair: str) -> dict[str, Array]:
    """Upper leg, lower leg and paw with toes, each hanging down from its joint."""
    l1, l3, l4 = (1e3 * length for length in (leg.upper_length, leg.lower_length, leg.foot_length))
    thick = 1.0 if pair == "front" else 1.45
    upper = loft(
        [
            (0, 0, 8.5 * thick, 1, 1),
            (0, 0, 6.5 * thick, 3.6 * thick, 6.0 * thick),
            (0, 0, 0, 5.2 * thick, 9.2 * thick),
            (0, 0, -0.35 * l1, 4.9 * thick, 8.4 * thick),
            (0, 0, -0.75 * l1, 3.7 * thick, 5.0 * thick),
            (0, 0, -l1, 3.1, 3.6),
            (0, 0, -l1 - 3.2, 0.8, 0.8),
        ],
        20,
        20,
    )
    lower = loft(
        [
            (0, 0, 3.6, 0.8, 0.8),
            (0, 0, 0.8, 3.1, 3.5),
            (0, 0, -0.3 * l3, 3.0, 3.6 * thick),
            (0, 0, -0.7 * l3, 2.2, 2.5),
            (0, 0, -l3, 1.9, 2.1),
            (0, 0, -l3 - 2.0, 0.5, 0.5),
        ],
        16,
        16,
    )
    sole = loft(
        [
            (0, 0, 2.0, 0.5, 0.5),
            (0, 0, 0, 1.9, 2.0),
            (0, 0, -0.55 * l4, 1.9, 1.9),
            (0.6, 0, -l4 + 1.2, 2.9, 2.2),
            (0.9, 0, -l4 - 1.6, 2.6, 1.7),
            (1.0, 0, -l4 - 2.5, 0.6, 0.5),
        ],
        14,
        16,
    )
    toes = []
    for number in range(4):
        spread = (number - 1.5) / 1.5
        toe = loft(
            [(-1.0, 0, 0, 0.5, 0.5), (0.5, 0, 0, 1.15, 1.2), (4.4, 0, -0.4, 1.0, 1.0), (6.2, 0, -0.9, 0.3, 0.3)], 7, 10
        )
        angle = 0.32 * spread
        turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
        toes.append(toe @ turn.T + [1.2, 2.1 * spread, -l4 - 1.1])
    return {
        f"{pair}_upper": upper,
        f"{pair}_lower": lower,
        f"{pair}_paw": np.concatenate([sole, *toes]),
    }


def generate() -> dict[str, bytes]:
    """All meshes as binary STL in metres, by file name."""
    robot = load_robot("nermo_lite")
    meshes = {**body_meshes(), **leg_meshes(robot.front_leg, "front"), **leg_meshes(robot.rear_leg, "rear")}
    return {f"{name}.stl": _stl(triangles * 1e-3) for name, triangles in meshes.items()}


def _stl(triangles: Array) -> bytes:
    """Binary STL. Coordinates are rounded to a micrometre, so that no library's last digit shows."""
    rounded = np.round(triangles, 6)
    edges = rounded[:, 1:] - rounded[:, :1]
    kept = rounded[np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1) > 0.0]
    record = np.zeros(len(kept), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    record["corners"] = kept + 0.0
    return b"nermo".ljust(80, b" ") + np.uint32(len(kept)).astype("<u4").tobytes() + record.tobytes()


def main(arguments: list[str] | None = None) -> int:
    """Writes the meshes; with `--check`, only says whether those on disk are the same."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=FOLDER, help="folder to write to (default: the package's meshes/)")
    parser.add_argument("--check", action="store_true", help="write nothing; exit status 1 if a file differs")
    options = parser.parse_args(arguments)
    meshes = generate()
    if options.check:
        stale = [name for name, data in meshes.items() if not _same(options.out / name, data)]
        if stale:
            sys.stderr.write(f"{options.out}: not up to date: {', '.join(stale)}\n")
        return int(bool(stale))
    options.out.mkdir(parents=True, exist_ok=True)
    for name, data in meshes.items():
        (options.out / name).write_bytes(data)
    return 0


def _same(path: Path, data: bytes) -> bool:
    return path.is_file() and path.read_bytes() == data


if __name__ == "__main__":
    sys.exit(main())
