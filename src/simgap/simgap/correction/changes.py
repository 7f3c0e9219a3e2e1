"""The difference between a nominal model and a diagnosed one, number by number, and in which words MJCF says it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from simgap.data.channels import model_names
from simgap.data.plant import Plant
from simgap.simulation.variant import Variant

Array = NDArray[np.float64]
Obj = mujoco.mjtObj

OBJECTS = {
    "joint": Obj.mjOBJ_JOINT,
    "tendon": Obj.mjOBJ_TENDON,
    "actuator": Obj.mjOBJ_ACTUATOR,
    "body": Obj.mjOBJ_BODY,
    "geom": Obj.mjOBJ_GEOM,
}
_SCALAR = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
_PRM = 3
"""Of an actuator's gain and bias parameters, those that a servo has."""


@dataclass(frozen=True)
class Attribute:
    """An attribute of an MJCF element and the field of mjModel behind it.

    Attributes:
        row: the row of the field that belongs to an element, or None where the element has none of its own.
        unit: of a hinge (or of anything else), with ``linear`` that of a slide.
    """

    element: str
    name: str
    field: str
    row: Callable[[mujoco.MjModel, int], int | None]
    unit: str = "1"
    linear: str = ""


def _own(model: mujoco.MjModel, index: int) -> int:
    return index


def _dof(model: mujoco.MjModel, joint: int) -> int | None:
    return int(model.jnt_dofadr[joint]) if int(model.jnt_type[joint]) in _SCALAR else None


def _qpos(model: mujoco.MjModel, joint: int) -> int | None:
    return int(model.jnt_qposadr[joint]) if int(model.jnt_type[joint]) in _SCALAR else None


ATTRIBUTES = (
    Attribute("joint", "damping", "dof_damping", _dof, "N m s/rad", "N s/m"),
    Attribute("joint", "armature", "dof_armature", _dof, "kg m^2", "kg"),
    Attribute("joint", "frictionloss", "dof_frictionloss", _dof, "N m", "N"),
    Attribute("joint", "solreffriction", "dof_solref", _dof),
    Attribute("joint", "solimpfriction", "dof_solimp", _dof),
    Attribute("joint", "stiffness", "jnt_stiffness", _own, "N m/rad", "N/m"),
    Attribute("joint", "springref", "qpos_spring", _qpos, "rad", "m"),
    Attribute("joint", "range", "jnt_range", _own, "rad", "m"),
    Attribute("joint", "solreflimit", "jnt_solref", _own),
    Attribute("tendon", "frictionloss", "tendon_frictionloss", _own, "N"),
    Attribute("tendon", "solreffriction", "tendon_solref_fri", _own),
    Attribute("tendon", "solimpfriction", "tendon_solimp_fri", _own),
    Attribute("tendon", "stiffness", "tendon_stiffness", _own, "N/m"),
    Attribute("tendon", "damping", "tendon_damping", _own, "N s/m"),
    Attribute("tendon", "springlength", "tendon_lengthspring", _own, "m"),
    Attribute("tendon", "range", "tendon_range", _own, "m"),
    Attribute("tendon", "limited", "tendon_limited", _own),
    Attribute("actuator", "gainprm", "actuator_gainprm", _own),
    Attribute("actuator", "biasprm", "actuator_biasprm", _own),
    Attribute("actuator", "gear", "actuator_gear", _own),
    Attribute("actuator", "delay", "actuator_delay", _own, "s"),
    Attribute("actuator", "forcerange", "actuator_forcerange", _own, "N m", "N"),
    Attribute("body", "mass", "body_mass", _own, "kg"),
    Attribute("body", "ipos", "body_ipos", _own, "m"),
    Attribute("body", "inertia", "body_inertia", _own, "kg m^2"),
    Attribute("geom", "friction", "geom_friction", _own),
    Attribute("geom", "priority", "geom_priority", _own),
    Attribute("geom", "solref", "geom_solref", _own),
    Attribute("geom", "pos", "geom_pos", _own, "m"),
    Attribute("geom", "quat", "geom_quat", _own),
)
_OPTIONS = (("gravity", "m/s^2"), ("impratio", "1"))
_FOLLOWS = ("jnt_limited", "actuator_forcelimited", "body_sameframe", "body_simple", "geom_sameframe")
"""Fields that are set along with one of the attributes, or that the compiler works out."""
_POSITIVE = ("damping", "frictionloss", "stiffness", "mass")
"""Below zero they would drive a robot. An armature may be: it makes up for the inertia that a time step adds."""


