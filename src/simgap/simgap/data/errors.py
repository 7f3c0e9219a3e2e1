"""The one error that the core raises for input that it cannot use."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class GapInputError(ValueError):
    """A recording, map or model that cannot be used; the message says which entry and why, in one sentence."""


def nearest(name: str, valid: Iterable[str], what: str) -> str:
    """The tail of an error message: the valid names closest to ``name``, or the first few of them."""
    names = [n for n in valid if n]
    if not names:
        return f"the model has no {what}"
    close = difflib.get_close_matches(name, names, n=3, cutoff=0.5)
    if close:
        return f"did you mean {', '.join(close)}?"
    shown = ", ".join(names[:12]) + (", ..." if len(names) > 12 else "")
    return f"valid {what}s: {shown}"
