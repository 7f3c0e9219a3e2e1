"""C's toy simulation (C 2.5.1): legs on a fixed base, let go from 10 degrees ahead with the knee folded by 10 %.

No ground, no servos; springs, friction and gravity alone bring the legs to rest, if the step is short enough.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import Literal, Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from nermo_control.legs.aslp import AslpPose
from nermo_control.pantograph_controller import aslp_leg
from nermo_description.blocks.pantograph import build_pantograph_leg
from nermo_description.pantograph import PantographLeg, PantographParameters
from nermo_description.pantograph_model import set_leg
from nermo_sim.leg_dynamics.massless import FollowingLegs, LookUpLegs, make_massless
from nermo_sim.leg_dynamics.minimal import MinimalLegs, make_minimal, set_minimal_leg

Kind = Literal["constraints", "minimal", "massless", "massless_friction"]
KINDS: tuple[Kind, ...] = ("constraints", "minimal", "massless", "massless_friction")
Integrator = Literal["euler", "semi_implicit", "implicit_fast"]
HIP_FRICTION = 8e-3
"""Viscous friction of the hip without its servo [N m s/rad]: chosen, all models come to rest within a second."""
HIP_START = math.radians(10.0)
KNEE_START = 1.1
DURATION = 1.0
"""Of one simulation [s]."""
AT_REST = 0.01
"""Kinetic energy over the energy at the start below which the legs rest [1]."""
_INTEGRATORS = {
    "semi_implicit": mujoco.mjtIntegrator.mjINT_EULER,
    "implicit_fast": mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
    "euler": mujoco.mjtIntegrator.mjINT_EULER,
}


class Forces(Protocol):
    """What a model needs beside MuJoCo."""

    def apply(self, data: mujoco.MjData, step: float) -> None:
        """Writes generalised forces for the next step [s]."""
        ...


class NoForces:
    """Closed loops: MuJoCo does it all."""

    def apply(self, data: mujoco.MjData, step: float) -> None:
        """Nothing to write."""


@dataclass(slots=True)
class FixedBase:
    """Legs on a fixed base."""

    kind: Kind
    model: mujoco.MjModel
    data: mujoco.MjData
    forces: Forces
    start_energy: float
    """Of one leg above its rest [J]."""

    def step(self, step: float, integrator: Integrator) -> None:
        """One step [s]. `euler` is the explicit one that C had; MuJoCo's own are semi-implicit."""
        self.forces.apply(self.data, step)
        if integrator != "euler":
            mujoco.mj_step(self.model, self.data)
            return
        mujoco.mj_forward(self.model, self.data)
        mujoco.mj_integratePos(self.model, self.data.qpos, self.data.qvel, step)
        self.data.qvel += step * self.data.qacc
        self.data.time += step


def stiffened(robot: PantographParameters, ratio: float) -> PantographParameters:
    """The robot with all springs of its legs stiffer by a ratio; the friction stays."""
    leg = robot.leg
    springs = ("diagonal_stiffness", "parallel_stiffness", "toe_stiffness")
    changed = leg.model_copy(update={name: ratio * getattr(leg, name) for name in springs})
    return robot.model_copy(update={"leg": changed})


def build_fixed_base(robot: PantographParameters, kind: Kind, legs: int = 1) -> FixedBase:
    """Legs of a kind, ready to be let go. On a fixed base they do not know of each other."""
    spec, prefixes = mujoco.MjSpec(), [f"{number}_" for number in range(legs)]
    spec.compiler.autolimits = False
    for prefix in prefixes:
        leg = build_pantograph_leg(robot, "front")
        for sensor in list(leg.sensors):
            leg.delete(sensor)
        for actuator in list(leg.actuators):
            leg.delete(actuator)
        for tendon in list(leg.tendons):
            leg.delete(tendon)
        leg.delete(leg.body("knee_pulley"))
        hip = leg.joint("hip_joint")
        hip.armature, hip.damping, hip.limited = 0.0, (HIP_FRICTION, 0.0, 0.0), mujoco.mjtLimited.mjLIMITED_FALSE
        if kind == "minimal":
            make_minimal(leg, robot)
        elif kind != "constraints":
            make_massless(leg, robot)
            leg.joint("hip_joint").damping = (HIP_FRICTION, 0.0, 0.0)
            if kind == "massless":  # knows no friction inside: the planar joint gets it, or nothing ever came to rest
                lever = robot.leg.spacing * aslp_leg(robot.leg).longest / (_arm(robot.leg) * robot.leg.diagonal_max)
                leg.joint("length").damping = (robot.leg.diagonal_damping * lever**2, 0.0, 0.0)
                leg.joint("foot_joint").damping = (robot.leg.toe_damping, 0.0, 0.0)
        spec.attach(leg, prefix=prefix, frame=spec.worldbody.add_frame())
    spec.option.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    model = spec.compile()
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    data = mujoco.MjData(model)
    base = FixedBase(kind, model, data, _forces(model, robot.leg, kind, prefixes), _start_energy(robot.leg))
    for prefix in prefixes:
        _let_go(base, robot.leg, prefix)
    mujoco.mj_forward(model, data)
    return base


def _arm(leg: PantographLeg) -> float:
    return leg.upper_length + leg.lower_length - leg.spacing


