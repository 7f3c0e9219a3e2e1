"""What makes one mouse differ from its description: deviations of a robot file, entered into its model.

The names, sites and values are those of `simgap`'s effects, so that a diagnosis can be written down as a robot.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import mujoco
import numpy as np

from nermo_description.parameters import Deviation, RobotDescription

Values = dict[str, float]


def enter_deviations(spec: mujoco.MjSpec, robot: RobotDescription) -> None:
    """Enters all deviations that are part of the body into a robot's model; those of the commands are the twin's.

    Raises ValueError for a site that the model has not.
    """
    for number, deviation in enumerate(robot.deviations):
        kind, enter = _ENTER.get(deviation.effect, ("", None))
        if enter is None:
            continue
        if kind == "world":
            enter(spec, deviation.values)
            continue
        for name in deviation.sites:
            element = getattr(spec, kind)(name)
            if element is None:
                raise ValueError(f"deviations.{number}.sites: the model of {robot.name} has no {kind} {name!r}")
            enter(element, _shared(spec, deviation, kind, name))


def _shared(spec: mujoco.MjSpec, deviation: Deviation, kind: str, name: str) -> Values:
    """Values at one site; a mass that is added to several bodies is shared out in proportion to theirs."""
    if deviation.effect != "mass":
        return deviation.values
    total = sum(float(spec.body(site).mass) for site in deviation.sites)
    return {"factor": 1.0 + deviation.values["change"] / total}


def _gain(actuator: mujoco.MjsActuator, values: Values) -> None:
    gain, bias = list(actuator.gainprm), list(actuator.biasprm)
    actuator.gainprm, actuator.biasprm = (
        [gain[0] * values["factor"], *gain[1:]],
        [bias[0], bias[1] * values["factor"], *bias[2:]],
    )


def _torque_limit(actuator: mujoco.MjsActuator, values: Values) -> None:
    actuator.forcerange = (max(actuator.forcerange[0], -values["limit"]), min(actuator.forcerange[1], values["limit"]))


def _friction(joint: mujoco.MjsJoint, values: Values) -> None:
    joint.frictionloss += values["friction"]


def _damping(joint: mujoco.MjsJoint, values: Values) -> None:
    damping = list(joint.damping)
    joint.damping = [damping[0] + values["damping"], *damping[1:]]


def _armature(joint: mujoco.MjsJoint, values: Values) -> None:
    joint.armature += values["inertia"]


def _stiffness(joint: mujoco.MjsJoint, values: Values) -> None:
    joint.stiffness = [value * values["factor"] for value in joint.stiffness]


def _rest_angle(joint: mujoco.MjsJoint, values: Values) -> None:
    joint.springref += values["shift"]


def _range(joint: mujoco.MjsJoint, values: Values) -> None:
    joint.range = (
        max(joint.range[0], values.get("lower", -math.inf)),
        min(joint.range[1], values.get("upper", math.inf)),
    )


def _slack(tendon: mujoco.MjsTendon, values: Values) -> None:
    tendon.range = (tendon.range[0], tendon.range[1] + values["slack"])


def _routing_friction(tendon: mujoco.MjsTendon, values: Values) -> None:
    tendon.frictionloss += values["friction"]


def _detached(tendon: mujoco.MjsTendon, values: Values) -> None:
    tendon.limited = mujoco.mjtLimited.mjLIMITED_FALSE


def _inertia(body: mujoco.MjsBody, values: Values) -> None:
    body.inertia = [value * values["factor"] for value in body.inertia]


def _mass(body: mujoco.MjsBody, values: Values) -> None:
    body.mass *= values["factor"]
    _inertia(body, values)


def _com(body: mujoco.MjsBody, values: Values) -> None:
    body.ipos = [place + values[axis] for place, axis in zip(body.ipos, "xyz", strict=True)]


def _slippery(geom: mujoco.MjsGeom, values: Values) -> None:
    geom.friction = [geom.friction[0] * values["factor"], *geom.friction[1:]]


def _soft(geom: mujoco.MjsGeom, values: Values) -> None:
    geom.solref = [geom.solref[0] * values["time_factor"], *geom.solref[1:]]


def _slope(spec: mujoco.MjSpec, values: Values) -> None:
    """Gravity leans instead of the ground, whose axes the world keeps; a positive pitch is downhill forward."""
    cp, sp = math.cos(-values["pitch"]), math.sin(-values["pitch"])
    cr, sr = math.cos(-values["roll"]), math.sin(-values["roll"])
    turn = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]]) @ np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    spec.option.gravity = turn @ np.array(spec.option.gravity)


_ENTER: dict[str, tuple[str, Callable[..., None]]] = {
    "servo_gain": ("actuator", _gain),
    "servo_torque_limit": ("actuator", _torque_limit),
    "coulomb_friction": ("joint", _friction),
    "viscous_friction": ("joint", _damping),
    "joint_damping": ("joint", _damping),
    "armature": ("joint", _armature),
    "joint_stiffness": ("joint", _stiffness),
    "joint_rest_angle": ("joint", _rest_angle),
    "joint_range": ("joint", _range),
    "tendon_slack": ("tendon", _slack),
    "tendon_friction": ("tendon", _routing_friction),
    "tendon_detached": ("tendon", _detached),
    "mass": ("body", _mass),
    "com_shift": ("body", _com),
    "inertia": ("body", _inertia),
    "ground_friction": ("geom", _slippery),
    "foot_compliance": ("geom", _soft),
    "ground_slope": ("world", _slope),
}
