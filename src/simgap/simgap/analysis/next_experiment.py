"""What next: the safe experiment on which the remaining rivals disagree most after each has been refitted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from simgap.analysis.experiment import Experiment, GenericMenu, Menu
from simgap.data.align import Aligned, Run
from simgap.data.channels import model_names
from simgap.data.errors import GapInputError
from simgap.data.plant import Plant
from simgap.inference.fit import Fitter
from simgap.inference.hypothesis import Fit
from simgap.inference.residual import Residuals
from simgap.simulation.replay import Replayer
from simgap.simulation.variant import Variant
from simgap.simulation.windows import Windows, cut, light

Array = NDArray[np.float64]
Progress = Callable[[float], None]

RIVALS = 3
"""Hypotheses that are compared, the winner among them."""
TRIED, TRIED_HEAVY = 5, 2
"""Experiments that are worked out in full: those on which the rivals as fitted differ most; fewer of a heavy model."""
WORTH = 1.0
"""[nats] An experiment that promises less settles nothing."""
FEWEST = 9
"""Windows of an experiment that are looked at, at least; half as many as of the recording."""
_MARGIN = 0.25
"""A simulated joint may leave its recorded range by this share of it."""
_LEAN = 0.15
"""[rad] by which a free body may lean further than recorded."""
_LEAD = 0.15
"""[s] of warm-up before the simulated experiment."""


@dataclass
class Proposal:
    """The chosen experiment with its expected gain, and what the others would give.

    Attributes:
        gain: [nats] by which the winner is expected to beat its closest rival on this experiment alone, both refitted.
        ranking: (name, expected gain) of all that were worked out, best first.
        dropped: names of experiments that some hypothesis predicts to leave what the recording has shown.
    """

    experiment: Experiment
    gain: float
    rivals: list[str]
    ranking: list[tuple[str, float]] = field(default_factory=list)
    dropped: list[str] = field(default_factory=list)

    def report(self) -> dict[str, Any]:
        """For diagnosis.json."""
        return {
            "name": self.experiment.name,
            "description": self.experiment.description,
            "duration_s": float(len(self.experiment.inputs) * self.experiment.period),
            "expected_gain": self.gain,
            "expected_gain_unit": "nats between the closest rivals, both refitted",
            "rivals": self.rivals,
            "ranking": [{"name": n, "expected_gain": g} for n, g in self.ranking],
            "unsafe": self.dropped,
            "file": None,
        }


def propose(
    fitter: Fitter, fits: Sequence[Fit], menu: Menu | None = None, seed: int = 0, progress: Progress | None = None
) -> Proposal | None:
    """The experiment that tells ``fits`` (winner first) apart best; None where none is safe or nothing is open."""
    fits = list(fits)[:RIVALS]
    if len(fits) < 2:
        return None
    aligned, plant = fitter.residuals.replayer.aligned, fitter.residuals.replayer.plant
    menu = menu or GenericMenu()
    seen: list[tuple[float, Experiment, Array]] = []
    dropped: list[str] = []
    variants = [fitter.variant(f.hypothesis, f.x, f.z) for f in fits]
    for experiment in menu.experiments(plant, aligned, _concerned(plant, fits)):
        if progress:
            progress(0.0)
        outputs = simulate(fitter.residuals.replayer, variants, experiment)
        if not all(_safe(plant, aligned, o) for o in outputs):
            dropped.append(experiment.name)
            continue
        spread = (outputs[1:] - outputs[0]) / fitter.residuals.replayer.floor
        live = fitter.residuals.live
        seen.append((float(np.log1p((spread[..., live] ** 2).mean(axis=1)).sum(axis=-1).min()), experiment, outputs[0]))
    seen.sort(key=lambda s: -s[0])
    gains: list[tuple[float, Experiment]] = []
    tried = TRIED if light(plant.model) else TRIED_HEAVY
    for i, (_, experiment, outputs) in enumerate(seen[:tried]):
        gain = _expected_gain(fitter, fits, experiment, outputs, seed)
        if gain is not None:
            gains.append((gain, experiment))
        if progress:
            progress((i + 1) / len(seen[:tried]))
    if not gains:
        return None
    gains.sort(key=lambda g: -g[0])
    if gains[0][0] < WORTH:
        return None
    rivals = [f.hypothesis.key for f in fits]
    return Proposal(gains[0][1], gains[0][0], rivals, [(e.name, g) for g, e in gains], dropped)


def simulate(replayer: Replayer, variants: Sequence[Variant], experiment: Experiment) -> Array:
    """Outputs (nv, n, no) of an experiment from rest, in the recorded pose whose inputs are most like its first row.

    NaN from where a simulation broke down. Row k belongs to row k of ``experiment.inputs``.
    """
    aligned, plant = replayer.aligned, replayer.plant
    spread = np.ptp(aligned.inputs, axis=0) + 1e-12
    distance = (((aligned.inputs - experiment.inputs[0]) / spread) ** 2).sum(axis=1)
    speed = (replayer.state.velocity / (replayer.state.velocity.std(axis=0) + 1e-12)) ** 2
    start = int(np.argmin(distance + 0.1 * speed.sum(axis=1)))
    lead = max(round(_LEAD / experiment.period), 1)
    inputs = np.concatenate([np.repeat(experiment.inputs[:1], lead, axis=0), experiment.inputs, experiment.inputs[-1:]])
    n = len(inputs)
    still = _recording(aligned, experiment.period, inputs, np.repeat(aligned.outputs[start : start + 1], n, axis=0))
    length = len(experiment.inputs) - 1
    first, one = np.array([lead], np.int64), np.zeros(1, np.int64)
    windows = Windows(first, lead, length, np.arange(length, dtype=np.int64), one, one)
    outputs = Replayer(plant, still, windows, replayer.floor, replayer.threads).run(variants)[:, 0]
    return np.concatenate([outputs, outputs[:, -1:]], axis=1)


def _recording(like: Aligned, period: float, inputs: Array, outputs: Array) -> Aligned:
    n = len(inputs)
    return Aligned(
        period,
        period * np.arange(n, dtype=np.float64),
        inputs,
        outputs,
        np.ones(outputs.shape, bool),
        (Run(0, n, 0.0),),
        like.live,
    )


def _expected_gain(
    fitter: Fitter, fits: Sequence[Fit], experiment: Experiment, outputs: Array, seed: int
) -> float | None:
    """Smallest lead [nats] of the winner over a rival on data that it makes itself; None where they are too few."""
    replayer = fitter.residuals.replayer
    settled = round(experiment.settle / experiment.period)
    noise = np.random.default_rng(seed).standard_normal(outputs[settled:].shape)
    made = _recording(
        replayer.aligned, experiment.period, experiment.inputs[settled:], outputs[settled:] + noise * replayer.floor
    )
    try:
        horizon, warm_up = (n * replayer.aligned.period for n in (fitter.windows.length, fitter.windows.warm_up))
        windows = cut(made, horizon, warm_up, max(len(fitter.windows) // 2, FEWEST))
    except GapInputError:
        return None
    first = fits[0]
    there = Replayer(replayer.plant, made, windows, replayer.floor, replayer.threads)
    truth = fitter.variant(first.hypothesis, first.x, first.z)
    local = Fitter(Residuals.build(there, truth), fitter.nuisances)
    local.budget = fitter.budget
    local.likelihood.independent[:] = fitter.likelihood.independent
    residual = local.replay(first.hypothesis, [(first.x, first.z)])[0]
    # Of many nuisances those that the winner did not need stay where they are.
    local.refresh(first.hypothesis, first.x, first.z, residual, fitter.moved(first))
    costs = [local.fit(f.hypothesis, f.x, f.z, iterations=3).cost for f in fits]
    return min(costs[1:]) - costs[0]


def _safe(plant: Plant, aligned: Aligned, outputs: Array) -> bool:
    """Whether joints stay about where they were recorded and no body leans much further than it did."""
    if not np.isfinite(outputs).all():
        return False
    for i, channel in enumerate(plant.outputs):
        angle = channel.euler in (0, 1)
        if not aligned.live[i] or (channel.qpos < 0 and not angle):
            continue
        low, high = np.percentile(aligned.outputs[aligned.valid[:, i], i], [0.5, 99.5])
        room = max(_MARGIN * (high - low), _LEAN if angle else 0.0)
        if outputs[:, i].min() < low - room or outputs[:, i].max() > high + room:
            return False
    kind = mujoco.mjtSensor.mjSENS_FRAMEQUAT
    quaternions = {c.sensor for c in plant.outputs if c.sensor_type == kind and c.euler < 0}
    for name in quaternions:
        channels = [i for i, c in enumerate(plant.outputs) if c.sensor == name]
        order = sorted(channels, key=lambda i: plant.outputs[i].component)
        if len(order) == 4 and _tilt(outputs[:, order]) > _tilt(aligned.outputs[:, order]) + _LEAN:
            return False
    return True


def _tilt(quaternion: Array) -> float:
    """Largest angle [rad] between a body's z axis and the vertical."""
    unit = quaternion / np.maximum(np.linalg.norm(quaternion, axis=1, keepdims=True), 1e-12)
    up = 1.0 - 2.0 * (unit[:, 1] ** 2 + unit[:, 2] ** 2)
    return float(np.arccos(np.clip(up, -1.0, 1.0)).max())


def _concerned(plant: Plant, fits: Sequence[Fit]) -> list[int]:
    """Inputs at the sites of the hypotheses; empty where a site is none of an actuator or its joint."""
    model = plant.model
    joints = model_names(model, mujoco.mjtObj.mjOBJ_JOINT)
    names: dict[str, list[int]] = {}
    for i, channel in enumerate(plant.inputs):
        mine = {channel.name}
        if channel.dof >= 0:
            mine.add(joints[int(model.dof_jntid[channel.dof])])
        elif model.actuator_trntype[channel.actuator] == mujoco.mjtTrn.mjTRN_JOINT:
            mine.add(joints[int(model.actuator_trnid[channel.actuator, 0])])
        for name in mine:
            names.setdefault(name, []).append(i)
    sites = {e.site.name for f in fits for e in f.hypothesis.effects}
    if any(s not in names for s in sites):
        return []
    return sorted({i for s in sites for i in names[s]})
