"""Recordings of a case: of the robot with its faults, which are moved or grown until they can be seen."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from simgap.blind.cases import SMALL, Case, Injected, Robot, all_sites, inject, robot_of, stronger
from simgap.blind.faults.base import LEVELS, Scale
from simgap.blind.faults.bodies import stand_of
from simgap.blind.faults.table import fault, soft_of
from simgap.blind.imitate import (
    IMITATED,
    IMITATED_WALK,
    LATE,
    WINDOW,
    ZERO,
    ZERO_SHARE,
    left_by_imitation,
    nominal_numbers,
)
from simgap.blind.truth import PERIOD, Run, Truth, build, record

Array = NDArray[np.float64]

RUNAWAY = 2e4
"""A fault that moves the recording by this many noise deviations is no fault but a crash."""
VISIBLE, _REDRAWS = 3.0, 6
"""A fault that moves the recording by fewer noise deviations, or that leaves fewer once nominal numbers imitate it
(`imitate.py`), is put elsewhere, so many times at most, and then grows. Of a pair each must show beside the other."""
ABOUT = 0.3
"""What imitates one of a pair may have the other as much larger or smaller."""
NOISE = {"rad": 4e-4, "m": 2e-4, "mm": 0.2, "rad/s": 8e-3, "1": 3e-4}
"""Standard deviation of the sensors' noise by unit."""


def realise(case: Case, robots: Sequence[str] = SMALL) -> Case:
    """Record a case whose faults can be seen, on its robot or, where they cannot, on another of ``robots``.

    A joint that hardly turns shows no inertia, a load on a vertical axis no weight, and a little viscous friction is
    the same as a servo that damps as much more as nominal numbers may be off; nobody could find them. Such a fault is
    put at another site; where no site shows it, it grows until it does or can grow no more.

    Raises ValueError as `simulate` does.
    """
    rng = np.random.default_rng([*case.seed, 2])
    levels = [LEVELS.index(f.level) for f in case.faults]
    drawn = [fault(f.name, f.kind) for f in case.faults]
    able = [r for r in robots if r != case.robot and all(all_sites(r)[f.kind] for f in drawn)]
    seen = _show(case, rng)
    for robot in rng.permutation(able) if not seen else ():
        case.robot, places = str(robot), all_sites(str(robot))
        case.faults = [inject(rng, f, places, level) for f, level in zip(drawn, levels, strict=True)]
        seen = _show(case, rng)
        if seen:
            break
    return case


def _show(case: Case, rng: np.random.Generator) -> bool:
    """Record a case, its faults moved or grown until each can be seen; whether that succeeded."""
    places = all_sites(case.robot)
    simulate(case)
    for attempt in range(2 * _REDRAWS):
        hidden = next((i for i in range(len(case.faults)) if _shift(case, i) < VISIBLE), None)
        if hidden is None:
            return True
        old = case.faults[hidden]
        others = {m for f in case.faults if f is not old for m in f.members}
        drawn = [inject(rng, fault(old.name, old.kind), places, LEVELS.index(old.level)) for _ in range(8)]
        elsewhere = [f for f in drawn if f.site != old.site and not set(f.members) & others]
        if elsewhere and attempt < _REDRAWS:
            case.faults[hidden] = elsewhere[0]
        else:
            old.size = stronger(old.name, old.size, 1.4)
        simulate(case)
    return False


_INIMITABLE = ("sensor_delay", "sensor_scale", "sensor_saturation", "sensor_misalignment", "link_", "slipped_horn")
"""Faults that act outside of the mechanics, or in mid-run: no number of a healthy robot does what they do."""


def _shift(case: Case, index: int) -> float:
    """How far one of the faults moves the recording beyond what a robot without it can [noise deviations].

    That is the healthy robot, or, of a pair, the one with the other fault.
    """
    this, others = case.faults[index], [f for i, f in enumerate(case.faults) if i != index]
    shift = case.healthy_shift
    if others:
        without = simulate(replace(case, faults=[replace(f, parameters={}) for f in others], columns={}))
        truths = Truths(case, robot_of(case.robot))
        shift = truths.apart(truths.in_si(case.columns), truths.in_si(without.columns))
    if shift < VISIBLE or this.name.startswith(_INIMITABLE):
        return shift
    return Truths(case, robot_of(case.robot)).beyond_healthy(case.columns, others)


def simulate(case: Case, robot: Robot | None = None) -> Case:
    """Fill in a case's recording and the true parameters of its faults.

    Raises ValueError where the truth breaks down even with the faults at half their size.
    """
    robot = robot or robot_of(case.robot)
    for attempt in range(4):
        try:
            return _simulate(case, robot)
        except ValueError:
            if attempt == 3:
                raise
            for injected in case.faults:
                injected.size = stronger(injected.name, injected.size, 0.5)
    raise AssertionError


