"""What can be wrong with a truth: each fault weak, medium and strong at every kind of site, and faults no library has.

The size of a fault is relative to what the healthy robot does in the very recording (its torques, speeds, swings), so
that weak, medium and strong mean the same for a pendulum and for a mouse.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from simgap.blind.stand import STAND, Stand
from simgap.blind.truth import PERIOD, Run, Soft, Truth

Array = NDArray[np.float64]
Values = dict[str, float]

LEVELS = ("weak", "medium", "strong")


@dataclass(frozen=True)
class Scale:
    """What a healthy robot does in a recording: root mean squares and ranges of its motion, by joint and actuator."""

    torque: dict[str, float]
    speed: dict[str, float]
    inertia: dict[str, float]
    low: dict[str, float]
    high: dict[str, float]
    begin: dict[str, float]
    force: Array
    swing: Array
    rate: Array
    total_force: float
    column: dict[str, tuple[float, float]]
    seconds: float

    @classmethod
    def of(cls, truth: Truth, healthy: Run, commands: Array) -> Scale:
        """Measure a healthy run on its commands (n, nu)."""
        model = truth.model
        inertia, torque, speed = {}, {}, {}
        for name in healthy.position:
            dof = truth.dof(name)
            inertia[name] = float(model.dof_M0[dof])
            acceleration = float(np.gradient(healthy.speed[:, dof], healthy.time).std())
            drive = float(np.sqrt((healthy.torque[:, dof] ** 2).mean()))
            torque[name] = max(drive, 0.3 * inertia[name] * acceleration)
            speed[name] = float(healthy.speed[:, dof].std()) or 1.0
        force = np.sqrt((healthy.force**2).mean(axis=0))
        rates = np.abs(np.gradient(commands, healthy.time, axis=0))
        return cls(
            torque,
            speed,
            inertia,
            {n: float(np.percentile(v, 1)) for n, v in healthy.position.items()},
            {n: float(np.percentile(v, 99)) for n, v in healthy.position.items()},
            {n: float(v[0]) for n, v in healthy.position.items()},
            np.percentile(np.abs(healthy.force), 95, axis=0),
            commands.std(axis=0),
            np.percentile(rates, 95, axis=0),
            float(force.sum()),
            {n: (float(v.std()), float(np.abs(v - np.median(v)).max())) for n, v in healthy.columns.items()},
            float(healthy.time[-1]),
        )


Inject = Callable[[Truth, Scale, str, float], Values]


@dataclass(frozen=True)
class Fault:
    """A fault: the name that a diagnosis should give it, the kind of its site, and its relative sizes.

    ``inject(truth, scale, member, size)`` returns the parameters that a diagnosis should find; an empty mapping where
    the mechanism has no parameter in common with the library's.
    """

    name: str
    kind: str
    sizes: tuple[float, float, float]
    inject: Inject
    known: bool = True


def _slope(truth: Truth, dof: int, level: float, speed: float) -> float:
    """Of a smooth friction law at standstill: steep, but no steeper than the time step can carry."""
    return min(0.5 * float(truth.model.dof_M0[dof]) / float(truth.model.opt.timestep), level / (0.01 * speed))


def _coulomb(truth: Truth, scale: Scale, joint: str, size: float) -> Values:
    level, dof = size * scale.torque[joint], truth.dof(joint)
    slope = _slope(truth, dof, level, scale.speed[joint])
    truth.friction[dof] = lambda v, _: float(level * np.tanh(slope * v / level))
    return {"friction": level}


def _stribeck(truth: Truth, scale: Scale, joint: str, size: float) -> Values:
    level, dof = size * scale.torque[joint], truth.dof(joint)
    slope, knee = _slope(truth, dof, level, scale.speed[joint]), 0.2 * scale.speed[joint]
    truth.friction[dof] = lambda v, _: float(level * (0.4 + np.exp(-((v / knee) ** 2))) * np.tanh(slope * v / level))
    return {}


def _viscous(truth: Truth, scale: Scale, joint: str, size: float) -> Values:
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


def _load(truth: Truth, scale: Scale, joint: str, size: float) -> Values:
    dof = truth.dof(joint)
    slope = _slope(truth, dof, size * scale.torque[joint], scale.speed[joint])

    def law(v: float, force: float) -> float:
        level = size * abs(force) + 1e-9
        return float(level * np.tanh(slope * v / level))

    truth.friction[dof] = law
    return {"coefficient": size}


def _by_chance(scale: Scale, joint: str) -> np.random.Generator:
    """The same for a joint of one recording."""
    return np.random.default_rng(round(1e6 * abs(scale.high[joint] - scale.low[joint])))


def _ripple(truth: Truth, scale: Scale, joint: str, size: float) -> Values:
    """Cogging: a wave over the joint's angle with a weaker one of twice as many periods."""
    level, dof, places = size * scale.torque[joint], truth.dof(joint), truth.addresses(joint)
    rng = _by_chance(scale, joint)
    period = float(rng.uniform(0.1, 0.35)) * (scale.high[joint] - scale.low[joint])
    wave, (first, second) = 2 * np.pi / period, rng.uniform(0.0, 2 * np.pi, 2)

    def force(data: mujoco.MjData) -> None:
        q = sum(data.qpos[p] for p in places)
        data.qfrc_applied[dof] += level * (np.sin(wave * q + first) + 0.2 * np.sin(2.0 * wave * q + second))

    truth.forces.append(force)
    return {"amplitude": level, "period": period}


