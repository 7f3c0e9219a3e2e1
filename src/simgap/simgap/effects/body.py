"""Effects of mass and its distribution."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import mujoco
import numpy as np

from simgap.effects.base import Context, Effect, Parameter, amount, named_sites, ratio
from simgap.simulation.variant import Variant

Obj = mujoco.mjtObj


def moving_bodies(model: mujoco.MjModel) -> list[int]:
    """Bodies with mass that are not fixed to the world."""
    return [b for b in range(1, model.nbody) if model.body_mass[b] > 0 and model.body_weldid[b] != 0]


def gyration(model: mujoco.MjModel, body: int) -> float:
    """Radius of gyration [m], a size of the body."""
    return float(np.sqrt(model.body_inertia[body].max() / model.body_mass[body]))


def shift_com(model: mujoco.MjModel, body: int, shift: Sequence[float]) -> None:
    """Move a body's centre of mass [m, body frame]; the compiled shortcuts for centred bodies are switched off."""
    model.body_ipos[body] += np.asarray(shift)
    model.body_sameframe[body] = 0
    model.body_simple[body] = 0


class Mass(Effect):
    """A body is heavier or lighter than modelled, its inertia with it."""

    name = "mass"

    @classmethod
    def candidates(cls, context: Context) -> Iterable[Effect]:
        for site in named_sites(context, Obj.mjOBJ_BODY, moving_bodies(context.model)):
            total = float(context.model.body_mass[list(site.targets)].sum())
            tries = tuple(t * total for t in (-0.35, 0.2, 0.5, 1.0))
            yield cls(site, [Parameter("change", "kg", 0.0, -0.9 * total, 5.0 * total, tries, 0.2 * total)])

    def apply(self, variant: Variant, values: Sequence[float]) -> None:
        targets, model = list(self.site.targets), variant.model
        total = float(variant.plant.model.body_mass[targets].sum())
        model.body_mass[targets] *= 1.0 + values[0] / total
        model.body_inertia[targets] *= 1.0 + values[0] / total


class ComShift(Effect):
    """A body's centre of mass lies elsewhere, in the body's frame."""

    name = "com_shift"

    @classmethod
    def candidates(cls, context: Context) -> Iterable[Effect]:
        for site in named_sites(context, Obj.mjOBJ_BODY, moving_bodies(context.model), together=False):
            size = 0.3 * gyration(context.model, site.targets[0])
            yield cls(site, [amount(axis, "m", size, (1.0,), low=-15.0, high=15.0) for axis in "xyz"])

    def starts(self) -> list[tuple[float, ...]]:
        size = self.parameters[0].scale
        return [tuple(s * size * (i == k) for i in range(3)) for k in range(3) for s in (-1.0, 1.0)]

    def apply(self, variant: Variant, values: Sequence[float]) -> None:
        shift_com(variant.model, self.site.targets[0], values)


def turns_alone(model: mujoco.MjModel, body: int) -> int:
    """The hinge by which alone a body turns (the first of a chain on the ground), else -1."""
    hinge, at = -1, body
    while at > 0:
        for joint in range(int(model.body_jntadr[at]), int(model.body_jntadr[at] + model.body_jntnum[at])):
            if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE:
                continue
            if hinge >= 0 or at != body or model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_HINGE:
                return -1
            hinge = joint
        at = int(model.body_parentid[at])
    return hinge


class Inertia(Effect):
    """A body's rotational inertia is another, its mass the same. Of one that turns about one hinge only, this is
    `armature`.
    """

    name = "inertia"

    @classmethod
    def candidates(cls, context: Context) -> Iterable[Effect]:
        bodies = [b for b in moving_bodies(context.model) if turns_alone(context.model, b) < 0]
        for site in named_sites(context, Obj.mjOBJ_BODY, bodies, together=False):
            yield cls(site, [ratio(tries=(0.4, 1.8, 4.0), high=20.0)])

    def apply(self, variant: Variant, values: Sequence[float]) -> None:
        variant.model.body_inertia[list(self.site.targets)] *= values[0]
