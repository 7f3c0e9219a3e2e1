"""A simulated test bench as in C 4.3.2: a cam presses on the foot, everything is sampled at 1 kHz and low-passed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfilt

from nermo_sensors.bench.table import BENCH_CELLS, BenchRecording
from nermo_sensors.cells.piezoelectric import PiezoelectricParameters
from nermo_sensors.cells.piezoresistive import PiezoresistiveParameters
from nermo_sensors.models.foot import TactileFeet
from nermo_sensors.parameters import TactileParameters

Array = NDArray[np.float64]

FREQUENCIES = tuple(0.5 * number for number in range(1, 9))
"""0.5 to 4 Hz in steps of 0.5 Hz (C 4.3.2.1) [Hz]."""


@dataclass(frozen=True, slots=True)
class Rig:
    """The bench of C figure 4.10, with its 12 mm cam."""

    peak: float = 28.0
    """Of the bump [N]."""
    periods: int = 10
    """At each frequency, at least."""
    seconds: float = 8.0
    """At each frequency, at least [s]."""
    rest: float = 0.1
    """Share of a turn in which the cam does not press."""
    ripple: float = 0.01
    """Standard deviation of the cam's speed from turn to turn [1]."""
    sampling_frequency: float = 1000.0
    """[Hz]"""
    cut_off: float = 10.0
    """Of the fourth-order Butterworth filter on all channels [Hz]."""
    temperature_deviation: float = 2.0
    """Standard deviation of the temperature from run to run [K]."""

    def run(
        self,
        parameters: TactileParameters,
        seed: int,
        frequencies: tuple[float, ...] = FREQUENCIES,
    ) -> BenchRecording:
        """One run through all frequencies [Hz], on a rested foot, at the rate of the filters.

        The seed draws noise, bias, temperature and the cam's ripple. Raises ParameterError for feet without C's cells.
        """
        parameters.cell(PiezoresistiveParameters), parameters.cell(PiezoelectricParameters)
        random = np.random.default_rng([seed, 1])
        force, frequency = self._profile(frequencies, random)
        period = 1.0 / self.sampling_frequency
        feet = TactileFeet(parameters, feet=1, seed=seed)
        feet.temperature += self.temperature_deviation * random.standard_normal()
        voltages = np.empty((len(force), 2))
        for row, (load, speed) in enumerate(zip(force.tolist(), frequency.tolist(), strict=True)):
            read = feet.read([load], period, speed)
            voltages[row] = [read[cell][0] for cell in BENCH_CELLS]
        low_pass = butter(4, self.cut_off, fs=self.sampling_frequency, output="sos")
        channels = [sosfilt(low_pass, channel) for channel in (force, voltages[:, 0], voltages[:, 1])]
        # The first half second shows the low-pass filter waking up, not the sensor.
        every = round(self.sampling_frequency / parameters.sampling_frequency)
        rows = slice(round(0.5 * self.sampling_frequency), None, every)
        felt, static, dynamic = (np.asarray(channel[rows], dtype=np.float64) for channel in channels)
        time = np.arange(len(force), dtype=np.float64)[rows] * period
        return BenchRecording(time, felt, static, dynamic, frequency[rows])

    def _profile(self, frequencies: tuple[float, ...], random: np.random.Generator) -> tuple[Array, Array]:
        """Force [N] and frequency [rad/s] of every sample. The cam stands for a second, then turns."""
        forces, turning = [np.zeros(round(self.sampling_frequency))], [np.full(round(self.sampling_frequency), np.pi)]
        for frequency in frequencies:
            for _ in range(max(self.periods, round(self.seconds * frequency))):
                speed = frequency * (1.0 + self.ripple * random.standard_normal())
                samples = round(self.sampling_frequency / speed)
                forces.append(self.peak * bump(np.arange(samples) / samples, self.rest))
                turning.append(np.full(samples, 2.0 * np.pi * frequency))
        return np.concatenate(forces), np.concatenate(turning)


def bump(turn: Array, rest: float) -> Array:
    """Two harmonic curves, up and down, then rest: 0 to 1 over a turn from 0 to 1."""
    return np.where(turn < 1.0 - rest, 0.5 * (1.0 - np.cos(2.0 * np.pi * turn / (1.0 - rest))), 0.0)


def smooth_bump(x: Array) -> Array:
    """exp(1 - 1 / (1 - x^2)) between -1 and 1 and 0 beyond: (4.17) with the sign it needs, scaled to 1 at 0."""
    inside = np.abs(x) < 1.0
    return np.where(inside, np.exp(1.0 - 1.0 / np.where(inside, 1.0 - x * x, 1.0)), 0.0)
