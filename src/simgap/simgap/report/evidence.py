"""What the page shows beyond diagnosis.json: curves of held-out windows, intervals of the ranking, a posture."""

from __future__ import annotations

from dataclasses import dataclass, field

import mujoco
import numpy as np
from numpy.typing import NDArray

from simgap.analysis.diagnose import Diagnosis
from simgap.data.align import Aligned
from simgap.inference.hypothesis import Hypothesis

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

_CHANNELS = 4
_WINDOWS = 4
_RANKED = 9
_FREE_CHANNELS = 3
_LONGEST = 18
_SITES = {
    "servo": mujoco.mjtObj.mjOBJ_ACTUATOR,
    "tendon": mujoco.mjtObj.mjOBJ_TENDON,
    "mass": mujoco.mjtObj.mjOBJ_BODY,
    "com": mujoco.mjtObj.mjOBJ_BODY,
    "inertia": mujoco.mjtObj.mjOBJ_BODY,
    "soft": mujoco.mjtObj.mjOBJ_BODY,
    "ground": mujoco.mjtObj.mjOBJ_GEOM,
    "foot": mujoco.mjtObj.mjOBJ_GEOM,
} | dict.fromkeys(("coulomb", "viscous", "stribeck", "load", "torque", "armature", "joint"), mujoco.mjtObj.mjOBJ_JOINT)
"""First word of an effect's name: what its sites are."""


@dataclass(frozen=True)
class Curve:
    """One channel in one held-out window: measured, nominal, and with what was found; all (ns,).

    ``start`` is when it begins [s], and in which run where there are several.
    """

    window: int
    start: str
    time: Array
    measured: Array
    nominal: Array
    after: Array


@dataclass(frozen=True)
class FreeCurve:
    """One channel of one free run, (nw, ns) each; nw is 1 unless the run is cut into stretches.

    ``run`` is what the recording calls it, empty where there is no other.
    """

    run: str
    channel: str
    unit: str
    time: Array
    measured: Array
    nominal: Array
    diagnosed: Array


@dataclass(frozen=True)
class Rank:
    """What one hypothesis gains over the nominal model with its nuisances [nats], with its 90 % interval."""

    name: str
    gain: float
    low: float
    high: float
    gap: float
    chosen: bool


@dataclass
class Evidence:
    """Everything that is drawn.

    Attributes:
        curves: {(channel, unit): windows}, the channels with the largest gap first.
        ranking: best first.
        unit: of what hypotheses gain, in words.
        qpos: a posture of the recording, (nq,).
        bodies: {body: names of the subsystems whose channels speak about it}.
        causes: {body: names of the effects that were found there}; a sensor's or the link's have no place.
        free: curves of one free run, the channels with the largest gap first.
    """

    model: mujoco.MjModel
    qpos: Array
    curves: dict[tuple[str, str], list[Curve]] = field(default_factory=dict)
    ranking: list[Rank] = field(default_factory=list)
    unit: str = "nats"
    bodies: dict[int, list[str]] = field(default_factory=dict)
    causes: dict[int, list[str]] = field(default_factory=dict)
    free: list[FreeCurve] = field(default_factory=list)


def gather(found: Diagnosis) -> Evidence:
    """Collect the evidence of a diagnosis; replays the held-out windows that are drawn once more."""
    plant = found.selector.fitter.residuals.replayer.plant
    evidence = Evidence(plant.model, _posture(found))
    evidence.curves = _curves(found)
    evidence.ranking, evidence.unit = _ranking(found), found.selector.scores.unit
    evidence.bodies = _bodies(found)
    evidence.causes = _causes(found)
    evidence.free = _free(found)
    return evidence


def _curves(found: Diagnosis) -> dict[tuple[str, str], list[Curve]]:
    """Held-out windows with the median gap and with the largest; fitted on the other folds."""
    fitter, best = found.selector.fitter, found.selection.best.fit
    residuals, windows = fitter.residuals, fitter.windows
    replayer = residuals.replayer
    none = np.zeros(0)
    held = np.flatnonzero(windows.fold >= 0)
    square = fitter.mean_square(fitter.replay(Hypothesis(), [(none, np.zeros(len(fitter.nuisances)))])[0])
    loud = np.argsort(-np.sqrt(np.maximum(square[held], 0.0)).mean(axis=0))[:_CHANNELS]
    order = held[np.argsort(np.log1p(square[held]).sum(axis=1))]
    picked = sorted({int(order[round(q * (len(order) - 1))]) for q in np.linspace(0.35, 0.95, _WINDOWS)})
    select = np.array(picked, np.int64)
    nominal = replayer.run([fitter.variant(Hypothesis(), none, np.zeros(len(fitter.nuisances)))], select)[0]
    after = np.empty_like(nominal)
    for i, window in enumerate(picked):
        x, z = _seen_by_others(found, int(windows.fold[window]))
        variant = fitter.variant(best.hypothesis, x, z)
        after[i] = replayer.run([variant], select[i : i + 1])[0, 0]
    seconds: Array = (windows.sample * found.aligned.period).astype(np.float64)
    curves: dict[tuple[str, str], list[Curve]] = {}
    for c in loud:
        output = replayer.plant.outputs[int(residuals.live[c])]
        column = int(residuals.live[c])
        curves[(output.name, output.unit)] = [
            Curve(
                window,
                _begin(found.aligned, int(windows.start[window])),
                seconds,
                np.where(residuals.mask[window, :, c], residuals.measured[window, :, c], np.nan),
                nominal[i, :, column],
                after[i, :, column],
            )
            for i, window in enumerate(picked)
        ]
    return curves


