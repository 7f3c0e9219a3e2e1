"""Certificates that are valid no more before their time: a list of their common names beside the keys.

Zenoh lets an end refuse peers by the common name in their certificate, not by its serial number. So each certificate
that follows a revoked one bears a name of its own: `workstation`, then `workstation-2`. Both ends find the name that
counts in the list; the link's file goes on saying `workstation`.
"""

from __future__ import annotations

from pathlib import Path

LIST = "revoked"
"""Name of the file in the folder of the keys: one common name a line, `#` begins a remark."""


def revoked_names(keys: Path) -> frozenset[str]:
    """Common names that are refused; none where there is no list. Raises OSError where it cannot be read."""
    try:
        lines = (keys / LIST).read_text(encoding="utf-8").splitlines()
    except FileNotFoundError:
        return frozenset()
    return frozenset(name for line in lines if (name := line.partition("#")[0].strip()))


def common_name(name: str, revoked: frozenset[str]) -> str:
    """The name in the certificate that counts for an end: its own, or with the first number that is not revoked."""
    candidate, number = name, 1
    while candidate in revoked:
        number += 1
        candidate = f"{name}-{number}"
    return candidate


def revoke(keys: Path, name: str, why: str) -> str:
    """Puts the certificate that counts for an end on the list; returns its common name. Raises OSError."""
    present = common_name(name, revoked_names(keys))
    with (keys / LIST).open("a", encoding="utf-8") as file:
        file.write(f"{present}  # {why}\n")
    return present
