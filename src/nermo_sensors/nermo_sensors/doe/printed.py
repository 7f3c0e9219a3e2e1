"""Table 4.5 as C prints it, digit by digit, and the figures of C 4.2.3 and table 4.1."""

from __future__ import annotations

CONSTANTS = {
    "sensitivity_s_per_n": "5.785e-6",
    "base_conductance_s": "1.769e-5",
    "saturation_force_n": "29.00",
}

P_AGAINST_CONSTANT = {
    "sensitivity_s_per_n": "7.85e-06",
    "base_conductance_s": "0.00719",
    "saturation_force_n": "0.0174",
}

TERMS: dict[str, dict[str, tuple[str, str, str, str]]] = {
    "sensitivity_s_per_n": {
        "glue": ("-1.690e-6", "4.569e-11", "10.93", "7.008e-3"),
        "shape": ("3.698e-6", "2.188e-10", "52.32", "1.68e-5"),
        "width": ("2.992e-6", "1.432e-10", "34.23", "1.106e-4"),
        "glue * length": ("2.330e-6", "8.689e-11", "20.78", "8.192e-4"),
    },
    "base_conductance_s": {
        "shape": ("1.751e-5", "4.907e-9", "11.25", "5.736e-3"),
        "width": ("1.080e-5", "1.866e-9", "4.278", "6.087e-2"),
        "length * width": ("-1.056e-5", "1.785e-9", "4.093", "6.591e-2"),
    },
    "saturation_force_n": {
        "layers": ("6.799", "739.6", "3.128", "0.1023"),
        "shape": ("10.13", "1641", "6.941", "0.02179"),
        "length * width": ("-8.621", "1189", "5.028", "0.04461"),
    },
}
"""Coefficient, sum of squares, F and p of each term."""

ERRORS = {
    "sensitivity_s_per_n": ("4.600e-11", 11, "4.182e-12"),
    "base_conductance_s": ("5.233e-9", 12, "4.361e-10"),
    "saturation_force_n": ("2838", 12, "236.5"),
}
"""Sum of squares, degrees of freedom and mean square of what is left."""

FEASIBILITY = {
    "sensitivity_s_per_n": "1.01e-5",
    "base_conductance_s": "4.14e-5",
    "saturation_force_n": "31.5",
    "unloaded_voltage_v": "0.75",
    "saturated_voltage_v": "4.7",
}
"""C 4.2.3, for a cell that it calls 20 x 30 mm."""


def agrees(printed: str, value: float, places: float = 0.5) -> bool:
    """Whether a value rounds to what is printed: within `places` of the last digit."""
    mantissa, _, exponent = printed.lower().partition("e")
    digits = len(mantissa.partition(".")[2])
    return abs(value - float(printed)) <= places * 10.0 ** (int(exponent or 0) - digits) * (1.0 + 1e-9)
