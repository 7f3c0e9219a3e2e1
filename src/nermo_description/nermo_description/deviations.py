"""What makes one mouse differ from its description: deviations of a robot file, entered into its model."""

from __future__ import annotations

import math
from collections.abc import Callable

import mujoco
import numpy as np

from nermo_description.parameters import RobotDescription

Values = dict[str, float]


def enter_deviations(spec: mujoco.MjSpec, robot: RobotDescription) -> None:
    """Enters all deviations that are part of the body into a robot's model; those of the commands are the twin's.

    Raises ValueError for a site that the model has not.
    """
    for number, deviation in enumerate(robot.deviations):
        kind = deviation.kind
        if kind.site == "world":
            _ENTER[kind.name](spec, deviation.values)
            continue
        elements = [getattr(spec, kind.site)(name) for name in deviation.sites]
        if None in elements:
            missing = deviation.sites[elements.index(None)]
            raise ValueError(f"deviations.{number}.sites: the model of {robot.name} has no {kind.site} {missing!r}")
        if kind.acts_on == "commands":
            continue
        values = _mass_factor(elements, deviation.values) if kind.name == "mass" else deviation.values
        for element in elements:
            _ENTER[kind.name](element, values)


def _mass_factor(bodies: list[mujoco.MjsBody], values: Values) -> Values:
    """A mass that is added to several bodies is shared out in proportion to theirs."""
    return {"factor": 1.0 + values["change"] / sum(float(body.mass) for body in bodies)}


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
    joint.damping = [max(damping[0] + values["damping"], 0.0), *damping[1:]]


def _armature(joint: mujoco.MjsJoint, values: Values) -> None:
    joint.armature = max(joint.armature + values["inertia"], 0.0)


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


_ENTER: dict[str, Callable[..., None]] = {
    "servo_gain": _gain,
    "servo_torque_limit": _torque_limit,
    "coulomb_friction": _friction,
    "viscous_friction": _damping,
    "joint_damping": _damping,
    "armature": _armature,
    "joint_stiffness": _stiffness,
    "joint_rest_angle": _rest_angle,
    "joint_range": _range,
    "tendon_slack": _slack,
    "tendon_friction": _routing_friction,
    "tendon_detached": _detached,
    "mass": _mass,
    "com_shift": _com,
    "inertia": _inertia,
    "ground_friction": _slippery,
    "foot_compliance": _soft,
    "ground_slope": _slope,
}