def _simulate(case: Case, robot: Robot) -> Case:
    found = Truths(case, robot)
    case.healthy_shift = 0.0
    result = healthy = found.healthy
    if case.faults:
        result = found.run(found.broken(), found.table)
        case.healthy_shift = found.apart(result.columns, healthy.columns)
        if case.healthy_shift > RUNAWAY:
            raise ValueError("the faults make the truth run away")
    case.columns = found.columns(found.table, result)
    return case


def simulate_again(case: Case, table: dict[str, Array]) -> dict[str, Array]:
    """Columns of a second recording of the same robot, told what ``table`` says (columns of commands, PERIOD apart).

    Raises ValueError where the truth breaks down.
    """
    found = Truths(case, robot_of(case.robot))
    robot = found.broken() if case.faults else found.truth()
    return found.columns(table, found.run(robot, table, again=1))


class Truths:
    """The healthy robot of a case on its own commands, and the broken one on any; everything by the case's seed."""

    def __init__(self, case: Case, robot: Robot) -> None:
        self._case, self._robot = case, robot
        rng = np.random.default_rng([*case.seed, 1])
        excitation, self._parts = int(rng.integers(1 << 30)), [int(s) for s in rng.integers(1 << 30, size=3)]
        self.table = robot.commands(excitation, round(case.seconds / PERIOD))
        self.noise = {
            r["column"]: NOISE.get(r.get("unit", ""), 4e-4) * robot.noise * float(rng.uniform(0.7, 1.5))
            for r in robot.mapping["outputs"]
        }
        self._quantum = float(rng.choice([0.0, 2.0]))
        self._healthy_truth = self.truth()
        self.healthy = self.run(self._healthy_truth, self.table)

    def truth(self, soft: dict[str, Any] | None = None, **spread: tuple[float, float]) -> Truth:
        """The robot without its faults, but with what lies between motors and links."""
        robot = self._robot
        rng = np.random.default_rng(self._parts[0])
        made = build(robot.spec(), robot.mapping, rng, soft, start=robot.start, **spread)
        made.quantum = self._quantum
        return made

    def beyond_healthy(self, columns: dict[str, Array], others: Sequence[Injected] = ()) -> float:
        """What of a recording no healthy robot could have made, whose numbers are all within tolerance [deviations].

        Nor one with ``others`` of the faults, of about their size. Of a robot that walks, in windows that start where
        it was.
        """
        model = self._healthy_truth.model
        walks = any(kind == mujoco.mjtJoint.mjJNT_FREE for kind in model.jnt_type)
        n = round(min(self._case.seconds, IMITATED_WALK if walks else IMITATED) / PERIOD)
        table = {name: values[:n] for name, values in self.table.items()}
        put: dict[int, tuple[Array, Array]] = {}
        if walks:
            broken, (like, _) = self.broken(), self._imitator(others)
            states = self.run(broken, table).states
            put = {k: broken.rigid(states[k], like.model) for k in range(0, n, round(WINDOW / PERIOD))}
        names = list(self.healthy.columns)
        numbers = len(self._imitator(others)[1])
        # A sensor's zero may be off as well.
        zeros = {c: min(ZERO, ZERO_SHARE * float(np.std(self.healthy.columns[c]))) for c in self._joint_columns()}
        sizes = len(others)

        def seen(z: Array) -> Array:
            steps, by, zero, late = np.split(z, np.cumsum([numbers, sizes, len(zeros)]))
            like = [replace(f, size=stronger(f.name, f.size, 1.0 + ABOUT * b)) for f, b in zip(others, by, strict=True)]
            made, moves = self._imitator(like)
            for move, step in zip(moves, steps, strict=True):
                move(step)
            self._put_in(made, like)
            run = record(made, told(made.model, self._robot.mapping, table), {}, np.random.default_rng(0), put)
            # What is put back to where it was is at every window's start in time.
            time = run.time if walks else run.time - LATE * late[0]
            off = dict.fromkeys(names, 0.0) | {c: b * zeros[c] for c, b in zip(zeros, zero, strict=True)}
            found = (np.interp(time, run.time, run.columns[c]) + off[c] for c in names)
            return np.stack([column / self.noise[c] for c, column in zip(names, found, strict=True)], 1)

        measured = self.in_si(columns)
        recorded = np.stack([measured[c][:n] / self.noise[c] for c in names], 1)
        return left_by_imitation(seen, recorded, numbers + sizes + len(zeros) + 1)

    def _imitator(self, others: Sequence[Injected]) -> tuple[Truth, list[Callable[[float], None]]]:
        """A robot whose numbers can be moved; not yet with other faults, but with what lies between its joints then."""
        made = self.truth(self._between(others), spread=(0.0, 0.0))
        return made, nominal_numbers(made)

    def apart(self, one: dict[str, Array], two: dict[str, Array]) -> float:
        """How far two recordings, in SI units, are from each other [noise deviations]."""
        square = [np.mean((one[c] - two[c]) ** 2) / self.noise[c] ** 2 for c in self.healthy.columns]
        return float(np.sqrt(np.mean(square)))

    def in_si(self, columns: dict[str, Array]) -> dict[str, Array]:
        """What the sensors saw, of a recording in the units of the map."""
        units = self._units()
        return {c: columns[c] * units[c] for c in self.healthy.columns}

    def _joint_columns(self) -> list[str]:
        """Columns that hold the position of a joint."""
        model, found = self._healthy_truth.model, []
        for row in self._robot.mapping["outputs"]:
            at_joint = "joint" in row and row.get("quantity") == "position"
            if "sensor" in row:
                at_joint = model.sensor_type[model.sensor(row["sensor"]).id] == mujoco.mjtSensor.mjSENS_JOINTPOS
            found += [row["column"]] if at_joint else []
        return found

    def run(self, made: Truth, table: dict[str, Array], again: int = 0) -> Run:
        """Record a truth; ``again`` gives noise of its own."""
        rng = np.random.default_rng(self._parts[1 + again])
        return record(made, told(made.model, self._robot.mapping, table), self.noise, rng)

    def broken(self) -> Truth:
        """The robot with its faults, whose sizes are relative to what the healthy one did on its own commands."""
        broken = self.truth(self._between(self._case.faults))
        self._put_in(broken, self._case.faults)
        return broken

    def _scale(self) -> Scale:
        made = self._healthy_truth
        return Scale.of(made, self.healthy, told(made.model, self._robot.mapping, self.table))

    def _between(self, faults: Sequence[Injected]) -> dict[str, Any]:
        """What faults put between motors and links, by joint."""
        model, scale = self._healthy_truth.model, self._scale()
        soft: dict[str, Any] = {}
        for injected in faults:
            if injected.name == "soft_mount":
                soft[injected.members[0]] = stand_of(scale, injected.size)
            if injected.name in ("servo_backlash", "flexing_link", "joint_elasticity"):
                joint, actuator = _drive(model, injected)
                between = soft_of(injected.name, injected.size, scale, joint, actuator)
                if between is not None:
                    soft[joint] = between
        return soft

    def _put_in(self, made: Truth, faults: Sequence[Injected]) -> None:
        """Put faults into a robot, in place, and note their true parameters."""
        scale = self._scale()
        for injected in faults:
            chosen = fault(injected.name, injected.kind)
            injected.parameters = {}
            for member in injected.members:
                values = chosen.inject(made, scale, member, injected.size)
                if injected.name == "mass" and injected.parameters:
                    values = {"change": values["change"] + injected.parameters["change"]}
                injected.parameters = values
            if len(injected.members) > 1 and injected.name not in _SHARED:
                injected.parameters = {}
        mujoco.mj_setConst(made.model, mujoco.MjData(made.model))

    def columns(self, table: dict[str, Array], run: Run) -> dict[str, Array]:
        """What a logger writes, in the units of the map."""
        units, time = self._units(), {self._robot.mapping["time"]["column"]: run.time}
        return {**time, **table, **{c: v / units[c] for c, v in run.columns.items()}}

    def _units(self) -> dict[str, float]:
        """SI units in a unit of each output's column."""
        return {r["column"]: 1e-3 if r.get("unit") == "mm" else 1.0 for r in self._robot.mapping["outputs"]}


