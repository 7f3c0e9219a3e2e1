"""A hidden truth: a robot that is not quite its model, simulated by code that shares nothing with the effect library.

Another time step, integrator and contacts than the nominal model's, nominal numbers off by 5 to 10 %, servos whose
control law is computed here, and mechanisms of their own: a physical play joint, a motor that heats up, a link that
flexes, a cable between a drum and a joint, smooth friction laws, a link that loses commands. A test holds this module
to importing nothing from the folders that diagnose.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from simgap.blind.stand import Stand, of_robot, on_stand

Array = NDArray[np.float64]

PERIOD = 0.005
"""[s] of the recording."""


@dataclass
class Soft:
    """What lies between motor and link: a free play of ``width`` [rad], or a spring of ``stiffness`` [N m/rad].

    ``seen``: whether the joint's sensor sits behind the spring, at the link.
    """

    width: float = 0.0
    stiffness: float = 0.0
    seen: bool = False


@dataclass
class Cable:
    """A cable from a drum to a tendon: it only pulls, after ``slack`` [m], through ``compliance`` [m/N]."""

    slack: float = 0.0
    compliance: float = 0.0
    broken: bool = False
    drum: float = float("nan")


@dataclass
class Link:
    """What happens to commands on their way: ``latency`` [s], ``jitter`` [s] (a mean), ``loss`` (share)."""

    latency: float = 0.0
    jitter: float = 0.0
    loss: float = 0.0


@dataclass
class Truth:
    """A robot that is not quite its model. Faults change its fields before it runs.

    Attributes:
        kp, kv, limit: (nu,) of the servos. servo: (nu,) which actuators are servos; the others obey as motors.
        native: (nu,) actuators that keep MuJoCo's own law, because it is none that is written here.
        delay [s], band, offset, rate: (nu,) of the servos' commands, in the units of the command.
        friction: {dof: law(speed, drive force) -> opposing force}.
        forces: called before each step to add to qfrc_applied. torques: change the servos' forces, (nu,) to (nu,).
        sensors: {column: transform(time, values)}. axes: transforms of several columns at once.
        soft: {joint: id of the motor's joint} where play or a spring was put in between.
        hides_soft: joints whose sensor sits at the motor and does not see what lies behind.
        start: {joint: angle} at the beginning.
    """

    model: mujoco.MjModel
    mapping: Mapping[str, Any]
    kp: Array
    kv: Array
    limit: Array
    servo: NDArray[np.bool_]
    native: NDArray[np.bool_]
    delay: Array
    band: Array
    offset: Array
    rate: Array
    link: Link = field(default_factory=Link)
    sag: float = 0.0
    sag_at: float = 1.0
    friction: dict[int, Callable[[float, float], float]] = field(default_factory=dict)
    forces: list[Callable[[mujoco.MjData], None]] = field(default_factory=list)
    torques: list[Callable[[mujoco.MjData, Array, float], Array]] = field(default_factory=list)
    sensors: dict[str, Callable[[Array, Array], Array]] = field(default_factory=dict)
    axes: list[tuple[tuple[str, ...], Callable[[Array], Array]]] = field(default_factory=list)
    cables: dict[int, Cable] = field(default_factory=dict)
    soft: dict[str, str] = field(default_factory=dict)
    hides_soft: set[str] = field(default_factory=set)
    start: dict[str, float] = field(default_factory=dict)
    quantum: float = 0.0

    def dof(self, joint: str) -> int:
        """Address of a joint's degree of freedom; where play was put in, the motor's."""
        return int(self.model.jnt_dofadr[self.model.joint(self.soft.get(joint, joint)).id])

    def rigid(self, state: tuple[Array, Array], healthy: mujoco.MjModel) -> tuple[Array, Array]:
        """Positions and velocities of a robot in the same place that has less (or nothing) between motors and links."""
        (q, v), at, to = state, self.model, healthy
        position, velocity = np.zeros(to.nq), np.zeros(to.nv)
        for j in range(to.njnt):
            name = str(to.joint(j).name)
            wide = len(to.joint(j).qpos0)
            between = self.soft.get(name, name)
            both = mujoco.mj_name2id(to, mujoco.mjtObj.mjOBJ_JOINT, between) < 0
            for mine in {name, between} if both else {name}:
                k = at.joint(mine).id
                a, b = int(at.jnt_qposadr[k]), int(to.jnt_qposadr[j])
                position[b : b + wide] += q[a : a + wide]
                a, b, dofs = int(at.jnt_dofadr[k]), int(to.jnt_dofadr[j]), 6 if wide == 7 else 3 if wide == 4 else 1
                velocity[b : b + dofs] += v[a : a + dofs]
        return position, velocity

    def addresses(self, joint: str) -> list[int]:
        """Addresses in qpos whose sum is the joint's coordinate."""
        names = [joint, self.soft[joint]] if joint in self.soft else [joint]
        return [int(self.model.jnt_qposadr[self.model.joint(n).id]) for n in names]


def build(
    spec: mujoco.MjSpec,
    mapping: Mapping[str, Any],
    rng: np.random.Generator,
    soft: Mapping[str, Soft | Stand] | None = None,
    spread: tuple[float, float] = (0.05, 0.10),
    start: Mapping[str, float] | None = None,
) -> Truth:
    """The nominal robot with every number off by 5 to 10 % (``spread``), another integrator and a finer time step.

    ``soft``: what lies below bodies, and between joints and their motors, by name.
    """
    for name, below in (soft or {}).items():
        spec = on_stand(spec, name, below) if isinstance(below, Stand) else spec
    nominal = spec.compile()
    between = {name: this for name, this in (soft or {}).items() if isinstance(this, Soft)}
    motors = {name: _split(spec, nominal, name, this) for name, this in between.items()}
    model = spec.compile()

    def off(n: int, kind: str = "") -> Array:
        # A stand is as its fault says.
        drawn = of_robot(model, kind) if kind else np.ones(n, bool)
        found, m = np.ones(n), int(drawn.sum())
        found[drawn] = 1.0 + rng.choice([-1.0, 1.0], m) * rng.uniform(*spread, m)
        return found

    masses = off(model.nbody, "body")
    model.body_mass[:] *= masses
    own = of_robot(model, "body")
    twist = np.ones(model.nbody)
    twist[own] += rng.uniform(-0.5, 0.5, int(own.sum())) * (spread[1] > 0) * 0.1
    model.body_inertia[:] *= (masses * twist)[:, None]
    for name in ("dof_damping", "dof_armature", "jnt_stiffness", "dof_frictionloss"):
        values = getattr(model, name)
        values *= off(len(values), name[:3]).reshape(-1, *[1] * (values.ndim - 1))
    model.geom_friction[:, 0] *= off(1)[0]
    if spread[1] > 0:
        model.geom_solref[:, 0] *= rng.uniform(0.8, 1.2)
    model.opt.timestep = PERIOD / 8 if model.opt.timestep < 0.002 else PERIOD / 5
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICIT
    model.opt.impratio = 3.0
    affine = np.asarray(model.actuator_biastype == int(mujoco.mjtBias.mjBIAS_AFFINE))
    fixed = np.asarray(model.actuator_gaintype == int(mujoco.mjtGain.mjGAIN_FIXED))
    native = ~fixed
    servo = affine & fixed & (model.actuator_biasprm[:, 1] != 0)
    kp, kv = model.actuator_gainprm[:, 0] * off(model.nu), -model.actuator_biasprm[:, 2] * off(model.nu)
    limited = model.actuator_forcelimited.astype(bool)
    limit = np.where(limited, np.abs(model.actuator_forcerange).max(axis=1), np.inf)
    # From here on every actuator is a plain motor; the servo's law is computed below.
    model.actuator_gainprm[~native, 0] = np.where(servo, 1.0, kp)[~native]
    model.actuator_biasprm[~native] = 0.0
    pulls = limited & (model.actuator_forcerange[:, 1] <= 0)
    model.actuator_ctrllimited[:] = 0
    model.actuator_forcelimited[~native] = 0
    mujoco.mj_setConst(model, mujoco.MjData(model))
    nu = model.nu
    made = Truth(
        model,
        mapping,
        kp,
        kv,
        limit,
        servo,
        native,
        np.zeros(nu),
        np.zeros(nu),
        np.zeros(nu),
        np.full(nu, np.inf),
        soft=motors,
        start=dict(start or {}),
    )
    made.cables = {int(a): Cable() for a in np.flatnonzero(pulls & servo)}
    made.hides_soft = {name for name, this in between.items() if this.stiffness > 0 and not this.seen}
    return made


def _split(spec: mujoco.MjSpec, nominal: mujoco.MjModel, name: str, between: Soft) -> str:
    """Put a motor with a joint of its own in front of a joint, which becomes the play or the spring between the two."""
    joint = spec.joint(name)
    index = nominal.joint(name).id
    dof = nominal.jnt_dofadr[index]
    motor = joint.parent.add_joint(
        name=f"{name}_motor",
        type=joint.type,
        axis=joint.axis,
        pos=joint.pos,
        armature=max(float(nominal.dof_armature[dof]), 0.02 * float(nominal.dof_M0[dof]), 2e-5),
        damping=joint.damping,
    )
    for actuator in spec.actuators:
        if actuator.target == name:
            actuator.target = motor.name
    joint.armature = 0.0
    if between.stiffness > 0:
        inertia = float(nominal.dof_M0[dof])
        joint.stiffness = [between.stiffness, 0.0, 0.0]
        joint.damping = np.array([0.08 * np.sqrt(between.stiffness * inertia), 0.0, 0.0])
    else:
        joint.damping = np.array([0.005 * float(nominal.dof_damping[dof]) + 1e-6, 0.0, 0.0])
        # A specification keeps angles as its file wrote them, in degrees unless it says otherwise.
        angular = spec.compiler.degree and joint.type == mujoco.mjtJoint.mjJNT_HINGE
        half = 0.5 * between.width * (180.0 / np.pi if angular else 1.0)
        joint.limited, joint.range = 1, [-half, half]
        joint.solref_limit = [0.003, 1.0]
    return str(motor.name)


@dataclass
class Run:
    """What a truth did: what was recorded, and how hard it worked (for the sizes of faults).

    ``torque`` and ``speed`` are (n, nv), ``position`` {joint: (n,)}, ``force`` (n, nu), ``states`` the positions and
    velocities at each time.
    """

    time: Array
    columns: dict[str, Array]
    torque: Array
    speed: Array
    position: dict[str, Array]
    force: Array
    states: list[tuple[Array, Array]]


def record(
    truth: Truth,
    commands: Array,
    noise: Mapping[str, float],
    rng: np.random.Generator,
    put: Mapping[int, tuple[Array, Array]] | None = None,
) -> Run:
    """Run the truth on commands (n, nu), held over PERIOD; ``noise`` {column: standard deviation}.

    ``put`` {tick: positions and velocities} puts it elsewhere on its way.

    Raises ValueError where the simulation breaks down.
    """
    model, data = truth.model, mujoco.MjData(truth.model)
    _begin(truth, data, commands[0])
    dt = float(model.opt.timestep)
    steps, n = round(PERIOD / dt), len(commands)
    heard = _transmit(truth.link, commands, rng)
    lines = [deque([heard[0, a]] * (round(d / dt) + 1), maxlen=round(d / dt) + 1) for a, d in enumerate(truth.delay)]
    slewed = heard[0].copy()
    slow, late = bool(np.isfinite(truth.rate).any()), bool((truth.delay > 0).any())
    reader = _Reader(truth)
    rows = np.empty((n, len(reader.columns)))
    torque, speed, force = np.empty((n, model.nv)), np.empty((n, model.nv)), np.empty((n, model.nu))
    scalar = [j for j in range(model.njnt) if model.jnt_type[j] != mujoco.mjtJoint.mjJNT_FREE]
    names = [str(model.joint(j).name) for j in scalar]
    position = np.empty((n, len(names)))
    where = [int(model.jnt_qposadr[j]) for j in scalar]
    states: list[tuple[Array, Array]] = []
    for k in range(n):
        if put is not None and k in put:
            data.qpos[:], data.qvel[:] = put[k]
        mujoco.mj_forward(model, data)
        states.append((data.qpos.copy(), data.qvel.copy()))
        rows[k] = reader.read(data)
        torque[k], speed[k], force[k] = data.qfrc_actuator, data.qvel, data.actuator_force
        position[k] = data.qpos[where]
        target = heard[k]
        for _ in range(steps):
            if late:
                for a, line in enumerate(lines):
                    line.append(target[a])
                goal = np.array([line[0] for line in lines])
            else:
                goal = target
            slewed = slewed + np.clip(goal - slewed, -truth.rate * dt, truth.rate * dt) if slow else goal
            _drive(truth, data, slewed, dt)
            mujoco.mj_step(model, data)
        if not np.isfinite(data.qpos).all() or data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number:
            raise ValueError(f"the truth broke down after {k * PERIOD:.2f} s")
    time = np.arange(n, dtype=np.float64) * np.float64(PERIOD)
    columns = _sensed(truth, time, dict(zip(reader.columns, rows.T, strict=True)), noise, rng)
    return Run(time, columns, torque, speed, dict(zip(names, position.T, strict=True)), force, states)


def _begin(truth: Truth, data: mujoco.MjData, command: Array) -> None:
    model = truth.model
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    for name, angle in truth.start.items():
        data.qpos[truth.addresses(name)[-1]] = angle
    mujoco.mj_forward(model, data)
    for a, cable in truth.cables.items():
        cable.drum = min(float(command[a]) + truth.offset[a], float(data.actuator_length[a]))


def _transmit(link: Link, commands: Array, rng: np.random.Generator) -> Array:
    """Commands as they are heard, tick by tick: late, unevenly late, some never. Late ones never undo newer ones."""
    n = len(commands)
    if not (link.latency or link.jitter or link.loss):
        return commands
    arrival = np.arange(n) * PERIOD + link.latency
    if link.jitter:
        arrival = arrival + rng.exponential(link.jitter, n)
    arrival[rng.random(n) < link.loss] = np.inf
    newest = np.zeros(n, np.int64)
    order = np.argsort(arrival, kind="stable")
    best, j = 0, 0
    for k in range(n):
        while j < n and arrival[order[j]] <= k * PERIOD + 1e-9:
            best = max(best, int(order[j]))
            j += 1
        newest[k] = best
    heard: Array = commands[newest]
    return heard


def _drive(truth: Truth, data: mujoco.MjData, command: Array, dt: float) -> None:
    """Set controls and applied forces of one step."""
    error = command + truth.offset - data.actuator_length
    error = np.where(np.abs(error) < truth.band, 0.0, error)
    asked = truth.kp * error - truth.kv * data.actuator_velocity
    # Saturation with a rounded corner, as of a current loop.
    with np.errstate(invalid="ignore"):
        share = np.where(np.isfinite(truth.limit), np.abs(asked) / truth.limit, 0.0)
    torque = asked / (1.0 + share**12) ** (1.0 / 12.0)
    for a, cable in truth.cables.items():
        torque[a] = _pull(truth, data, a, cable, float(command[a] + truth.offset[a]), dt)
    for change in truth.torques:
        torque = change(data, torque, dt)
    if truth.sag:
        # Voltage over a source's resistance: what flows is what the reduced voltage still drives.
        load = float(np.abs(torque[truth.servo]).sum()) / truth.sag_at
        torque = torque / (1.0 + truth.sag * load)
    control = np.where(truth.servo, torque, command + truth.offset)
    data.ctrl[:] = control
    data.qfrc_applied[:] = 0.0
    for dof, law in truth.friction.items():
        data.qfrc_applied[dof] -= law(float(data.qvel[dof]), float(data.qfrc_actuator[dof]))
    for force in truth.forces:
        force(data)


def _pull(truth: Truth, data: mujoco.MjData, a: int, cable: Cable, command: float, dt: float) -> float:
    """Force [N] (negative: a pull) of a drum that follows its command as the servo does, and of the cable behind it."""
    if cable.broken:
        return 0.0
    length, rate = float(data.actuator_length[a]), float(data.actuator_velocity[a])
    kp, kv = float(truth.kp[a]), float(truth.kv[a])
    if cable.compliance > 0.0:
        # The drum turns until the cable's pull and the servo agree: kv dx/dt = kp (u - x) + pull, solved implicitly.
        stiffness = 1.0 / cable.compliance
        taut = length > cable.drum + cable.slack
        k = stiffness if taut else 0.0
        friction = kv or 0.02 * kp
        cable.drum = (friction / dt * cable.drum + kp * command + k * (length - cable.slack)) / (friction / dt + kp + k)
        pull = k * (length - cable.slack - cable.drum)
    else:
        pull = kp * (length - cable.slack - command) + kv * rate
    return -float(np.clip(pull, 0.0, truth.limit[a]))


class _Reader:
    """Reads the map's columns from the simulation by itself: it must not share the diagnosis's idea of a sensor."""

    def __init__(self, truth: Truth) -> None:
        self.columns = [row["column"] for row in truth.mapping["outputs"]]
        self._read = [self._reading(truth, row) for row in truth.mapping["outputs"]]

    def read(self, data: mujoco.MjData) -> list[float]:
        """Values in SI, one a column."""
        return [f(data) for f in self._read]

    @staticmethod
    def _reading(truth: Truth, row: Mapping[str, Any]) -> Callable[[mujoco.MjData], float]:
        model = truth.model
        component = row.get("component")
        if "sensor" in row:
            sensor = model.sensor(row["sensor"]).id
            place, kind = int(model.sensor_adr[sensor]), int(model.sensor_type[sensor])
            if kind == mujoco.mjtSensor.mjSENS_JOINTPOS:
                return _Reader._coordinate(truth, str(model.joint(int(model.sensor_objid[sensor])).name))
            if kind == mujoco.mjtSensor.mjSENS_ACTUATORPOS:
                return _Reader._servo_position(truth, int(model.sensor_objid[sensor]))
            place += "xyz".index(component) if component in ("x", "y", "z") and model.sensor_dim[sensor] == 3 else 0
            place += "wxyz".index(component) if component and model.sensor_dim[sensor] == 4 else 0
            return lambda data: float(data.sensordata[place])
        if "joint" in row:
            return _Reader._coordinate(truth, row["joint"])
        body = model.body(row["body"]).id
        if row["quantity"] == "orientation":
            part = "wxyz".index(component or "w")
            return lambda data: float(data.xquat[body, part])
        axis = "xyz".index(component or "x")
        return lambda data: float(data.xpos[body, axis])

    @staticmethod
    def _coordinate(truth: Truth, joint: str) -> Callable[[mujoco.MjData], float]:
        places = truth.addresses(joint)
        if joint in truth.hides_soft:
            places = places[1:]
        return lambda data: float(sum(data.qpos[p] for p in places))

    @staticmethod
    def _servo_position(truth: Truth, actuator: int) -> Callable[[mujoco.MjData], float]:
        return lambda data: float(data.actuator_length[actuator])


def _sensed(
    truth: Truth, time: Array, columns: dict[str, Array], noise: Mapping[str, float], rng: np.random.Generator
) -> dict[str, Array]:
    for name, transform in truth.sensors.items():
        columns[name] = transform(time, columns[name])
    for names, turn in truth.axes:
        turned = turn(np.stack([columns[n] for n in names], 1))
        columns |= dict(zip(names, turned.T, strict=True))
    for name, values in columns.items():
        noisy = values + noise.get(name, 0.0) * rng.standard_normal(len(values))
        step = truth.quantum * noise.get(name, 0.0)
        columns[name] = np.round(noisy / step) * step if step else noisy
    return columns
