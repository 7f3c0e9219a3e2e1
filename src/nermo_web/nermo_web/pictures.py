"""Pictures of a camera as a browser shows them: JPEG or PNG as they come, raw ones made into JPEG."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np

LARGEST_BYTES = 16 * 1024 * 1024
"""Of a message; a raw picture of 1920 x 1080 has 6.2 million."""
QUALITY = 75
"""Of JPEG, of 100."""
_KINDS = ((b"\xff\xd8\xff", "image/jpeg"), (b"\x89PNG\r\n\x1a\n", "image/png"))
_ENCODINGS: dict[str, tuple[int, Callable[[Any], Any]]] = {
    "bgr8": (3, lambda picture: picture),
    "rgb8": (3, lambda picture: picture[..., ::-1]),
    "bgra8": (4, lambda picture: picture[..., :3]),
    "rgba8": (4, lambda picture: picture[..., 2::-1]),
    "mono8": (1, lambda picture: picture),
}
"""Bytes of a pixel, and its way to OpenCV's order, by sensor_msgs' name."""


def kind_of(data: bytes) -> str:
    """The media type of a compressed picture, by its first bytes.

    Raises:
        ValueError: it is neither JPEG nor PNG.
    """
    for begin, kind in _KINDS:
        if data.startswith(begin):
            return kind
    raise ValueError("the picture is neither JPEG nor PNG")


def compressed(data: bytes, encoding: str, width: int, height: int, step: int) -> bytes:
    """A raw picture as JPEG; ``step``: bytes of a row, padding included.

    Raises:
        ValueError: an encoding that is not shown, or sizes that do not agree.
    """
    if encoding not in _ENCODINGS:
        raise ValueError(f"encoding {encoding!r}: shown are {', '.join(_ENCODINGS)}")
    size, ordered = _ENCODINGS[encoding]
    if width < 1 or height < 1 or step < size * width or len(data) != step * height:
        raise ValueError(f"{len(data)} bytes are no {width} x {height} of {encoding} with {step} bytes a row")
    rows = np.frombuffer(data, np.uint8).reshape(height, step)[:, : size * width]
    picture = np.ascontiguousarray(ordered(rows.reshape(height, width, size)))
    done, made = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    if not done:
        raise ValueError(f"{width} x {height} cannot be made into JPEG")
    return bytes(made.tobytes())