@dataclass(frozen=True)
class Change:
    """One attribute of one element of the model that the diagnosis moves.

    Attributes:
        element: `joint`, `tendon`, `actuator`, `body`, `geom` or `option`.
        name, index: of the element; the index is that of the compiled model.
        nominal, value: all numbers of the attribute, in SI, angles in radians.
        low, high: 90 % interval of the effects' parameters, one at a time, in the same numbers.
    """

    element: str
    name: str
    index: int
    attribute: str
    nominal: tuple[float, ...]
    value: tuple[float, ...]
    unit: str
    low: tuple[float, ...] = ()
    high: tuple[float, ...] = ()

    @property
    def place(self) -> tuple[str, int, str]:
        """Which number it is."""
        return self.element, self.index, self.attribute

    @property
    def sentence(self) -> str:
        """In words, for the terminal."""
        before, after = (" ".join(f"{v:.4g}" for v in values) for values in (self.nominal, self.value))
        unit = "" if self.unit == "1" else f" {self.unit}"
        return f"{self.element} {self.name}: {self.attribute} {before} -> {after}{unit}".replace(
            "option : ", "option: "
        )


@dataclass(frozen=True)
class Signal:
    """What happens on the way from a command to an actuator, inside a servo or joint, or from a sensor to its reading.

    Attributes:
        where: `controller` (the map's `gains` of an actuator), `command` (of an actuator), `servo` (an actuator),
            `joint`, `mount` (the body that stands on it), `sensor` (an output of the map), or `recording` (a measured
            input: nothing about the robot).
        quantity: see `simgap.correction.signals`.
    """

    where: str
    name: str
    quantity: str
    value: float
    unit: str
    low: float | None = None
    high: float | None = None
    index: int = -1
    """Of the actuator whose whole command it is, else -1."""

    @property
    def sentence(self) -> str:
        """In words, for the terminal."""
        unit = "" if self.unit == "1" else f" {self.unit}"
        return f"{self.where} {self.name}: {self.quantity.replace('_', ' ')} {self.value:.4g}{unit}"


@dataclass(frozen=True)
class Correction:
    """All that a diagnosis changes.

    ``unnamed`` are fields of mjModel that differ and that no attribute here stands for.
    """

    changes: tuple[Change, ...]
    signals: tuple[Signal, ...]
    unnamed: tuple[str, ...] = ()

    def report(self) -> dict[str, Any]:
        """As the key `correction` of diagnosis.json."""
        return {
            "model": [{k: list(v) if isinstance(v, tuple) else v for k, v in vars(c).items()} for c in self.changes],
            "signals": [dict(vars(s)) for s in self.signals],
            "unnamed": list(self.unnamed),
        }

    @classmethod
    def of(cls, report: dict[str, Any]) -> Correction:
        """The reverse of `report`."""
        rows: list[dict[str, Any]] = [
            {k: tuple(v) if isinstance(v, list) else v for k, v in row.items()} for row in report["model"]
        ]
        signals = tuple(Signal(**row) for row in report["signals"])
        return cls(tuple(Change(**row) for row in rows), signals, tuple(report["unnamed"]))


def correction(plant: Plant, diagnosed: Variant, spread: Iterable[Variant] = ()) -> Correction:
    """What makes ``diagnosed`` of the plant's nominal model.

    ``spread`` are variants at the ends of the parameters' intervals; they give every number its range.
    """
    nominal = Variant.nominal(plant)
    controlled = set(plant.map.gains)
    changes = {
        c.place: c
        for c in differences(nominal.model, diagnosed.model)
        if not (c.element == "actuator" and c.name in controlled and c.attribute in ("gainprm", "biasprm"))
    }
    signals = {(s.where, s.name, s.quantity): s for s in _signals(plant, diagnosed)}
    for variant in spread:
        for key, change in changes.items():
            value = _read(variant.model, change)
            low, high = (change.low or change.value), (change.high or change.value)
            changes[key] = replace(change, low=_each(min, low, value), high=_each(max, high, value))
        found = {(s.where, s.name, s.quantity): s.value for s in _signals(plant, variant)}
        for name, signal in signals.items():
            value_ = found.get(name, signal.value)
            low_ = signal.value if signal.low is None else signal.low
            high_ = signal.value if signal.high is None else signal.high
            signals[name] = replace(signal, low=min(low_, value_), high=max(high_, value_))
    return Correction(tuple(changes.values()), tuple(signals.values()), _unnamed(nominal.model, diagnosed.model))


def _each(pick: Callable[[float, float], float], a: Sequence[float], b: Sequence[float]) -> tuple[float, ...]:
    return tuple(pick(x, y) for x, y in zip(a, b, strict=True))


def _read(model: mujoco.MjModel, change: Change) -> tuple[float, ...]:
    if change.element == "option":
        return _numbers(getattr(model.opt, change.attribute))
    attribute = next(a for a in ATTRIBUTES if (a.element, a.name) == (change.element, change.attribute))
    return _values(model, attribute, change.index) or change.value


