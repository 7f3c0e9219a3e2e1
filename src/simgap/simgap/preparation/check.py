"""A recording looked at before it is diagnosed: clock, holes, noise, units and signs, and what its motion can tell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from simgap.analysis.input_checks import check_map
from simgap.analysis.rate_reports import rate_reports, rate_warnings
from simgap.data.align import Aligned, align
from simgap.data.channels import model_names
from simgap.data.errors import GapInputError
from simgap.data.excitation import NOTHING_MOVED, excited
from simgap.data.noise_floor import noise_floor, noise_warning
from simgap.data.plant import Plant
from simgap.data.recording import Recording, concatenate
from simgap.preparation.detectability import Detectable, advice, detectability
from simgap.simulation.state import MeasuredState, measured_state

Array = NDArray[np.float64]

_STILL = 20.0
"""A joint that moves by less than this many noise floors, from end to end, stands still."""
_REVERSALS = 6
"""Friction changes its sign with the motion; fewer reversals tell it from an offset only by chance."""
_OWN = 0.05
"""Share of a cause's torque that no other cause can imitate, from which a regression tells it from them."""
_CLOCK = 0.2
"""Spread of the sampling steps (90 % of them), as a share of the period, from which the clock is called uneven."""


@dataclass(frozen=True)
class JointMotion:
    """How one measured joint moves.

    Attributes:
        low, high: of its coordinate [rad or m].
        speed: root mean square.
        reversals: changes of direction, of motions beyond the noise; from one run to the next as well.
        noise: noise floor of its position.
        still: whether it hardly moves.
        separable: causes that this motion tells from each other and from a constant torque.
        confounded: those that it does not.
    """

    name: str
    low: float
    high: float
    speed: float
    reversals: int
    noise: float
    still: bool
    separable: tuple[str, ...] = ()
    confounded: tuple[str, ...] = ()


@dataclass
class Check:
    """What was seen.

    Attributes:
        errors: what a diagnosis would refuse.
        warnings: what is odd.
        advice: what to record instead, or as well.
    """

    period: float
    duration: float
    runs: int
    joints: list[JointMotion]
    errors: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    advice: list[str] = field(default_factory=list)
    detectability: list[Detectable] | None = None
    """Of every effect at every part; None where nobody asked, or where the map is wrong."""

    @property
    def verdict(self) -> str:
        """``usable``, ``poor`` (it cannot tell much) or ``unusable``."""
        if self.errors:
            return "unusable"
        return "poor" if all(j.still for j in self.joints) else "usable"

    def report(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "schema": "simgap/check/1",
            "verdict": self.verdict,
            "period_s": self.period,
            "duration_s": self.duration,
            "runs": self.runs,
            "joints": [dict(vars(joint)) for joint in self.joints],
            "errors": self.errors,
            "warnings": self.warnings,
            "advice": self.advice,
            "detectability": None if self.detectability is None else [row.report() for row in self.detectability],
        }


def check(recordings: Sequence[Recording], plant: Plant, detect: bool = False) -> Check:
    """Look at recordings as a diagnosis would, without fitting anything.

    ``detect``: also say how small an effect could be found, which takes some seconds.

    Raises:
        GapInputError: they cannot even be put on a common grid.
    """
    recording = concatenate(list(recordings))
    aligned = align(recording, plant)
    floor = noise_floor(aligned)
    state = measured_state(plant, aligned, floor)
    found = Check(aligned.period, aligned.duration, len(aligned.runs), _joints(plant, aligned, state, floor))
    found.warnings += [*plant.warnings, *aligned.warnings, *_clock(recording, aligned), *_quiet(plant, aligned, floor)]
    if bare := noise_warning(aligned, floor, [o.name for o in plant.outputs]):
        found.warnings.append(bare)
    try:
        found.warnings += check_map(plant, aligned, state)
        found.warnings += rate_warnings(rate_reports(plant, aligned))
    except GapInputError as error:
        found.errors.append(str(error))
    if (off := 1.0 - float(aligned.enabled.mean())) > 0.0:
        found.warnings.append(f"the servos give no torque in {100 * off:.0f} % of the recording")
    found.advice = _advice(plant, aligned, found)
    if detect and not found.errors:
        moves = excited(plant, aligned, floor)
        found.detectability = detectability(plant, aligned, floor) if moves else []
        found.advice += advice(found.detectability)
        if not moves:
            found.warnings.append(f"{NOTHING_MOVED}: no effect could be found in it")
    return found


def _clock(recording: Recording, aligned: Aligned) -> list[str]:
    """Whether the samples come evenly."""
    steps = np.diff(recording.time[np.isfinite(recording.time)])
    steps = steps[(steps > 0.1 * aligned.period) & (steps < 10.0 * aligned.period)]
    if len(steps) < 10:
        return []
    low, high = np.percentile(steps, [5, 95])
    if high - low < _CLOCK * aligned.period:
        return []
    return [
        f"the clock is uneven: 90 % of the samples are {1e3 * low:.3g} to {1e3 * high:.3g} ms apart "
        f"(median {1e3 * aligned.period:.3g} ms); a delay smaller than that cannot be told"
    ]


def _quiet(plant: Plant, aligned: Aligned, floor: Array) -> list[str]:
    """Outputs whose motion hardly rises above their noise."""
    found = []
    for i, channel in enumerate(plant.outputs):
        values = aligned.outputs[aligned.valid[:, i], i]
        if aligned.live[i] and channel.qpos < 0 and np.ptp(values) < _STILL * floor[i]:
            found.append(
                f"output {channel.name}: ranges over {np.ptp(values) / floor[i]:.0f} noise floors only; it says little"
            )
    return found


