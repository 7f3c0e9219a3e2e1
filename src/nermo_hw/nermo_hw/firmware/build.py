"""The firmware's logic as programs of this machine: `firmware/host/*.cpp` with the board's own sources, built once."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import tempfile
from pathlib import Path

FLAGS = ("-std=c++17", "-Wall", "-Wextra", "-Werror", "-Wpedantic", "-Wconversion", "-fno-exceptions")
OPTIMISED = ("-O2",)
SANITIZED = ("-O1", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
COMPILERS = ("g++", "c++", "clang++")
LONGEST_BUILD = 300.0
"""[s]"""


class FirmwareError(RuntimeError):
    """The firmware cannot be built or run here; the text says why, and what would help."""


def host_program(name: str, sanitized: bool = False) -> Path:
    """A program of `firmware/host`, built anew where a source or a flag has changed.

    sanitized: it ends at the first wrong access or undefined behaviour.

    Raises FirmwareError where there is no compiler, no checkout, or the build fails.
    """
    root = firmware_folder()
    flags = (*FLAGS, *(SANITIZED if sanitized else OPTIMISED))
    command = [compiler(), *flags, "-I", str(root / "lib" / "pwm_board")]
    sources = [root / "host" / f"{name}.cpp", root / "lib" / "pwm_board" / "board.cpp"]
    known = hashlib.sha256(" ".join(command).encode())
    for path in sorted(root.glob("*/**/*.?pp")):
        known.update(path.read_bytes())
    program = root.parent / ".cache" / "firmware" / f"{name}-{known.hexdigest()[:16]}"
    if not program.exists():
        program.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(
            dir=program.parent
        ) as folder:  # whoever else builds it meanwhile is not disturbed
            made = Path(folder) / name
            run = subprocess.run(
                [*command, *map(str, sources), "-o", str(made)], capture_output=True, text=True, timeout=LONGEST_BUILD
            )
            if run.returncode:
                raise FirmwareError(f"the firmware does not build here: {run.stderr.strip()[:2000]}")
            made.replace(program)
    return program


def compiler() -> str:
    """The C++ compiler: CXX, or the first of COMPILERS. Raises FirmwareError where there is none."""
    for name in (os.environ.get("CXX", ""), *COMPILERS):
        if name and (found := shutil.which(name)):
            return found
    raise FirmwareError("the PWM board is emulated by its own firmware, and there is no C++ compiler: install g++")


def firmware_folder() -> Path:
    """The folder `firmware` of the checkout. Raises FirmwareError where there is none, as in a plain install."""
    named = os.environ.get("NERMO_ROOT")
    for start in [Path(named)] if named else [Path(__file__).resolve(), Path.cwd()]:
        for folder in (start, *start.parents):
            if (folder / "firmware" / "lib" / "pwm_board" / "board.cpp").is_file():
                return folder / "firmware"
    raise FirmwareError(
        "the PWM board is emulated by its own firmware, which is in Nermo's checkout: name it in NERMO_ROOT"
    )
