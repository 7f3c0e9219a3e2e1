"""The report's plots: round ticks that have room, curves that stay in their panel, colours that tell apart."""

from __future__ import annotations

import re
from itertools import pairwise

import numpy as np
import pytest

from simgap.report.plot import Panel, Scale, framed, number_texts
from simgap.report.style import heat, scales
from simgap.report.svg import Drawing, text_width


@pytest.mark.parametrize(
    ("low", "high", "texts"),
    [
        (0.0, 1.0, ["0", "0.2", "0.4", "0.6", "0.8", "1"]),
        (-1.3, 1.2, ["−1", "−0.5", "0", "0.5", "1"]),
        (0.0, 2.4e-5, ["0", "0.5·10⁻⁵", "1·10⁻⁵", "1.5·10⁻⁵", "2·10⁻⁵"]),
        (99.0, 101.0, ["99", "99.5", "100", "100.5", "101"]),
    ],
)
def test_ticks_are_round_and_within_the_scale(low: float, high: float, texts: list[str]) -> None:
    ticks = Scale(low, high, 0.0, 400.0).ticks(5)
    assert [text for _, text in ticks] == texts
    assert all(low - 1e-9 <= value <= high + 1e-9 for value, _ in ticks)


def test_a_logarithmic_scale_has_powers_of_ten_where_there_are_many() -> None:
    scale = Scale(0.8, 300.0, 0.0, 100.0, logarithmic=True)
    assert [t for t, _ in scale.ticks(9)] == [1, 2, 5, 10, 20, 50, 100, 200]
    assert [t for t, _ in scale.ticks(6)] == [1, 3, 10, 30, 100, 300]
    assert [t for t, _ in Scale(0.8, 2e6, 0.0, 1.0, logarithmic=True).ticks(4)] == [1, 100, 10000, 1000000]
    assert scale(0.8) == 0.0 and scale(300.0) == pytest.approx(100.0)
    assert number_texts([]) == []


@pytest.mark.parametrize("width", [60.0, 150.0, 800.0])
def test_texts_of_an_axis_do_not_touch(width: float) -> None:
    drawing = Drawing("d", 900.0, 200.0)
    Panel(drawing, (50.0, 0.0, width, 100.0), (0.0, 0.0123), (0.0, 1.0)).x_axis()
    places = re.findall(r'<text x="([\d.]+)"[^>]*>([^<]*)</text>', drawing.svg())
    ends = [(float(x) - 0.5 * text_width(t, 12.0), float(x) + 0.5 * text_width(t, 12.0)) for x, t in places]
    assert all(right < left for (_, right), (left, _) in pairwise(ends)) and len(ends) >= 1


def test_a_curve_is_interrupted_where_nothing_is_known_and_cut_at_the_border() -> None:
    drawing = Drawing("d", 100.0, 100.0)
    panel = Panel(drawing, (0.0, 0.0, 100.0, 100.0), (0.0, 4.0), (0.0, 1.0))
    panel.line(np.arange(5.0), np.array([0.5, 1e30, np.nan, 0.5, 0.6]), "red")
    path = re.search(r' d="(M[^"]*)"', drawing.svg())
    assert path and path[1].count("M") == 2 and len(path[1]) < 60
    assert 'clip-path="url(#d-1)"' in drawing.svg() and 'id="d-1"' in drawing.svg()


def test_a_long_curve_is_thinned_but_keeps_its_peaks() -> None:
    time = np.linspace(0.0, 20.0, 100_000)
    values = np.sin(time)
    values[40_321] = 5.0
    drawing = Drawing("d", 900.0, 100.0)
    Panel(drawing, (0.0, 0.0, 900.0, 100.0), (0.0, 20.0), (-1.0, 5.0)).line(time, values, "red")
    path = re.search(r' d="(M[^"]*)"', drawing.svg())
    assert path and len(path[1]) < 100_000
    heights = [float(y) for y in re.findall(r"[ML][-\d.]+ ([-\d.]+)", path[1])]
    assert min(heights) == 0.0 and max(heights) == pytest.approx(100.0, abs=0.1)


def test_a_run_away_simulation_does_not_decide_the_scale() -> None:
    low, high = framed(np.array([0.0, 1.0]), np.array([0.0, 1e9]))
    assert low > -0.2 and high < 2.5
    assert framed(np.full(3, np.nan), np.ones(3)) == (0.0, 1.0)


def test_the_scales_go_from_weak_to_strong_on_both_screens() -> None:
    def light(name: str, css: str) -> list[float]:
        found = re.findall(rf"--{name}-(\d+): #(..)(..)(..);", css)
        return [0.299 * int(r, 16) + 0.587 * int(g, 16) + 0.114 * int(b, 16) for _, r, g, b in found]

    for name in ("heat", "cool"):
        assert np.all(np.diff(light(name, scales(dark=False))) < 0)
        assert np.all(np.diff(light(name, scales(dark=True))) > 0)
    assert f"{heat(1.0)[4:-1]}:" in scales(dark=False) and heat(2.0) == heat(1.0) and heat(-1.0) == heat(0.0)
