"""Where on the floor a pixel is, for a camera that looks down: by tags on the floor, its height, or a scale."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from nermo_track.camera import Camera
from nermo_track.film import Picture
from nermo_track.floor import find_floor
from nermo_track.layout import Layout
from nermo_track.pose import Placement
from nermo_track.sightings import Detector, Sightings

Array = NDArray[np.float64]

BACK = 0.055
"""[m] Height of the mouse's outline over the floor: where the twin is widest in a stand, its torsos' middles."""
BACK_DEVIATION = 0.010
"""[m] By which it may be off: the outline is the torsos' in one place and a leg's in another."""


@dataclass(frozen=True)
class Plane:
    """A level plane over the floor, as a camera sees it."""

    camera: Camera
    world: Placement
    """The world in the camera's axes; z = 0 is the floor."""
    above: float
    """[m] Of the plane over the floor."""
    scale_known: bool = False
    """Somebody measured the scale in the plane itself: then its height is no matter."""

    @classmethod
    def of_tags(cls, camera: Camera, picture: Picture, layout: Layout, above: float, name: str) -> Plane:
        """By the floor's tags in a picture. Raises TrackError if none is seen, or they are not where they should be."""
        corners = Detector(layout.ids).find(picture)
        return cls(
            camera, find_floor(Sightings(np.zeros(1), layout.ids, corners[None]), camera, layout, name).world, above
        )

    @classmethod
    def of_height(cls, camera: Camera, height: float, above: float) -> Plane:
        """A camera that looks straight down from ``height`` [m]: the world's x is the picture's, its y is up in it."""
        return cls(
            camera, Placement(Rotation.from_euler("x", 180.0, degrees=True), np.array([0.0, 0.0, height])), above
        )

    @classmethod
    def of_scale(cls, camera: Camera | None, scale: float, width: int, height: int) -> Plane:
        """A picture in whose middle a pixel is ``scale`` [m] wide at the height of the mouse's outline."""
        middle = {"cx": 0.5 * (width - 1), "cy": 0.5 * (height - 1)}
        # Without a camera's file any lens will do: what is filmed straight from above has the same scale everywhere.
        seen = camera or Camera(width=width, height=height, fx=float(width), fy=float(width), **middle)
        plane = cls.of_height(seen, scale * seen.fx, 0.0)
        return cls(plane.camera, plane.world, 0.0, scale_known=True)

    @property
    def height(self) -> float:
        """[m] Of the camera over the plane."""
        return float(self.world.inverse.position[2]) - self.above

    @property
    def tilt(self) -> float:
        """[rad] Of the line of sight from straight down."""
        return float(np.arccos(np.clip(-self.world.rotation.inv().apply([0.0, 0.0, 1.0])[2], -1.0, 1.0)))

    @property
    def scale_deviation(self) -> float:
        """By which all lengths may be off together, as a share of them, since the outline's height is not known."""
        return 0.0 if self.scale_known else BACK_DEVIATION / self.height

    def metres(self, pixels: Array) -> Array:
        """(n, 2) [m] Where rays through pixels (n, 2) meet the plane, in the world's x and y."""
        eye = self.world.inverse.position
        rays = self.world.rotation.inv().apply(self.camera.rays(pixels))
        far = (self.above - eye[2]) / rays[:, 2]
        return np.asarray(eye[:2] + far[:, None] * rays[:, :2], dtype=np.float64)
