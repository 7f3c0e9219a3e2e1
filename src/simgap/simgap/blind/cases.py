"""The cases of a blind check, drawn from number and seed: which robot has which faults, how large, and where."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from importlib.metadata import entry_points
from typing import Any, cast

import mujoco
import numpy as np
from numpy.typing import NDArray

from simgap.blind.faults.base import LEVELS, Fault
from simgap.blind.faults.table import FAULTS, UNKNOWN
from simgap.blind.robots import MAPS, MODELS, commands, start
from simgap.blind.sites import Site, sites
from simgap.blind.truth import PERIOD

Array = NDArray[np.float64]

KINDS = {"none": 0.20, "single": 0.50, "pair": 0.15, "unknown": 0.15}
"""Kinds of cases and their shares: 40, 100, 30 and 30 of 200."""
SMALL = tuple(MODELS)
"""Robots that come with the check."""
ROBOTS = "simgap.blind_robots"
"""Group of entry points by which other packages bring robots: name = module:function without arguments, gives a Robot.
Processes that make cases find them by name."""
HEAVY = 0.25
"""Robots that take long are drawn less often, by this factor, where a fault can also sit in another one."""


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
    """A nominal robot of the check: its MJCF, its map, where it begins, and what it is told, by seed.

    Attributes:
        excite: columns of commands in the map's units, each (n,), of seed, n and period [s].
        noise: factor of the usual noise of its sensors.
        share: how often it is drawn, where a fault can also sit in another one.
    """

    name: str
    xml: str
    mapping: dict[str, Any]
    start: dict[str, float]
    excite: Callable[[int, int, float], dict[str, Array]]
    noise: float = 1.0
    share: float = 1.0

    def spec(self) -> mujoco.MjSpec:
        """A fresh specification of the nominal model."""
        return mujoco.MjSpec.from_string(self.xml)

    def commands(self, seed: int, n: int) -> dict[str, Array]:
        """Columns of commands in the map's units."""
        return self.excite(seed, n, PERIOD)


def robot_of(name: str) -> Robot:
    """A robot by name: of this check, or one that an installed package brings (see ROBOTS).

    Raises ValueError for an unknown one.
    """
    if name in MODELS:
        share = HEAVY if name == "quad" else 1.0
        return Robot(name, MODELS[name], dict(MAPS[name]), start(name), partial(commands, name), share=share)
    others = {point.name: point for point in entry_points(group=ROBOTS)}
    if name in others:
        return cast(Robot, others[name].load()())
    raise ValueError(f"robot {name!r} is unknown: choose of {', '.join((*SMALL, *sorted(others)))}")


def draw(
    count: int, seed: int, robots: Sequence[str] = SMALL, seconds: float = 15.0, only: Sequence[str] = ()
) -> list[Case]:
    """``count`` cases in random order, in the shares of KINDS; every effect at every level before one comes twice.

    The same count, seed and robots give the same cases. ``only``: names of effects, of which each case has one.

    Raises ValueError for names that no fault has, and for faults that none of the robots can have.
    """
    rng = np.random.default_rng([seed, 7919])
    places = {name: all_sites(name) for name in robots}
    known = _called(only, places) if only else FAULTS
    numbers = {"single": count} if only else shares_of(count)
    shares = {name: robot_of(name).share for name in robots}
    single = _deck(known, rng, places)
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
        single, unknown = single or _deck(known, rng, places), unknown or _deck(UNKNOWN, rng, places)
        able = [r for r in robots if not drawn or places[r][drawn[0][0].kind]]
        weights = np.array([shares[r] / (1.0 + used[r]) ** 2 for r in able])
        robot = able[int(own.choice(len(able), p=weights / weights.sum()))]
        used[robot] += 1
        faults = [inject(own, f, places[robot], level) for f, level in drawn]
        if kind == "pair":
            faults.append(_second(own, faults[0], places[robot]))
        cases.append(Case(f"{number:03d}", robot, kind, (seed, number), seconds, faults))
    return cases


def shares_of(count: int) -> dict[str, int]:
    """How many of each of KINDS: rounded, the remainder to the largest fractions."""
    exact = {k: share * count for k, share in KINDS.items()}
    numbers = {k: int(v) for k, v in exact.items()}
    for kind in sorted(exact, key=lambda k: numbers[k] - exact[k])[: count - sum(numbers.values())]:
        numbers[kind] += 1
    return numbers


def all_sites(robot: str) -> dict[str, list[Site]]:
    """Where each kind of fault can sit in a robot, by name."""
    chosen = robot_of(robot)
    return sites(chosen.spec().compile(), chosen.mapping)


def _called(names: Sequence[str], places: dict[str, dict[str, list[Site]]]) -> list[Fault]:
    """The faults of these names that some robot can have."""
    for name in names:
        of_it = [f for f in FAULTS if f.name == name]
        if not of_it:
            raise ValueError(f"fault {name!r} is unknown: choose of {', '.join(sorted({f.name for f in FAULTS}))}")
        if not any(p[f.kind] for f in of_it for p in places.values()):
            raise ValueError(f"fault {name!r}: none of {', '.join(places)} can have it")
    return [f for f in FAULTS if f.name in names]


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


def inject(rng: np.random.Generator, chosen: Fault, places: dict[str, list[Site]], level: int) -> Injected:
    """A fault at one of its places in a robot, about as large as its level says."""
    site = places[chosen.kind][int(rng.integers(len(places[chosen.kind])))]
    # Not exactly the size of the table, so that nobody can learn the table.
    size = chosen.sizes[level] if chosen.name == "tendon_detached" else _jittered(rng, chosen, level)
    return Injected(chosen.name, chosen.kind, site.name, site.members, LEVELS[level], size, chosen.known, site.places)


def _jittered(rng: np.random.Generator, chosen: Fault, level: int) -> float:
    """A size about that of its level; for factors, the distance from 1 is what is varied. Signs vary where they may."""
    size = stronger(chosen.name, chosen.sizes[level], float(np.exp(rng.uniform(-0.12, 0.12))))
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


def stronger(name: str, size: float, by: float) -> float:
    """The size of a fault ``by`` times as strong; of factors, the distance from 1 is what counts."""
    if name in _FACTORS:
        return max(1.0 + (size - 1.0) * by, 0.1)
    return min(size * by, 0.9) if name == "link_loss" else size * by


def _second(rng: np.random.Generator, first: Injected, places: dict[str, list[Site]]) -> Injected:
    """A second fault of the same robot, of another mechanism and not in the same part where that can be."""
    able = [f for f in FAULTS if places[f.kind] and f.name != first.name]
    best: Injected | None = None
    for _ in range(20):
        second = inject(rng, able[int(rng.integers(len(able)))], places, int(rng.integers(1, 3)))
        best = best or second
        if not set(second.members) & set(first.members):
            return second
    assert best is not None
    return best
