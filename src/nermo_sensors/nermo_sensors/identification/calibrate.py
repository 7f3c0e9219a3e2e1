"""All laws of both cells from one bench recording, and the choice between two of them."""

from __future__ import annotations

from dataclasses import dataclass

from nermo_sensors.bench.table import BenchRecording
from nermo_sensors.cells.piezoresistive import PiezoresistiveParameters
from nermo_sensors.identification.fit import Fit
from nermo_sensors.identification.piezoelectric import fit_charge, fit_rate, fit_rate_acceleration
from nermo_sensors.identification.piezoresistive import fit_memory, fit_pair
from nermo_sensors.models.amplifier import NonInvertingAmplifier
from nermo_sensors.parameters import Calibration, TactileParameters


@dataclass(frozen=True, slots=True)
class Identification:
    """The calibration with how well each law fits."""

    calibration: Calibration
    fits: dict[str, Fit]
    """By the names of the calibration's parts."""


def calibrate(recording: BenchRecording, parameters: TactileParameters) -> Identification:
    """Fits everything. The amplifier is known: its resistor and reference are not fitted.

    Raises UnidentifiableError, and ParameterError for feet without such a cell.
    """
    cell = parameters.cell(PiezoresistiveParameters)
    amplifier = NonInvertingAmplifier(cell.feedback_resistance, cell.reference_voltage)
    pair, pair_fit = fit_pair(recording)
    memory, memory_fit = fit_memory(recording, amplifier)
    rate, rate_fit = fit_rate(recording)
    both, both_fit = fit_rate_acceleration(recording)
    charge, charge_fit = fit_charge(recording)
    better = charge_fit.residual_deviation < both_fit.residual_deviation
    return Identification(
        Calibration(
            pair=pair,
            memory=memory,
            rate=rate,
            rate_acceleration=both,
            charge=charge,
            law="charge" if better else "rate_acceleration",
        ),
        {
            "pair": pair_fit,
            "memory": memory_fit,
            "rate": rate_fit,
            "rate_acceleration": both_fit,
            "charge": charge_fit,
        },
    )