def _forces(model: mujoco.MjModel, leg: PantographLeg, kind: Kind, prefixes: list[str]) -> Forces:
    match kind:
        case "constraints":
            return NoForces()
        case "minimal":
            return MinimalLegs(model, leg, prefixes)
        case "massless":
            return LookUpLegs(model, leg, prefixes)
        case "massless_friction":
            return FollowingLegs(model, leg, prefixes)


def _let_go(base: FixedBase, leg: PantographLeg, prefix: str) -> None:
    hip, knee = leg_start(leg)
    match base.kind:
        case "constraints":
            set_leg(base.data, prefix.removesuffix("_"), leg, hip, knee)
        case "minimal":
            set_minimal_leg(base.data, prefix, hip, knee, 0.0, leg.toe_rest)
        case _:
            x, z = aslp_leg(leg).forward(AslpPose(hip, knee))
            line = math.atan2(x, -z)
            base.data.joint(f"{prefix}hip_joint").qpos = line
            base.data.joint(f"{prefix}length").qpos = math.hypot(x, z)
            base.data.joint(f"{prefix}foot_joint").qpos = leg.toe_rest + hip - line
            if isinstance(base.forces, FollowingLegs):
                base.forces.knees = [knee] * len(base.forces.knees)


def leg_start(leg: PantographLeg) -> tuple[float, float]:
    """Hip and knee at the start [rad]: 10 degrees ahead of hanging, the knee folded by 10 % more than stretched."""
    return aslp_leg(leg).hip_reference + HIP_START, KNEE_START * leg.knee_reference


def _start_energy(leg: PantographLeg) -> float:
    """Roughly: in the springs, and in the raised leg."""
    from nermo_control.legs.aslp_symbolic import minimal_functions  # sympy is slow to load

    energy = minimal_functions(leg).energy
    _, knee = leg_start(leg)
    sprung = energy(knee, 0.0, leg.toe_rest) - energy(leg.knee_reference, 0.0, leg.toe_rest)
    return sprung + leg.mass * 9.81 * 0.5 * aslp_leg(leg).longest * (1.0 - math.cos(HIP_START))


def comes_to_rest(base: FixedBase, step: float, integrator: Integrator, duration: float = DURATION) -> bool:
    """Whether the legs, let go, are at rest in the last quarter of the time, as those of a stable simulation are."""
    model, data = base.model, base.data
    model.opt.timestep, model.opt.integrator = step, _INTEGRATORS[integrator]
    count, energy = math.ceil(duration / step), base.start_energy * _legs(base)
    try:
        for number in range(count):
            base.step(step, integrator)
            kinetic = float(data.energy[1])
            if not math.isfinite(kinetic) or kinetic > 1e3 * energy or np.abs(data.qpos).max() > 1e3:
                return False
            if number > 0.75 * count and kinetic > AT_REST * energy:
                return False
    except (ValueError, OverflowError, ZeroDivisionError):  # the leg was torn where no geometry exists
        return False
    return bool(np.isfinite(data.qpos).all())


def _legs(base: FixedBase) -> int:
    return sum(base.model.joint(joint).name.endswith("hip_joint") for joint in range(base.model.njnt))


def largest_stable_step(
    robot: PantographParameters,
    kind: Kind,
    integrator: Integrator,
    largest: float = 0.05,
    smallest: float = 1e-6,
    precision: float = 1.05,
) -> float | None:
    """By binary search [s], with one leg; None where none is found above `smallest`."""

    def stable(step: float) -> bool:
        return comes_to_rest(build_fixed_base(robot, kind), step, integrator)

    if stable(largest):
        return largest
    unstable, step = largest, 0.5 * largest
    while not stable(step):
        unstable, step = step, 0.5 * step
        if step < smallest:
            return None
    while unstable / step > precision:
        middle = math.sqrt(unstable * step)
        if stable(middle):
            step = middle
        else:
            unstable = middle
    return step


def step_cost(
    robot: PantographParameters, kind: Kind, integrator: Integrator, step: float, count: int = 300, legs: int = 4
) -> float:
    """Mean processor time of one step of four legs [s], while they come to rest."""
    base = build_fixed_base(robot, kind, legs)
    base.model.opt.timestep, base.model.opt.integrator = step, _INTEGRATORS[integrator]
    for _ in range(20):
        base.step(step, integrator)
    begin = time.thread_time()
    for _ in range(count):
        base.step(step, integrator)
    return (time.thread_time() - begin) / count


def trajectory(
    robot: PantographParameters, kind: Kind, integrator: Integrator, step: float, duration: float, every: float = 0.005
) -> NDArray[np.float64]:
    """Direction of the line from hip to foot [rad] and its length [m] over time, shape (n, 2)."""
    base, leg = build_fixed_base(robot, kind), aslp_leg(robot.leg)
    base.model.opt.timestep, base.model.opt.integrator = step, _INTEGRATORS[integrator]
    rows, at, hold = [], base.data, round(every / step)
    for number in range(round(duration / step)):
        if number % hold == 0:
            if kind in ("constraints", "minimal"):
                hip, knee, ankle = (float(at.joint(f"0_{name}_joint").qpos[0]) for name in ("hip", "knee", "ankle"))
                x, z = leg.forward(AslpPose(hip, knee, ankle - knee))
                rows.append((math.atan2(x, -z), math.hypot(x, z)))
            else:
                rows.append((float(at.joint("0_hip_joint").qpos[0]), float(at.joint("0_length").qpos[0])))
        base.step(step, integrator)
    return np.array(rows)