def _armature(truth: Truth, scale: Scale, joint: str, size: float) -> Values:
    extra = size * scale.inertia[joint]
    truth.model.dof_armature[truth.dof(joint)] += extra
    return {"inertia": extra}


def _spring(truth: Truth, scale: Scale, joint: str, size: float) -> Values:
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


def _fatigue(truth: Truth, scale: Scale, joint: str, size: float) -> Values:
    truth.model.jnt_stiffness[truth.model.joint(joint).id] *= 1.0 - size
    return {"factor": 1.0 - size}


def _creep(truth: Truth, scale: Scale, joint: str, size: float) -> Values:
    shift = size * (scale.high[joint] - scale.low[joint])
    truth.model.qpos_spring[truth.model.jnt_qposadr[truth.model.joint(joint).id]] += shift
    return {"shift": shift}


def _stop(truth: Truth, scale: Scale, joint: str, size: float) -> Values:
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


def _mass(truth: Truth, scale: Scale, body: str, size: float) -> Values:
    index = truth.model.body(body).id
    extra = size * float(truth.model.body_mass[index])
    truth.model.body_mass[index] *= 1.0 + size
    truth.model.body_inertia[index] *= 1.0 + size
    return {"change": extra}


def _gyration(truth: Truth, body: int) -> float:
    return float(np.sqrt(truth.model.body_inertia[body].max() / truth.model.body_mass[body]))


def _com(truth: Truth, scale: Scale, body: str, size: float) -> Values:
    index = truth.model.body(body).id
    # Along the body's x: what hangs or stands shows that best.
    shift = np.array([size * _gyration(truth, index), 0.0, 0.0])
    truth.model.body_ipos[index] += shift
    truth.model.body_sameframe[index] = truth.model.body_simple[index] = 0
    return dict(zip("xyz", map(float, shift), strict=True))


def _inertia(truth: Truth, scale: Scale, body: str, size: float) -> Values:
    truth.model.body_inertia[truth.model.body(body).id] *= 1.0 + size
    return {"factor": 1.0 + size}


def _index(truth: Truth, actuator: str) -> int:
    return int(truth.model.actuator(actuator).id)


def _delay(truth: Truth, scale: Scale, actuator: str, size: float) -> Values:
    truth.delay[_index(truth, actuator)] = size
    return {"delay": size}


def _band(truth: Truth, scale: Scale, actuator: str, size: float) -> Values:
    a = _index(truth, actuator)
    truth.band[a] = size * scale.swing[a]
    return {"half_width": float(truth.band[a])}


def _offset(truth: Truth, scale: Scale, actuator: str, size: float) -> Values:
    a = _index(truth, actuator)
    truth.offset[a] = size * scale.swing[a]
    return {"offset": float(truth.offset[a])}


