"""Films that are drawn pixel by pixel: tags on a floor and on a mouse that moves, through a lens that distorts.

Every pixel's ray meets the paper at its own row's time and at several times of the exposure, so that distortion,
rolling shutter and motion blur are as they are, and not approximated.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from nermo_track.calibrate import COLUMNS, ROWS, SQUARE, board
from nermo_track.camera import Camera
from nermo_track.film import Picture
from nermo_track.layout import DICTIONARY, MODULES, Layout, Tag
from nermo_track.pose import Placement

Array = NDArray[np.float64]
Poses = Callable[[Array], tuple[Array, Rotation]]
"""Times (n,) [s] -> positions (n, 3) [m] and rotations of a frame in the world."""
Painter = Callable[[Array, float], None]
"""Paints on a picture (height, width) whose first row's exposure begins at a time [s]."""

FINER = 3
"""Rays along each edge of a pixel."""
MOMENTS = 5
"""Times of an exposure."""
TEXELS = 24
"""Of a tag's texture along the edge of a module."""
WHITE, BLACK, FLOOR = 210.0, 25.0, 120.0
"""Grey of paper, ink and ground."""


@dataclass(frozen=True)
class Print:
    """A printed paper in the frame of what it lies on, its x to the right of the print and its y up."""

    texture: NDArray[np.float32]
    """(rows, columns) Grey."""
    width: float
    """[m]"""
    height: float
    """[m]"""
    position: Array
    """(3,) [m] Of its middle."""
    rotation: Rotation

    @classmethod
    def of_tag(cls, tag: Tag) -> Print:
        """A tag with one white module around it."""
        edge = tag.size * (1.0 + 2.0 / MODULES)
        return cls(_texture(tag.id), edge, edge, np.array(tag.position), tag.rotation)

    @classmethod
    def of_board(cls) -> Print:
        """The board for the camera's calibration, one millimetre of paper around it, about its middle."""
        dots = 28
        picture = board().generateImage((COLUMNS * dots, ROWS * dots), marginSize=0, borderBits=1)
        width, height = ((1e3 * SQUARE * count + 2.0) * 1e-3 for count in (COLUMNS, ROWS))
        texture = np.pad(np.repeat(np.repeat(picture, 4, axis=0), 4, axis=1), 4, constant_values=255)
        return cls(_grey(texture), width, height, np.zeros(3), Rotation.identity())

    @classmethod
    def of_floor(cls, width: float, height: float, seed: int = 0) -> Print:
        """A floor [m] with grain, fine and coarse, a hair below the papers on it."""
        random, shape = np.random.default_rng(seed), (round(1e3 * height), round(1e3 * width))
        texture = np.full(shape, FLOOR, dtype=np.float32)
        for coarse in (2.0, 6.0, 20.0):
            grain = cv2.GaussianBlur(random.standard_normal(shape).astype(np.float32), (0, 0), coarse)
            texture += np.float32(6.0 / np.std(grain)) * grain
        return cls(texture, width, height, np.array([0.0, 0.0, -1e-4]), Rotation.identity())

    @property
    def corners(self) -> Array:
        """(4, 3) [m]"""
        half = 0.5 * np.array([self.width, self.height, 0.0])
        signs = np.array([[-1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [-1.0, -1.0, 0.0]])
        return np.asarray(self.rotation.apply(signs * half) + self.position, dtype=np.float64)


@dataclass(frozen=True)
class Flaws:
    """What spoils a picture."""

    noise: float = 2.5
    """Standard deviation of a pixel's noise, of 255."""
    softness: float = 0.7
    """[px] Standard deviation of the lens's blur."""


def look_at(eye: Sequence[float], target: Sequence[float]) -> Placement:
    """The world in the axes of a camera at ``eye`` [m] that looks at ``target`` [m], upright."""
    place = np.array(eye, dtype=np.float64)
    ahead = np.array(target, dtype=np.float64) - place
    ahead /= np.linalg.norm(ahead)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    axes = Rotation.from_matrix(np.column_stack([right, np.cross(ahead, right), ahead]))
    return Placement(axes, place).inverse


class Studio:
    """One camera that films papers: some lie still in the world, others move with a body."""

    def __init__(
        self,
        camera: Camera,
        world: Placement,
        still: Sequence[Print],
        moving: Sequence[Print],
        flaws: Flaws | None = None,
        seed: int = 0,
        painters: Sequence[Painter] = (),
        others: Sequence[tuple[Print, Poses]] = (),
    ) -> None:
        """``world``: the world in the camera's axes. ``painters`` paint what is no paper, after all papers.

        ``moving`` papers lie on the body whose poses a picture is asked for, ``others`` move with frames of their own.
        """
        self.camera, self.world, self._moving, self._flaws = camera, world, moving, flaws or Flaws()
        self._others = others
        self._painters = painters
        self._random = np.random.default_rng(seed)
        fine = (np.arange(max(camera.width, camera.height) * FINER) + 0.5) / FINER - 0.5
        across, down = np.meshgrid(fine[: camera.width * FINER], fine[: camera.height * FINER])
        rays = camera.rays(np.column_stack([across.ravel(), down.ravel()]))
        shape = (camera.height * FINER, camera.width * FINER, 3)
        self._eye = world.inverse.position
        self._rays = world.rotation.inv().apply(rays).reshape(shape)
        self._still = np.full(shape[:2], FLOOR)
        for paper in still:
            self._paint(
                self._still, slice(0, shape[0]), slice(0, shape[1]), paper, np.zeros((1, 3)), Rotation.identity(1)
            )

    @classmethod
    def of_layout(
        cls, camera: Camera, world: Placement, layout: Layout, seed: int = 0, markers: Mapping[str, Poses] | None = None
    ) -> Studio:
        """A camera over a floor and a mouse with tags; ``markers``: the poses of marked places that wear theirs."""
        still, moving = ([Print.of_tag(tag) for tag in tags] for tags in (layout.floor, layout.mouse))
        worn = [(Print.of_tag(tag), poses) for place, poses in (markers or {}).items() for tag in layout.markers[place]]
        return cls(camera, world, still, moving, seed=seed, others=worn)

    def picture(self, poses: Poses | None, begin: float, cover: bool = False) -> Picture:
        """The picture whose first row's exposure begins at ``begin`` [s]; ``cover``: a hand is before the mouse."""
        size = (self.camera.width, self.camera.height)
        picture = np.asarray(cv2.resize(self._still, size, interpolation=cv2.INTER_AREA), dtype=np.float64)
        if poses is not None:
            for paper in self._moving:
                self._paint_moving(picture, paper, poses, begin, cover)
            for paper, own in self._others:
                self._paint_moving(picture, paper, own, begin, False)
            for paint in self._painters:
                paint(picture, begin)
        if self._flaws.softness > 0.0:
            picture = np.asarray(cv2.GaussianBlur(picture, (0, 0), self._flaws.softness), dtype=np.float64)
        noisy = picture + self._flaws.noise * self._random.standard_normal(picture.shape)
        return np.asarray(np.clip(np.round(noisy), 0, 255), dtype=np.uint8)

    def _paint_moving(self, picture: Array, paper: Print, poses: Poses, begin: float, cover: bool) -> None:
        """Draw a paper that moves over all rows that it may be in."""
        camera = self.camera
        moments = begin + (np.arange(MOMENTS) + 0.5) / MOMENTS * camera.exposure
        ends = np.array([begin, begin + camera.exposure + camera.height * camera.line_delay])
        place, turn = poses(ends)
        outline = np.vstack([turn[k].apply(paper.corners) + place[k] for k in range(2)])
        pixels, _ = camera.project(self.world.apply(outline))
        low = np.clip(np.floor(pixels.min(axis=0)).astype(int) - 6, 0, [camera.width, camera.height])
        high = np.clip(np.ceil(pixels.max(axis=0)).astype(int) + 7, 0, [camera.width, camera.height])
        if (high <= low).any():
            return
        columns, rows = slice(low[0] * FINER, high[0] * FINER), slice(low[1] * FINER, high[1] * FINER)
        total = np.zeros((rows.stop - rows.start, columns.stop - columns.start))
        touched = np.zeros(total.shape, dtype=bool)
        late = (np.arange(rows.start, rows.stop) // FINER) * camera.line_delay
        for moment in moments:
            part = self._still[rows, columns].copy()
            at = poses(moment + late)
            touched |= self._paint(part, rows, columns, paper, *at, cover=cover)
            total += part
        fine = total / MOMENTS
        shape = (high[1] - low[1], FINER, high[0] - low[0], FINER)
        # Around it may be another paper, which was painted before.
        part = picture[low[1] : high[1], low[0] : high[0]]
        np.copyto(part, fine.reshape(shape).mean(axis=(1, 3)), where=touched.reshape(shape).any(axis=(1, 3)))

    def _paint(
        self,
        canvas: Array,
        rows: slice,
        columns: slice,
        paper: Print,
        place: Array,
        turn: Rotation,
        cover: bool = False,
    ) -> NDArray[np.bool_]:
        """Draw a paper where the canvas's rays meet its front, and say where; ``place`` and ``turn`` of its body.

        There may be one of these, or one a row.
        """
        axes = (turn * paper.rotation).as_matrix()
        origin = turn.apply(paper.position) + place
        start = (self._eye - origin)[:, None, :] @ axes
        towards = self._rays[rows, columns] @ axes
        with np.errstate(divide="ignore", invalid="ignore"):
            far = -start[..., 2] / towards[..., 2]
            across, up = start[..., 0] + far * towards[..., 0], start[..., 1] + far * towards[..., 1]
        inside = (
            (far > 0.0)
            & (towards[..., 2] < 0.0)
            & (np.abs(across) < 0.5 * paper.width)
            & (np.abs(up) < 0.5 * paper.height)
        )
        if cover:
            canvas[inside] = FLOOR
            return inside
        height, width = paper.texture.shape
        column = 0.5 * (width - 1) + across * width / paper.width
        row = 0.5 * (height - 1) - up * height / paper.height
        found = cv2.remap(
            paper.texture,
            np.where(inside, column, 0.0).astype(np.float32),
            np.where(inside, row, 0.0).astype(np.float32),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )
        canvas[inside] = found[inside]
        return inside


@cache
def _texture(number: int) -> NDArray[np.float32]:
    """A tag with one white module around it."""
    inner = cv2.aruco.generateImageMarker(DICTIONARY, number, MODULES, borderBits=1)
    padded = np.pad(inner, 1, constant_values=255)
    return _grey(np.repeat(np.repeat(padded, TEXELS, axis=0), TEXELS, axis=1))


def _grey(picture: NDArray[Any]) -> NDArray[np.float32]:
    """Paper and ink for white and black."""
    return (BLACK + (WHITE - BLACK) * (picture > 127)).astype(np.float32)


def shoot(
    studio: Studio, poses: Poses, begin: float, seconds: float, fps: float, covered: Sequence[tuple[float, float]] = ()
) -> Iterator[Picture]:
    """Pictures of a film that begins at ``begin`` [s] of the poses' time.

    ``covered``: from when to when [s] of the film a hand is before the mouse.
    """
    for number in range(round(seconds * fps)):
        time = number / fps
        yield studio.picture(poses, begin + time, any(low <= time < high for low, high in covered))


def save_film(pictures: Iterator[Picture], path: Path, camera: Camera, fps: float) -> None:
    """Write pictures as a film (.avi, Motion JPEG)."""
    video = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), fps, (camera.width, camera.height), False)
    try:
        video.set(cv2.VIDEOWRITER_PROP_QUALITY, 95)
        for picture in pictures:
            video.write(picture)
    finally:
        video.release()
