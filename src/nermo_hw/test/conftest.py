"""Emulated devices for the tests of this package."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from emulated import EmulatedDevice


@pytest.fixture
def emulate(tmp_path: Path) -> Iterator[Callable[..., EmulatedDevice]]:
    """Starts emulated devices, `nermo_lite` unless told otherwise."""
    from emulated import EmulatedDevice

    devices: list[EmulatedDevice] = []

    def start(*arguments: str) -> EmulatedDevice:
        devices.append(EmulatedDevice(tmp_path / str(len(devices)), *arguments))
        return devices[-1]

    yield start
    for device in devices:
        if device.process.poll() is None:
            device.kill()