def _rate(truth: Truth, scale: Scale, actuator: str, size: float) -> Values:
    a = _index(truth, actuator)
    truth.rate[a] = size * scale.rate[a]
    return {"limit": float(truth.rate[a])}


def _gain(truth: Truth, scale: Scale, actuator: str, size: float) -> Values:
    a = _index(truth, actuator)
    if truth.servo[a]:
        truth.kp[a] *= size
        truth.kv[a] *= size
    else:
        truth.model.actuator_gainprm[a, 0] *= size
    return {"factor": size}


def _torque_limit(truth: Truth, scale: Scale, actuator: str, size: float) -> Values:
    a = _index(truth, actuator)
    truth.limit[a] = size * float(scale.force[a])
    return {"limit": float(truth.limit[a])}


def _sag(truth: Truth, scale: Scale, _: str, size: float) -> Values:
    truth.sag, truth.sag_at = size, scale.total_force
    return {}


def _varied(size: float) -> float:
    """A number in [0, 1) that differs from case to case, as sizes do, and is the same whenever a case is made again."""
    return float(np.modf(97.0 * size)[0])


def _hot(truth: Truth, scale: Scale, actuator: str, size: float) -> Values:
    """A motor that heats with the square of its torque within seconds and loses torque as it does."""
    a = _index(truth, actuator)
    heat, time = 0.0, 2.5 + 3.5 * _varied(size)

    def change(data: mujoco.MjData, torque: Array, dt: float) -> Array:
        nonlocal heat
        heat += dt / time * (float((torque[a] / max(scale.force[a], 1e-9)) ** 2) - heat)
        torque = torque.copy()
        torque[a] *= 1.0 / (1.0 + 4.0 * size * heat)
        return torque

    truth.torques.append(change)
    # How much it loses is relative to a torque that nobody who diagnoses knows.
    return {"time": time}


def _cable(change: Callable[[Truth, Scale, int, float], Values]) -> Inject:
    def inject(truth: Truth, scale: Scale, tendon: str, size: float) -> Values:
        model, target = truth.model, truth.model.tendon(tendon).id
        through = model.actuator_trntype == mujoco.mjtTrn.mjTRN_TENDON
        return change(truth, scale, int(np.flatnonzero(through & (model.actuator_trnid[:, 0] == target))[0]), size)

    return inject


def _slack(truth: Truth, scale: Scale, a: int, size: float) -> Values:
    truth.cables[a].slack = size * float(scale.swing[a])
    return {"slack": truth.cables[a].slack}


def _stretch(truth: Truth, scale: Scale, a: int, size: float) -> Values:
    truth.cables[a].compliance = size / float(truth.kp[a])
    return {"compliance": truth.cables[a].compliance}


def _broken(truth: Truth, scale: Scale, a: int, size: float) -> Values:
    truth.cables[a].broken = True
    return {"share": 1.0}


def _routing(truth: Truth, scale: Scale, a: int, size: float) -> Values:
    """Capstan friction would grow with the pull; this is the constant part, of the sheath."""
    level, tendon = size * float(scale.force[a]), int(truth.model.actuator_trnid[a, 0])
    speed = float(scale.rate[a]) or 1e-3

    def force(data: mujoco.MjData) -> None:
        slide = float(np.tanh(data.ten_velocity[tendon] / (0.02 * speed)))
        jacobian = data.ten_J.reshape(truth.model.ntendon, -1)
        if jacobian.shape[1] == truth.model.nv:
            data.qfrc_applied[:] -= level * slide * jacobian[tendon]
        else:  # stored row by row without its zeros
            first, count = int(truth.model.ten_J_rowadr[tendon]), int(truth.model.ten_J_rownnz[tendon])
            where = truth.model.ten_J_colind[first : first + count]
            data.qfrc_applied[where] -= level * slide * data.ten_J[first : first + count]

    truth.forces.append(force)
    return {"friction": level}


