"""Which OpenGL MuJoCo draws with. It decides when it is imported, and an import with a missing one fails altogether."""

from __future__ import annotations

import ctypes
import os
import sys

_LIBRARIES = {"egl": "libEGL.so.1", "osmesa": "libOSMesa.so.8"}


def choose_opengl() -> None:
    """Sets MUJOCO_GL to what this machine has, unless it names something usable or there is a display.

    Without any it becomes `disable`: then only drawing fails. Does nothing outside Linux.
    """
    if sys.platform != "linux":
        return
    wanted = os.environ.get("MUJOCO_GL", "").strip().lower()
    has_display = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if (not wanted and has_display) or (wanted and wanted not in _LIBRARIES):
        return
    candidates = dict.fromkeys([wanted, *_LIBRARIES]) if wanted else _LIBRARIES
    os.environ["MUJOCO_GL"] = next((name for name in candidates if _loads(_LIBRARIES[name])), "disable")


def _loads(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True
