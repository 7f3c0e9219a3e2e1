"""What an effect is: a small change of the model or of a signal path, at a site, with bounded parameters."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import ClassVar, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from simgap.data.channels import model_names
from simgap.data.plant import Plant
from simgap.data.supply import sways
from simgap.data.trees import tree_of
from simgap.simulation.contacts import colliding
from simgap.simulation.replay import Replayer
from simgap.simulation.scales import Scales, measure_scales
from simgap.simulation.variant import Variant

Array = NDArray[np.float64]
Obj = mujoco.mjtObj
FEW_JOINTS, SEVERAL_JOINTS = 4, 12
"""A robot of which no more joints are seen gets values of their own in a group; the second where nothing touches the
ground, which makes replays cheap."""
_HINGE, _SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)


@dataclass(frozen=True)
class Parameter:
    """One number of an effect.

    Attributes:
        neutral: the value at which the effect does nothing.
        low, high: bounds.
        tries: values to start from, weak to strong (an effect may have no slope at its neutral value).
        scale: the size of a noticeable change; also the step of finite differences, times a small factor.
        strong: distance from neutral of the strongest try.
        log: whether it is a factor, which may be wrong by decades: steps and distances are those of its logarithm.
        far: further values to start from, decades away: near ones show nothing where a model is that wrong.
        spread: standard deviation about neutral of what somebody has stated (a controller's own gain); of the
            logarithm of a factor. Nothing is known of others.
        part: of an effect at several parts whose values differ, the one that it is of; the name ends with it.
    """

    name: str
    unit: str
    neutral: float
    low: float
    high: float
    tries: tuple[float, ...]
    scale: float
    log: bool = False
    far: tuple[float, ...] = ()
    spread: float = math.inf
    part: str = ""

    @property
    def strong(self) -> float:
        """See above; in the logarithm of a factor."""
        return max(abs(self.away(t)) for t in self.tries)

    def of_part(self, name: str) -> Parameter:
        """The same, of one part."""
        return replace(self, name=f"{self.name}_{name}", part=name)

    def away(self, value: float) -> float:
        """Distance of a value from neutral, with its sign; in the logarithm of a factor."""
        return math.log(value / self.neutral) if self.log else value - self.neutral

    def at(self, away: float) -> float:
        """The value at a distance from neutral."""
        return self.neutral * math.exp(away) if self.log else self.neutral + away


@dataclass(frozen=True)
class Site:
    """Where an effect acts: a name of the model or of a group, and the indices behind it."""

    name: str
    targets: tuple[int, ...]


class Wave(NamedTuple):
    """A torque that goes to and fro with a joint's position, see `simgap.effects.joint.TorqueRipple`; in SI."""

    amplitude: float
    period: float
    origin: float


@dataclass
class Context:
    """What effects may look at when they are laid out for a recording."""

    plant: Plant
    scales: Scales
    groups: dict[str, tuple[str, ...]] = field(default_factory=dict)
    switched: bool = False
    """Whether servos were without power for a part of the recording."""
    swaying: bool = False
    """Whether the supply's voltage was measured, and is not always the same."""
    warming: frozenset[int] = frozenset()
    """Actuators whose motor's temperature was measured, and is not always the same."""
    waves: dict[int, tuple[Wave, ...]] | None = None
    """What the recording suggests of each measured joint of which ripples are sought, most likely first; None where
    nothing was recorded yet."""

    @classmethod
    def of(cls, replayer: Replayer, nominal: Variant, groups: dict[str, tuple[str, ...]]) -> Context:
        """What the recording of a replayer tells by itself, and by a nominal replay; no `waves`."""
        return cls(
            replayer.plant,
            measure_scales(replayer, nominal),
            groups,
            switched=not replayer.aligned.enabled.all(),
            swaying=sways(replayer.supply),
            warming=replayer.heat.measured,
        )

    @property
    def model(self) -> mujoco.MjModel:
        """The nominal model."""
        return self.plant.model

    def seen(self, kind: mujoco.mjtObj, index: int) -> bool:
        """Whether a recording can say anything of an object: its kinematic tree is driven or measured somewhere.

        What belongs to no tree (the ground) or to several (a tendon) is always looked at.
        """
        tree = tree_of(self.model, kind, index)
        return tree < 0 or not self._trees or tree in self._trees

    @cached_property
    def _trees(self) -> frozenset[int]:
        """Trees with a channel."""
        model, found = self.model, set()
        for told in self.plant.inputs:
            by_actuator = told.actuator >= 0
            found.add(
                tree_of(model, Obj.mjOBJ_ACTUATOR, told.actuator) if by_actuator else int(model.dof_treeid[told.dof])
            )
        for output in self.plant.outputs:
            sensor = model.sensor(output.sensor).id
            kind = mujoco.mjtObj(int(model.sensor_objtype[sensor]))
            found.add(tree_of(model, kind, int(model.sensor_objid[sensor])))
        # What cannot be placed may be moved by anything.
        return frozenset() if -1 in found else frozenset(found)


class Effect(ABC):
    """An effect at a site. Subclass it, give it a name, say where it can act, and how it enters a variant."""

    name: str
    grows: ClassVar[bool] = False
    """Whether ``apply`` looks at ``variant.moment``."""
    one_sided: ClassVar[bool] = False
    """Whether what a change in one direction shows says nothing of the other: a foot that does not slip does not mind
    more friction."""
    tie: float = 0.0
    """Standard deviation of how far the values of its parts are from what they have in common, in their units, of
    factors in the logarithm; 0 where nothing ties them."""
    special_case: ClassVar[str] = ""
    """Name of the effect whose law this one's generalises, at the same site."""

    def __init__(self, site: Site, parameters: Sequence[Parameter], form: str = "") -> None:
        self.site, self.parameters, self.form = site, tuple(parameters), form

    @property
    def key(self) -> str:
        """name@site, the public name of the effect."""
        return f"{self.name}@{self.site.name}"

    @property
    def aliases(self) -> tuple[str, ...]:
        """Other names for the very same change."""
        return ()

    @classmethod
    @abstractmethod
    def candidates(cls, context: Context) -> Iterable[Effect]:
        """All places at which the effect can act in this model, laid out for this recording."""

    @abstractmethod
    def apply(self, variant: Variant, values: Sequence[float]) -> None:
        """Enter the effect with the given parameter values into ``variant``, in place."""

    def alternatives(self) -> Sequence[Effect]:
        """The same with another law; tried where this one is among the best, from its values.

        Further parameters come after those of this one.
        """
        return ()

    def starts_from(self, special: Sequence[float]) -> list[tuple[float, ...]]:
        """Parameter values to start from where the special case was fitted with the values ``special``."""
        return []

    def starts(self) -> list[tuple[float, ...]]:
        """Parameter values to start from: each parameter's tries, the others at the middle of theirs."""
        if len(self.parameters) == 1:
            return [(t,) for t in self.parameters[0].tries]
        middle = [p.tries[len(p.tries) // 2] for p in self.parameters]
        return [(t, *middle[1:]) for t in self.parameters[0].tries]

    def far_starts(self) -> list[tuple[float, ...]]:
        """Parameter values decades away to start from, where all parameters have some; the same for all parts."""
        return list(zip(*(p.far for p in self.parameters), strict=True)) if self.one_size else []

    @property
    def one_size(self) -> bool:
        """Whether its parameters grow together: one number, or the same one of several parts."""
        return len(self.parameters) == 1

    def moved(self, share: float, values: Sequence[float] | NDArray[np.float64]) -> tuple[float, ...]:
        """The same so many times as strong, within bounds or not: values so many times as far from neutral."""
        return tuple(p.at(share * p.away(float(v))) for p, v in zip(self.parameters, values, strict=True))

    def times(self, share: float, values: Sequence[float] | NDArray[np.float64]) -> tuple[float, ...] | None:
        """Values so many times as far from neutral; None outside their bounds."""
        moved = self.moved(share, values)
        inside = all(p.low <= v <= p.high for p, v in zip(self.parameters, moved, strict=True))
        return moved if inside else None

    def __repr__(self) -> str:
        told = ", ".join(filter(None, [self.form, "part by part" if self.tie else ""]))
        return self.key + (f" ({told})" if told else "")


def named_sites(context: Context, kind: mujoco.mjtObj, indices: Iterable[int], together: bool = True) -> list[Site]:
    """One site for each object that a recording sees, one for each group that holds several of them, and ``all``."""
    names, chosen = model_names(context.model, kind), sorted(i for i in set(indices) if context.seen(kind, i))
    sites = [Site(names[i], (i,)) for i in chosen]
    if together and len(chosen) > 1:
        seen = {tuple(chosen)}
        for group, members in group_names([names[i] for i in chosen], context.groups).items():
            targets = tuple(i for i in chosen if names[i] in members)
            if len(targets) > 1 and targets not in seen:
                seen.add(targets)
                sites.append(Site(group, targets))
        sites.append(Site("all", tuple(chosen)))
    return sites


def group_names(names: Sequence[str], given: dict[str, tuple[str, ...]]) -> dict[str, set[str]]:
    """Groups of names: those given, and those that share a word (front_left_knee: front, left, all_knees)."""
    groups: dict[str, set[str]] = {g: set(names) & set(members) for g, members in given.items()}
    words: dict[str, set[str]] = {}
    for name in names:
        for word in set(name.lower().replace("-", "_").replace("/", "_").split("_")):
            if len(word) > 1 and not word.isdigit() and word not in ("joint", "servo", "motor", "link", "actuator"):
                words.setdefault(word, set()).add(name)
    sides = ("front", "rear", "hind", "left", "right", "fl", "fr", "rl", "rr")
    for word, members in words.items():
        if 1 < len(members) < len(names):
            groups.setdefault(word if word in sides else f"all_{word}s", members)
    return groups


class ByPart(Effect):
    """An effect at joints or servos. In a group of few, each has a value of its own, named after it; many share one.

    Joints of one robot carry different torques: with one friction for all, the small joint's would be the large one's.
    """

    _APART = math.log(2.0)
    """How far values of like parts are apart: by this share of what they have in common, or this much in the logarithm
    of a factor. Frictions of hip, thigh and calf of a quadruped differ by four."""

    @property
    def one_size(self) -> bool:
        """See above."""
        return True

    def apart(self, others: Iterable[Effect], value: float) -> ByPart | None:
        """The same with a value of its own for each part, tied to a common one, which is about ``value``.

        ``others``: effects that may act at the parts alone, whose values have their bounds. None where parts have
        values of their own already, or cannot have them.
        """
        first, targets = self.parameters[0], self.site.targets
        same = [o for o in others if o.name == self.name and len(o.parameters) == 1]
        alone = {o.site.targets: o for o in same if o.parameters[0].name == first.name}
        tie = self._APART * (1.0 if first.log else abs(first.away(value)))
        if len(self.parameters) > 1 or len(targets) < 2 or tie == 0.0 or not all((t,) in alone for t in targets):
            return None
        found = copy(self)
        parts = [alone[(target,)] for target in targets]
        found.parameters = tuple(p.parameters[0].of_part(p.site.name) for p in parts)
        found.tie = tie
        return found

    def starts(self) -> list[tuple[float, ...]]:
        """All parts weak, all medium, all strong."""
        return list(zip(*(p.tries for p in self.parameters), strict=True))


def by_joint(context: Context, site: Site, make: Callable[[list[int]], Parameter]) -> list[Parameter]:
    """`by_part` of joints."""
    return by_part(context, site, mujoco.mjtObj.mjOBJ_JOINT, make)


def by_part(
    context: Context, site: Site, kind: mujoco.mjtObj, make: Callable[[list[int]], Parameter]
) -> list[Parameter]:
    """Parameters of a `ByPart`: one for all parts of a site, or one each where few joints of the robot are seen.

    ``make`` lays out the parameter of some parts.
    """
    few = FEW_JOINTS if colliding(context.model)[0] else SEVERAL_JOINTS
    seen = sum(context.seen(Obj.mjOBJ_JOINT, j) for j in scalar_joints(context.model))
    if len(site.targets) < 2 or seen > few:
        return [make(list(site.targets))]
    names = model_names(context.model, kind)
    made = [(names[i], make([i])) for i in site.targets]
    count = min(len(p.tries) for _, p in made)
    return [replace(p.of_part(name), tries=p.tries[:count]) for name, p in made]


def scalar_joints(model: mujoco.MjModel) -> list[int]:
    """Hinges and slides."""
    return [j for j in range(model.njnt) if int(model.jnt_type[j]) in (_HINGE, _SLIDE)]


def joint_units(model: mujoco.MjModel, joint: int) -> tuple[str, str]:
    """(unit of position, unit of force) of a joint."""
    return ("rad", "N m") if model.jnt_type[joint] == _HINGE else ("m", "N")


def dof_of(model: mujoco.MjModel, joint: int) -> int:
    """Address of a scalar joint's degree of freedom."""
    return int(model.jnt_dofadr[joint])


def amount(
    name: str, unit: str, scale: float, tries: Sequence[float] = (0.1, 0.4, 1.5), low: float = 0.0, high: float = 20.0
) -> Parameter:
    """A parameter whose neutral value is 0; tries and bounds are given in units of ``scale``."""
    return Parameter(name, unit, 0.0, low * scale, high * scale, tuple(t * scale for t in tries), scale)


def ratio(
    name: str = "factor",
    tries: Sequence[float] = (0.5, 0.75, 1.3, 1.8),
    low: float = 0.002,
    high: float = 100.0,
    far: Sequence[float] = (),
    spread: float = math.inf,
) -> Parameter:
    """A dimensionless factor whose neutral value is 1; published models are wrong by factors of fifty."""
    return Parameter(name, "1", 1.0, low, high, tuple(tries), 0.3, True, tuple(far), spread)