def _loose_strap(truth: Truth, scale: Scale, tendon: str, size: float) -> Values:
    index = truth.model.tendon(tendon).id
    slack = size * float(truth.model.tendon_range[index, 1])
    truth.model.tendon_range[index, 1] += slack
    return {"slack": slack}


def _cut_strap(truth: Truth, scale: Scale, tendon: str, size: float) -> Values:
    truth.model.tendon_limited[truth.model.tendon(tendon).id] = 0
    return {"share": 1.0}


def _slippery(truth: Truth, scale: Scale, geom: str, size: float) -> Values:
    index = truth.model.geom(geom).id
    truth.model.geom_friction[index, 0] *= size
    truth.model.geom_priority[index] = int(truth.model.geom_priority.max()) + (truth.model.geom_priority[index] <= 0)
    return {"factor": size}


def _soft_foot(truth: Truth, scale: Scale, geom: str, size: float) -> Values:
    index = truth.model.geom(geom).id
    truth.model.geom_solref[index, 0] = size * max(float(truth.model.geom_solref[index, 0]), 1e-3)
    truth.model.geom_priority[index] = int(truth.model.geom_priority.max()) + (truth.model.geom_priority[index] <= 0)
    return {}


def _slope_of_ground(truth: Truth, scale: Scale, _: str, size: float) -> Values:
    """The floor itself is tilted about y."""
    model = truth.model
    for g in np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE):
        model.geom_quat[g] = [np.cos(size / 2), 0.0, np.sin(size / 2), 0.0]
        model.geom_sameframe[g] = 0
    return {"pitch": size}


def _bias(truth: Truth, scale: Scale, column: str, size: float) -> Values:
    bias = size * scale.column[column][0]
    truth.sensors[column] = lambda t, y: y + bias
    return {"bias": bias}


def _scaled(truth: Truth, scale: Scale, column: str, size: float) -> Values:
    truth.sensors[column] = lambda t, y: size * y
    return {"factor": size}


def _late(truth: Truth, scale: Scale, column: str, size: float) -> Values:
    truth.sensors[column] = lambda t, y: np.interp(t - size, t, y)
    return {"delay": size}


def _smoothed(truth: Truth, scale: Scale, column: str, size: float) -> Values:
    """Two equal filters one after the other, with the lag of one."""

    def smooth(t: Array, y: Array) -> Array:
        steps = 0.5 * size / float(t[1] - t[0])
        keep = steps / (1.0 + steps)
        for _ in range(2):
            y = lfilter([1.0 - keep], [1.0, -keep], y, zi=[keep * y[0]])[0]
        return y

    truth.sensors[column] = smooth
    return {"delay": size}


def _saturated(truth: Truth, scale: Scale, column: str, size: float) -> Values:
    truth.sensors[column] = lambda t, y: np.clip(y, *_ends(y, size))
    return {}


def _ends(y: Array, size: float) -> tuple[float, float]:
    top = size * float(np.abs(y).max())
    return -top, top


def _askew(truth: Truth, scale: Scale, column: str, size: float) -> Values:
    """``column`` is the first of three; the mounting is turned about the axis (1, 1, 1)."""
    row = next(r for r in truth.mapping["outputs"] if r["column"] == column)
    names = tuple(r["column"] for r in truth.mapping["outputs"] if r.get("sensor") == row["sensor"])
    if any(n == names for n, _ in truth.axes):
        return {}
    vector = np.full(3, size / np.sqrt(3.0))
    quaternion, matrix = np.zeros(4), np.zeros(9)
    mujoco.mju_axisAngle2Quat(quaternion, vector / np.linalg.norm(vector), float(np.linalg.norm(vector)))
    mujoco.mju_quat2Mat(matrix, quaternion)
    turn = matrix.reshape(3, 3).T
    truth.axes.append((names, lambda y: y @ turn.T))
    return {}


def _latency(truth: Truth, scale: Scale, _: str, size: float) -> Values:
    truth.link.latency = size
    # A robot takes up what has arrived at its next tick.
    return {"delay": float(np.ceil(size / PERIOD - 1e-9)) * PERIOD}


def _jitter(truth: Truth, scale: Scale, _: str, size: float) -> Values:
    truth.link.jitter = size
    return {}


