"""Effects of the ground."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from simgap.effects.base import Context, Effect, Parameter, Site, named_sites, ratio
from simgap.simulation.contacts import colliding
from simgap.simulation.variant import Variant

Obj = mujoco.mjtObj

_SLIPPERY = (0.06, 0.12, 0.25, 0.55, 1.7)
"""Factors of friction. A foot that hardly pushes sideways does not slip before little is left, and from where it sticks
no slope leads there."""


class GroundFriction(Effect):
    """The ground is more slippery or rougher, everywhere or under one foot."""

    name = "ground_friction"
    one_sided = True

    @classmethod
    def candidates(cls, context: Context) -> Iterable[Effect]:
        _, feet = colliding(context.model)
        if not feet:
            return
        for site in named_sites(context, Obj.mjOBJ_GEOM, feet) if len(feet) < 9 else [Site("all", tuple(feet))]:
            if len(feet) > 1 or site.name != "all":
                yield cls(site, [ratio(tries=_SLIPPERY, low=0.02, high=4.0)])

    def apply(self, variant: Variant, values: Sequence[float]) -> None:
        model = variant.model
        world, _ = colliding(model)
        for g in self.site.targets:
            # Contacts take the larger friction of two geoms; a higher priority makes this one's count.
            friction = np.maximum(model.geom_friction[g], model.geom_friction[world].max(axis=0))
            model.geom_friction[g] = friction * np.array([values[0], 1.0, 1.0])
            model.geom_priority[g] = max(int(model.geom_priority[world].max()), 0) + 1
        pairs = np.isin(model.pair_geom1, self.site.targets) | np.isin(model.pair_geom2, self.site.targets)
        model.pair_friction[pairs, :2] *= values[0]


class GroundSlope(Effect):
    """The ground is not level, and who tracks the robot has z along the plumb line: the ground turns about the origin.

    By ``pitch`` about y (positive: downhill forward) and ``roll`` about x of the world.
    """

    name = "ground_slope"

    @classmethod
    def candidates(cls, context: Context) -> Iterable[Effect]:
        if np.linalg.norm(context.model.opt.gravity) > 0 and colliding(context.model)[0]:
            yield cls(Site("all", ()), _slopes())

    def starts(self) -> list[tuple[float, ...]]:
        return _UPHILL

    def apply(self, variant: Variant, values: Sequence[float]) -> None:
        model = variant.model
        turn = Rotation.from_euler("yx", values)
        world, _ = colliding(model)
        model.geom_pos[world] = turn.apply(model.geom_pos[world])
        turned = turn * Rotation.from_quat(model.geom_quat[world], scalar_first=True)
        model.geom_quat[world] = turned.as_quat(scalar_first=True)
        model.geom_sameframe[world] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE


class GravityLean(Effect):
    """What the robot stands on or hangs from is not level, and what tracks it leans with it: gravity leans.

    By ``pitch`` about y (positive: downhill forward) and ``roll`` about x of the world.
    """

    name = "gravity_lean"

    @property
    def aliases(self) -> tuple[str, ...]:
        return ("ground_slope@all",)

    @classmethod
    def candidates(cls, context: Context) -> Iterable[Effect]:
        if np.linalg.norm(context.model.opt.gravity) > 0:
            yield cls(Site("all", ()), _slopes())

    def starts(self) -> list[tuple[float, ...]]:
        return _UPHILL

    def apply(self, variant: Variant, values: Sequence[float]) -> None:
        lean(variant.model, -values[0], -values[1])


_UPHILL: list[tuple[float, ...]] = [(0.06, 0.0), (-0.06, 0.0), (0.0, 0.06), (0.0, -0.06)]


def _slopes() -> list[Parameter]:
    bounds = {"neutral": 0.0, "low": -0.4, "high": 0.4, "tries": (0.05,), "scale": 0.03}
    return [Parameter(n, "rad", **bounds) for n in ("pitch", "roll")]  # type: ignore[arg-type]


def lean(model: mujoco.MjModel, pitch: float, roll: float) -> None:
    """Turn gravity by ``pitch`` about y and ``roll`` about x [rad], in place."""
    cp, sp, cr, sr = np.cos(pitch), np.sin(pitch), np.cos(roll), np.sin(roll)
    turn = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]]) @ np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    model.opt.gravity[:] = turn @ model.opt.gravity


class FootCompliance(Effect):
    """The feet (or the ground) are softer: contacts settle over a longer time."""

    name = "foot_compliance"

    @classmethod
    def candidates(cls, context: Context) -> Iterable[Effect]:
        _, feet = colliding(context.model)
        if feet:
            for site in named_sites(context, Obj.mjOBJ_GEOM, feet) if len(feet) < 9 else [Site("all", tuple(feet))]:
                if len(feet) > 1 or site.name != "all":
                    yield cls(site, [ratio("time_factor", tries=(2.0, 4.0, 8.0), low=0.5, high=30.0)])

    def apply(self, variant: Variant, values: Sequence[float]) -> None:
        model = variant.model
        world, _ = colliding(model)
        for g in self.site.targets:
            if model.geom_solref[g, 0] > 0:
                model.geom_solref[g, 0] *= values[0]
                model.geom_priority[g] = max(int(model.geom_priority[world].max()), 0) + 1
                model.geom_friction[g] = np.maximum(model.geom_friction[g], model.geom_friction[world].max(axis=0))
