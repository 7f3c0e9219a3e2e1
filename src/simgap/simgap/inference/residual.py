"""The gap, sample by sample: measured minus replayed, in units of the noise floor, with each start forgiven."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from simgap.data.noise_floor import input_noise
from simgap.simulation.contacts import colliding
from simgap.simulation.replay import Replayer
from simgap.simulation.variant import Variant

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

BROKEN = 1e4
"""Residual of a simulation that broke down, and the largest that any sample may have."""
_START_SD = 2.0
"""Standard errors of the smoother understate how well a window's start is known: it also bends corners."""


_KNOT = 0.03
"""[s] An error of a measured input is a line through points of this distance: short against what it moves."""
_WANDER = 0.1
"""[s] over which the slow part of that error stays about the same."""
_INPUT_ERRORS = (0.005, 0.01, 0.02, 0.05)
"""Sizes of that error, in root mean squares of the input, of which the likeliest is taken. Torques that are computed
from a motor's current ripple by several per cent; what is larger than that is for an effect to explain."""


_NUDGES, _NUDGE = 8, 0.3
"""Replays that show how far a landing leaves the replay open, and by how many standard errors their starts differ."""


@dataclass
class Residuals:
    """Turns replayed outputs into whitened residuals.

    A window starts where the recording says, which is only as good as its sensors: an error of the start grows with
    the dynamics and would pass for a gap. Its covariance S S' (S: response of the window to one standard error of each
    coordinate and rate) is added to that of the noise, and residuals are whitened with (I + S S')^(-1/2). A measured
    input is no better: S has columns for its error too, white noise and a slow wander of unknown size.

    Attributes:
        live: (nl,) indices of the outputs that are compared.
        mask: (nw, ns, nl) whether a sample was recorded.
    """

    replayer: Replayer
    live: Ints
    measured: Array
    mask: NDArray[np.bool_]
    _basis: Array
    _shrink: Array
    input_error: float = 0.0
    """Size of the wander of measured inputs, in their root mean square."""
    chance: tuple[Array, Array] | None = None
    """Directions (nw, m, k) in which chance moves whitened windows, and how far (nw, k): more noise, where given."""
    _open: Array | None = None
    """Factor (nw, ns, nl) by which landings raise the noise floor."""

    @classmethod
    def build(cls, replayer: Replayer, reference: Variant, start: bool = True) -> Residuals:
        """Prepare for one recording; ``reference`` is the variant about which the start's influence is computed."""
        rows = replayer.windows.rows()
        live = np.flatnonzero(replayer.aligned.live)
        measured, mask = replayer.aligned.outputs[rows][..., live], replayer.aligned.valid[rows][..., live]
        size = mask.shape[1] * mask.shape[2]
        made = cls(replayer, live, measured, mask, np.zeros((len(rows), size, 0)), np.zeros((len(rows), 0)))
        if start and replayer.state.size:
            if colliding(replayer.plant.model)[0]:
                made._open = np.sqrt(1.0 + made._scatter(reference))
            made.update_start(reference)
        return made

    @property
    def channels(self) -> list[str]:
        """Names of the compared outputs."""
        return [self.replayer.plant.outputs[i].name for i in self.live]

    def raw(self, outputs: Array, select: Ints | None = None) -> Array:
        """Whitened by the noise floor alone: (..., nw, ns, nl) from outputs (..., nw, ns, no)."""
        measured, mask = (self.measured, self.mask) if select is None else (self.measured[select], self.mask[select])
        simulated = outputs[..., self.live]
        difference = measured - simulated
        for i, channel in enumerate(self.live):
            if self.replayer.plant.outputs[channel].wrapped:
                difference[..., i] = (difference[..., i] + np.pi) % (2 * np.pi) - np.pi
        for group in self._quaternions():
            flip = (measured[..., group] * simulated[..., group]).sum(-1) < 0
            other = measured[..., group] + simulated[..., group]
            difference[..., group] = np.where(flip[..., None], other, difference[..., group])
        whitened = difference / self.replayer.floor[self.live]
        if self._open is not None:
            whitened = whitened / (self._open if select is None else self._open[select])
        whitened = np.where(np.isfinite(whitened), whitened, BROKEN)
        result: Array = np.where(mask, np.clip(whitened, -BROKEN, BROKEN), 0.0)
        return result

    def whiten(self, raw: Array, select: Ints | None = None) -> Array:
        """Apply (I + S S')^(-1/2) window by window; same shape."""
        basis, shrink = (self._basis, self._shrink) if select is None else (self._basis[select], self._shrink[select])
        return _scaled(raw, basis, -shrink)

    def colour(self, whitened: Array) -> Array:
        """Take `whiten` back, in all windows."""
        return _scaled(whitened, self._basis, self._shrink / (1.0 - self._shrink))

    def of(self, variants: list[Variant], select: Ints | None = None, which: Ints | None = None) -> Array:
        """Residuals (nv, nw, ns, nl) of variants; ``which`` as in Replayer.run."""
        whitened = self.whiten(self.raw(self.replayer.run(variants, select, which), select), select)
        if self.chance is None:
            return whitened
        return weighed(whitened, *(part if select is None else part[select] for part in self.chance))

    def update_start(self, *references: Variant) -> None:
        """Recompute how an error of the start shows: the mean covariance about several models, the likeliest last.

        About one model alone the others would be judged by what only that one forgives.
        """
        responses = [self._responses(reference) for reference in references]
        share = len(references) ** -0.5
        start, white, slow = (share * np.concatenate([r[i] for r in responses], -1) for i in range(3))
        base = responses[-1][3]
        tried = []
        for level in _INPUT_ERRORS if white.shape[-1] else (0.0,):
            basis, scale, _ = np.linalg.svd(np.concatenate([start, white, level * slow], -1), full_matrices=False)
            amounts = np.einsum("wmk,wm->wk", basis, base)
            fit = (base**2).sum() - (amounts**2 * scale**2 / (1.0 + scale**2)).sum()
            tried.append((fit + np.log1p(scale**2).sum(), level, basis, scale))
        _, self.input_error, basis, scale = min(tried, key=lambda t: t[0])
        # Errors that do not show are left out: they cost time.
        kept = int((scale > 0.1).any(axis=0).sum())
        self._basis = np.ascontiguousarray(basis[..., :kept])
        self._shrink = 1.0 - 1.0 / np.sqrt(1.0 + scale[:, :kept] ** 2)

    def _responses(self, reference: Variant) -> tuple[Array, Array, Array, Array]:
        """Responses (nw, m, k) of one model to errors of the start and of measured inputs; its residual (nw, m)."""
        state, nw = self.replayer.state, len(self.replayer.windows)
        sd, rate_sd = state.start_sd
        nm = state.size
        count = 1 + 2 * nm
        shift, rate_shift = np.zeros((count, nm)), np.zeros((count, nm))
        shift[1 : 1 + nm] = np.diag(_START_SD * sd)
        rate_shift[1 + nm :] = np.diag(_START_SD * rate_sd)
        window = np.tile(np.arange(nw), count)
        which = np.zeros(count * nw, np.int64)
        outputs = self.replayer.run_pairs(
            [reference], which, window, np.repeat(shift, nw, axis=0), np.repeat(rate_shift, nw, axis=0)
        )
        raw = self.raw(outputs.reshape(count, nw, *outputs.shape[1:])).reshape(count, nw, -1)
        start = np.moveaxis(raw[1:] - raw[0], 0, -1)
        white, slow = self._input_responses(reference, raw[0])
        return start, white, slow, raw[0]

    def _scatter(self, reference: Variant) -> Array:
        """Variance (nw, ns, nl) of replays whose starts differ by less than anybody can measure."""
        state, nw = self.replayer.state, len(self.replayer.windows)
        rng = np.random.default_rng(0)
        nudges = _NUDGE * rng.standard_normal((2, _NUDGES, nw, state.size))
        nudges[:, 0] = 0.0
        shift, rate_shift = ((n * sd).reshape(-1, state.size) for n, sd in zip(nudges, state.start_sd, strict=True))
        window, which = np.tile(np.arange(nw), _NUDGES), np.zeros(_NUDGES * nw, np.int64)
        outputs = self.replayer.run_pairs([reference], which, window, shift, rate_shift)
        raw = self.raw(outputs.reshape(_NUDGES, nw, *outputs.shape[1:]))
        scatter: Array = ((raw[1:] - raw[0]) ** 2).mean(axis=0)
        return scatter

    def _input_responses(self, reference: Variant, base: Array) -> tuple[Array, Array]:
        """Responses (nw, m, k) to errors of measured inputs: white noise, and a wander of their root mean square."""
        aligned, windows, plant = self.replayer.aligned, self.replayer.windows, self.replayer.plant
        measured = [i for i, c in enumerate(plant.inputs) if c.measured or c.actuator < 0]
        if not measured:
            return np.zeros((*base.shape, 0)), np.zeros((*base.shape, 0))
        rows = windows.start[:, None] + np.arange(windows.length)
        size = np.sqrt((aligned.inputs**2).mean(axis=0))
        noise = np.maximum(input_noise(aligned), 1e-4 * size)
        count = max(round(windows.length * aligned.period / _KNOT), 2) + 1
        spacing = windows.length / (count - 1)
        hats = np.maximum(1.0 - np.abs(np.arange(windows.length)[:, None] / spacing - np.arange(count)), 0.0)
        variants = []
        for i in measured:
            for k in range(count):
                variant = reference.copy()
                variant.inputs.added = np.zeros_like(aligned.inputs)
                # A point stands for ``spacing`` samples, whose noise averages out.
                variant.inputs.added[rows, i] = noise[i] / np.sqrt(max(spacing, 1.0)) * hats[:, k]
                variants.append(variant)
        raw = self.raw(self.replayer.run(variants)).reshape(len(variants), *base.shape)
        white = np.moveaxis(raw - base, 0, -1)
        # The wander has fewer points; each moves its neighbours with it.
        wide = max(round(windows.length * aligned.period / _WANDER), 2) + 1
        mix = np.maximum(1.0 - np.abs(np.linspace(0, wide - 1, count)[:, None] - np.arange(wide)), 0.0)
        parts = []
        for n, i in enumerate(measured):
            unit = white[..., n * count : (n + 1) * count] * (size[i] / (noise[i] / np.sqrt(max(spacing, 1.0))))
            parts.append(unit @ mix)
        return white, np.concatenate(parts, axis=-1)

    def _quaternions(self) -> list[list[int]]:
        """Positions (among the live outputs) of complete quaternions."""
        groups: dict[str, list[int]] = {}
        for i, channel in enumerate(self.live):
            output = self.replayer.plant.outputs[channel]
            if output.sensor_type == mujoco.mjtSensor.mjSENS_FRAMEQUAT and output.euler < 0:
                groups.setdefault(output.sensor, []).append(i)
        return [g for g in groups.values() if len(g) == 4]


def weighed(whitened: Array, basis: Array, size: Array) -> Array:
    """Residuals (..., nw, ns, nl) in units of noise and of what moves them by ``size`` (nw, k) along ``basis``."""
    return _scaled(whitened, basis, 1.0 / np.sqrt(1.0 + size**2) - 1.0)


def _scaled(values: Array, basis: Array, more: Array) -> Array:
    """Values (..., nw, ns, nl) whose parts along ``basis`` (nw, m, k) are larger by the share ``more`` (nw, k)."""
    if basis.shape[-1] == 0:
        return values
    flat = np.moveaxis(values.reshape(-1, *values.shape[-3:-2], basis.shape[1]), 1, 0)
    flat = flat + ((flat @ basis) * more[:, None, :]) @ np.swapaxes(basis, 1, 2)
    return np.moveaxis(flat, 0, 1).reshape(values.shape)


def channel_gap(residual: Array, mask: NDArray[np.bool_]) -> Array:
    """Root mean square (..., nl) of residuals (..., nw, ns, nl) over the recorded samples."""
    count = np.maximum(mask.sum(axis=(-3, -2)), 1)
    gap: Array = np.sqrt((residual**2).sum(axis=(-3, -2)) / count)
    return gap
