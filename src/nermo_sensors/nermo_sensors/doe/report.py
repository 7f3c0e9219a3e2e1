"""Everything of C 4.2 in rows: what comes out beside what is printed."""

from __future__ import annotations

from typing import Any

from nermo_sensors.doe import printed
from nermo_sensors.doe.design import screening_design
from nermo_sensors.doe.feasibility import assess, cell_weight_g, thesis_models
from nermo_sensors.doe.screening import RESPONSES, CellDesign, eliminate, load_table
from nermo_sensors.models.amplifier import NonInvertingAmplifier

Rows = list[dict[str, Any]]


def report(shape: str, layers: int, length_mm: float, width_mm: float, glue: bool) -> dict[str, Rows]:
    """Aliases, terms of table 4.5, elimination, feasibility of a cell, and table 4.1.

    Raises ValueError for a cell that cannot be.
    """
    cell = CellDesign(glue, layers, shape, length_mm, width_mm)
    return {
        "aliases": _aliases(),
        "terms": _terms(),
        "elimination": _elimination(),
        "feasibility": _feasibility(cell),
        "requirements": _requirements(cell),
    }


def _aliases() -> Rows:
    """Main effects and interactions of two that cannot be told apart; three and more are left out."""
    rows = []
    for group in screening_design().aliases:
        small = [effect for effect in group if effect.count("*") <= 1]
        if len(small) > 1:
            rows.append({"effect": small[0], "aliased_with": ", ".join(small[1:])})
    return rows


def _terms() -> Rows:
    rows: Rows = []
    for response, model in thesis_models().items():
        rows.append(_cell(response, "constant", "coefficient", printed.CONSTANTS[response], model.constant))
        rows.append(
            _cell(
                response, "model", "p_against_constant", printed.P_AGAINST_CONSTANT[response], model.p_against_constant
            )
        )
        for term in model.terms:
            values = (term.coefficient, term.sum_of_squares, term.f, term.p)
            names = ("coefficient", "sum_of_squares", "f", "p")
            for name, text, value in zip(names, printed.TERMS[response][term.name], values, strict=True):
                rows.append(_cell(response, term.name, name, text, value))
        squares, _, mean = printed.ERRORS[response]
        rows.append(_cell(response, "error", "sum_of_squares", squares, model.error_sum_of_squares))
        found = model.error_sum_of_squares / model.error_degrees_of_freedom
        rows.append(_cell(response, "error", "mean_square", mean, found))
    return rows


def _elimination() -> Rows:
    table = load_table()
    return [
        {
            "response": response,
            "kept": ", ".join(f"{term.name} (p {term.p:.3g})" for term in eliminate(table, response).terms),
            "thesis": ", ".join(printed.TERMS[response]),
        }
        for response in RESPONSES
    ]


def _feasibility(cell: CellDesign) -> Rows:
    models, amplifier = thesis_models(), NonInvertingAmplifier()
    asked = assess(cell, amplifier, models)
    likely = assess(CellDesign(True, 2, "B", 20.0, 25.0), amplifier, models)
    rows: Rows = []
    for name in type(asked).__dataclass_fields__:
        text = printed.FEASIBILITY.get(name)
        rows.append(
            {
                "quantity": name,
                "this_cell": getattr(asked, name),
                "cell_20_x_25_mm": getattr(likely, name),
                "thesis": None if text is None else float(text),
            }
        )
    return rows


def _requirements(cell: CellDesign) -> Rows:
    """Table 4.1 for this cell: what the models and the circuit say, and what only a built sensor could."""
    found = assess(cell, NonInvertingAmplifier(), thesis_models())
    gain = NonInvertingAmplifier().feedback_ohm * NonInvertingAmplifier().reference_v
    count_n = 5.0 / (2**12 - 1) / (gain * found.sensitivity_s_per_n)
    weight_g = cell_weight_g(cell)
    return [
        _requirement(
            "load range", "0 to 20 N", f"{found.saturation_force_n:.1f} N static", found.covers_required_force
        ),
        _requirement("load range, dynamic", "0 to 20 N", "see `nermo bench sensors`", None),
        _requirement("frequency response", "> 4 Hz", "see `nermo bench sensors`", None),
        _requirement("sensitivity", "< 200 mN", f"{1e3 * count_n:.2g} mN a count at 12 bit, 5 V", count_n < 0.2),
        _requirement("sampling", "< 10 ms", "5 ms (200 Hz) in the graph", True),
        _requirement(
            "weight on the tip", "< 2 g", f"Velostat and copper {weight_g:.2g} g; C weighs neither PZT nor glue", None
        ),
        _requirement("total weight", "< 20 g", "C gives no weight of the electronics", None),
    ]


def _requirement(name: str, asked: str, found: str, met: bool | None) -> dict[str, Any]:
    return {"requirement": name, "asked": asked, "found": found, "met": met}


def _cell(response: str, term: str, name: str, text: str, value: float) -> dict[str, Any]:
    return {
        "response": response,
        "term": term,
        "quantity": name,
        "ours": value,
        "thesis": float(text),
        "rounds_alike": printed.agrees(text, value),
    }
