"""Which effects a recording could show, how small, and which it could not tell from each other; nothing is fitted.

Every effect is entered once, at a moderate strength, and replayed in a few windows about the nominal model. What it
changes there, less what nominal numbers within their tolerances can imitate, is taken to grow in proportion with it.
Half its square in noise floors is the evidence [nats] that a diagnosis would see, as if the model were right otherwise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from simgap.analysis.isolability import angle_matrix
from simgap.analysis.options import Options
from simgap.data.align import Aligned
from simgap.data.errors import GapInputError
from simgap.data.plant import Plant
from simgap.effects.base import Context, Effect
from simgap.effects.library import enumerate_effects
from simgap.inference.fit import Fitter
from simgap.inference.hypothesis import Hypothesis
from simgap.inference.model_selection import CLOSE, EVIDENCE, LEAD
from simgap.inference.residual import BROKEN, Residuals
from simgap.inference.scores import PER_PARAMETER
from simgap.simulation.horizon import usable_horizon
from simgap.simulation.replay import Replayer
from simgap.simulation.variant import Variant
from simgap.simulation.windows import HORIZON, HORIZON_HEAVY, WARM_UP, affordable, at_limit, cut, light

Array = NDArray[np.float64]
Values = tuple[float, ...]

WORK = 8e6
"""Time steps times degrees of freedom that the replays of all effects may take: about as many seconds of one processor,
in millions. The number of windows is chosen by it."""
_FEWEST, _MOST = 6, 18
"""Windows."""
_BATCH = 24
_ONSET = 0.5
"""Share of the strongest try from which on even the weakest lies where an effect needs that much to begin."""
_NO_SIZE = 1e-9
_BEYOND = 3.0
"""An effect that would have to be so many times its strongest start value does not show."""


@dataclass(frozen=True)
class Detectable:
    """One effect at one site.

    Attributes:
        smallest: value of the parameter from which it would be found; None where it does not show. Of a stop or a limit
            a value at which it would be, for nobody knows where it begins.
        rival: the effect that is most like it, where the two are not told apart at any size.
        sensor: the output that shows it most.
        segment: [s] of the recording that shows it most, (from, to).
    """

    effect: str
    site: str
    parameter: str
    unit: str
    smallest: float | None
    rival: str | None
    sensor: str
    segment: tuple[float, float]

    def report(self) -> dict[str, Any]:
        """As JSON."""
        return {**vars(self), "segment": list(self.segment)}


_TO_SEE = {
    "armature": "accelerate harder: quick moves to and fro",
    "joint_range": "move to the stops",
    "sensor_saturation": "move to the ends of the sensor's range",
    "servo_rate_limit": "command steps",
    "servo_torque_limit": "load the servo until it gives way",
    "thermal_drift": "load the servo for a while",
    "supply_sag": "load all servos at once",
    "torque_ripple": "turn slowly through most of the range",
}
"""Effect that does not show -> what would show it."""


def advice(rows: Sequence[Detectable]) -> list[str]:
    """What to record so that more can be told."""
    found = []
    for effect, way in _TO_SEE.items():
        hidden = [row.site for row in rows if row.effect == effect and row.smallest is None]
        if hidden:
            found.append(f"{way}, to see {effect} ({', '.join(hidden)})")
    sites = {row.site: row.rival.split("@")[1] for row in rows if row.rival and row.rival.split("@")[0] == row.effect}
    for one, other in sites.items():
        if sites.get(other) != one or one < other:
            found.append(f"move {one} and {other} one after the other, to tell which of the two is to blame")
    friction = {"coulomb_friction", "stribeck_friction"}
    mixed = {row.site for row in rows if row.effect in friction and row.rival and row.rival.split("@")[0] in friction}
    if mixed:
        found.append(f"turn round slowly, to tell the laws of friction apart ({', '.join(sorted(mixed))})")
    return found


def detectability(
    plant: Plant, aligned: Aligned, floor: Array, threads: int | None = None, options: Options | None = None
) -> list[Detectable]:
    """All effects of the library at single sites; empty where the recording holds too few windows.

    ``options``: how a diagnosis would be done, where not as of any robot: which effects and sites make sense, what may
    be off without being a fault, and where it would look.
    """
    options, nominal = options or Options(), Variant.nominal(plant)
    if options.cut is not None:
        windows = options.cut(aligned)
        found: tuple[Replayer, int] | None = Replayer(plant, aligned, windows, floor, threads), len(windows)
    else:
        found = _windows(plant, aligned, floor, nominal, threads)
    if found is None:
        return []
    replayer, whole = found
    effects = enumerate_effects(Context.of(replayer, nominal, options.groups))
    effects = _single(effects) if options.keep is None else [e for e in _first_forms(effects) if options.keep(e)]
    size = np.sqrt((aligned.inputs**2).mean(axis=0))
    nuisances = options.nuisances(plant, aligned.outputs.std(axis=0), size, aligned.period)
    if options.cut is None:
        replayer = _affordable(replayer, len(effects) + len(nuisances) + 2 * replayer.state.size)
    residuals = Residuals.build(replayer, nominal)
    fitter = Fitter(residuals, nuisances)
    base = residuals.of([nominal])[0]
    fitter.estimate_independent(base)
    fitter.refresh(Hypothesis(), np.zeros(0), np.zeros(len(nuisances)), base)
    # As if no gap were left.
    root = np.sqrt(fitter.weights(np.ones((len(base), base.shape[2]))))[:, None, :]
    rows = (fitter.jacobian * root).reshape(len(nuisances), base.size).astype(float)
    factor = cho_factor(rows @ rows.T + np.eye(len(rows)))
    responses = np.empty((len(effects), base.size), np.float32)
    starts = [_start(effect) for effect in effects]
    for first in range(0, len(effects), _BATCH):
        part = slice(first, first + _BATCH)
        for k, change in enumerate(_changes(fitter, effects[part], starts[part], base)):
            flat = (change * root).reshape(-1)
            responses[first + k] = flat - rows.T @ cho_solve(factor, rows @ flat)
    # The diagnosis sees more windows like these.
    more = whole / len(replayer.windows)
    return _told(effects, starts, responses.astype(float), more, residuals, base.shape)


def _told(
    effects: Sequence[Effect],
    starts: Sequence[Values],
    responses: Array,
    more: float,
    residuals: Residuals,
    shape: tuple[int, ...],
) -> list[Detectable]:
    evidence = 0.5 * more * (responses**2).sum(axis=1)
    needed = EVIDENCE + PER_PARAMETER + float(np.log(len(effects)))
    apart = np.sin(np.radians(angle_matrix(list(responses)))) ** 2
    for i, effect in enumerate(effects):
        for j, other in enumerate(effects):
            if i == j or other.key in effect.aliases or effect.key in other.aliases:
                apart[i, j] = 1.0
    aligned, windows = residuals.replayer.aligned, residuals.replayer.windows
    rows = []
    for i, (effect, start) in enumerate(zip(effects, starts, strict=True)):
        nearest = int(np.argmin(apart[i]))
        share = float(np.sqrt(max(needed, CLOSE / max(apart[i, nearest], LEAD)) / max(evidence[i], 1e-300)))
        rival = effects[nearest].key if apart[i, nearest] < LEAD else None
        share = max(share, 1.0) if _has_onset(effect) else share
        steps = [abs(p.away(v)) / p.strong for p, v in zip(effect.parameters, start, strict=True)]
        square = (responses[i] ** 2).reshape(shape)
        window = int(np.argmax(square.sum(axis=(1, 2))))
        begin = float(aligned.time[windows.start[window]])
        most = int(np.argmax(steps))
        parameter = effect.parameters[most]
        value = float(parameter.at(min(share, _BEYOND / max(steps)) * parameter.away(start[most])))
        shows = share * max(steps) <= _BEYOND and parameter.low <= value <= parameter.high
        # What is laid out for a command that never changes has no size.
        shows &= parameter.strong > _NO_SIZE
        rows.append(
            Detectable(
                effect.name,
                effect.site.name,
                parameter.name,
                parameter.unit,
                value if shows else None,
                rival if shows else None,
                residuals.channels[int(np.argmax(square.sum(axis=(0, 1))))],
                (begin, begin + windows.length * aligned.period),
            )
        )
    return rows


def _windows(
    plant: Plant, aligned: Aligned, floor: Array, nominal: Variant, threads: int | None
) -> tuple[Replayer, int] | None:
    """A replayer of a few windows like the diagnosis's, and how many that has; None where they are too few."""
    most, longest = affordable(plant.model), HORIZON if light(plant.model) else HORIZON_HEAVY
    avoided = at_limit(aligned, floor)
    try:
        made = Replayer(plant, aligned, cut(aligned, longest, WARM_UP, _MOST, avoided), floor, threads)
        horizon = usable_horizon(made, nominal)
        if horizon <= 0.9 * longest:
            count = round(_MOST * longest / horizon)
            made = Replayer(plant, aligned, cut(aligned, horizon, WARM_UP, count, avoided), floor, threads)
            most, longest = round(most * longest / horizon), horizon
        return made, len(cut(aligned, longest, WARM_UP, most, avoided))
    except GapInputError:
        return None