def _loss(truth: Truth, scale: Scale, _: str, size: float) -> Values:
    truth.link.loss = size
    return {}


def soft_of(name: str, size: float, scale: Scale, joint: str, actuator: int) -> Soft | None:
    """What a fault puts between motor and link; None for faults that change the finished truth."""
    if name == "servo_backlash":
        return Soft(width=size * float(scale.swing[actuator]))
    if name in ("flexing_link", "joint_elasticity"):
        swing = max(scale.high[joint] - scale.low[joint], 1e-6)
        return Soft(stiffness=4.0 * scale.torque[joint] / (size * swing), seen=name == "joint_elasticity")
    return None


def _built_in(truth: Truth, scale: Scale, member: str, size: float) -> Values:
    """Play and flexing links are put in when the truth is built."""
    return {}


def _elastic(truth: Truth, scale: Scale, joint: str, size: float) -> Values:
    return {"compliance": 1.0 / float(truth.model.jnt_stiffness[truth.model.joint(joint).id])}


def _backlash(truth: Truth, scale: Scale, actuator: str, size: float) -> Values:
    return {"width": size * float(scale.swing[_index(truth, actuator)])}


def stand_of(scale: Scale, size: float) -> Stand:
    """What gives way under the robot, relative to what its strongest joint does."""
    torque, swing = max(scale.torque.values()), max(scale.high[j] - scale.low[j] for j in scale.high)
    return Stand(4.0 * torque / (size * max(swing, 1e-6)))


def _soft_mount(truth: Truth, scale: Scale, body: str, size: float) -> Values:
    """The stand is put in when the truth is built; its two axes differ a little, the mean counts."""
    model = truth.model
    names = (f"{STAND}_{axis}" for axis in "xy")
    return {"compliance": float(np.mean([1.0 / np.ravel(model.jnt_stiffness[model.joint(n).id])[0] for n in names]))}


FAULTS: tuple[Fault, ...] = (
    Fault("coulomb_friction", "joint", (0.12, 0.3, 0.7), _coulomb),
    Fault("viscous_friction", "unsprung", (0.15, 0.35, 0.8), _viscous),
    Fault("stribeck_friction", "joint", (0.1, 0.25, 0.5), _stribeck),
    Fault("load_friction", "driven", (0.12, 0.25, 0.45), _load),
    Fault("torque_ripple", "geared", (0.2, 0.4, 0.9), _ripple),
    Fault("armature", "joint", (0.25, 0.6, 1.5), _armature),
    Fault("joint_stiffness", "joint", (0.2, 0.5, 1.2), _spring),
    Fault("joint_stiffness", "sprung", (0.25, 0.45, 0.75), _fatigue),
    Fault("joint_rest_angle", "sprung", (0.15, 0.35, 0.8), _creep),
    Fault("joint_damping", "sprung", (0.15, 0.35, 0.8), _viscous),
    Fault("joint_range", "joint", (0.12, 0.25, 0.45), _stop),
    Fault("mass", "body", (0.25, 0.5, 1.0), _mass),
    Fault("com_shift", "unbalanced", (0.25, 0.5, 1.0), _com),
    Fault("inertia", "turned", (0.5, 1.0, 2.5), _inertia),
    Fault("servo_delay", "actuator", (0.006, 0.015, 0.04), _delay),
    Fault("servo_dead_band", "servo", (0.04, 0.1, 0.25), _band),
    Fault("servo_backlash", "play", (0.05, 0.12, 0.3), _backlash),
    Fault("joint_elasticity", "elastic", (0.04, 0.1, 0.25), _elastic),
    Fault("soft_mount", "mounted", (0.015, 0.04, 0.1), _soft_mount),
    Fault("servo_gain", "actuator", (0.75, 0.6, 0.4), _gain),
    Fault("servo_offset", "servo", (0.1, 0.2, 0.5), _offset),
    Fault("servo_rate_limit", "servo", (0.85, 0.65, 0.4), _rate),
    Fault("servo_torque_limit", "servo", (0.8, 0.6, 0.4), _torque_limit),
    Fault("thermal_drift", "servo", (0.3, 0.6, 1.2), _hot),
    Fault("supply_sag", "supply", (0.12, 0.25, 0.45), _sag),
    Fault("tendon_slack", "cable", (0.15, 0.4, 1.0), _cable(_slack)),
    Fault("tendon_elasticity", "cable", (0.4, 1.0, 3.0), _cable(_stretch)),
    Fault("tendon_friction", "cable", (0.1, 0.25, 0.5), _cable(_routing)),
    Fault("tendon_detached", "cable", (1.0, 1.0, 1.0), _cable(_broken)),
    Fault("tendon_slack", "strap", (0.02, 0.05, 0.12), _loose_strap),
    Fault("tendon_detached", "strap", (1.0, 1.0, 1.0), _cut_strap),
    Fault("ground_friction", "foot", (0.6, 0.4, 0.2), _slippery),
    Fault("ground_slope", "ground", (0.03, 0.06, 0.12), _slope_of_ground),
    # A foot sinks in by the square of this; twice as strong would be softer than the leg is long.
    Fault("foot_compliance", "foot", (1.5, 2.2, 3.2), _soft_foot),
    Fault("sensor_bias", "sensor", (0.05, 0.12, 0.3), _bias),
    Fault("sensor_scale", "sensor", (1.05, 1.12, 1.3), _scaled),
    Fault("sensor_delay", "sensor", (0.006, 0.015, 0.04), _late),
    Fault("sensor_delay", "filtered", (0.006, 0.015, 0.04), _smoothed),
    Fault("sensor_saturation", "sensor", (0.85, 0.7, 0.5), _saturated),
    Fault("sensor_misalignment", "axes", (0.06, 0.15, 0.35), _askew),
    Fault("link_latency", "several", (0.008, 0.02, 0.05), _latency),
    Fault("link_jitter", "all", (0.008, 0.02, 0.05), _jitter),
    Fault("link_loss", "all", (0.3, 0.55, 0.8), _loss),
)
"""Names are those of the diagnosis's contract; mechanisms and laws are not its own."""