def _values(model: mujoco.MjModel, attribute: Attribute, index: int) -> tuple[float, ...]:
    row = attribute.row(model, index)
    if row is None:
        return ()
    numbers = _numbers(getattr(model, attribute.field)[row])
    return numbers[:_PRM] if attribute.name in ("gainprm", "biasprm") else numbers


def _numbers(values: Any) -> tuple[float, ...]:
    return tuple(float(v) for v in np.atleast_1d(values))


def differences(nominal: mujoco.MjModel, diagnosed: mujoco.MjModel) -> Iterator[Change]:
    """Every attribute of MJCF in which two models of one structure differ."""
    for name, unit in _OPTIONS:
        before, after = (_numbers(getattr(m.opt, name)) for m in (nominal, diagnosed))
        if before != after:
            yield Change("option", "", 0, name, before, after, unit)
    for attribute in ATTRIBUTES:
        names = model_names(nominal, OBJECTS[attribute.element])
        for index, name in enumerate(names):
            before, after = (_values(m, attribute, index) for m in (nominal, diagnosed))
            if before == after:
                continue
            if attribute.name in _POSITIVE and after[0] < 0.0:
                after = (0.0,)
                if before == after:
                    continue
            yield Change(
                attribute.element, name, index, attribute.name, before, after, _unit(nominal, attribute, index)
            )


def _unit(model: mujoco.MjModel, attribute: Attribute, index: int) -> str:
    joint = -1
    if attribute.element == "joint":
        joint = index
    elif attribute.element == "actuator" and model.actuator_trntype[index] == mujoco.mjtTrn.mjTRN_JOINT:
        joint = int(model.actuator_trnid[index, 0])
    hinge = joint >= 0 and model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE
    return attribute.unit if hinge or not attribute.linear else attribute.linear


def _unnamed(nominal: mujoco.MjModel, diagnosed: mujoco.MjModel) -> tuple[str, ...]:
    known = {a.field for a in ATTRIBUTES} | set(_FOLLOWS)
    prefixes = ("dof_", "jnt_", "body_", "geom_", "actuator_", "tendon_", "qpos", "pair_", "site_", "eq_")
    found = []
    for name in dir(nominal):
        if name.startswith(prefixes) and name not in known:
            before, after = getattr(nominal, name), getattr(diagnosed, name)
            if isinstance(before, np.ndarray) and not np.array_equal(before, after):
                found.append(name)
    return tuple(found)


def _signals(plant: Plant, variant: Variant) -> list[Signal]:
    found = [*_input_signals(plant, variant), *_robot_signals(plant, variant)]
    # What a controlled motor is told passes these first.
    touched = {s.name for s in found if s.where in ("command", "servo")}
    return [*_controller_signals(plant, variant, touched), *found]


def _robot_signals(plant: Plant, variant: Variant) -> Iterator[Signal]:
    model, servos, friction = plant.model, variant.servos, variant.friction
    actuators, joints = (model_names(model, kind) for kind in (Obj.mjOBJ_ACTUATOR, Obj.mjOBJ_JOINT))
    for a in range(model.nu):
        unit = _command_unit(model, a)
        if servos.dead_band[a]:
            quantity = "dead_band" if servos.hard[a] else "dead_band_in_part"
            yield Signal("servo", actuators[a], quantity, float(servos.dead_band[a]), unit)
        if servos.backlash[a]:
            yield Signal("servo", actuators[a], "backlash", float(servos.backlash[a]), unit)
        if servos.compliance[a]:
            force = "N m" if unit == "rad" else "N"
            yield Signal("servo", actuators[a], "compliance", float(servos.compliance[a]), f"{unit}/({force})")
            yield Signal("servo", actuators[a], "ringing", float(servos.ringing[a]), "1")
        if servos.heat_loss[a]:
            yield Signal("servo", actuators[a], "heat_loss", float(servos.heat_loss[a]), "1")
            yield Signal("servo", actuators[a], "heat_time", float(servos.heat_time[a]), "s")
            yield Signal("servo", actuators[a], "heat_reference", float(servos.heat_reference[a]), "1")
        if servos.temperature_loss[a]:
            yield Signal("servo", actuators[a], "temperature_loss", float(servos.temperature_loss[a]), "1")
    if servos.sag:
        yield Signal("servo", "all", "sag", float(servos.sag), "1")
        yield Signal("servo", "all", "sag_reference", float(servos.sag_reference), "1")
    if servos.follows:
        yield Signal("servo", "all", "follows_voltage", float(servos.follows), "1")
    for j, name in enumerate(joints):
        dof = _dof(model, j)
        if dof is None:
            continue
        hinge = model.jnt_type[j] == mujoco.mjtJoint.mjJNT_HINGE
        if friction.stribeck[dof]:
            speed = float(friction.stribeck_velocity[dof])
            yield Signal("joint", name, "stribeck", float(friction.stribeck[dof]), "N m" if hinge else "N")
            yield Signal("joint", name, "stribeck_speed", speed, "rad/s" if hinge else "m/s")
        if friction.load[dof]:
            yield Signal("joint", name, "load_friction", float(friction.load[dof]), "1")
        if friction.ripple[dof]:
            yield Signal("joint", name, "ripple", float(friction.ripple[dof]), "N m" if hinge else "N")
            for quantity, along in (
                ("ripple_period", friction.ripple_period),
                ("ripple_origin", friction.ripple_origin),
            ):
                yield Signal("joint", name, quantity, float(along[dof]), "rad" if hinge else "m")
    yield from _mount_signals(plant, variant)
    outputs = variant.outputs
    for i, channel in enumerate(plant.outputs):
        for quantity, values, neutral, unit in (
            ("scale", outputs.scale, 1.0, "1"),
            ("bias", outputs.bias, 0.0, channel.unit),
            ("delay", outputs.delay, 0.0, "s"),
            ("lead", outputs.lead, 0.0, "s"),
            ("lag", outputs.lag, 0.0, "s"),
            ("limit", outputs.limit, np.inf, channel.unit),
        ):
            if values[i] != neutral:
                yield Signal("sensor", channel.name, quantity, float(values[i]), unit)
    for channels, turn in outputs.turns:
        angle = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2.0
        for axis, value in zip("xyz", angle, strict=True):
            yield Signal("sensor", plant.outputs[channels[0]].sensor, f"turned_about_{axis}", float(value), "rad")


