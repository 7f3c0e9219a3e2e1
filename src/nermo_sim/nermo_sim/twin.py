"""The digital twin: a MuJoCo model that takes servo commands and gives sensor data, one control tick at a time."""

from __future__ import annotations

import logging
import math
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from nermo_control.types import Odometry
from nermo_description.command_follower import CommandFollower, Following
from nermo_description.model import build_model
from nermo_description.parameters import LEGS
from nermo_description.robots import AnyRobot
from nermo_sim.command_path import CommandPath
from nermo_sim.divergence import StateHistory
from nermo_sim.layout import ModelLayout
from nermo_sim.sensor_data import SensorData, SensorNoise

Vector3 = tuple[float, float, float]
RobotType = TypeVar("RobotType", bound=AnyRobot)
_log = logging.getLogger(__name__)


CONTACT_FORCE = 1e-3
"""Normal force from which a foot counts as touching [N]."""


@dataclass(frozen=True, slots=True)
class BaseState:
    """Ground truth of base_link."""

    position: Vector3
    """[m], world."""
    quaternion: tuple[float, float, float, float]
    """(w, x, y, z), base_link in the world."""
    linear_velocity: Vector3
    """[m/s], base_link axes."""
    angular_velocity: Vector3
    """[rad/s], base_link axes."""


@dataclass(slots=True)
class _Push:
    body: int
    force: Vector3
    until: int