def _begin(aligned: Aligned, row: int) -> str:
    seconds, calls = f"{aligned.time[row]:.1f} s", {run.name for run in aligned.runs}
    run = next(run for run in aligned.runs if run.start <= row < run.stop)
    # A window's picture has no room for more.
    name = run.name if len(run.name) <= _LONGEST else run.name[: _LONGEST - 3] + "..."
    return seconds if len(calls) == 1 else f"{seconds} of {name}"


def _free(found: Diagnosis) -> list[FreeCurve]:
    """The run whose diagnosed error is the median one, in the channels that show most of the gap."""
    plant = found.selector.fitter.residuals.replayer.plant
    names = [output.name for output in plant.outputs]
    shares: dict[str, float] = {}
    for row in found.report["where"]:
        shares[row["channel"]] = shares.get(row["channel"], 0.0) + row["share"]
    loud = sorted(shares, key=lambda name: -shares[name])[:_FREE_CHANNELS]
    whole = [run for run in found.runs if not run.broke_down("diagnosed")] or found.runs
    if not whole or not loud:
        return []
    whole = sorted(whole, key=lambda run: run.error(plant, "diagnosed").get(loud[0], 0.0))
    run = whole[len(whole) // 2]
    return [
        FreeCurve(
            run.name if len({r.name for r in found.aligned.runs}) > 1 else "",
            name,
            plant.outputs[c].unit,
            run.time,
            run.measured[..., c],
            run.simulated["nominal"][..., c],
            run.simulated["diagnosed"][..., c],
        )
        for name, c in ((name, names.index(name)) for name in loud)
    ]


def _seen_by_others(found: Diagnosis, fold: int) -> tuple[Array, Array]:
    """Parameters and nuisances of the fit that has not seen a fold."""
    fit = found.selection.best.fit
    x = fit.fold_x[fold] if len(fit.fold_x) > fold else fit.x
    z = fit.fold_z[fold] if len(fit.fold_z) > fold else fit.z
    return x, z


def _ranking(found: Diagnosis) -> list[Rank]:
    selector, selection = found.selector, found.selection
    ranked = []
    seen: set[str] = set()
    contestants = [selection.best, *selection.rivals, *selection.singles]
    for scored in contestants:
        if scored.key in seen or scored is selection.reference:
            continue
        seen.add(scored.key)
        gain, low, high = selector.scores.difference(selection.reference.fit, scored.fit)
        ranked.append(Rank(scored.key, gain, low, high, scored.gap, scored is selection.best))
    return sorted(ranked, key=lambda r: -r.gain)[:_RANKED]


def _posture(found: Diagnosis) -> Array:
    """Where the robot was in the middle of the recording, as far as it was measured."""
    replayer = found.selector.fitter.residuals.replayer
    model, state = replayer.plant.model, replayer.state
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    row = len(state.position) // 2
    for j, address in enumerate(state.qpos):
        if address >= 0:
            data.qpos[address] = state.position[row, j]
    if state.base is not None:
        data.qpos[state.base[0] : state.base[0] + 7] = state.pose[row]
    posture: Array = np.array(data.qpos)
    return posture


def _bodies(found: Diagnosis) -> dict[int, list[str]]:
    """Which bodies each channel's subsystem is, as indices of the model."""
    plant = found.selector.fitter.residuals.replayer.plant
    model = plant.model
    spoken: dict[int, list[str]] = {}
    for output in plant.outputs:
        sensor = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SENSOR, output.sensor)
        for body in _of_object(model, int(model.sensor_objtype[sensor]), int(model.sensor_objid[sensor])):
            names = spoken.setdefault(body, [])
            if output.subsystem not in names:
                names.append(output.subsystem)
    return spoken


def _causes(found: Diagnosis) -> dict[int, list[str]]:
    """Which bodies the effects act at."""
    model = found.selector.fitter.residuals.replayer.plant.model
    causes: dict[int, list[str]] = {}
    for effect in found.selection.best.fit.hypothesis.effects:
        kind = _SITES.get(effect.name.split("_")[0])
        targets = [] if kind is None else [t for t in effect.site.targets if t >= 0]
        for body in sorted({b for t in targets for b in _of_object(model, int(kind), t)}):  # type: ignore[arg-type]
            causes.setdefault(body, []).append(effect.key)
    return causes


def _of_object(model: mujoco.MjModel, kind: int, index: int) -> list[int]:
    """Bodies that a joint, actuator, tendon, site, geom or body of the model stands for."""
    obj = mujoco.mjtObj
    if index < 0:
        return []
    if kind == obj.mjOBJ_JOINT:
        return [int(model.jnt_bodyid[index])]
    if kind in (obj.mjOBJ_BODY, obj.mjOBJ_XBODY):
        return [index]
    if kind == obj.mjOBJ_SITE:
        return [int(model.site_bodyid[index])]
    if kind == obj.mjOBJ_GEOM:
        return [int(model.geom_bodyid[index])]
    if kind == obj.mjOBJ_ACTUATOR:
        target = int(model.actuator_trnid[index, 0])
        tendon = model.actuator_trntype[index] == mujoco.mjtTrn.mjTRN_TENDON
        return _of_object(model, int(obj.mjOBJ_TENDON if tendon else obj.mjOBJ_JOINT), target)
    if kind == obj.mjOBJ_TENDON:
        found = []
        for w in range(int(model.tendon_adr[index]), int(model.tendon_adr[index] + model.tendon_num[index])):
            if model.wrap_type[w] == mujoco.mjtWrap.mjWRAP_JOINT:
                found.append(int(model.jnt_bodyid[model.wrap_objid[w]]))
            elif model.wrap_type[w] == mujoco.mjtWrap.mjWRAP_SITE:
                found.append(int(model.site_bodyid[model.wrap_objid[w]]))
        return sorted(set(found))
    return []