def _tight_spot(truth: Truth, scale: Scale, joint: str, size: float) -> Values:
    """A bent shaft, a damaged tooth: dry friction that is six times as large in a part of the joint's range."""
    most, dof, places = size * scale.torque[joint], truth.dof(joint), truth.addresses(joint)
    swing = scale.high[joint] - scale.low[joint]
    spot = scale.low[joint] + float(_by_chance(scale, joint).uniform(0.3, 0.7)) * swing
    slope = _slope(truth, dof, most, scale.speed[joint])

    def force(data: mujoco.MjData) -> None:
        away = (sum(data.qpos[p] for p in places) - spot) / (0.12 * swing)
        level = most * (1.0 + 5.0 * float(np.exp(-(away**4)))) / 6.0
        data.qfrc_applied[dof] -= level * np.tanh(slope * data.qvel[dof] / level)

    truth.forces.append(force)
    return {}


def _push(truth: Truth, scale: Scale, joint: str, size: float) -> Values:
    level, dof = size * scale.torque[joint], truth.dof(joint)

    def force(data: mujoco.MjData) -> None:
        data.qfrc_applied[dof] += level * (np.sin(2 * np.pi * 0.83 * data.time) > 0.3)

    truth.forces.append(force)
    return {}


def _drag(truth: Truth, scale: Scale, joint: str, size: float) -> Values:
    level = size * scale.torque[joint] / scale.speed[joint] ** 3
    truth.friction[truth.dof(joint)] = lambda v, _: level * v**3
    return {}


def _one_sided(truth: Truth, scale: Scale, joint: str, size: float) -> Values:
    swing, dof, places = scale.high[joint] - scale.low[joint], truth.dof(joint), truth.addresses(joint)
    level, middle = size * scale.torque[joint], 0.5 * (scale.low[joint] + scale.high[joint])

    def force(data: mujoco.MjData) -> None:
        q = 2.0 * (sum(data.qpos[p] for p in places) - middle) / swing
        data.qfrc_applied[dof] -= level * (3.0 * q**3 if q > 0 else -np.sqrt(-q))

    truth.forces.append(force)
    return {}


