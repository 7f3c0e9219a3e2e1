"""What a trot costs with each model of the leg, and where the energy goes (C 2.6.1: up to 15 times too little).

The servos are direct-current motors: stall torque and no-load speed, which the robot's file has, give the losses in
their windings too. With b = stall torque / no-load speed, the torque tau at the shaft costs tau omega + tau^2 / b.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import mujoco
import numpy as np

from nermo_control.legs.aslp import AslpPose
from nermo_control.pantograph_controller import GRAVITY, PantographController, PantographGait, aslp_leg
from nermo_control.types import ControlCommand, Posture
from nermo_description.model import SCENES, build_robot
from nermo_description.pantograph import PantographParameters
from nermo_description.pantograph_model import set_leg
from nermo_description.parameters import LEGS
from nermo_sim.leg_dynamics.fixed_base import Forces, Kind, NoForces
from nermo_sim.leg_dynamics.massless import FollowingLegs, make_massless
from nermo_sim.leg_dynamics.minimal import MinimalLegs, make_minimal, set_minimal_leg

STEP = 0.00025
"""Of the physics [s]: with twice as much the minimal model, near its largest stable step, falls over."""
PERIOD_NS = 5_000_000
STAND, WALK, SETTLE = 0.3, 3.0, 1.2
"""Standing, walking, and what of the walk is not counted [s]."""
FREQUENCY, STEP_LENGTH = 2.5, 0.06
"""A trot that all models survive [Hz, m]."""
_ROWS = {
    mujoco.mjtConstraint.mjCNSTR_EQUALITY: "loops_w",
    mujoco.mjtConstraint.mjCNSTR_LIMIT_JOINT: "stops_w",
    mujoco.mjtConstraint.mjCNSTR_LIMIT_TENDON: "stops_w",
}
"""All other constraints of the models are contacts."""


@dataclass(slots=True)
class Budget:
    """Mean powers over the walk that is counted."""

    powers: dict[str, float] = field(default_factory=dict)
    """[W]"""
    time: float = 0.0
    """[s]"""

    def add(self, name: str, power: float, step: float) -> None:
        """Counts a power [W] over a step [s]."""
        self.powers[name] = self.powers.get(name, 0.0) + power * step

    def means(self) -> dict[str, float]:
        """[W]"""
        return {name: energy / self.time for name, energy in self.powers.items()}


@dataclass(slots=True)
class Walker:
    """A whole robot with one model of its legs, on flat ground."""

    kind: Kind
    robot: PantographParameters
    model: mujoco.MjModel
    data: mujoco.MjData
    forces: Forces
    pulleys: list[float] = field(default_factory=lambda: [0.0] * 4)
    """Of the mass-less model, whose knees have no bodies [rad]."""


def build_walker(robot: PantographParameters, kind: Kind) -> Walker:
    """The robot standing, with a model of its legs. ValueError for `massless`, which has no cable."""
    if kind == "massless":
        raise ValueError("legs from the look-up table have no cable: they cannot swing")
    spec = build_robot(robot)
    for name in LEGS:
        if kind == "minimal":
            make_minimal(spec, robot, f"{name}_")
        elif kind == "massless_friction":
            make_massless(spec, robot, f"{name}_")
            joint, servo = spec.joint(f"{name}_hip_joint"), robot.servos[f"{name}_hip"]
            joint.damping, joint.armature = (servo.damping, 0.0, 0.0), servo.armature
            hip = spec.add_actuator(name=f"{name}_hip", target=f"{name}_hip_joint", trntype=mujoco.mjtTrn.mjTRN_JOINT)
            hip.set_to_position(kp=servo.proportional_gain)
            hip.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
            hip.forcerange = (-servo.max_torque, servo.max_torque)
    spec.attach(mujoco.MjSpec.from_file(str(SCENES / "flat.xml")), prefix="scene_", frame=spec.worldbody.add_frame())
    spec.option.timestep = STEP
    model = spec.compile()
    data = mujoco.MjData(model)
    prefixes = [f"{leg}_" for leg in LEGS]
    leg, hip_angle, knee = robot.leg, robot.servos["front_left_hip"].neutral, robot.leg.knee_reference
    x, z = aslp_leg(leg).forward(AslpPose(hip_angle, knee))
    for prefix in prefixes:
        if kind == "constraints":
            set_leg(data, prefix.removesuffix("_"), leg, hip_angle, knee)
        elif kind == "minimal":
            set_minimal_leg(data, prefix, hip_angle, knee, 0.0, leg.toe_rest)
        else:
            line = math.atan2(x, -z)
            data.joint(f"{prefix}hip_joint").qpos = line
            data.joint(f"{prefix}length").qpos = math.hypot(x, z)
            data.joint(f"{prefix}foot_joint").qpos = leg.toe_rest + hip_angle - line
    toe = leg.toe_rest + hip_angle
    data.joint("root").qpos[2] = -z + leg.toe_length * math.cos(toe) + leg.foot_radius
    forces: Forces = NoForces()
    if kind == "minimal":
        forces = MinimalLegs(model, leg, prefixes)
    elif kind == "massless_friction":
        forces = FollowingLegs(model, leg, prefixes)
    return Walker(kind, robot, model, data, forces)


def cost_of_transport(robot: PantographParameters, kind: Kind, gait: PantographGait | None = None) -> dict[str, float]:
    """Trots with the open-loop CPG; speed [m/s], mean powers [W], and costs of transport [1].

    `net`: work of the servos over weight times way, as if they got back what they brake. `mechanical`: the positive
    work alone. `electrical`: with the losses in the windings, and nothing given back. `fell` is 1 where it fell.
    """
    gait = gait or PantographGait()
    walker = build_walker(robot, kind)
    controller = PantographController(robot, gait, PERIOD_NS)
    data, budget = walker.data, Budget()
    ticks = round((STAND + WALK) * 1e9 / PERIOD_NS)
    position = list(robot.posture("stand").values())
    begin = 0.0
    for tick in range(ticks):
        stamp = tick * PERIOD_NS
        if stamp * 1e-9 < STAND:
            command = ControlCommand(stamp, posture=Posture.STAND)
        else:
            velocity = STEP_LENGTH * FREQUENCY / gait.duty_factor
            command = ControlCommand(stamp, forward_velocity=velocity, gait="trot", gait_frequency=FREQUENCY)
        servos = controller.step(stamp, command, None, position).servo_positions
        position = list(servos)
        counted = stamp * 1e-9 >= STAND + SETTLE
        if counted and budget.time == 0.0:
            begin = float(data.qpos[0])
        for _ in range(round(PERIOD_NS * 1e-9 / STEP)):
            _step(walker, servos, budget if counted else Budget())
        if float(data.body("torso").xmat[8]) < 0.6 or not np.isfinite(data.qpos).all():
            return {"fell": 1.0, "time_s": float(data.time)}
    speed = (float(data.qpos[0]) - begin) / budget.time
    powers = budget.means()
    scale = robot.mass * GRAVITY * max(abs(speed), 1e-3)
    return {
        "fell": 0.0,
        "speed_m_s": speed,
        **powers,
        "net": (powers["servo_positive_w"] - powers["servo_negative_w"]) / scale,
        "mechanical": powers["servo_positive_w"] / scale,
        "electrical": powers["servo_electrical_w"] / scale,
    }


def _step(walker: Walker, servos: tuple[float, ...], budget: Budget) -> None:
    """One step of the physics, its powers counted with the velocities before it."""
    model, data, robot = walker.model, walker.data, walker.robot
    budget.time += STEP
    before = 0.0
    if isinstance(walker.forces, FollowingLegs):
        before = walker.forces.dissipated
        _pull(walker, servos, budget)
    else:
        for number, servo in enumerate(robot.servos):
            data.actuator(servo).ctrl = servos[number]
    walker.forces.apply(data, STEP)
    velocity, passive = data.qvel.copy(), 0.0
    if isinstance(walker.forces, FollowingLegs):
        passive = (walker.forces.dissipated - before) / STEP
    elif isinstance(walker.forces, MinimalLegs):
        passive = walker.forces.dissipation(data)
    mujoco.mj_step(model, data)
    for servo, parameters in robot.servos.items():
        actuator = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_ACTUATOR, servo)
        if actuator < 0:
            continue
        dof = int(model.jnt_dofadr[model.actuator_trnid[actuator, 0]])
        _count_servo(
            budget,
            float(data.actuator_force[actuator]) - parameters.damping * float(velocity[dof]),
            float(velocity[dof]),
            parameters.damping,
        )
    if isinstance(walker.forces, NoForces):
        for dof in range(6, model.nv):
            joint = model.joint(int(model.dof_jntid[dof])).name
            if joint.endswith(("slider", "toe_joint")):
                passive += float(model.dof_damping[dof]) * float(velocity[dof]) ** 2
    budget.add("leg_friction_w", passive, STEP)
    # efc_vel is J v of the velocities before the step, and efc_force what the solver did in it.
    for name, power in zip(*_constraint_powers(data), strict=True):
        budget.add(name, -power, STEP)


def _constraint_powers(data: mujoco.MjData) -> tuple[list[str], list[float]]:
    count = data.nefc
    kinds, powers = data.efc_type[:count].tolist(), (data.efc_force[:count] * data.efc_vel[:count]).tolist()
    return [_ROWS.get(mujoco.mjtConstraint(kind), "contact_w") for kind in kinds], powers


def _pull(walker: Walker, servos: tuple[float, ...], budget: Budget) -> None:
    """Hips and cables of the mass-less legs: the hip's servo turns the line to the foot, the knee's winds the cable.

    The winding is limited as in (2.20).
    """
    robot, data, legs = walker.robot, walker.data, walker.forces
    assert isinstance(legs, FollowingLegs)
    kinematics, leg = aslp_leg(robot.leg), robot.leg
    for number, name in enumerate(LEGS):
        hip, wanted = servos[2 * number], servos[2 * number + 1]
        servo = robot.servos[f"{name}_knee"]
        fold = leg.knee_of_cable(min(leg.cable_max + leg.pulley_radius * wanted, leg.cable_max))
        x, z = kinematics.forward(AslpPose(hip, fold))
        data.actuator(f"{name}_hip").ctrl = math.atan2(x, -z)
        by_length, lever = legs.stop_forces(data)[number], legs.length_by_cable(number)
        torque = (legs.tensions[number] + by_length * lever) * leg.pulley_radius
        fastest = servo.max_velocity * max(1.0 - torque / servo.max_torque, 0.0)
        now = walker.pulleys[number]
        # As the proportional controller of the servo would, within what (2.20) leaves.
        rate = servo.proportional_gain * (wanted - now) / servo.damping
        rate = min(max(rate, -fastest), servo.max_velocity)
        walker.pulleys[number] = now + STEP * rate
        before = leg.cable_max + leg.pulley_radius * now
        cable = min(leg.cable_max + leg.pulley_radius * walker.pulleys[number], leg.cable_max)
        # What the servo puts in through the stop of the length comes out of it at the foot, less what the stop takes.
        budget.add("stops_w", by_length * lever * (min(before, leg.cable_max) - cable) / STEP, STEP)
        legs.cable_knees[number] = leg.knee_of_cable(cable)
        _count_servo(budget, -torque, rate, servo.damping)


def _count_servo(budget: Budget, torque: float, velocity: float, damping: float) -> None:
    """Torque at the shaft [N m], its velocity [rad/s]."""
    mechanical, windings = torque * velocity, torque * torque / damping
    budget.add("servo_positive_w", max(mechanical, 0.0), STEP)
    budget.add("servo_negative_w", max(-mechanical, 0.0), STEP)
    budget.add("windings_w", windings, STEP)
    budget.add("servo_electrical_w", max(mechanical + windings, 0.0), STEP)