class Twin(Generic[RobotType]):
    """The robot in MuJoCo. Time is in integer ns and goes on over resets.

    robot: parameters, which also give the order of the servos. scene: name of a scene of `nermo_description`.
    model: a compiled model to use instead of building one (for variants of the robot).
    period_ns: control period, a multiple of the model's time step. noise and seed: of the sensors.
    interpolate: move the servos' targets linearly over the tick instead of holding them.
    dump_folder: where model and states go when the simulation diverges.

    Raises ModelError for a model without the agreed names, ValueError for a period that does not fit the time step.
    """

    def __init__(
        self,
        robot: RobotType,
        scene: str = "flat",
        *,
        model: mujoco.MjModel | None = None,
        period_ns: int = 5_000_000,
        noise: SensorNoise | None = None,
        seed: int = 0,
        interpolate: bool = False,
        dump_folder: Path | None = None,
    ) -> None:
        self.robot = robot
        self.model = build_model(robot, scene) if model is None else model
        self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET  # a NaN must be seen, not papered over
        if self.model.ntree == 1:
            # All of it is one island; looking for more costs a sixteenth of a step, and changes no bit.
            self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ISLAND
        self.data = mujoco.MjData(self.model)
        self.layout = ModelLayout(self.model, tuple(robot.servos))
        self.period_ns = period_ns
        self._substeps = round(period_ns * 1e-9 / self.model.opt.timestep)
        if self._substeps < 1 or abs(self._substeps * self.model.opt.timestep * 1e9 - period_ns) > 1.0:
            raise ValueError(f"period = {period_ns} ns: must be a multiple of {self.model.opt.timestep} s")
        self._interpolate = interpolate
        self._dump_folder = dump_folder
        self._deviations = None if noise is None else noise.deviations(self.layout, self.model.nsensordata)
        self._random = np.random.default_rng(seed)
        self._friction = self.model.geom_friction.copy()
        self._torque_range = self.model.actuator_forcerange[self.layout.actuators].copy()
        self._powered = np.ones(len(self.layout.servos), dtype=bool)
        path = CommandPath(robot, self.layout.servos, period_ns * 1e-9)
        self._path = None if path.neutral else path
        self._history = StateHistory(self.model, max(1, round(1e9 / period_ns)))

        # Views into MjData stay valid for its whole life; taking them once saves an attribute lookup a tick.
        self._sensordata = self.data.sensordata
        self._control = self.data.ctrl
        self._base_position = self.data.site_xpos[self.layout.base_site]
        self._base_axes = self.data.site_xmat[self.layout.base_site]
        self._twist = np.zeros(6)
        self._follower = CommandFollower(self.model.key_ctrl[self.layout.keyframes["crouch"]][self.layout.actuators])
        self._substep_shares = [(step + 1) / self._substeps for step in range(self._substeps)]

        self.time_ns = 0
        self.diverged: Exception | None = None
        self._pushes: list[_Push] = []
        self.reset()

    @property
    def keyframes(self) -> tuple[str, ...]:
        """Names of the postures for `reset`."""
        return tuple(self.layout.keyframes)

    @property
    def bodies(self) -> tuple[str, ...]:
        """Names of the bodies for `push`."""
        return tuple(self.model.body(number).name for number in range(1, self.model.nbody))

    @property
    def joint_count(self) -> int:
        """Number of hinge joints."""
        return len(self.layout.joints)

    @property
    def command_state(self) -> Following:
        """What the servos follow now."""
        return self._follower.state

    def power(self, powered: NDArray[np.bool_] | bool) -> None:
        """Gives servos power or takes it, shape (n,) in the order of the robot's servos, or all alike.

        A servo without power has no torque, but the friction of its gears. While none has any, commands are passed
        over; when it comes back the robot stays as it lies until it is commanded anew.
        """
        powered = np.broadcast_to(powered, self._powered.shape)
        if (powered == self._powered).all():
            return
        self._powered = powered.copy()
        actuators = self.layout.actuators
        self.model.actuator_forcerange[actuators] = np.where(powered[:, None], self._torque_range, 0.0)
        if not powered.any():
            self._follower.state = Following.LIMP
        elif self._follower.state is Following.LIMP:
            self._follower.state = Following.WAITING

    def reset(self, keyframe: str = "stand") -> SensorData:
        """Puts the robot into a keyframe, at rest, at the origin. Time goes on; who has no power gets none.

        Raises ValueError for an unknown keyframe.
        """
        if keyframe not in self.layout.keyframes:
            raise ValueError(f"keyframe {keyframe!r} is unknown: choose one of {', '.join(self.keyframes)}")
        mujoco.mj_resetDataKeyframe(self.model, self.data, self.layout.keyframes[keyframe])
        self.data.time = self.time_ns * 1e-9
        mujoco.mj_forward(self.model, self.data)
        self._pushes.clear()
        self._history.clear()
        self._history.add(self.data, self._control)
        if self._path is not None:
            self._path.clear()
        self.diverged = None
        state = Following.WAITING if self._powered.any() else Following.LIMP
        self._follower.rest(self._control[self.layout.actuators], state)
        return self.sensors()

    def step(self, servo_positions: Sequence[float] | None) -> SensorData:
        """Advances by one control tick.

        servo_positions: targets [rad] in the order of the robot's servos, or None where no new command came: then the
        last one goes on, until the follower holds and then crouches.

        Raises ValueError for a wrong number of targets or one that is not finite, and SimulationDivergedError, also on
        every further call until a reset.
        """
        if self.diverged is not None:
            raise self.diverged
        if servo_positions is not None:
            self._check(servo_positions)
        actuators = self.layout.actuators
        if self._follower.state is Following.LIMP:
            # The targets go where the servos are, so that nothing jumps when power comes back.
            self._follower.rest(self._sensordata[self.layout.servo_position], Following.LIMP)
        elif servo_positions is not None:
            self._follower.command(np.array(servo_positions, dtype=np.float64))
        if self._pushes:
            self._apply_pushes()
        target = self._follower.step(self.period_ns)
        assert target is not None, "a reset gave it a place to rest"
        if self._path is not None:
            target = self._path(target, self._sensordata[self.layout.servo_position])
        if self._interpolate:
            start = self._control[actuators]
            for share in self._substep_shares:
                self._control[actuators] = start + share * (target - start)
                mujoco.mj_step(self.model, self.data)
        else:
            self._control[actuators] = target
            mujoco.mj_step(self.model, self.data, self._substeps)
        self.time_ns += self.period_ns
        if not self._history.add(self.data, self._control):
            self._stop()
        return self.sensors()

    def sensors(self) -> SensorData:
        """Sensor data of the present tick."""
        values = self._sensordata.copy()
        if self._deviations is not None:
            values += self._deviations * self._random.standard_normal(len(values))
        return SensorData(self.time_ns, values, self.layout)

    def push(self, force: Vector3, duration: float, body: str = "torso") -> None:
        """Pushes a body at its centre of mass with a constant force [N], world axes, for a while [s].

        Raises ValueError for an unknown body, a force that is not finite, or a duration outside 0.001 s to 10 s.
        """
        if body not in self.bodies:
            raise ValueError(f"body {body!r} is unknown: choose one of {', '.join(self.bodies)}")
        if not all(map(math.isfinite, force)):
            raise ValueError(f"force = {force} N: must be finite")
        if not 0.001 <= duration <= 10.0:
            raise ValueError(f"duration = {duration} s: must be within 0.001 s and 10 s")
        number = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_BODY, body)
        self._pushes.append(_Push(number, force, self.time_ns + round(duration * 1e9)))

    def scale_friction(self, factor: float) -> None:
        """Scales the sliding friction of all geoms, relative to the model as built."""
        self.model.geom_friction[:, 0] = factor * self._friction[:, 0]

    def displace(self, heading: float, joint_angles: Sequence[float] | NDArray[np.float64]) -> None:
        """Turns the robot about the vertical [rad] and adds to the angles [rad] of its joints `layout.joints`."""
        root = self.layout.root_position + 3
        turn, turned = np.array([math.cos(heading / 2.0), 0.0, 0.0, math.sin(heading / 2.0)]), np.zeros(4)
        mujoco.mju_mulQuat(turned, turn, self.data.qpos[root : root + 4])
        self.data.qpos[root : root + 4] = turned
        self.data.qpos[self.layout.joint_position] += joint_angles
        mujoco.mj_forward(self.model, self.data)

    # Ground truth

    def odometry(self) -> Odometry:
        """Planar pose of base_link in the world and its velocity, as the controller takes it."""
        x, y, _ = self._base_position.tolist()
        axes = self._base_axes.tolist()
        mujoco.mj_objectVelocity(self.model, self.data, mujoco.mjtObj.mjOBJ_SITE, self.layout.base_site, self._twist, 1)
        twist = self._twist.tolist()
        return Odometry(self.time_ns, x, y, math.atan2(axes[3], axes[0]), twist[3], twist[2])

    def base_state(self) -> BaseState:
        """Pose and velocity of base_link."""
        quaternion = np.zeros(4)
        mujoco.mju_mat2Quat(quaternion, self._base_axes)
        mujoco.mj_objectVelocity(self.model, self.data, mujoco.mjtObj.mjOBJ_SITE, self.layout.base_site, self._twist, 1)
        x, y, z = self._base_position.tolist()
        qw, qx, qy, qz = quaternion.tolist()
        wx, wy, wz, vx, vy, vz = self._twist.tolist()
        return BaseState((x, y, z), (qw, qx, qy, qz), (vx, vy, vz), (wx, wy, wz))

    def tilt(self) -> float:
        """Angle between base_link's z axis and the vertical [rad]; more than half a right angle is a fall."""
        return math.acos(min(max(float(self._base_axes[8]), -1.0), 1.0))

    def foot_forces(self) -> tuple[NDArray[np.float64], tuple[bool, ...]]:
        """Contact force on each foot [N], world axes, shape (4, 3), and whether it touches anything."""
        forces, touching = np.zeros((len(LEGS), 3)), [False] * len(LEGS)
        wrench = np.zeros(6)
        for number in range(self.data.ncon):
            contact = self.data.contact[number]
            # The contact frame's normal points from the first geom to the second, and so does the force.
            for geom, sign in ((int(contact.geom1), -1.0), (int(contact.geom2), 1.0)):
                leg = self.layout.foot_of_geom.get(geom)
                if leg is not None and contact.efc_address >= 0:
                    mujoco.mj_contactForce(self.model, self.data, number, wrench)
                    forces[leg] += sign * (contact.frame.reshape(3, 3).T @ wrench[:3])
                    touching[leg] |= bool(wrench[0] > CONTACT_FORCE)
        return forces, tuple(touching)

    def joint_states(self) -> tuple[list[float], list[float]]:
        """Angles [rad] and velocities [rad/s] of the joints `layout.joints`."""
        return (
            self.data.qpos[self.layout.joint_position].tolist(),
            self.data.qvel[self.layout.joint_velocity].tolist(),
        )

    # One tick's parts

    def _check(self, servo_positions: Sequence[float]) -> None:
        if len(servo_positions) != len(self.layout.servos):
            raise ValueError(f"{len(servo_positions)} servo positions: there are {len(self.layout.servos)} servos")
        if not math.isfinite(sum(servo_positions)):
            raise ValueError(f"servo positions = {list(servo_positions)}: must be finite")

    def _apply_pushes(self) -> None:
        self.data.xfrc_applied[:] = 0.0
        self._pushes = [push for push in self._pushes if push.until > self.time_ns]
        for push in self._pushes:
            self.data.xfrc_applied[push.body, :3] += push.force

    def _stop(self) -> None:
        folder = self._dump_folder or Path(tempfile.mkdtemp(prefix="nermo-divergence-"))
        self.diverged = self._history.save(folder)
        raise self.diverged


def _log_warning(message: str) -> None:
    _log.warning("MuJoCo: %s", message)


mujoco.set_mju_user_warning(_log_warning)
