"""Pictures and videos of a run, without a display."""

from __future__ import annotations

import os
from pathlib import Path

import imageio.v2 as imageio
import mujoco
import numpy as np
from numpy.typing import NDArray

from nermo_sim.console import console
from nermo_sim.divergence import STATE
from nermo_sim.run_table import Recording

Picture = NDArray[np.uint8]
"""Shape (height, width, 3), RGB."""


class RenderingUnavailableError(RuntimeError):
    """This machine has no OpenGL for pictures. Callers go on without."""


class Renderer:
    """Draws a model off screen.

    Raises RenderingUnavailableError where OpenGL cannot be had.
    """

    def __init__(self, model: mujoco.MjModel, width: int = 640, height: int = 480) -> None:
        model.vis.global_.offwidth = max(model.vis.global_.offwidth, width)
        model.vis.global_.offheight = max(model.vis.global_.offheight, height)
        try:
            self._renderer = mujoco.Renderer(model, height, width)
        except Exception as error:  # the OpenGL back ends raise whatever they like
            raise RenderingUnavailableError(
                f"no OpenGL to draw with (MUJOCO_GL={os.environ.get('MUJOCO_GL', '')}): {error}"
            ) from error
        # Mirrors and shadows take five times as long as all the rest.
        self._renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = False
        self._renderer.scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = False

    def picture(self, data: mujoco.MjData, camera: str) -> Picture:
        """One picture from a camera of the model."""
        self._renderer.update_scene(data, camera)
        return np.array(self._renderer.render(), dtype=np.uint8)

    def close(self) -> None:
        """Gives the OpenGL context back."""
        self._renderer.close()

    def __enter__(self) -> Renderer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def save_picture(path: Path, model: mujoco.MjModel, state: NDArray[np.float64], camera: str = "overview") -> None:
    """Writes a PNG of one state of a recording.

    Raises RenderingUnavailableError.
    """
    data = mujoco.MjData(model)
    mujoco.mj_setState(model, data, state, STATE)
    mujoco.mj_forward(model, data)
    with Renderer(model, 960, 540) as renderer:
        imageio.imwrite(path, renderer.picture(data, camera))


def save_video(
    path: Path, model: mujoco.MjModel, recording: Recording, camera: str = "side", frame_rate: float = 30.0
) -> None:
    """Writes an mp4 of a recording at its own speed.

    Raises RenderingUnavailableError, and ValueError for an empty recording.
    """
    if len(recording.stamps) == 0:
        raise ValueError("the recording is empty: there is nothing to draw")
    data = mujoco.MjData(model)
    times = np.arange(0.0, recording.time[-1] + 1e-9, 1.0 / frame_rate)
    rows = np.minimum(np.searchsorted(recording.time, times), len(recording.stamps) - 1)
    with (
        Renderer(model, 640, 480) as renderer,
        imageio.get_writer(path, fps=frame_rate, codec="libx264", macro_block_size=8) as video,
    ):
        for row in rows:
            mujoco.mj_setState(model, data, recording.states[row], STATE)
            mujoco.mj_forward(model, data)
            video.append_data(renderer.picture(data, camera))  # type: ignore[attr-defined]


def film(path: Path, model: mujoco.MjModel, recording: Recording) -> list[Path]:
    """A video, where there is OpenGL to draw it with; otherwise the terminal says why there is none."""
    try:
        save_video(path, model, recording)
    except RenderingUnavailableError as error:
        console.print(f"no video: {error}")
        return []
    return [path]
