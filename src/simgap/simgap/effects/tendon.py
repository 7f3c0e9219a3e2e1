"""Effects of tendons: cables with slack, stretch, friction in their routing, or gone altogether."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import mujoco
import numpy as np

from simgap.data.channels import is_servo
from simgap.effects.base import Context, Effect, Parameter, amount, named_sites
from simgap.effects.friction import DryFriction
from simgap.effects.servo import channels_of, pulls_cable
from simgap.simulation.variant import Variant

Obj = mujoco.mjtObj


def drivers(model: mujoco.MjModel, tendon: int) -> list[int]:
    """Actuators that pull a tendon."""
    at_tendon = model.actuator_trntype == mujoco.mjtTrn.mjTRN_TENDON
    return [int(a) for a in np.flatnonzero(at_tendon & (model.actuator_trnid[:, 0] == tendon))]


def _length_scale(context: Context, tendons: Sequence[int]) -> float:
    """[m] how far these tendons move, as far as their actuators' commands or their geometry tell."""
    actuators = [a for t in tendons for a in drivers(context.model, t)]
    channels = channels_of(context.plant, actuators)
    if channels and context.scales.input_rms[channels].max() > 0:
        return float(context.scales.input_rms[channels].mean())
    return float(np.abs(context.model.tendon_length0[list(tendons)]).mean()) or 0.01


class TendonSlack(Effect):
    """The cable is too long: it pulls only after the slack is taken up. Pulled by a servo it may be too short."""

    name = "tendon_slack"

    @property
    def aliases(self) -> tuple[str, ...]:
        """A zero of the servo that lies elsewhere is the same."""
        return self._servo

    _servo: tuple[str, ...] = ()

    @classmethod
    def candidates(cls, context: Context) -> Iterable[Effect]:
        for site in named_sites(context, Obj.mjOBJ_TENDON, range(context.model.ntendon)):
            size = 0.1 * _length_scale(context, site.targets)
            pulled = all(any(pulls_cable(context.model, a) for a in drivers(context.model, t)) for t in site.targets)
            tries, low = ((-0.5, 0.15, 0.5, 1.5, 4.0, 10.0), -20.0) if pulled else ((0.15, 0.5, 1.5, 4.0, 10.0), 0.0)
            effect = cls(site, [amount("slack", "m", size, tries, low, high=20.0)])
            if pulled and len(site.targets) == 1:
                names = [context.model.actuator(a).name for a in drivers(context.model, site.targets[0])]
                effect._servo = tuple(f"servo_offset@{name}" for name in names)
            yield effect

    def apply(self, variant: Variant, values: Sequence[float]) -> None:
        model = variant.model
        for t in self.site.targets:
            if model.tendon_limited[t]:
                model.tendon_range[t, 1] += values[0]
            if model.tendon_stiffness[t] > 0:
                model.tendon_lengthspring[t, 1] += values[0]
            for a in drivers(model, t):
                if pulls_cable(model, a):
                    variant.inputs.offset[channels_of(variant.plant, [a])] += values[0]
                elif is_servo(model, a):
                    variant.servos.dead_band[a] += values[0]


class TendonElasticity(Effect):
    """The cable stretches: a spring in series with what pulls it.

    Behind a spring of stiffness k, a servo (p, d) gives way: to first order in time it pulls with the share
    r = k / (p + k) of its stiffness, r^2 of its damping, and answers its command later by d / (p + k).
    """

    name = "tendon_elasticity"

    @classmethod
    def candidates(cls, context: Context) -> Iterable[Effect]:
        model = context.model
        for site in named_sites(context, Obj.mjOBJ_TENDON, range(model.ntendon)):
            stiffness = [
                max(
                    [
                        float(model.tendon_stiffness[t]),
                        *(-float(model.actuator_biasprm[a, 1]) for a in drivers(model, t)),
                    ]
                )
                for t in site.targets
            ]
            if min(stiffness) > 0:
                yield cls(
                    site, [amount("compliance", "m/N", 0.3 / float(np.mean(stiffness)), (0.3, 1.0, 4.0), high=60.0)]
                )

    def apply(self, variant: Variant, values: Sequence[float]) -> None:
        model = variant.model
        for t in self.site.targets:
            model.tendon_stiffness[t] /= 1.0 + values[0] * model.tendon_stiffness[t]
            for a in drivers(model, t):
                softer = 1.0 / (1.0 - values[0] * model.actuator_biasprm[a, 1])
                variant.inputs.delay[channels_of(variant.plant, [a])] -= (
                    values[0] * softer * model.actuator_biasprm[a, 2]
                )
                model.actuator_gainprm[a, 0] *= softer
                model.actuator_biasprm[a, 1] *= softer
                model.actuator_biasprm[a, 2] *= softer**2


class TendonFriction(DryFriction):
    """Dry friction of the cable in its routing."""

    name = "tendon_friction"

    @classmethod
    def candidates(cls, context: Context) -> Iterable[Effect]:
        for site in named_sites(context, Obj.mjOBJ_TENDON, range(context.model.ntendon)):
            force = float(context.scales.tendon_force[list(site.targets)].mean())
            if force > 0:
                yield cls(site, [amount("friction", "N", 0.2 * force)])

    def apply(self, variant: Variant, values: Sequence[float]) -> None:
        model, tendons = variant.model, list(self.site.targets)
        self.grip(model.tendon_solref_fri, model.tendon_solimp_fri, tendons)
        model.tendon_frictionloss[tendons] += values[0]


class TendonDetached(Effect):
    """The cable has come off: it transmits nothing. The parameter is the share of its force that is lost."""

    name = "tendon_detached"

    @classmethod
    def candidates(cls, context: Context) -> Iterable[Effect]:
        for site in named_sites(context, Obj.mjOBJ_TENDON, range(context.model.ntendon), together=False):
            yield cls(site, [Parameter("share", "1", 0.0, 0.9, 1.0, (1.0,), 0.1)])

    def apply(self, variant: Variant, values: Sequence[float]) -> None:
        model, kept = variant.model, max(1.0 - values[0], 0.0)
        for t in self.site.targets:
            model.tendon_stiffness[t] *= kept
            model.tendon_damping[t] *= kept
            model.tendon_limited[t] = 0
            for a in drivers(model, t):
                model.actuator_gainprm[a, 0] *= kept
                model.actuator_biasprm[a, :3] *= kept
