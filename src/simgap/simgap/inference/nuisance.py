"""What is never exactly as modelled: the nominal numbers, each with a prior. They are refitted with every candidate."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from simgap.data.channels import is_servo
from simgap.data.plant import Plant
from simgap.effects.base import joint_units
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
class Number:
    """What a nuisance is in physical terms.

    Attributes:
        name: of the quantity, without the place.
        site: where it is: a name of the model or of a group, empty for the whole robot.
        nominal: value in the model; of several parts that move together that of the first, of their mass the sum.
        spread: one standard deviation of the prior; of the logarithm where ``factor``.
        unit: of nominal and value, SI.
    """

    name: str
    site: str
    nominal: float
    spread: float
    unit: str
    factor: bool = True

    def value(self, z: float) -> float:
        """The number at z standard deviations."""
        return float(self.nominal * np.exp(self.spread * z) if self.factor else self.nominal + self.spread * z)


@dataclass(frozen=True)
class Nuisance:
    """One nominal number; ``apply(variant, z)`` moves it by z standard deviations of its prior, in place."""

    name: str
    apply: Callable[[Variant, float], None]
    number: Number | None = None

    def scaled(self, share: float) -> Nuisance:
        """With a prior ``share`` times as wide."""
        if share == 1.0:
            return self
        number = self.number and replace(self.number, spread=share * self.number.spread)
        return Nuisance(self.name, lambda variant, z: self.apply(variant, share * z), number)

    def described(self) -> Number:
        """Its physical description; in standard deviations of the prior where none was given."""
        return self.number or Number(self.name, "", 0.0, 1.0, "prior deviations", False)


def enumerate_nuisances(plant: Plant, output_swing: Array, input_size: Array, period: float) -> list[Nuisance]:
    """The nuisances of a plant.

    ``output_swing`` (no,) is each output's spread in the recording, ``input_size`` (ni,) each input's root mean square,
    ``period`` [s] that of the samples.
    """
    model = plant.model
    measured = all(c.measured or c.actuator < 0 for c in plant.inputs)
    timing = (MEASURED_TIMING if measured else TIMING) * (period + float(model.opt.timestep))
    found = [Nuisance("timing of inputs", _timing(timing), Number("timing of inputs", "", 0.0, timing, "s", False))]
    bodies = moving_bodies(model)
    for group in [[b] for b in bodies] if len(bodies) <= _MANY else [bodies]:
        label = model.body(group[0]).name or f"body_{group[0]}" if len(group) == 1 else "all"
        total = float(model.body_mass[group].sum())
        found.append(Nuisance(f"mass {label}", _mass(group), Number("mass", label, total, MASS, "kg")))
        if len(group) == 1:
            # How far the mass lies from where the body hangs is no better known than how far it spreads.
            size = float(np.hypot(gyration(model, group[0]), 0.5 * np.linalg.norm(model.body_ipos[group[0]])))
            for axis, letter in enumerate("xyz"):
                number = Number(f"com {letter}", label, float(model.body_ipos[group[0], axis]), COM * size, "m", False)
                found.append(Nuisance(f"com {label} {letter}", _com(group[0], axis, COM * size), number))
            number = Number("inertia", label, float(model.body_inertia[group[0]].max()), INERTIA, "kg m^2")
            found.append(Nuisance(f"inertia {label}", _field("body_inertia", group, INERTIA), number))
    for field, label in (
        ("dof_damping", "damping"),
        ("dof_frictionloss", "friction"),
        ("jnt_stiffness", "stiffness"),
        ("tendon_stiffness", "tendon stiffness"),
        ("tendon_damping", "tendon damping"),
        ("tendon_frictionloss", "tendon friction"),
        ("dof_armature", "armature"),
    ):
        for row in np.flatnonzero(getattr(model, field) > 0).tolist():
            found.append(Nuisance(f"{label} {row}", _field(field, [row], PASSIVE), passive(model, field, row)))
    if semi_implicit(model):
        number = Number("inertia that a time step adds and the robot lacks", "", 0.0, STEP, "1", False)
        found.append(Nuisance("time step", _continuous(step_inertia(model)), number))
    for a in range(model.nu):
        if any(c.actuator == a for c in plant.inputs):
            name = model.actuator(a).name or str(a)
            found.append(Nuisance(f"gain {name}", _gain(a), servo_gain(model, a)))
            if is_servo(model, a, 1) and model.actuator_biasprm[a, 2] != 0:
                found.append(Nuisance(f"rate gain {name}", _rate_gain(a), servo_gain(model, a, 2)))
    for i, channel in enumerate(plant.inputs):
        if channel.actuator < 0:
            number = Number("scale of input", channel.name, 1.0, GAIN, "1")
            found.append(Nuisance(f"scale {channel.name}", _input_scale(i), number))
        if channel.measured or channel.actuator < 0:
            # Of an actuator's input in its control, which is what the path moves.
            unit = "1" if channel.actuator >= 0 else joint_units(model, int(model.dof_jntid[channel.dof]))[1]
            sd = INPUT_OFFSET * float(input_size[i])
            number = Number("zero of input", channel.name, 0.0, sd, unit, False)
            found.append(Nuisance(f"zero {channel.name}", _input_zero(i, sd), number))
    world, feet = colliding(model)
    if feet:
        found.append(Nuisance("ground friction", _ground(world, feet), sliding(model, feet)))
        found.append(Nuisance("contact softness", _softness(world, feet), softness(model, feet)))
        found += firmness(model)
    if np.linalg.norm(model.opt.gravity) > 0:
        found += tilts()
    rates = [i for i, output in enumerate(plant.outputs) if output.sensor_type in _RATES]
    if rates and len(rates) < len(plant.outputs) and semi_implicit(model):
        sd = RATE_TIMING * float(model.opt.timestep)
        found.append(Nuisance("timing of rates", _lead(rates, sd), Number("timing of rates", "", 0.0, sd, "s", False)))
    for i, output in enumerate(plant.outputs):
        if output.qpos >= 0:
            sd = min(ZERO, 0.02 * float(output_swing[i]))
            number = Number("zero of sensor", output.name, 0.0, sd, output.unit, False)
            found.append(Nuisance(f"zero {output.name}", _zero(i, sd), number))
    return found


# -- what the numbers are in physical terms ----------------------------------------------------------------------------


def passive(model: mujoco.MjModel, field: str, row: int, site: str | None = None) -> Number:
    """Damping, friction, stiffness or armature of a joint or a tendon."""
    kind = field.split("_")[1]
    if field.startswith("tendon"):
        length, force, name = "m", "N", model.tendon(row).name or str(row)
    else:
        joint = row if field.startswith("jnt") else int(model.dof_jntid[row])
        (length, force), name = joint_units(model, joint), model.joint(joint).name or str(joint)
    unit = {
        "damping": f"{force} s/{length}",
        "frictionloss": force,
        "stiffness": f"{force}/{length}",
        "armature": "kg m^2" if length == "rad" else "kg",
    }[kind]
    label = ("tendon " if field.startswith("tendon") else "") + ("friction" if kind == "frictionloss" else kind)
    return Number(label, site or name, float(np.ravel(getattr(model, field)[row])[0]), PASSIVE, unit)


def servo_gain(model: mujoco.MjModel, actuator: int, slot: int = 1, site: str | None = None) -> Number:
    """Gain of an actuator: of a servo by its error, of another by its control; ``slot`` 2: that by its velocity."""
    site = site or model.actuator(actuator).name or str(actuator)
    hinge = model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_JOINT and (
        model.jnt_type[model.actuator_trnid[actuator, 0]] == mujoco.mjtJoint.mjJNT_HINGE
    )
    force, length = ("N m", "rad") if hinge else ("N", "m")
    if slot == 2:
        rate = -float(model.actuator_biasprm[actuator, 2])
        return Number("rate gain", site, rate, PASSIVE, f"{force} s/{length}")
    per = "/" + length if is_servo(model, actuator, 1) else f" s/{length}" if is_servo(model, actuator, 2) else ""
    return Number("gain", site, float(model.actuator_gainprm[actuator, 0]), GAIN, force + per)


def sliding(model: mujoco.MjModel, feet: Sequence[int]) -> Number:
    """Friction of the ground and what touches it."""
    return Number("ground friction", "", float(model.geom_friction[feet[0], 0]), CONTACT, "1")


def softness(model: mujoco.MjModel, feet: Sequence[int]) -> Number:
    """Time over which a contact settles."""
    return Number("contact softness", "", float(model.geom_solref[feet[0], 0]), CONTACT, "s")


def tilts() -> list[Nuisance]:
    """How far gravity leans in the axes of the recording."""
    return [
        Nuisance(name, apply, Number(name, "", 0.0, TILT, "rad", False))
        for name, apply in (
            ("pitch of gravity", lambda v, z: lean(v.model, TILT * z, 0.0)),
            ("roll of gravity", lambda v, z: lean(v.model, 0.0, TILT * z)),
        )
    ]


# -- how they move -----------------------------------------------------------------------------------------------------


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

    if model.opt.cone != mujoco.mjtCone.mjCONE_ELLIPTIC:
        return []
    number = Number("firmness of friction", "", float(model.opt.impratio), FIRMNESS, "1")
    return [Nuisance("firmness of friction", apply, number)]


def _zero(channel: int, sd: float) -> Callable[[Variant, float], None]:
    def apply(variant: Variant, z: float) -> None:
        variant.outputs.bias[channel] += sd * z

    return apply