def _affordable(replayer: Replayer, count: int) -> Replayer:
    """The same with as many windows as ``count`` replays of them are worth."""
    windows, model, period = replayer.windows, replayer.plant.model, replayer.aligned.period
    steps = (windows.warm_up + windows.length) * period / model.opt.timestep
    number = int(np.clip(WORK / (count * steps * model.nv), min(_FEWEST, len(windows)), len(windows)))
    if number >= len(windows):
        return replayer
    horizon, lead = windows.length * period, windows.warm_up * period
    fewer = cut(replayer.aligned, horizon, lead, number, at_limit(replayer.aligned, replayer.floor))
    return Replayer(replayer.plant, replayer.aligned, fewer, replayer.floor, replayer.threads)


def _single(effects: Sequence[Effect]) -> list[Effect]:
    """One form of each effect at single parts; of an effect that acts on several at once only, all of them."""
    alone = {e.name for e in effects if len(e.site.targets) < 2}
    kept: dict[str, Effect] = {}
    for effect in effects:
        if len(effect.site.targets) < 2 or effect.name not in alone:
            kept.setdefault(effect.key, effect)
    return list(kept.values())


def _first_forms(effects: Sequence[Effect]) -> list[Effect]:
    """One form of each effect at each site."""
    kept: dict[tuple[str, str], Effect] = {}
    for effect in effects:
        kept.setdefault((effect.name, effect.site.name), effect)
    return list(kept.values())


