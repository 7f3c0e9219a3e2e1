"""A process that gives up, for good, the right to read anything but what it is shown (Linux Landlock)."""

from __future__ import annotations

import ctypes
import os
import struct
import sys
from collections.abc import Iterable
from pathlib import Path

_CREATE_RULESET, _ADD_RULE, _RESTRICT_SELF = 444, 445, 446
_NO_NEW_PRIVILEGES = 38
_EXECUTE, _WRITE, _READ_FILE, _READ_DIR = 1 << 0, 1 << 1, 1 << 2, 1 << 3
_TRUNCATE = 1 << 14
_OF_FILES = _EXECUTE | _WRITE | _READ_FILE | _TRUNCATE
_READ = _EXECUTE | _READ_FILE | _READ_DIR
SYSTEM = ("/usr", "/lib", "/lib64", "/bin", "/sbin", "/etc", "/proc", "/sys", "/dev", "/run/systemd/resolve", "/nix")
"""Where a Python finds its libraries; nobody keeps answers there."""


def available() -> int:
    """Version of Landlock that the kernel offers; 0 where it offers none."""
    if not sys.platform.startswith("linux"):
        return 0
    version = ctypes.CDLL(None, use_errno=True).syscall(_CREATE_RULESET, None, 0, 1)
    return max(int(version), 0)


def confine(readable: Iterable[Path], writable: Iterable[Path]) -> bool:
    """From now on this process and its children read only the system, their Python and ``readable``.

    They write only ``writable``. It cannot be undone, not by root either. False where the kernel cannot do it.
    """
    version = available()
    if not version:
        return False
    libc = ctypes.CDLL(None, use_errno=True)
    handled = (1 << (13 if version == 1 else 14 if version == 2 else 15)) - 1
    attributes = struct.pack("=Q", handled)
    ruleset = libc.syscall(_CREATE_RULESET, attributes, len(attributes), 0)
    if ruleset < 0:
        return False
    python = {Path(p) for p in (sys.prefix, sys.base_prefix, *sys.path) if p}
    rules = [(p, _READ) for p in {*map(Path, SYSTEM), *python, *(Path(p) for p in readable)}]
    rules += [(Path(p), handled) for p in writable]
    for path, allowed in rules:
        if path.exists():
            descriptor = os.open(path, os.O_PATH | os.O_CLOEXEC)
            rights = allowed & handled if path.is_dir() else allowed & handled & _OF_FILES
            libc.syscall(_ADD_RULE, ruleset, 1, struct.pack("=Qi", rights, descriptor), 0)
            os.close(descriptor)
    # /dev/null is written by many.
    descriptor = os.open("/dev", os.O_PATH | os.O_CLOEXEC)
    libc.syscall(_ADD_RULE, ruleset, 1, struct.pack("=Qi", (_READ | _WRITE) & handled, descriptor), 0)
    os.close(descriptor)
    done = libc.prctl(_NO_NEW_PRIVILEGES, 1, 0, 0, 0) == 0 and libc.syscall(_RESTRICT_SELF, ruleset, 0) == 0
    os.close(ruleset)
    return bool(done)


def can_read(path: Path) -> bool:
    """Whether this process can read a file or list a folder."""
    try:
        if path.is_dir():
            next(os.scandir(path), None)
        else:
            with path.open("rb") as file:
                file.read(1)
    except OSError:
        return False
    return True
