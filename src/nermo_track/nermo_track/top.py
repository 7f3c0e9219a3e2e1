"""Films from above of a mouse without tags: from the film to its way over the floor."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nermo_track.camera import Camera
from nermo_track.errors import TrackError
from nermo_track.film import Film
from nermo_track.layout import Layout
from nermo_track.plane import BACK, Plane
from nermo_track.silhouette import SHAKEN, Background, background, outlines
from nermo_track.way import WINDOW, Way, way
from nermo_track.work import Say, check_size

STEEP = np.radians(20.0)
"""[rad] Of the line of sight from straight down, from which on the outline shows the mouse's side too. Chosen."""


@dataclass(frozen=True)
class View:
    """A film from above, and what is known of its scale: one of height and scale, or the tags on the floor."""

    film: Path
    camera: Camera | None = None
    fps: float | None = None
    height: float | None = None
    """[m] Of the camera over the floor, looking straight down."""
    scale: float | None = None
    """[m/px] In the middle of the picture, at the height of the mouse's outline."""
    floor: Path | None = None
    """A film or picture of the floor without the mouse, by the same camera; where None the film's own median."""
    back: float = BACK
    """[m] Height of the mouse's outline over the floor."""
    window: float = WINDOW
    """[s] Over which the way is smoothed."""


@dataclass(frozen=True)
class Overlooked:
    """A film's way, and how it was seen."""

    view: View
    way: Way
    plane: Plane

    def warnings(self) -> list[str]:
        """What somebody should look at."""
        found, unseen = [], self.way.unseen
        if self.plane.tilt > STEEP:
            found.append(
                f"the camera looks {np.degrees(self.plane.tilt):.0f} degrees aside (best: straight down, at most "
                f"{np.degrees(STEEP):.0f}): it sees the mouse's side, and its way is off"
            )
        if unseen.count > 0.2 * unseen.pictures:
            found.append(f"{100.0 * unseen.count / unseen.pictures:.0f} % of the pictures do not tell where it is")
        return found

    def report(self) -> dict[str, Any]:
        """As a command's JSON file has it."""
        found, unseen = self.way, self.way.unseen
        names = ("x", "y", "heading", "speed", "sideways", "drift")
        return {
            "film": str(self.view.film),
            "pictures": unseen.pictures,
            "places": len(found.time),
            "nothing": unseen.nothing,
            "cut": unseen.cut,
            "several": unseen.several,
            "odd": unseen.odd,
            "jump": unseen.jump,
            "longest_gap_s": unseen.longest,
            "nose_by": found.nose_by,
            "camera_height_m": self.plane.height + self.plane.above,
            "scale_deviation": found.scale_deviation,
            "body_length_m": found.length,
            "along_m": found.along,
            "mean_speed_m_s": found.mean_speed,
            "mean_speed_sd_m_s": found.mean_speed_deviation,
            "drift_m": float(found.drift[-1]),
            "drift_sd_m": float(found.deviation[-1, 5]),
            "turned_deg": float(np.degrees(found.heading[-1] - found.first_heading)),
            "median_sd": dict(zip(names, np.median(found.deviation, axis=0).tolist(), strict=True)),
        }


def overlook(view: View, layout: Layout, say: Say) -> Overlooked:
    """The way of the mouse through a film from above.

    Raises:
        TrackError: the film cannot be used, its scale is not known, the camera moves, or the mouse cannot be followed.
    """
    film, name = Film(view.film, view.fps), str(view.film)
    if view.camera is not None:
        check_size(film, view.camera)
    floor = background(film, None if view.floor is None else Film(view.floor), lambda share: say("floor", share))
    if floor.shift > SHAKEN:
        raise TrackError(
            f"{name}: the floor moves by {floor.shift:.1f} px in the picture (allowed: {SHAKEN:g} px); "
            "the camera must stand still, so put it on a stand"
        )
    plane = _plane(view, film, floor, layout)
    found = outlines(film, floor, plane, lambda share: say("outline", share))
    gone = way(
        found,
        name,
        exposure=plane.camera.exposure,
        line_delay=plane.camera.line_delay,
        scale_deviation=plane.scale_deviation,
        window=view.window,
        still=view.floor is not None,
    )
    return Overlooked(view, gone, plane)


def _plane(view: View, film: Film, floor: Background, layout: Layout) -> Plane:
    """The plane of the mouse's outline. Raises TrackError where nothing tells it, or it is not below the camera."""
    if view.scale is not None:
        return Plane.of_scale(view.camera, view.scale, film.width, film.height)
    if view.camera is None:
        raise TrackError("--camera: is missing; without a camera's file say the scale of the picture (--scale)")
    if view.height is not None:
        plane = Plane.of_height(view.camera, view.height, view.back)
    else:
        try:
            plane = Plane.of_tags(view.camera, floor.picture, layout, view.back, str(view.film))
        except TrackError as error:
            raise TrackError(f"{error}. Without them say how high the camera is (--height), or the scale") from error
    if plane.height <= view.back:
        raise TrackError(
            f"--height: the camera is {plane.height + view.back:g} m over the floor; it must be above twice the "
            f"mouse's back (--back {view.back:g})"
        )
    return plane