def _has_onset(effect: Effect) -> bool:
    """Whether it does nothing before it reaches the motion, as a stop does, or a limit: all its tries are far off."""
    away = [abs(p.away(t)) / p.strong for p in effect.parameters for t in p.tries]
    return min(away) > _ONSET


def _start(effect: Effect) -> Values:
    """A moderate start; the weakest of an effect that has an onset."""
    starts = effect.starts()
    if not _has_onset(effect):
        return starts[len(starts) // 2]
    return min(starts, key=lambda s: sum(abs(p.away(v)) for p, v in zip(effect.parameters, s, strict=True)))


def _changes(fitter: Fitter, effects: Sequence[Effect], starts: Sequence[Values], base: Array) -> list[Array]:
    """What each effect changes in the residual at its start value; nil where the model breaks down with it."""
    z = np.zeros(len(fitter.nuisances))
    plain = [i for i, e in enumerate(effects) if not e.grows]
    variants = [fitter.variant(Hypothesis((effects[i],)), np.array(starts[i]), z) for i in plain]
    residual = dict(zip(plain, fitter.residuals.of(variants), strict=True)) if plain else {}
    for i, effect in enumerate(effects):
        if effect.grows:
            residual[i] = fitter.replay(Hypothesis((effect,)), [(np.array(starts[i]), z)])[0]
    return [
        change if np.abs(change := residual[i] - base).max() < 0.5 * BROKEN else np.zeros_like(base)
        for i in range(len(effects))
    ]
