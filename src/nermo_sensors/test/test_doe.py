"""C 4.2: the screening design, table 4.5 recomputed from table 4.4, and the feasibility numbers."""

import numpy as np
import pytest

from nermo_sensors.doe.design import screening_design
from nermo_sensors.doe.feasibility import assess, thesis_models
from nermo_sensors.doe.screening import (
    RESPONSES,
    THESIS_TERMS,
    CellDesign,
    analyse,
    distinguishable_terms,
    eliminate,
    load_table,
)
from nermo_sensors.models.amplifier import Converter, NonInvertingAmplifier

TABLE_4_5: dict[str, tuple[float, dict[str, tuple[float, float, float]]]] = {
    "sensitivity_s_per_n": (
        5.785e-6,
        {
            "glue": (-1.690e-6, 10.93, 7.008e-3),
            "shape": (3.698e-6, 52.32, 1.68e-5),
            "width": (2.992e-6, 34.23, 1.106e-4),
            "glue * length": (2.330e-6, 20.78, 8.192e-4),
        },
    ),
    "base_conductance_s": (
        1.769e-5,
        {
            "shape": (1.751e-5, 11.25, 5.736e-3),
            "width": (1.080e-5, 4.278, 6.087e-2),
            "length * width": (-1.056e-5, 4.093, 6.591e-2),
        },
    ),
    "saturation_force_n": (
        29.00,
        {
            "layers": (6.799, 3.128, 0.1023),
            "shape": (10.13, 6.941, 0.02179),
            "length * width": (-8.621, 5.028, 0.04461),
        },
    ),
}
"""Constant, then coefficient, F and p of each term, as printed."""


def test_design_is_orthogonal_with_sixteen_runs() -> None:
    design = screening_design()
    assert design.runs.shape == (16, 6)
    np.testing.assert_array_equal(design.runs.T @ design.runs, 16 * np.eye(6))


def test_design_has_resolution_four() -> None:
    """No main effect is aliased with an interaction of two; some interactions of two are aliased with each other."""
    design = screening_design()
    for factor in design.factors:
        assert all(other.count("*") >= 2 for other in design.aliased_with(factor))
    assert "glue * shape" in design.aliased_with("length * width")
    assert "shape * width" in design.aliased_with("length * glue")


def test_table_has_the_runs_of_the_design() -> None:
    """Every run of table 4.4 is one of the design, once the temperature (never varied) is read off its generator."""
    coded = [
        CellDesign(row["glue"] == "+", row["layers"], row["shape"], row["length_mm"], row["width_mm"]).coded()
        for row in load_table().to_dict("records")
    ]
    runs = {
        (c["glue"], c["layers"], c["glue"] * c["layers"] * c["length"], c["shape"], c["length"], c["width"])
        for c in coded
    }
    assert runs == {tuple(run) for run in screening_design().runs}


@pytest.mark.parametrize("response", RESPONSES)
def test_table_4_5_comes_out_of_table_4_4(response: str) -> None:
    model = analyse(load_table(), response, THESIS_TERMS[response])
    constant, printed = TABLE_4_5[response]
    assert model.constant == pytest.approx(constant, rel=1e-3)
    assert {term.name for term in model.terms} == set(printed)
    for term in model.terms:
        coefficient, f, p = printed[term.name]
        assert term.coefficient == pytest.approx(coefficient, rel=1e-3)
        assert term.f == pytest.approx(f, rel=2e-3)
        assert term.p == pytest.approx(p, rel=1e-2)


@pytest.mark.parametrize("response", ["base_conductance_s", "saturation_force_n"])
def test_elimination_finds_the_terms_of_the_thesis(response: str) -> None:
    assert {term.name for term in eliminate(load_table(), response).terms} == set(THESIS_TERMS[response])


def test_elimination_keeps_two_more_terms_for_the_sensitivity() -> None:
    """C drops length and layers * length, although both stay below its own 10 %."""
    model = eliminate(load_table(), "sensitivity_s_per_n")
    extra = {term.name: term.p for term in model.terms if term.name not in THESIS_TERMS["sensitivity_s_per_n"]}
    assert set(extra) == {"length", "layers * length"}
    assert all(0.05 < p < 0.1 for p in extra.values())


def test_aliased_terms_are_refused_by_name() -> None:
    with pytest.raises(ValueError, match=r"'length \* width' and 'glue \* shape' are aliased"):
        analyse(load_table(), "base_conductance_s", ["length * width", "glue * shape"])
    assert len(distinguishable_terms(load_table())) == 12


@pytest.mark.parametrize(
    ("length_mm", "width_mm", "expected"),
    [(20, 25, (1.01e-5, 4.14e-5, 31.5)), (20, 30, (1.14e-5, 4.53e-5, 31.0))],
    ids=["the printed figures", "the printed size"],
)
def test_feasibility(length_mm: float, width_mm: float, expected: tuple[float, float, float]) -> None:
    """C 4.2.3 prints the figures of a cell 20 mm long and 25 mm wide for one of 20 x 30 mm."""
    thin = CellDesign(glue=True, layers=2, shape="B", length_mm=length_mm, width_mm=width_mm)
    thick = CellDesign(glue=True, layers=6, shape="B", length_mm=length_mm, width_mm=width_mm)
    found = assess(thin, NonInvertingAmplifier(), thesis_models())
    assert (found.sensitivity_s_per_n, found.base_conductance_s, found.saturation_force_n) == pytest.approx(
        expected, rel=0.01
    )
    assert found.covers_required_force
    assert assess(thick, NonInvertingAmplifier(), thesis_models()).saturation_force_n > found.saturation_force_n


def test_amplifier_gives_the_corrected_voltages() -> None:
    """(4.2) gives 1.0 V at 25 kohm and 7.0 V at 31.5 N; the 0.75 V and 4.7 V of C leave out its 1."""
    amplifier = NonInvertingAmplifier()
    assert amplifier.voltage(1 / 25e3) == pytest.approx(1.0)
    assert amplifier.voltage(1 / 5e3) == pytest.approx(4.0)
    assert amplifier.voltage(4.14e-5 + 1.01e-5 * 31.5) == pytest.approx(7.0, abs=0.05)
    assert amplifier.conductance(amplifier.voltage(3.3e-4)) == pytest.approx(3.3e-4)


def test_converter_clips_and_says_so() -> None:
    converter = Converter(lower_v=0.0, upper_v=5.0, bits=12)
    assert converter.read(7.0) == 5.0
    assert converter.is_saturated(converter.read(7.0))
    assert converter.is_saturated(converter.read(-1.0))
    assert not converter.is_saturated(converter.read(2.5))
    assert abs(converter.read(1.2345) - 1.2345) <= converter.step_v / 2


def test_wrong_shape_is_named() -> None:
    with pytest.raises(ValueError, match="shape: 'C' is not one of A, B"):
        CellDesign(True, 2, "C", 20, 20).coded()
