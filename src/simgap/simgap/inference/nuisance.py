"""What is never exactly as modelled: the nominal numbers, each with a prior. They are refitted with every candidate."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from simgap.data.channels import is_servo
from simgap.data.plant import Plant
from simgap.effects.body import gyration, moving_bodies, shift_com
from simgap.effects.contact import lean
from simgap.simulation.contacts import colliding
from simgap.simulation.integration import semi_implicit, step_inertia
from simgap.simulation.variant import Variant

Array = NDArray[np.float64]

MASS, COM, INERTIA = 0.08, 0.06, 0.08
PASSIVE = 0.08
"""Damping, friction loss, stiffness, armature: factors of the nominal value."""
STEP = 1.0
"""Share of the inertia that a time step adds that a robot may lack: a real one has no step."""
GAIN = 0.08
CONTACT = 0.15
FIRMNESS = 0.8
"""Of friction against normal force (MuJoCo's impratio, 1 where nobody set it): the solver's matter, and so free
within a factor of three. Known when this was chosen: the robots of the blind check have 3."""
TILT = 0.008
"""[rad]"""
TIMING = 0.25
"""Of a sample period plus a time step: neither stamps nor a coarse step against a continuous robot are better."""
MEASURED_TIMING = 0.5
"""The same for inputs that were measured: filters and a bus of their own lie between them and the outputs."""
RATE_TIMING = 0.5
"""Of a time step: a semi-implicit step keeps rates half a step behind coordinates."""
_RATES = (
    mujoco.mjtSensor.mjSENS_JOINTVEL,
    mujoco.mjtSensor.mjSENS_ACTUATORVEL,
    mujoco.mjtSensor.mjSENS_TENDONVEL,
    mujoco.mjtSensor.mjSENS_GYRO,
    mujoco.mjtSensor.mjSENS_VELOCIMETER,
    mujoco.mjtSensor.mjSENS_FRAMELINVEL,
    mujoco.mjtSensor.mjSENS_FRAMEANGVEL,
)
ZERO = 0.004
"""[rad or m] of a position sensor's zero, as a share of its range of motion where that is smaller."""
INPUT_OFFSET = 0.03
"""Zero of a measured input, as a share of its root mean square."""
BOX = 1.5
"""Nuisances stay within this many standard deviations (12 % of most numbers): what lies beyond is an effect."""
_MANY = 12
"""Models with more bodies share their mass nuisances by group."""


@dataclass(frozen=True)
class Nuisance:
    """One nominal number; ``apply(variant, z)`` moves it by z standard deviations of its prior, in place."""

    name: str
    apply: Callable[[Variant, float], None]


def enumerate_nuisances(plant: Plant, output_swing: Array, input_size: Array, period: float) -> list[Nuisance]:
    """The nuisances of a plant.

    ``output_swing`` (no,) is each output's spread in the recording, ``input_size`` (ni,) each input's root mean square,
    ``period`` [s] that of the samples.
    """
    model = plant.model
    measured = all(c.measured or c.actuator < 0 for c in plant.inputs)
    timing = (MEASURED_TIMING if measured else TIMING) * (period + float(model.opt.timestep))
    found = [Nuisance("timing of inputs", _timing(timing))]
    bodies = moving_bodies(model)
    for group in [[b] for b in bodies] if len(bodies) <= _MANY else [bodies]:
        label = model.body(group[0]).name or f"body_{group[0]}" if len(group) == 1 else "all"
        found.append(Nuisance(f"mass {label}", _mass(group)))
        if len(group) == 1:
            # How far the mass lies from where the body hangs is no better known than how far it spreads.
            size = float(np.hypot(gyration(model, group[0]), 0.5 * np.linalg.norm(model.body_ipos[group[0]])))
            found += [Nuisance(f"com {label} {a}", _com(group[0], i, COM * size)) for i, a in enumerate("xyz")]
            found.append(Nuisance(f"inertia {label}", _field("body_inertia", group, INERTIA)))
    for field, label, sd in (
        ("dof_damping", "damping", PASSIVE),
        ("dof_frictionloss", "friction", PASSIVE),
        ("jnt_stiffness", "stiffness", PASSIVE),
        ("tendon_stiffness", "tendon stiffness", PASSIVE),
        ("tendon_damping", "tendon damping", PASSIVE),
        ("tendon_frictionloss", "tendon friction", PASSIVE),
    ):
        found += [
            Nuisance(f"{label} {i}", _field(field, [int(i)], sd)) for i in np.flatnonzero(getattr(model, field) > 0)
        ]
    for dof in np.flatnonzero(model.dof_armature > 0):
        found.append(Nuisance(f"armature {dof}", _field("dof_armature", [int(dof)], PASSIVE)))
    if semi_implicit(model):
        found.append(Nuisance("time step", _continuous(step_inertia(model))))
    for a in range(model.nu):
        if any(c.actuator == a for c in plant.inputs):
            name = model.actuator(a).name or str(a)
            found.append(Nuisance(f"gain {name}", _gain(a)))
            if is_servo(model, a, 1) and model.actuator_biasprm[a, 2] != 0:
                found.append(Nuisance(f"rate gain {name}", _rate_gain(a)))
    for i, channel in enumerate(plant.inputs):
        if channel.actuator < 0:
            found.append(Nuisance(f"scale {channel.name}", _input_scale(i)))
        if channel.measured or channel.actuator < 0:
            found.append(Nuisance(f"zero {channel.name}", _input_zero(i, INPUT_OFFSET * float(input_size[i]))))
    world, feet = colliding(model)
    if feet:
        found.append(Nuisance("ground friction", _ground(world, feet)))
        found.append(Nuisance("contact softness", _softness(world, feet)))
        found += firmness(model)
    if np.linalg.norm(model.opt.gravity) > 0:
        found += [Nuisance("pitch of gravity", lambda v, z: lean(v.model, TILT * z, 0.0))]
        found += [Nuisance("roll of gravity", lambda v, z: lean(v.model, 0.0, TILT * z))]
    rates = [i for i, output in enumerate(plant.outputs) if output.sensor_type in _RATES]
    if rates and len(rates) < len(plant.outputs) and semi_implicit(model):
        found.append(Nuisance("timing of rates", _lead(rates, RATE_TIMING * float(model.opt.timestep))))
    for i, output in enumerate(plant.outputs):
        if output.qpos >= 0:
            found.append(Nuisance(f"zero {output.name}", _zero(i, min(ZERO, 0.02 * float(output_swing[i])))))
    return found


def apply_nuisances(nuisances: Sequence[Nuisance], variant: Variant, z: Array) -> None:
    """Enter all nuisances into a variant, in place."""
    for nuisance, value in zip(nuisances, z, strict=True):
        if value != 0.0:
            nuisance.apply(variant, float(value))


def _field(field: str, rows: Sequence[int], sd: float) -> Callable[[Variant, float], None]:
    def apply(variant: Variant, z: float) -> None:
        getattr(variant.model, field)[list(rows)] *= np.exp(sd * z)

    return apply


def _mass(bodies: Sequence[int]) -> Callable[[Variant, float], None]:
    def apply(variant: Variant, z: float) -> None:
        variant.model.body_mass[list(bodies)] *= np.exp(MASS * z)
        variant.model.body_inertia[list(bodies)] *= np.exp(MASS * z)

    return apply


def _com(body: int, axis: int, sd: float) -> Callable[[Variant, float], None]:
    def apply(variant: Variant, z: float) -> None:
        shift_com(variant.model, body, sd * z * np.eye(3)[axis])

    return apply


def _gain(actuator: int) -> Callable[[Variant, float], None]:
    def apply(variant: Variant, z: float) -> None:
        factor, model = np.exp(GAIN * z), variant.model
        model.actuator_gainprm[actuator, 0] *= factor
        if is_servo(model, actuator, 1):
            model.actuator_biasprm[actuator, 1] *= factor
        elif is_servo(model, actuator, 2):
            model.actuator_biasprm[actuator, 2] *= factor

    return apply


def _rate_gain(actuator: int) -> Callable[[Variant, float], None]:
    def apply(variant: Variant, z: float) -> None:
        variant.model.actuator_biasprm[actuator, 2] *= np.exp(PASSIVE * z)

    return apply


def _input_scale(channel: int) -> Callable[[Variant, float], None]:
    def apply(variant: Variant, z: float) -> None:
        variant.inputs.scale[channel] *= np.exp(GAIN * z)

    return apply


def _input_zero(channel: int, sd: float) -> Callable[[Variant, float], None]:
    def apply(variant: Variant, z: float) -> None:
        variant.inputs.offset[channel] += sd * z

    return apply


def _continuous(inertia: Array) -> Callable[[Variant, float], None]:
    def apply(variant: Variant, z: float) -> None:
        variant.model.dof_armature[:] -= STEP * z * inertia

    return apply


def _timing(sd: float) -> Callable[[Variant, float], None]:
    def apply(variant: Variant, z: float) -> None:
        variant.inputs.delay += sd * z

    return apply


def _lead(channels: Sequence[int], sd: float) -> Callable[[Variant, float], None]:
    def apply(variant: Variant, z: float) -> None:
        variant.outputs.lead[list(channels)] += sd * z

    return apply


def _ground(world: Sequence[int], feet: Sequence[int]) -> Callable[[Variant, float], None]:
    rows = [*world, *feet]

    def apply(variant: Variant, z: float) -> None:
        variant.model.geom_friction[rows, 0] *= np.exp(CONTACT * z)
        variant.model.pair_friction[:, :2] *= np.exp(CONTACT * z)

    return apply


def _softness(world: Sequence[int], feet: Sequence[int]) -> Callable[[Variant, float], None]:
    rows = [*world, *feet]

    def apply(variant: Variant, z: float) -> None:
        times = variant.model.geom_solref[rows, 0]
        variant.model.geom_solref[rows, 0] = np.where(times > 0, times * np.exp(CONTACT * z), times)

    return apply


def firmness(model: mujoco.MjModel) -> list[Nuisance]:
    """How firmly friction holds against its normal force: a number of elliptic cones, which others do not have."""

    def apply(variant: Variant, z: float) -> None:
        variant.model.opt.impratio *= np.exp(FIRMNESS * z)

    return [Nuisance("firmness of friction", apply)] if model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC else []


def _zero(channel: int, sd: float) -> Callable[[Variant, float], None]:
    def apply(variant: Variant, z: float) -> None:
        variant.outputs.bias[channel] += sd * z

    return apply
