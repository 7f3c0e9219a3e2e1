"""Recordings of a hidden truth, by code that shares nothing with the effect library.

Another time step and integrator than the nominal model's, nominal numbers off by 5 to 10 %, servos whose control law is
computed here, and mechanisms of their own: a physical play joint for backlash, smooth friction laws, a tilted floor, a
buffer of commands for a delay. A test holds this file to importing nothing from nermo_gap.core.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

PERIOD = 0.005
"""[s] of the recording."""


@dataclass
class Truth:
    """A robot that is not quite its model. Faults (see FAULTS) change its fields before it runs."""

    model: mujoco.MjModel
    kp: Array
    kv: Array
    limit: Array
    servo: NDArray[np.bool_]
    delay: Array
    band: Array
    offset: Array
    rate: Array
    sag: float = 0.0
    friction: dict[int, Callable[[float, float], float]] = field(default_factory=dict)
    forces: list[Callable[[mujoco.MjData], None]] = field(default_factory=list)
    sensors: dict[int, Callable[[Array, Array], Array]] = field(default_factory=dict)
    play: dict[int, int] = field(default_factory=dict)
    lose: float = 0.0


def build(
    xml: str, rng: np.random.Generator, play: dict[str, float] | None = None, spread: tuple[float, float] = (0.05, 0.10)
) -> Truth:
    """The nominal robot with every number off by 5 to 10 %, another integrator and a finer time step.

    ``play`` gives joints a free motion [rad] between the motor, which gets a joint of its own, and the link.
    """
    spec = mujoco.MjSpec.from_string(xml)
    nominal = spec.compile()
    play_joints: dict[int, int] = {}
    for name, width in (play or {}).items():
        joint = spec.joint(name)
        index = nominal.joint(name).id
        motor = joint.parent.add_joint(
            name=f"{name}_motor",
            type=joint.type,
            axis=joint.axis,
            pos=joint.pos,
            armature=max(float(nominal.dof_armature[nominal.jnt_dofadr[index]]), 2e-4),
            damping=joint.damping,
        )
        for actuator in spec.actuators:
            if actuator.target == name:
                actuator.target = motor.name
        joint.armature, joint.damping = 0.0, np.array([1e-4, 0.0, 0.0])
        joint.limited, joint.range = 1, [-width / 2, width / 2]
        joint.solref_limit = [0.003, 1.0]
        play_joints[index] = -1
    model = spec.compile()
    for name in play or {}:
        play_joints[nominal.joint(name).id] = model.joint(f"{name}_motor").id

    def off(n: int) -> Array:
        return 1.0 + rng.choice([-1.0, 1.0], n) * rng.uniform(*spread, n)

    masses = off(model.nbody)
    model.body_mass[:] *= masses
    model.body_inertia[:] *= (masses * (1.0 + rng.uniform(-0.05, 0.05, model.nbody)))[:, None]
    for values in (model.dof_damping, model.dof_armature, model.jnt_stiffness, model.dof_frictionloss):
        values *= off(len(values)).reshape(-1, *[1] * (values.ndim - 1))
    model.geom_friction[:, 0] *= off(1)[0]
    model.opt.timestep = PERIOD / 8 if model.opt.timestep < 0.002 else PERIOD / 5
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICIT
    model.geom_solref[:, 0] *= rng.uniform(0.8, 1.2)
    servo = np.asarray(model.actuator_biastype == int(mujoco.mjtBias.mjBIAS_AFFINE))
    gains = off(model.nu)
    kp, kv = model.actuator_gainprm[:, 0] * gains, -model.actuator_biasprm[:, 2] * off(model.nu)
    limited = model.actuator_forcelimited.astype(bool)
    limit = np.where(limited, model.actuator_forcerange[:, 1], np.inf)
    # From here on every actuator is a plain motor; the servo's law is computed below.
    model.actuator_gainprm[:, 0] = np.where(servo, 1.0, kp)
    model.actuator_biasprm[:] = 0.0
    model.actuator_ctrllimited[:], model.actuator_forcelimited[:] = 0, 0
    mujoco.mj_setConst(model, mujoco.MjData(model))
    nu = model.nu
    zeros, infinite = np.zeros(nu), np.full(nu, np.inf)
    return Truth(model, kp, kv, limit, servo, zeros.copy(), zeros.copy(), zeros.copy(), infinite, play=play_joints)


def record(
    truth: Truth,
    commands: Array,
    read: list[tuple[str, str]],
    noise: float,
    rng: np.random.Generator,
) -> tuple[Array, Array]:
    """Run the truth on commands (n, nu) held over PERIOD; returns time (n,) and outputs (n, no).

    ``read`` lists (kind, name): a joint's position, or a body's height.
    """
    model, data = truth.model, mujoco.MjData(truth.model)
    steps, dt = round(PERIOD / truth.model.opt.timestep), truth.model.opt.timestep
    lines = [deque([0.0] * (round(d / dt) + 1), maxlen=round(d / dt) + 1) for d in truth.delay]
    for a, line in enumerate(lines):
        line.extend([commands[0, a]] * len(line))
    slewed, held = commands[0].copy(), commands[0].copy()
    rows = np.empty((len(commands), len(read)))
    last = 0.0
    for k, command in enumerate(commands):
        mujoco.mj_forward(model, data)
        for i, (kind, name) in enumerate(read):
            rows[k, i] = _read(truth, data, kind, name)
        if rng.random() >= truth.lose:
            held = command
        for _ in range(steps):
            for a in range(model.nu):
                lines[a].append(held[a])
                slewed[a] += float(np.clip(lines[a][0] - slewed[a], -truth.rate[a] * dt, truth.rate[a] * dt))
            torque = _servo_torque(truth, data, slewed)
            share = min(truth.sag * last, 0.9)
            data.ctrl[:] = np.where(truth.servo, torque * (1.0 - share), torque)
            last = float(np.abs(data.ctrl / np.where(np.isfinite(truth.limit), truth.limit, 1.0)).mean())
            data.qfrc_applied[:] = 0.0
            for dof, law in truth.friction.items():
                data.qfrc_applied[dof] -= law(float(data.qvel[dof]), float(data.qfrc_actuator[dof]))
            for force in truth.forces:
                force(data)
            mujoco.mj_step(model, data)
    time: Array = np.arange(len(commands), dtype=np.float64) * np.float64(PERIOD)
    for i, sensor in truth.sensors.items():
        rows[:, i] = sensor(time, rows[:, i])
    return time, rows + noise * rng.standard_normal(rows.shape)


def _servo_torque(truth: Truth, data: mujoco.MjData, command: Array) -> Array:
    error = command + truth.offset - data.actuator_length
    error = np.where(np.abs(error) < truth.band, 0.0, error)
    torque = np.clip(truth.kp * error - truth.kv * data.actuator_velocity, -truth.limit, truth.limit)
    return np.where(truth.servo, torque, command + truth.offset)


def _read(truth: Truth, data: mujoco.MjData, kind: str, name: str) -> float:
    model = truth.model
    if kind == "height":
        return float(data.xpos[model.body(name).id, 2])
    joint = model.joint(name).id
    value = float(data.qpos[model.jnt_qposadr[joint]])
    for original, motor in truth.play.items():
        if model.joint(motor).name == f"{name}_motor" and original >= 0:
            value += float(data.qpos[model.jnt_qposadr[motor]])
    return value
