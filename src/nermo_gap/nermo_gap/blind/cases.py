"""The cases of a blind check: drawn from number and seed, built into a recording, a map, a model and an answer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from nermo_gap.blind.faults import FAULTS, LEVELS, UNKNOWN, Fault, Scale, fault, soft_of
from nermo_gap.blind.imitate import (
    IMITATED,
    IMITATED_WALK,
    WINDOW,
    ZERO,
    ZERO_SHARE,
    left_by_imitation,
    nominal_numbers,
)
from nermo_gap.blind.robots import MAPS, MODELS, commands, start
from nermo_gap.blind.sites import Site, sites
from nermo_gap.blind.truth import PERIOD, Run, Truth, build, record

Array = NDArray[np.float64]

KINDS = {"none": 0.20, "single": 0.50, "pair": 0.15, "unknown": 0.15}
"""Kinds of cases and their shares: 40, 100, 30 and 30 of 200."""
SMALL = tuple(MODELS)
"""Robots that come with the check."""
MICE = ("nermo_lite",)
"""Our own robots, walking under their own controller; they take minutes each."""
HEAVY = {"quad": 0.25, "nermo_lite": 0.25}
"""Robots that take long are drawn less often, by this factor, where a fault can also sit in another one."""
RUNAWAY = 2e4
"""A fault that moves the recording by this many noise deviations is no fault but a crash."""
VISIBLE, _REDRAWS = 3.0, 6
"""A fault that moves the recording by fewer noise deviations, or that leaves fewer once nominal numbers imitate it
(`imitate.py`), is put elsewhere, so many times at most, and then grows."""
NOISE = {"rad": 4e-4, "m": 2e-4, "mm": 0.2, "rad/s": 8e-3, "1": 3e-4}
"""Standard deviation of the sensors' noise by unit."""


@dataclass
class Injected:
    """One fault of a case, as it is sealed."""

    name: str
    kind: str
    site: str
    members: tuple[str, ...]
    level: str
    size: float
    known: bool
    places: tuple[str, ...]
    parameters: dict[str, float] = field(default_factory=dict)

    @property
    def key(self) -> str:
        """name@site."""
        return f"{self.name}@{self.site}"


@dataclass
class Case:
    """A case: what is published (columns, map, model) and what is sealed (everything else)."""

    id: str
    robot: str
    kind: str
    seed: tuple[int, int]
    seconds: float
    faults: list[Injected]
    columns: dict[str, Array] = field(default_factory=dict)
    healthy_shift: float = 0.0

    def answer(self) -> dict[str, Any]:
        """What is sealed."""
        return {
            "id": self.id,
            "robot": self.robot,
            "kind": self.kind,
            "seed": list(self.seed),
            "seconds": self.seconds,
            "faults": [asdict(f) for f in self.faults],
            "effect_on_recording": self.healthy_shift,
        }


@dataclass(frozen=True)
class Robot:
    """A nominal robot of the check: its MJCF, its map, where it begins, and what it is told, by seed."""

    name: str
    xml: str
    mapping: dict[str, Any]
    start: dict[str, float]
    noise: float = 1.0

    def spec(self) -> mujoco.MjSpec:
        """A fresh specification of the nominal model."""
        return mujoco.MjSpec.from_string(self.xml)

    def commands(self, seed: int, n: int) -> dict[str, Array]:
        """Columns of commands in the map's units."""
        if self.name in MICE:
            from nermo_gap.blind import mouse

            return mouse.walk(seed, n, PERIOD)
        return commands(self.name, seed, n, PERIOD)


def robot_of(name: str) -> Robot:
    """A robot by name.

    Raises ValueError for an unknown one.
    """
    if name in MODELS:
        return Robot(name, MODELS[name], dict(MAPS[name]), start(name))
    if name in MICE:
        # Imported here: the small robots need none of the mouse's packages.
        from nermo_gap.blind import mouse

        return Robot(name, mouse.xml(), mouse.mapping(), {}, noise=5.0)
    raise ValueError(f"robot {name!r} is unknown: choose of {', '.join((*SMALL, *MICE))}")


