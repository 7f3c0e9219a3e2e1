"""Where effects can act on the mouse, which of those places are worth a look, and what is never exactly as modelled."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from nermo_description.markers import MARKERS
from nermo_description.parameters import LEGS
from nermo_gap.robots.channels import GYRO
from simgap.data.channels import model_names
from simgap.data.plant import Plant
from simgap.effects.base import Effect
from simgap.effects.body import gyration, shift_com
from simgap.inference import nuisance as prior
from simgap.inference.nuisance import Nuisance, Number
from simgap.simulation.contacts import colliding
from simgap.simulation.variant import Variant

Array = NDArray[np.float64]
Obj = mujoco.mjtObj
Apply = Callable[[Variant, float], None]
_IDLE = ("tail", "head")
GLUED = 5e-4
"""[m] by which a marker at a foot may be off: half a millimetre by eye."""


def groups(model: mujoco.MjModel) -> dict[str, tuple[str, ...]]:
    """Groups of sites by name; a group holds names of actuators, joints, tendons, bodies and geoms alike."""
    kinds = (Obj.mjOBJ_ACTUATOR, Obj.mjOBJ_JOINT, Obj.mjOBJ_TENDON, Obj.mjOBJ_BODY, Obj.mjOBJ_GEOM)
    names = [name for kind in kinds for name in model_names(model, kind)]
    legs = [n for n in names if n.startswith(LEGS)]
    spine = [n for n in names if n.startswith("spine_")]

    def ending(*ends: str) -> tuple[str, ...]:
        return tuple(n for n in legs if n.endswith(ends))

    def of(word: str) -> tuple[str, ...]:
        # The shaft of a servo is not a printed joint: what groups have in common is the leg.
        return tuple(n for n in legs if word in n.split("_")[:2] and not n.endswith("pulley_joint"))

    return {
        "all_hips": ending("_hip", "_hip_joint"),
        "all_knees": ending("_knee", "_knee_joint", "_knee_tendon"),
        "all_knee_pulleys": ending("_knee_pulley_joint"),
        "all_ankles": ending("_ankle_joint"),
        "all_feet": ending("_foot"),
        **{word: of(word) for word in ("front", "rear", "left", "right")},
        "spine": tuple(n for n in spine if "pulley" not in n),
        "spine_lateral": tuple(n for n in spine if n.startswith("spine_lateral_") and "pulley" not in n),
        "spine_vertical": tuple(n for n in spine if n.startswith("spine_vertical_") and "pulley" not in n),
    }


def worth_a_look(plant: Plant) -> Callable[[Effect], bool]:
    """Whether a candidate makes sense on the mouse.

    Tail and head are left out: nothing measures them. Vertebrae are looked at together, ankles too. The tracker has
    neither bias nor scale, for windows start where it sees the mouse.
    """
    model = plant.model
    joints, actuators = model_names(model, Obj.mjOBJ_JOINT), model_names(model, Obj.mjOBJ_ACTUATOR)
    shafts = {n for n in joints if n.endswith(("_hip_joint", "_knee_pulley_joint")) and n.startswith(LEGS)}
    shafts |= {"all_hips", "all_knee_pulleys"}
    spines = {n for n in ("spine", "spine_lateral", "spine_vertical") if n == "spine" or "spine_vertical" in actuators}
    printed = {f"{leg}_knee_joint" for leg in LEGS} | spines | {"all_knees", "all_ankles", "front", "rear"}
    servos = {n for n in actuators if not n.startswith(_IDLE)} | {"all_hips", "all_knees", "front", "rear", "all"}
    tendons = {n for n in model_names(model, Obj.mjOBJ_TENDON) if not n.startswith(_IDLE)}
    feet = {f"{leg}_foot" for leg in LEGS} | {"all_feet", "front", "rear", "left", "right"}
    bodies = {"torso", "rear_torso"}
    hips = {n for n in shafts if "hip" in n}
    tracked = ("base_link", *(place for _, place in MARKERS.values()))

    def keep(effect: Effect) -> bool:
        name, site = effect.name, effect.site.name
        if name.startswith(("servo", "link", "supply")):
            # A motor of its own behind a play takes a finer time step than replays have; the late command is its like.
            return site in servos and effect.form != "motor"
        if name == "thermal_drift":
            # One candidate more, not one a servo: each is replayed step by step, and they warm together.
            return site == "all"
        if name.startswith("tendon"):
            return site in tendons | {"all_knees"}
        if name in ("ground_friction", "foot_compliance"):
            return site in feet
        if name in ("mass", "com_shift", "inertia"):
            return site in bodies or (name, site) == ("mass", "all")
        if name.startswith("sensor"):
            return not site.startswith(tracked) and "torque" not in site
        if name == "joint_stiffness":
            return site in printed | {"all"} and effect.form == "factor"
        if name in ("joint_rest_angle", "joint_damping"):
            return site in printed
        if name == "joint_range":
            return site in printed | hips
        if name == "joint_elasticity":
            return site in shafts
        if name == "torque_ripple":
            # Every place to look costs replays of a walk, and the servo's loop holds its shaft against its teeth.
            return False
        if name == "soft_mount":
            # A mouse on a bench is held by its stand, which has joints and a compliance of its own; else it walks.
            return False
        if name == "coulomb_friction":
            return site in shafts | printed
        if name in ("stribeck_friction", "load_friction", "armature"):
            return site in ("all_hips", "all_knee_pulleys")
        return name != "viscous_friction" or site in shafts

    return keep


def nuisances(plant: Plant, output_swing: Array, input_size: Array, period: float) -> list[Nuisance]:
    """Nominal numbers of the mouse with their priors: those of the core, but parts that are alike move together."""
    model = plant.model
    timing = prior.TIMING * (period + float(model.opt.timestep))
    found = [Nuisance("timing of inputs", _timing(timing), Number("timing of inputs", "", 0.0, timing, "s", False))]
    # What comes over the servos' bus, and from the IMU, was measured before it was stamped.
    for label, kind in (("servo reports", ("_position", "_torque", "_encoder")), ("IMU", GYRO)):
        late = [i for i, output in enumerate(plant.outputs) if output.name.endswith(kind)]
        if late:
            found.append(Nuisance(f"age of {label}", _age(late, timing), Number("age", label, 0.0, timing, "s", False)))
    bodies = {name: i for i, name in enumerate(model_names(model, Obj.mjOBJ_BODY))}
    torsos = [bodies["torso"], bodies["rear_torso"]]
    limbs = [i for i in bodies.values() if i and i not in torsos]
    for label, rows in (("torso", torsos[:1]), ("rear torso", torsos[1:]), ("limbs", limbs)):
        number = Number("mass", label, float(model.body_mass[rows].sum()), prior.MASS, "kg")
        found.append(Nuisance(f"mass {label}", _scaled(("body_mass", "body_inertia"), rows, prior.MASS), number))
    for body, axes in zip(torsos, ("xyz", "x"), strict=True):
        size, name = prior.COM * gyration(model, body), model.body(body).name
        for axis in map("xyz".index, axes):
            number = Number(f"com {'xyz'[axis]}", name, float(model.body_ipos[body, axis]), size, "m", False)
            found.append(Nuisance(f"com {name} {'xyz'[axis]}", _com(body, axis, size), number))
    number = Number("inertia", "torsos", float(model.body_inertia[torsos[0]].max()), prior.INERTIA, "kg m^2")
    found.append(Nuisance("inertia torsos", _scaled(("body_inertia",), torsos, prior.INERTIA), number))
    joints = model_names(model, Obj.mjOBJ_JOINT)

    def dofs(*ends: str) -> list[int]:
        return [int(model.jnt_dofadr[i]) for i, n in enumerate(joints) if n.endswith(ends) and not n.startswith(_IDLE)]

    shafts, knees, ankles = dofs("_hip_joint", "_pulley_joint"), dofs("_knee_joint"), dofs("_ankle_joint")
    vertebrae = dofs(*(f"_{i}_joint" for i in range(1, 9)))
    for label, field, rows in (
        ("damping servos", "dof_damping", shafts),
        ("armature servos", "dof_armature", shafts),
        ("damping printed joints", "dof_damping", [*knees, *ankles, *vertebrae]),
    ):
        number = prior.passive(model, field, rows[0], label.split(" ", 1)[1])
        found.append(Nuisance(label, _scaled((field,), rows, prior.PASSIVE), number))
    # No two parts are alike: a mouse is built by hand. Left and right may show as one, but must not be one.
    springs = [i for i, n in enumerate(joints) if n.endswith(("_knee_joint", "_ankle_joint"))]
    spine = [int(model.dof_jntid[d]) for d in vertebrae]
    for label, rows in (*((joints[i], [i]) for i in springs), ("spine", spine)):
        number = prior.passive(model, "jnt_stiffness", rows[0], label)
        found.append(Nuisance(f"stiffness {label}", _scaled(("jnt_stiffness",), rows, prior.PASSIVE), number))
    for i, name in enumerate(model_names(model, Obj.mjOBJ_ACTUATOR)):
        if not name.startswith(_IDLE):
            found.append(Nuisance(f"gain {name}", _gain([i]), prior.servo_gain(model, i, site=name)))
    world, feet = colliding(model)
    found.append(Nuisance("ground friction", _sliding([*world, *feet]), prior.sliding(model, feet)))
    found.append(Nuisance("contact softness", _softness([*world, *feet]), prior.softness(model, feet)))
    for foot in feet:
        if (name := model.geom(foot).name).endswith("_foot"):
            number = Number("foot friction", name, float(model.geom_friction[foot, 0]), prior.PASSIVE, "1")
            found.append(Nuisance(f"friction {name}", _rubber(foot), number))
    for place, (frame, site) in MARKERS.items():
        # Only where a leg moves: what the body does not turn shows in its zero alone.
        if frame == "site" and any(output.name == f"marker_{place}_x" for output in plant.outputs):
            for letter in "xz":
                number = Number(f"marker {letter}", place, 0.0, GLUED, "m", False)
                found.append(Nuisance(f"marker {place} {letter}", _glued(site, "xyz".index(letter)), number))
    found += prior.firmness(model)
    found += prior.tilts()
    for i, output in enumerate(plant.outputs):
        if output.qpos >= 0:
            sd = min(prior.ZERO, 0.02 * float(output_swing[i]))
            number = Number("zero of sensor", output.name, 0.0, sd, output.unit, False)
            found.append(Nuisance(f"zero {output.name}", _zero(i, sd), number))
    return found


def _scaled(fields: Sequence[str], rows: Sequence[int], sd: float) -> Apply:
    def apply(variant: Variant, z: float) -> None:
        for field in fields:
            getattr(variant.model, field)[list(rows)] *= np.exp(sd * z)

    return apply


def _com(body: int, axis: int, sd: float) -> Apply:
    def apply(variant: Variant, z: float) -> None:
        shift_com(variant.model, body, sd * z * np.eye(3)[axis])

    return apply


def _rubber(foot: int) -> Apply:
    def apply(variant: Variant, z: float) -> None:
        variant.model.geom_friction[foot, 0] *= np.exp(prior.PASSIVE * z)

    return apply


def _glued(site: str, axis: int) -> Apply:
    def apply(variant: Variant, z: float) -> None:
        variant.model.site_pos[variant.model.site(site).id, axis] += GLUED * z

    return apply


def _gain(actuators: Sequence[int]) -> Apply:
    rows = list(actuators)

    def apply(variant: Variant, z: float) -> None:
        variant.model.actuator_gainprm[rows, 0] *= np.exp(prior.GAIN * z)
        variant.model.actuator_biasprm[rows, 1] *= np.exp(prior.GAIN * z)

    return apply


def _sliding(geoms: Sequence[int]) -> Apply:
    def apply(variant: Variant, z: float) -> None:
        variant.model.geom_friction[list(geoms), 0] *= np.exp(prior.CONTACT * z)

    return apply


def _softness(geoms: Sequence[int]) -> Apply:
    def apply(variant: Variant, z: float) -> None:
        variant.model.geom_solref[list(geoms), 0] *= np.exp(prior.CONTACT * z)

    return apply


def _timing(sd: float) -> Apply:
    def apply(variant: Variant, z: float) -> None:
        variant.inputs.delay += sd * z

    return apply


def _age(channels: Sequence[int], sd: float) -> Apply:
    def apply(variant: Variant, z: float) -> None:
        variant.outputs.lead[list(channels)] -= sd * z

    return apply


def _zero(channel: int, sd: float) -> Apply:
    def apply(variant: Variant, z: float) -> None:
        variant.outputs.bias[channel] += sd * z

    return apply


def by_site(effect: dict[str, Any]) -> list[tuple[str, dict[str, float]]]:
    """(site, {name: value}) of an effect of a report: its own, or each part's where parts have values of their own."""
    parts: dict[str, dict[str, float]] = {}
    for name, told in effect["parameters"].items():
        part = str(told.get("part", ""))
        parts.setdefault(part or str(effect["site"]), {})[name.removesuffix(f"_{part}")] = float(told["value"])
    return list(parts.items())