def _mount_signals(plant: Plant, variant: Variant) -> Iterator[Signal]:
    mounts, bodies = variant.mounts, model_names(plant.model, Obj.mjOBJ_BODY)
    for body in np.flatnonzero(mounts.compliance):
        yield Signal("mount", bodies[body], "compliance", float(mounts.compliance[body]), "rad/(N m)")
        yield Signal("mount", bodies[body], "ringing", float(mounts.ringing[body]), "1")
        if mounts.inertia[body]:
            yield Signal("mount", bodies[body], "inertia", float(mounts.inertia[body]), "kg m^2")


def _controller_signals(plant: Plant, variant: Variant, touched: set[str]) -> Iterator[Signal]:
    """Gains of the robot's own controller, which the map names and no MJCF holds, where they or its commands change."""
    for a, name in enumerate(model_names(plant.model, Obj.mjOBJ_ACTUATOR)):
        if name not in plant.map.gains:
            continue
        gear = float(variant.model.actuator_gear[a, 0])
        turns = _command_unit(plant.model, a) == "rad"
        before, after = (-m.actuator_biasprm[a, 1:3] * gear**2 for m in (plant.model, variant.model))
        if name in touched or not np.array_equal(before, after):
            yield Signal("controller", name, "kp", float(after[0]), "N m/rad" if turns else "N/m")
            yield Signal("controller", name, "kd", float(after[1]), "N m s/rad" if turns else "N s/m")


def _input_signals(plant: Plant, variant: Variant) -> Iterator[Signal]:
    model, paths = plant.model, variant.inputs
    for i, channel in enumerate(plant.inputs):
        robot = channel.actuator >= 0 and not channel.measured
        several = sum(c.actuator == channel.actuator for c in plant.inputs) > 1
        name = channel.column if several or not robot else channel.name
        unit = _command_unit(model, channel.actuator) if channel.actuator >= 0 else "N m"
        for quantity, values, neutral, of in (
            ("scale", paths.scale, 1.0, "1"),
            ("offset", paths.offset, 0.0, unit),
            ("delay", paths.delay, 0.0, "s"),
            ("rate_limit", paths.rate_limit, np.inf, f"{unit}/s"),
            ("play", paths.play, 0.0, unit),
            ("loss", paths.loss, 0.0, "1"),
            ("jitter", paths.jitter, 0.0, "s"),
        ):
            if values[i] != neutral:
                index = channel.actuator if robot and not several else -1
                where = "command" if robot else "recording"
                yield Signal(where, name, quantity, float(values[i]), of, index=index)
        if paths.loss[i] or paths.jitter[i]:
            yield Signal("command" if robot else "recording", name, "update", float(paths.update[i]), "s")


def _command_unit(model: mujoco.MjModel, actuator: int) -> str:
    if model.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_NONE:
        return "of its command"
    if model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_JOINT:
        hinge = model.jnt_type[model.actuator_trnid[actuator, 0]] == mujoco.mjtJoint.mjJNT_HINGE
        return "rad" if hinge else "m"
    return "m"