def draw(count: int, seed: int, robots: Sequence[str] = SMALL, seconds: float = 15.0) -> list[Case]:
    """``count`` cases in random order, in the shares of KINDS; every effect at every level before one comes twice.

    The same count, seed and robots give the same cases.
    """
    rng = np.random.default_rng([seed, 7919])
    numbers = _shares(count)
    places = {name: _all_sites(name) for name in robots}
    single = _deck(FAULTS, rng, places)
    unknown = _deck(UNKNOWN, rng, places)
    kinds = [kind for kind, n in numbers.items() for _ in range(n)]
    order = rng.permutation(len(kinds))
    cases: list[Case] = []
    used = dict.fromkeys(robots, 0)
    for number in range(count):
        kind = kinds[order[number]]
        own = np.random.default_rng([seed, number])
        drawn: list[tuple[Fault, int]] = []
        if kind == "single":
            drawn = [single.pop(0)]
        elif kind == "unknown":
            drawn = [unknown.pop(0)]
        elif kind == "pair":
            drawn = [(_pick(own, FAULTS, places), int(own.integers(1, 3)))]
        single, unknown = single or _deck(FAULTS, rng, places), unknown or _deck(UNKNOWN, rng, places)
        able = [r for r in robots if not drawn or places[r][drawn[0][0].kind]]
        weights = np.array([HEAVY.get(r, 1.0) / (1.0 + used[r]) ** 2 for r in able])
        robot = able[int(own.choice(len(able), p=weights / weights.sum()))]
        used[robot] += 1
        faults = [_inject(own, f, places[robot], level) for f, level in drawn]
        if kind == "pair":
            faults.append(_second(own, faults[0], places[robot]))
        cases.append(Case(f"{number:03d}", robot, kind, (seed, number), seconds, faults))
    return cases


def _shares(count: int) -> dict[str, int]:
    """How many of each kind: rounded, the remainder to the largest fractions."""
    exact = {k: share * count for k, share in KINDS.items()}
    numbers = {k: int(v) for k, v in exact.items()}
    for kind in sorted(exact, key=lambda k: numbers[k] - exact[k])[: count - sum(numbers.values())]:
        numbers[kind] += 1
    return numbers


def _all_sites(robot: str) -> dict[str, list[Site]]:
    chosen = robot_of(robot)
    return sites(chosen.spec().compile(), chosen.mapping)


def _deck(
    faults: Sequence[Fault], rng: np.random.Generator, places: dict[str, dict[str, list[Site]]]
) -> list[tuple[Fault, int]]:
    """Every fault that some robot can have, at every level (unknown ones not weak), shuffled."""
    able = [f for f in faults if any(p[f.kind] for p in places.values())]
    deck = [(f, level) for f in able for level in range(0 if f.known else 1, 3)]
    return [deck[i] for i in rng.permutation(len(deck))]


def _pick(rng: np.random.Generator, faults: Sequence[Fault], places: dict[str, dict[str, list[Site]]]) -> Fault:
    able = [f for f in faults if any(p[f.kind] for p in places.values())]
    return able[int(rng.integers(len(able)))]


def _inject(rng: np.random.Generator, chosen: Fault, places: dict[str, list[Site]], level: int) -> Injected:
    site = places[chosen.kind][int(rng.integers(len(places[chosen.kind])))]
    # Not exactly the size of the table, so that nobody can learn the table.
    size = chosen.sizes[level] if chosen.name == "tendon_detached" else _jittered(rng, chosen, level)
    return Injected(chosen.name, chosen.kind, site.name, site.members, LEVELS[level], size, chosen.known, site.places)


def _jittered(rng: np.random.Generator, chosen: Fault, level: int) -> float:
    """A size about that of its level; for factors, the distance from 1 is what is varied. Signs vary where they may."""
    size = _stronger(chosen.name, chosen.sizes[level], float(np.exp(rng.uniform(-0.12, 0.12))))
    if chosen.name in ("servo_offset", "sensor_bias", "com_shift", "ground_slope", "joint_rest_angle"):
        size *= float(rng.choice([-1.0, 1.0]))
    return size


