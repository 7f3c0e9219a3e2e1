"""Colours of the report, by name: the page says what they are on a light and on a dark screen.

Blue and orange, and two scales from weak to strong: safe for the colour-blind.
"""

from __future__ import annotations

INK, QUIET, LINE, EDGE = "var(--ink)", "var(--faint)", "var(--line)", "var(--edge)"
BEFORE, AFTER, MEASURED = "var(--orange)", "var(--blue)", "var(--measured)"
UNSEEN = "var(--unseen)"

_LEVELS = 12
"""Steps of a scale."""
_STRONG = 0.62
"""Share of a scale from which on text stands on it in the colour of the paper."""
_HEAT = ("#f4f1ea", "#f3d9a4", "#e8a04c", "#b9561b", "#6d2709")
_COOL = ("#f2f5f7", "#a9c8de", "#3f7cad", "#123a5c")
_HEAT_DARK = ("#2b2622", "#5c3217", "#a04c18", "#e09a48", "#f8e0b0")
_COOL_DARK = ("#20282e", "#23506f", "#5b9ccb", "#d4e8f5")


def heat(share: float) -> str:
    """Colour of a share of the gap, 0 to 1."""
    return f"var(--heat-{_level(share)})"


def cool(share: float) -> str:
    """Colour of likeness, 0 to 1."""
    return f"var(--cool-{_level(share)})"


def ink_on(share: float) -> str:
    """Colour of text on either scale."""
    return "var(--on-strong)" if share > _STRONG else INK


def scales(dark: bool) -> str:
    """Both scales as CSS custom properties."""
    pairs = (("heat", _HEAT_DARK if dark else _HEAT), ("cool", _COOL_DARK if dark else _COOL))
    return " ".join(
        f"--{name}-{i}: {_between(stops, i / _LEVELS)};" for name, stops in pairs for i in range(_LEVELS + 1)
    )


def _level(share: float) -> int:
    return round(_LEVELS * min(max(share, 0.0), 1.0))


def _between(stops: tuple[str, ...], share: float) -> str:
    """The colour at a share of the way over equally spaced ones."""
    at = share * (len(stops) - 1)
    i = min(int(at), len(stops) - 2)
    low, high = (tuple(int(c[k : k + 2], 16) for k in (1, 3, 5)) for c in stops[i : i + 2])
    return "#" + "".join(f"{round(a + (at - i) * (b - a)):02x}" for a, b in zip(low, high, strict=True))