def _joints(plant: Plant, aligned: Aligned, state: MeasuredState, floor: Array) -> list[JointMotion]:
    model, names, found = plant.model, model_names(plant.model, mujoco.mjtObj.mjOBJ_JOINT), []
    noise = {c.qpos: float(floor[i]) / abs(c.gear) for i, c in enumerate(plant.outputs) if c.qpos >= 0}
    measured = {int(q): k for k, q in enumerate(state.qpos) if q >= 0}
    for channel in plant.outputs:
        # A dead channel is of a joint that stands still, as far as anybody can see.
        if channel.qpos >= 0 and channel.qpos not in measured:
            joint = int(np.flatnonzero(model.jnt_qposadr == channel.qpos)[0])
            value = float(channel.coordinate(aligned.outputs[0, [plant.outputs.index(channel)]])[0])
            found.append(JointMotion(names[joint], value, value, 0.0, 0, noise[channel.qpos], True))
    for qpos, k in measured.items():
        joint = int(np.flatnonzero(model.jnt_qposadr == qpos)[0])
        position, velocity = state.position[:, k], state.velocity[:, k]
        low, high = (float(v) for v in np.percentile(position, [0.5, 99.5]))
        sd = noise.get(qpos, float(state.position_sd[k]))
        still = high - low < _STILL * sd
        least = max(5.0 * sd, 0.02 * (high - low))
        ways = [way for r in aligned.runs for way in _ways(position[r.start : r.stop], least)]
        # A run that goes up and one that goes down tell friction as one that turns round does.
        reversals = int(np.count_nonzero(np.diff(ways)))
        separable, confounded = ((), ()) if still else _separable(aligned, position, velocity)
        speed = float(np.sqrt(np.mean(velocity**2)))
        found.append(JointMotion(names[joint], low, high, speed, reversals, sd, still, separable, confounded))
    return found


def _ways(position: Array, size: float) -> list[int]:
    """Direction, 1 or -1, of each way of at least ``size`` that a coordinate (n,) goes before it turns round."""
    ways: list[int] = []
    extreme = float(position[0])
    for value in position:
        if ways and (value - extreme) * ways[-1] > 0.0:
            extreme = float(value)
        elif abs(value - extreme) > size:
            ways.append(1 if value > extreme else -1)
            extreme = float(value)
    return ways


def _separable(aligned: Aligned, position: Array, velocity: Array) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Which of a joint's torques (n,) no mixture of the others imitates: inertia, damping, friction, a spring."""
    acceleration = np.zeros_like(velocity)
    for run in aligned.runs:
        part = slice(run.start, run.stop)
        acceleration[part] = np.gradient(velocity[part], aligned.period)
    slow = 0.1 * float(np.sqrt(np.mean(velocity**2))) or 1.0
    causes = {
        "inertia": acceleration,
        "viscous friction": velocity,
        "dry friction": np.tanh(velocity / slow),
        "stiffness or gravity": position - position.mean(),
    }
    rows = {name: values / (np.linalg.norm(values) or 1.0) for name, values in causes.items()}
    constant = np.full(len(position), 1.0 / np.sqrt(len(position)))
    told: list[str] = []
    confounded: list[str] = []
    for name, values in rows.items():
        others = np.stack([constant, *(v for n, v in rows.items() if n != name)], 1)
        rest = values - others @ np.linalg.lstsq(others, values, rcond=None)[0]
        (told if float(rest @ rest) > _OWN else confounded).append(name)
    return tuple(told), tuple(confounded)


def _advice(plant: Plant, aligned: Aligned, found: Check) -> list[str]:
    advice = []
    still = [j.name for j in found.joints if j.still]
    moving = [j for j in found.joints if not j.still]
    if still:
        advice.append(f"{', '.join(still)}: stands still, so nothing can be said about it; move it over half its range")
    few = [f"{j.name} ({j.reversals} times)" for j in moving if j.reversals < _REVERSALS]
    if few:
        advice.append(
            f"{', '.join(few)}: turn round seldom; move to and fro {_REVERSALS} times or more, slowly and quickly, to "
            "tell friction"
        )
    alike: dict[tuple[str, ...], list[str]] = {}
    for joint in moving:
        if joint.reversals >= _REVERSALS and joint.confounded:
            alike.setdefault(joint.confounded, []).append(joint.name)
    for confounded, those in alike.items():
        advice.append(
            f"{', '.join(those)}: {' and '.join(confounded)} cannot be told from the rest; vary speed and range, as in "
            "a chirp"
        )
    if found.duration < 20.0:
        advice.append(f"{found.duration:.3g} s are little; half a minute gives narrower intervals")
    measured = {c.dof for c in plant.outputs} | {
        int(plant.model.jnt_dofadr[np.flatnonzero(plant.model.jnt_qposadr == c.qpos)[0]])
        for c in plant.outputs
        if c.qpos >= 0
    }
    names = model_names(plant.model, mujoco.mjtObj.mjOBJ_JOINT)
    unseen = [
        names[j]
        for j in range(plant.model.njnt)
        if plant.model.jnt_type[j] in (2, 3) and int(plant.model.jnt_dofadr[j]) not in measured
    ]
    if unseen:
        advice.append(f"{', '.join(unseen)}: not measured; a joint that nobody sees hides what is wrong with it")
    return advice