_FACTORS = (
    "servo_gain",
    "sensor_scale",
    "servo_rate_limit",
    "servo_torque_limit",
    "sensor_saturation",
    "ground_friction",
)


def _stronger(name: str, size: float, by: float) -> float:
    """The size of a fault ``by`` times as strong; of factors, the distance from 1 is what counts."""
    if name in _FACTORS:
        return max(1.0 + (size - 1.0) * by, 0.1)
    return min(size * by, 0.9) if name == "link_loss" else size * by


def _second(rng: np.random.Generator, first: Injected, places: dict[str, list[Site]]) -> Injected:
    """A second fault of the same robot, of another mechanism and not in the same part where that can be."""
    able = [f for f in FAULTS if places[f.kind] and f.name != first.name]
    best: Injected | None = None
    for _ in range(20):
        second = _inject(rng, able[int(rng.integers(len(able)))], places, int(rng.integers(1, 3)))
        best = best or second
        if not set(second.members) & set(first.members):
            return second
    assert best is not None
    return best


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
    able = [r for r in robots if r != case.robot and all(_all_sites(r)[f.kind] for f in drawn)]
    seen = _show(case, rng)
    for robot in rng.permutation(able) if not seen else ():
        case.robot, places = str(robot), _all_sites(str(robot))
        case.faults = [_inject(rng, f, places, level) for f, level in zip(drawn, levels, strict=True)]
        seen = _show(case, rng)
        if seen:
            break
    return case


def _show(case: Case, rng: np.random.Generator) -> bool:
    """Record a case, its faults moved or grown until each can be seen; whether that succeeded."""
    places = _all_sites(case.robot)
    simulate(case)
    for attempt in range(2 * _REDRAWS):
        hidden = next((i for i in range(len(case.faults)) if _shift(case, i) < VISIBLE), None)
        if hidden is None:
            return True
        old = case.faults[hidden]
        others = {m for f in case.faults if f is not old for m in f.members}
        drawn = [_inject(rng, fault(old.name, old.kind), places, LEVELS.index(old.level)) for _ in range(8)]
        elsewhere = [f for f in drawn if f.site != old.site and not set(f.members) & others]
        if elsewhere and attempt < _REDRAWS:
            case.faults[hidden] = elsewhere[0]
        else:
            old.size = _stronger(old.name, old.size, 1.4)
        simulate(case)
    return False


_INIMITABLE = ("sensor_delay", "sensor_scale", "sensor_saturation", "sensor_misalignment", "link_")
"""Faults that act outside of the mechanics: no number of a healthy robot does what they do."""


def _shift(case: Case, index: int) -> float:
    """How far one of the faults alone moves the recording, beyond what a healthy robot can [noise deviations]."""
    alone = case
    if len(case.faults) > 1:
        alone = simulate(replace(case, faults=[replace(case.faults[index], parameters={})], columns={}))
    if alone.healthy_shift < VISIBLE or case.faults[index].name.startswith(_INIMITABLE):
        return alone.healthy_shift
    return _Truths(alone, robot_of(case.robot)).beyond_healthy(alone.columns)


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
                injected.size = _stronger(injected.name, injected.size, 0.5)
    raise AssertionError


def _simulate(case: Case, robot: Robot) -> Case:
    found = _Truths(case, robot)
    case.healthy_shift = 0.0
    result = healthy = found.healthy
    if case.faults:
        result = found.run(found.broken(), found.table)
        shifts = [
            float(np.sqrt(np.mean((result.columns[c] - healthy.columns[c]) ** 2)) / found.noise[c])
            for c in result.columns
        ]
        case.healthy_shift = float(np.sqrt(np.mean(np.square(shifts))))
        if case.healthy_shift > RUNAWAY:
            raise ValueError("the faults make the truth run away")
    case.columns = found.columns(found.table, result)
    return case