def _drive(model: mujoco.MjModel, injected: Injected) -> tuple[str, int]:
    """The joint of a fault, and the actuator that drives it."""
    if injected.kind == "elastic":
        joint = model.joint(injected.members[0]).id
        return injected.members[0], int(np.flatnonzero(model.actuator_trnid[:, 0] == joint)[0])
    actuator = model.actuator(injected.members[0]).id
    return str(model.joint(int(model.actuator_trnid[actuator, 0])).name), int(actuator)


_SHARED = ("servo_delay", "servo_gain", "load_friction", "sensor_delay", "ground_friction", "link_latency", "mass")
"""Faults whose parameter means the same at every member of a group."""


def told(model: mujoco.MjModel, mapping: dict[str, Any], table: dict[str, Array]) -> Array:
    """Commands (n, nu) in the units of the controls, from columns in the map's units."""
    n = len(next(iter(table.values())))
    found = np.zeros((n, model.nu))
    for row in mapping["inputs"]:
        index = model.actuator(row["actuator"]).id
        scale = {"mm": 1e-3, "deg": np.pi / 180}.get(row["unit"], 1.0)
        if row["kind"] == "torque":
            scale /= float(model.actuator_gear[index, 0] * _nominal_gain(model, index))
        found[:, index] = scale * table[row["column"]]
    return found


def _nominal_gain(model: mujoco.MjModel, index: int) -> float:
    """Of a plain motor, as its model has it; what the truth's motor really gives is its own affair."""
    return 1.0 if model.actuator_gaintype[index] == mujoco.mjtGain.mjGAIN_FIXED else float("nan")
