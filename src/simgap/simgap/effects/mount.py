"""Effects of what a robot is fixed to."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import mujoco
import numpy as np

from simgap.data.channels import model_names
from simgap.data.mounting import Mounting
from simgap.effects.base import Context, Effect, Parameter, Site, amount
from simgap.simulation.variant import SPRING_DAMPING, Variant

Obj = mujoco.mjtObj
_NOTICEABLE = 12.0
"""[Hz] at which a robot rings, its joints held, whose mount gives noticeably."""


class SoftMount(Effect):
    """What the robot is fixed to gives way: a table, a clamp, a stand that tilts or sways under it.

    The base tilts about the two horizontal axes through its origin, as one spring with a damping ratio.
    """

    name = "soft_mount"

    @classmethod
    def candidates(cls, context: Context) -> Iterable[Effect]:
        mounting = context.plant.mounting
        if mounting is None:
            return
        names = model_names(context.model, Obj.mjOBJ_BODY)
        for i, body in enumerate(mounting.bodies):
            if _seen(context, body):
                yield cls(Site(names[body], (body,)), [_give(mounting, i)])

    def alternatives(self) -> Sequence[Effect]:
        """One whose mount has an inertia, and is sought how long it rings: a heavy table."""
        if self.form:
            return ()
        compliance = self.parameters[0]
        size = 1.0 / (compliance.scale * (2.0 * math.pi * _NOTICEABLE) ** 2)
        inertia = amount("inertia", "kg m^2", size, (0.0, 0.5, 2.0))
        ratio = Parameter("damping_ratio", "1", SPRING_DAMPING, 0.005, 1.0, (0.02, 0.05, 0.15, 0.4), SPRING_DAMPING)
        return (SoftMount(self.site, (compliance, inertia, ratio), "swaying"),)

    def apply(self, variant: Variant, values: Sequence[float]) -> None:
        targets, mounts = list(self.site.targets), variant.mounts
        mounts.compliance[targets] += values[0]
        if self.form:
            mounts.inertia[targets], mounts.ringing[targets] = values[1:]


def _seen(context: Context, body: int) -> bool:
    """Whether something that moves on a base is driven or measured."""
    model = context.model
    carried = np.flatnonzero((model.body_rootid == body) & (model.body_treeid >= 0))
    return any(context.seen(Obj.mjOBJ_BODY, int(b)) for b in carried)


def _give(mounting: Mounting, which: int) -> Parameter:
    """How far a mount tilts; tries ring at 25, 12, 6 and 3 Hz with all that stands on it."""
    noticeable = 1.0 / (float(mounting.inertia[which].mean()) * (2.0 * math.pi * _NOTICEABLE) ** 2)
    return amount("compliance", "rad/(N m)", noticeable, (0.25, 1.0, 4.0, 16.0), high=40.0)