def simulate_again(case: Case, table: dict[str, Array]) -> dict[str, Array]:
    """Columns of a second recording of the same robot, told what ``table`` says (columns of commands, PERIOD apart).

    Raises ValueError where the truth breaks down.
    """
    found = _Truths(case, robot_of(case.robot))
    robot = found.broken() if case.faults else found.truth()
    return found.columns(table, found.run(robot, table, again=1))


class _Truths:
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

    def beyond_healthy(self, columns: dict[str, Array]) -> float:
        """What of a recording no healthy robot could have made, whose numbers are all within tolerance [deviations].

        Of a robot that walks, in windows that start where it was.
        """
        model = self._healthy_truth.model
        walks = any(kind == mujoco.mjtJoint.mjJNT_FREE for kind in model.jnt_type)
        n = round(min(self._case.seconds, IMITATED_WALK if walks else IMITATED) / PERIOD)
        table = {name: values[:n] for name, values in self.table.items()}
        put: dict[int, tuple[Array, Array]] = {}
        if walks:
            broken = self.broken()
            states = self.run(broken, table).states
            put = {k: broken.rigid(states[k], model) for k in range(0, n, round(WINDOW / PERIOD))}
        names = list(self.healthy.columns)
        count = len(nominal_numbers(self.truth(spread=(0.0, 0.0))))
        # A sensor's zero may be off as well.
        zeros = {c: min(ZERO, ZERO_SHARE * float(np.std(self.healthy.columns[c]))) for c in self._joint_columns()}

        def seen(numbers: Array) -> Array:
            made = self.truth(spread=(0.0, 0.0))
            for number, z in zip(nominal_numbers(made), numbers[:count], strict=True):
                number(z)
            mujoco.mj_setConst(made.model, mujoco.MjData(made.model))
            run = record(made, told(made.model, self._robot.mapping, table), {}, np.random.default_rng(0), put)
            off = dict.fromkeys(names, 0.0) | {c: z * zeros[c] for c, z in zip(zeros, numbers[count:], strict=True)}
            return np.stack([(run.columns[c] + off[c]) / self.noise[c] for c in names], 1)

        scale = self._units()
        recorded = np.stack([columns[c][:n] * scale[c] / self.noise[c] for c in names], 1)
        return left_by_imitation(seen, recorded, count + len(zeros))

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
        healthy_truth, healthy, case = self._healthy_truth, self.healthy, self._case
        scale = Scale.of(healthy_truth, healthy, told(healthy_truth.model, self._robot.mapping, self.table))
        soft = {}
        for injected in case.faults:
            if injected.name in ("servo_backlash", "flexing_link"):
                actuator = healthy_truth.model.actuator(injected.members[0]).id
                joint = str(healthy_truth.model.joint(int(healthy_truth.model.actuator_trnid[actuator, 0])).name)
                between = soft_of(injected.name, injected.size, scale, joint, actuator)
                if between is not None:
                    soft[joint] = between
        broken = self.truth(soft)
        for injected in case.faults:
            chosen = fault(injected.name, injected.kind)
            injected.parameters = {}
            for member in injected.members:
                values = chosen.inject(broken, scale, member, injected.size)
                if injected.name == "mass" and injected.parameters:
                    values = {"change": values["change"] + injected.parameters["change"]}
                injected.parameters = values
            if len(injected.members) > 1 and injected.name not in _SHARED:
                injected.parameters = {}
        mujoco.mj_setConst(broken.model, mujoco.MjData(broken.model))
        return broken

    def columns(self, table: dict[str, Array], run: Run) -> dict[str, Array]:
        """What a logger writes, in the units of the map."""
        units, time = self._units(), {self._robot.mapping["time"]["column"]: run.time}
        return {**time, **table, **{c: v / units[c] for c, v in run.columns.items()}}

    def _units(self) -> dict[str, float]:
        """SI units in a unit of each output's column."""
        return {r["column"]: 1e-3 if r.get("unit") == "mm" else 1.0 for r in self._robot.mapping["outputs"]}


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