def _slipped(truth: Truth, scale: Scale, actuator: str, size: float) -> Values:
    """A horn slips a tooth, or its screw loosens: the servo's zero jumps once, at 30 to 70 % of the recording."""
    a, jump = _index(truth, actuator), size * float(scale.swing[_index(truth, actuator)])
    before, moment = float(truth.offset[a]), scale.seconds * (0.3 + 0.4 * _varied(size))

    def slip(data: mujoco.MjData, torque: Array, dt: float) -> Array:
        truth.offset[a] = before + (jump if data.time >= moment else 0.0)
        return torque

    truth.torques.append(slip)
    return {}


def _hysteresis(truth: Truth, scale: Scale, joint: str, size: float) -> Values:
    """A Bouc-Wen element: a spring that yields and remembers."""
    dof, places = truth.dof(joint), truth.addresses(joint)
    swing, memory, last = scale.high[joint] - scale.low[joint], 0.0, float("nan")
    level = 1.5 * size * scale.torque[joint]

    def force(data: mujoco.MjData) -> None:
        nonlocal memory, last
        q = float(sum(data.qpos[p] for p in places))
        move = 0.0 if np.isnan(last) else (q - last) / (0.15 * swing)
        last = q
        memory += move - abs(move) * memory * abs(memory) ** 0.5
        memory = float(np.clip(memory, -1.5, 1.5))
        data.qfrc_applied[dof] -= level * memory * (1.0 + 0.8 * np.sin(2.2 * data.time))

    truth.forces.append(force)
    return {}


def _crosstalk(truth: Truth, scale: Scale, actuator: str, size: float) -> Values:
    """Part of another motor's force arrives here, squared."""
    a = _index(truth, actuator)
    others = [i for i in np.flatnonzero(truth.servo) if i != a]

    def change(data: mujoco.MjData, torque: Array, dt: float) -> Array:
        torque = torque.copy()
        for other in others[:1]:
            share = torque[other] / max(scale.force[other], 1e-9)
            torque[a] += size * scale.force[a] * share * abs(share)
        return torque

    truth.torques.append(change)
    return {}


def _sticky(truth: Truth, scale: Scale, column: str, size: float) -> Values:
    """A sensor that now and then hangs for a while."""

    def hang(t: Array, y: Array) -> Array:
        rng, out = np.random.default_rng(round(1e6 * abs(float(y[len(y) // 2])))), y.copy()
        position = 0
        while position < len(y):
            position += int(rng.exponential(0.5) / (t[1] - t[0])) + 1
            length = int(rng.uniform(0.5, 1.5) * size * 0.4 / (t[1] - t[0])) + 2
            out[position : position + length] = y[min(position, len(y) - 1)]
            position += length
        return out

    truth.sensors[column] = hang
    return {}


UNKNOWN: tuple[Fault, ...] = (
    Fault("tight_spot", "joint", (0.4, 0.8, 1.6), _tight_spot, known=False),
    Fault("periodic_push", "joint", (0.15, 0.35, 0.8), _push, known=False),
    Fault("cubic_drag", "joint", (0.15, 0.35, 0.7), _drag, known=False),
    Fault("odd_spring", "joint", (0.15, 0.35, 0.8), _one_sided, known=False),
    Fault("slipped_horn", "servo", (0.1, 0.2, 0.5), _slipped, known=False),
    Fault("hysteresis", "joint", (0.2, 0.4, 0.8), _hysteresis, known=False),
    Fault("flexing_link", "flexing", (0.1, 0.2, 0.4), _built_in, known=False),
    Fault("crosstalk", "servo", (0.2, 0.4, 0.8), _crosstalk, known=False),
    Fault("hanging_sensor", "sensor", (0.15, 0.3, 0.6), _sticky, known=False),
)


def fault(name: str, kind: str) -> Fault:
    """A fault by its name and the kind of its site."""
    return next(f for f in (*FAULTS, *UNKNOWN) if (f.name, f.kind) == (name, kind))
