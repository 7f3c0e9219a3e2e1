"""Finding the checkout that a command belongs to. Standard library only."""

from __future__ import annotations

import os
from pathlib import Path


def checkout_root() -> Path:
    """The checkout's top folder: NERMO_ROOT, or the one above this file or above the current folder.

    Raises:
        FileNotFoundError: There is none, as in a plain install used elsewhere.
    """
    named = os.environ.get("NERMO_ROOT")
    starts = [Path(named)] if named else [Path(__file__).resolve(), Path.cwd()]
    for start in starts:
        for folder in (start, *start.parents):
            if (folder / "requirements.lock").is_file() and (folder / "src" / "nermo_bringup").is_dir():
                return folder
    raise FileNotFoundError("the Nermo checkout was not found; go into it, or name it in NERMO_ROOT")
