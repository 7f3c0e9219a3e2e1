"""What can be wrong at a joint: friction, springs, stops, a flexible drive."""

from __future__ import annotations

import mujoco
import numpy as np

from simgap.blind.faults.base import Scale, Values, by_chance, steepness
from simgap.blind.truth import Truth


def coulomb(truth: Truth, scale: Scale, joint: str, size: float) -> Values:
    """Dry friction, a share of the joint's torque."""
    level, dof = size * scale.torque[joint], truth.dof(joint)
    slope = steepness(truth, dof, level, scale.speed[joint])
    truth.friction[dof] = lambda v, _: float(level * np.tanh(slope * v / level))
    return {"friction": level}


def stribeck(truth: Truth, scale: Scale, joint: str, size: float) -> Values:
    """Dry friction that is larger at standstill."""
    level, dof = size * scale.torque[joint], truth.dof(joint)
    slope, knee = steepness(truth, dof, level, scale.speed[joint]), 0.2 * scale.speed[joint]
    truth.friction[dof] = lambda v, _: float(level * (0.4 + np.exp(-((v / knee) ** 2))) * np.tanh(slope * v / level))
    return {}


def viscous(truth: Truth, scale: Scale, joint: str, size: float) -> Values:
    """Drag, a share of the joint's torque at its speed."""
    level = size * scale.torque[joint] / scale.speed[joint]
    dof = truth.dof(joint)

    def force(data: mujoco.MjData) -> None:
        data.qfrc_applied[dof] -= level * data.qvel[dof]

    limit = 0.5 * float(truth.model.dof_M0[dof]) / float(truth.model.opt.timestep)
    if level < limit:
        truth.forces.append(force)
    else:  # too stiff for an explicit law
        truth.model.dof_damping[dof] += level
    return {"damping": level}


def load(truth: Truth, scale: Scale, joint: str, size: float) -> Values:
    """Friction that grows with what the motor carries."""
    dof = truth.dof(joint)
    slope = steepness(truth, dof, size * scale.torque[joint], scale.speed[joint])

    def law(v: float, force: float) -> float:
        level = size * abs(force) + 1e-9
        return float(level * np.tanh(slope * v / level))

    truth.friction[dof] = law
    return {"coefficient": size}


def ripple(truth: Truth, scale: Scale, joint: str, size: float) -> Values:
    """Cogging: a wave over the joint's angle with a weaker one of twice as many periods."""
    level, dof, places = size * scale.torque[joint], truth.dof(joint), truth.addresses(joint)
    rng = by_chance(scale, joint)
    period = float(rng.uniform(0.1, 0.35)) * (scale.high[joint] - scale.low[joint])
    wave, (first, second) = 2 * np.pi / period, rng.uniform(0.0, 2 * np.pi, 2)

    def force(data: mujoco.MjData) -> None:
        q = sum(data.qpos[p] for p in places)
        data.qfrc_applied[dof] += level * (np.sin(wave * q + first) + 0.2 * np.sin(2.0 * wave * q + second))

    truth.forces.append(force)
    return {"amplitude": level, "period": period}


def armature(truth: Truth, scale: Scale, joint: str, size: float) -> Values:
    """More inertia of the motor, relative to the joint's."""
    extra = size * scale.inertia[joint]
    truth.model.dof_armature[truth.dof(joint)] += extra
    return {"inertia": extra}


def spring(truth: Truth, scale: Scale, joint: str, size: float) -> Values:
    """A spring that the model lacks, beside the joint."""
    swing = scale.high[joint] - scale.low[joint]
    stiffness, places, dof = (
        2.0 * size * scale.torque[joint] / max(swing, 1e-6),
        truth.addresses(joint),
        truth.dof(joint),
    )

    def force(data: mujoco.MjData) -> None:
        data.qfrc_applied[dof] -= stiffness * sum(data.qpos[p] for p in places)

    truth.forces.append(force)
    return {"stiffness": stiffness}


def fatigue(truth: Truth, scale: Scale, joint: str, size: float) -> Values:
    """A spring that lost a share of its stiffness."""
    truth.model.jnt_stiffness[truth.model.joint(joint).id] *= 1.0 - size
    return {"factor": 1.0 - size}


def creep(truth: Truth, scale: Scale, joint: str, size: float) -> Values:
    """A spring whose rest moved, by a share of the joint's swing."""
    shift = size * (scale.high[joint] - scale.low[joint])
    truth.model.qpos_spring[truth.model.jnt_qposadr[truth.model.joint(joint).id]] += shift
    return {"shift": shift}


def stop(truth: Truth, scale: Scale, joint: str, size: float) -> Values:
    """A stop within the joint's swing."""
    low, high = scale.low[joint], scale.high[joint]
    # The robot begins on the free side of it.
    above = scale.begin[joint] < high - size * (high - low)
    sign, limit = (1.0, high - size * (high - low)) if above else (-1.0, low + size * (high - low))
    dof, places = truth.dof(joint), truth.addresses(joint)
    stiffness = 0.04 * float(truth.model.dof_M0[dof]) / float(truth.model.opt.timestep) ** 2

    def force(data: mujoco.MjData) -> None:
        depth = sign * (sum(data.qpos[p] for p in places) - limit)
        if depth > 0:
            damping = 0.4 * np.sqrt(stiffness * truth.model.dof_M0[dof])
            data.qfrc_applied[dof] -= sign * max(stiffness * depth + sign * damping * data.qvel[dof], 0.0)

    truth.forces.append(force)
    return {"upper" if above else "lower": limit}


def elastic(truth: Truth, scale: Scale, joint: str, size: float) -> Values:
    """A drive that gives way; the spring is put in when the truth is built."""
    return {"compliance": 1.0 / float(truth.model.jnt_stiffness[truth.model.joint(joint).id])}
