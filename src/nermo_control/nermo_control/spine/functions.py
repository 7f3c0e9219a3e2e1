"""The spine functions: the one list of them."""

from __future__ import annotations

from dataclasses import dataclass, fields


@dataclass(frozen=True, slots=True)
class SpineModes:
    """Which spine functions are on (sp_m, N table 5.5); `SpineModes.msg` has the same fields.

    A function that is added here and there can be switched by messages, command files, pads and keys; what it does
    stands in `controller.py`.
    """

    turning: bool = False
    stride_extension: bool = False
    offset_compensation: bool = False
    balance_compensation: bool = False


SPINE_FUNCTIONS = tuple(one.name for one in fields(SpineModes))
"""Names of all spine functions."""
