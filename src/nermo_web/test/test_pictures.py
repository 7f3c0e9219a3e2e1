"""Pictures as they come over a topic, for the browser."""

from __future__ import annotations

import contextlib

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nermo_web.pictures import compressed, kind_of

RED = (220, 30, 40)
"""As red, green and blue."""


@pytest.mark.parametrize(
    ("encoding", "pixel"),
    [("rgb8", RED), ("bgr8", RED[::-1]), ("rgba8", (*RED, 255)), ("bgra8", (*RED[::-1], 255)), ("mono8", (90,))],
)
@pytest.mark.parametrize("padding", [0, 5])
def test_a_raw_picture_keeps_its_colours_and_sizes(encoding: str, pixel: tuple[int, ...], padding: int) -> None:
    row = bytes(pixel) * 24 + bytes(padding)
    made = compressed(row * 16, encoding, 24, 16, len(row))
    assert kind_of(made) == "image/jpeg"
    shown = cv2.imdecode(np.frombuffer(made, np.uint8), cv2.IMREAD_COLOR)
    assert shown.shape == (16, 24, 3)
    wanted = RED[::-1] if len(pixel) > 1 else pixel * 3
    np.testing.assert_allclose(shown.reshape(-1, 3).mean(axis=0), wanted, atol=6.0)


@given(
    st.binary(max_size=200),
    st.sampled_from(["rgb8", "mono8", "bayer_rggb8", ""]),
    *(st.integers(0, 2**32 - 1) | st.integers(0, 9) for _ in range(3)),
)
def test_what_is_no_picture_is_refused_in_words(data: bytes, encoding: str, width: int, height: int, step: int) -> None:
    with contextlib.suppress(ValueError):
        made = compressed(data, encoding, width, height, step)
        assert len(data) == step * height and kind_of(made) == "image/jpeg"


@pytest.mark.parametrize("data", [b"", b"GIF89a", b"<svg/>", b"\xff\xd8"])
def test_only_jpeg_and_png_are_passed_on(data: bytes) -> None:
    with pytest.raises(ValueError, match="neither JPEG nor PNG"):
        kind_of(data)
