"""Pictures: the sensor's curve, estimates with three standard deviations, and how residuals are distributed."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.stats import norm

from nermo_sensors.bench.table import BenchRecording
from nermo_sensors.cells.piezoresistive import Sigmoid, SigmoidPair
from nermo_sensors.identification.fit import Fit
from nermo_sensors.identification.piezoresistive import force_rate
from nermo_sensors.parameters import TactileParameters

Array = NDArray[np.float64]

_SHOWN_SECONDS = 2.0


def plot_sensor_curve(parameters: TactileParameters, recording: BenchRecording, path: Path) -> None:
    """Voltage over force, rising and falling, with the pair of sigmoids (C figure 4.11)."""
    figure, axes = _figure(1)
    rate = force_rate(recording)
    for rows, label in ((rate >= 0.0, "rising"), (rate < 0.0, "falling")):
        axes[0].plot(recording.force[rows], recording.piezoresistive[rows], ".", markersize=1, label=label)
    pair = parameters.calibration.pair
    curve = SigmoidPair(
        Sigmoid(pair.rising.a, pair.rising.b, pair.rising.c, pair.rising.d),
        Sigmoid(pair.falling.a, pair.falling.b, pair.falling.c, pair.falling.d),
        pair.switch,
    )
    forces = np.linspace(0.0, recording.force.max(), 200)
    typical = float(np.std(rate))
    for sign in (1.0, -1.0):
        axes[0].plot(forces, curve.voltage(forces, sign * typical), color="black", linewidth=1)
    axes[0].set(xlabel="force [N]", ylabel="piezoresistive cell [V]", title="sensor curve, fit of (4.21) in black")
    axes[0].legend()
    figure.savefig(path, dpi=120)


def plot_fits(fits: Mapping[str, Fit], path: Path) -> None:
    """Residuals of each fit over the predicted voltage, and their distribution."""
    figure, axes = _figure(2 * len(fits), columns=2)
    for row, (name, fit) in enumerate(fits.items()):
        left, right = axes[2 * row], axes[2 * row + 1]
        left.plot(fit.predicted, fit.residuals, ".", markersize=1)
        left.set(xlabel="predicted [V]", ylabel="residual [V]", title=f"{name}: R2 = {fit.r_squared:.5f}")
        _histogram(right, fit.residuals / max(fit.residual_deviation, 1e-12))
    figure.savefig(path, dpi=100)


def plot_estimates(recording: BenchRecording, traces: Mapping[str, tuple[Array, Array]], path: Path) -> None:
    """Truth and estimates with +-3 sigma at 1 and at 2.5 Hz, as C figure 4.15."""
    shown = [name for name in ("f1", "f2", "memory") if name in traces]
    turning = recording.frequency / (2.0 * np.pi)
    wanted = [float(turning[np.argmin(np.abs(turning - hertz))]) for hertz in (1.0, 2.5)]
    figure, axes = _figure(len(shown) * len(wanted), columns=len(wanted))
    for row, name in enumerate(shown):
        load, variance = traces[name]
        for column, hertz in enumerate(wanted):
            rows = np.flatnonzero(np.abs(turning - hertz) < 1e-6)
            rows = rows[-round(_SHOWN_SECONDS / recording.period) :]
            time, axis = recording.time[rows], axes[row * len(wanted) + column]
            reach = 3.0 * np.sqrt(variance[rows])
            axis.plot(time, recording.force[rows], color="black", linewidth=1, label="truth")
            axis.plot(time, load[rows], linewidth=1, label=name)
            axis.fill_between(time, load[rows] - reach, load[rows] + reach, alpha=0.3, linewidth=0)
            highest = float(recording.force.max())
            axis.set(ylim=(-0.5 * highest, 1.6 * highest), xlabel="time [s]", ylabel="load [N]")
            axis.set_title(f"{name}, {hertz:.1f} Hz, +-3 sigma")
            axis.legend()
    figure.savefig(path, dpi=100)


def plot_residual_distribution(
    recording: BenchRecording, traces: Mapping[str, tuple[Array, Array]], path: Path
) -> None:
    """Errors of the load over their own standard deviation, beside the Gaussian that they should be."""
    figure, axes = _figure(len(traces), columns=3)
    for axis, (name, (load, variance)) in zip(axes, traces.items(), strict=False):
        _histogram(axis, (load - recording.force) / np.sqrt(variance))
        axis.set_title(name)
    figure.savefig(path, dpi=100)


def _histogram(axis: Axes, values: Array) -> None:
    bins = np.linspace(-6.0, 6.0, 61).tolist()
    axis.hist(np.clip(values, -6.0, 6.0), bins=bins, density=True)
    axis.plot(bins, norm.pdf(np.array(bins)), color="black", linewidth=1)
    axis.set(xlabel="error over standard deviation", yticks=[])


def _figure(count: int, columns: int = 1) -> tuple[Figure, list[Axes]]:
    rows = -(-count // columns)
    figure = Figure(figsize=(6.0 * columns, 3.5 * rows), layout="constrained")
    return figure, list(np.ravel(figure.subplots(rows, columns)))
