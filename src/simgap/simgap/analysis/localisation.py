"""Where the gap lies: the residual's power by channel, subsystem and phase of motion, and by frequency."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from simgap.data.align import Aligned
from simgap.data.channels import OutputChannel
from simgap.inference.residual import Residuals

Array = NDArray[np.float64]
Phases = Callable[[Aligned, OutputChannel], dict[str, NDArray[np.bool_]] | None]
"""The rows (n,) of the grid that belong to each named phase of a channel; None where the channel knows none."""

_BANDS = ((0.0, 1.0), (1.0, 3.0), (3.0, 10.0), (10.0, np.inf))
_REVERSAL = 0.05
"""[s] about a change of direction."""


def locate(residuals: Residuals, residual: Array, phases: Phases | None = None) -> list[dict[str, object]]:
    """Shares of the gap beyond the noise floor by channel and phase, largest first; they add up to 1.

    Without ``phases`` of its own a channel that measures a coordinate has ``standstill``, ``reversal`` and ``moving``;
    others have one.
    Channels are weighed by amplitude rather than power, so that one sensor with a low floor does not hide the rest.
    """
    replayer = residuals.replayer
    rows = replayer.windows.rows()
    found: list[dict[str, object]] = []
    for c, channel in enumerate(residuals.live):
        output = replayer.plant.outputs[channel]
        square = residual[..., c] ** 2
        mask = residuals.mask[..., c]
        amplitude = float(np.sqrt(max(square[mask].mean() - 1.0, 0.0))) if mask.any() else 0.0
        power = float(square[mask].sum()) or 1.0
        given = None if phases is None else phases(replayer.aligned, output)
        by_phase = _phases(residuals, channel, rows) if given is None else {n: m[rows] for n, m in given.items()}
        for phase, inside in by_phase.items():
            share = amplitude * float(square[mask & inside].sum()) / power
            found.append({"channel": output.name, "subsystem": output.subsystem, "phase": phase, "share": share})
    total = sum(float(str(f["share"])) for f in found) or 1.0
    for f in found:
        f["share"] = float(str(f["share"])) / total
    return sorted(found, key=lambda f: -float(str(f["share"])))


def _phases(residuals: Residuals, channel: int, rows: NDArray[np.int64]) -> dict[str, NDArray[np.bool_]]:
    replayer = residuals.replayer
    state, output = replayer.state, replayer.plant.outputs[channel]
    everywhere = np.ones(rows.shape, bool)
    match = np.flatnonzero(state.qpos == output.qpos) if output.qpos >= 0 else np.flatnonzero(state.dof == output.dof)
    if not len(match) or (output.qpos < 0 and output.dof < 0):
        return {"all": everywhere}
    rate = state.velocity[:, int(match[0])]
    slow = np.abs(rate) < 0.05 * max(float(np.sqrt((rate**2).mean())), 1e-12)
    turn = np.concatenate([[False], np.signbit(rate[1:]) != np.signbit(rate[:-1])])
    reach = max(int(_REVERSAL / replayer.aligned.period), 1)
    near = np.convolve(turn, np.ones(2 * reach + 1), mode="same") > 0.5
    standstill = np.convolve(slow, np.ones(2 * reach + 1), mode="same") > 2 * reach + 0.5
    return {
        "standstill": standstill[rows],
        "reversal": (near & ~standstill)[rows],
        "moving": (~near & ~standstill)[rows],
    }


def bands(residuals: Residuals, residual: Array) -> list[dict[str, object]]:
    """Shares of each channel's power by frequency band [Hz]."""
    replayer = residuals.replayer
    step = replayer.aligned.period * float(np.diff(replayer.windows.sample[:2])[0])
    frequencies = np.fft.rfftfreq(residual.shape[1], step)
    found: list[dict[str, object]] = []
    for c, channel in enumerate(residuals.live):
        power = (np.abs(np.fft.rfft(residual[..., c], axis=1)) ** 2).sum(axis=0)
        for low, high in _BANDS:
            inside = (frequencies >= low) & (frequencies < high)
            found.append(
                {
                    "channel": replayer.plant.outputs[channel].name,
                    "from_hz": low,
                    "to_hz": None if np.isinf(high) else high,
                    "share": float(power[inside].sum() / max(float(power.sum()), 1e-300)),
                }
            )
    return found
