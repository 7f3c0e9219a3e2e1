"""What servos and joints do that MuJoCo's elements do not: dead band, play, elastic drives, heat, sag, friction by
load, torque that ripples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields

import mujoco
import numpy as np
from mujoco import batch as mjbatch
from numpy.typing import NDArray

from simgap.data.plant import Plant
from simgap.simulation.transmission import Transmission
from simgap.simulation.variant import FrictionPath, ServoPath, Variant

Array = NDArray[np.float64]

_ROUNDING = 1e-9
"""Rows: a step that begins with a switch, to the last bit, sees it."""
SHAPES = {
    "hard": "dead_band",
    "heat_time": "heat_loss",
    "heat_reference": "heat_loss",
    "ringing": "compliance",
    "sag_reference": "sag",
    "stribeck_velocity": "stribeck",
    "ripple_period": "ripple",
    "ripple_origin": "ripple",
}
"""Fields of the paths that do nothing by themselves, and the field whose law each of them shapes."""
_PAST = ("backlash", "compliance")
"""Laws of the servo path that have a state of their own, which the warm-up must settle."""
_SERVO_LAWS, _FRICTION_LAWS = (
    tuple(field.name for field in fields(path) if field.name not in SHAPES) for path in (ServoPath, FrictionPath)
)


def needs_servo_step(variant: Variant) -> bool:
    """Whether some law of the servos acts: a field of their path that is not zero."""
    return any(np.any(getattr(variant.servos, name)) for name in _SERVO_LAWS)


def needs_friction_step(variant: Variant) -> bool:
    """Whether some friction changes from step to step, or torque ripples: a field of their path that is not zero."""
    return any(np.any(getattr(variant.friction, name)) for name in _FRICTION_LAWS)


def needs_step(variant: Variant) -> bool:
    """Whether servos or frictions look at the state, so that a variant cannot run in one call."""
    return needs_servo_step(variant) or needs_friction_step(variant)


def needs_past(variant: Variant) -> bool:
    """Whether a law that acts remembers what was before."""
    return any(np.any(getattr(variant.servos, name)) for name in _PAST)


class ServoStep:
    """One control step of all simulations; ``variants`` gives the variant of each."""

    def __init__(self, plant: Plant, variants: Sequence[Variant], dt: float) -> None:
        servos = [v.servos for v in variants]
        self._dt, model = dt, plant.model
        self.active = any(needs_servo_step(v) for v in variants)
        if not self.active:
            return
        self._band = np.stack([s.dead_band for s in servos])
        self._hard = np.stack([s.hard for s in servos])
        self._sag = np.array([s.sag for s in servos])[:, None]
        self._reference = np.array([s.sag_reference for s in servos])[:, None]
        self._follows = np.array([s.follows for s in servos])[:, None]
        self._gain = np.stack([v.model.actuator_gainprm[:, 0] for v in variants])
        self._bias = np.stack([v.model.actuator_biasprm[:, :3] for v in variants])
        self._gear = np.stack([v.model.actuator_gear[:, 0] for v in variants])
        limited = np.stack([v.model.actuator_forcelimited for v in variants]).astype(bool)
        bounds = np.stack([v.model.actuator_forcerange for v in variants])
        self._low = np.where(limited, bounds[..., 0], -np.inf)
        self._high = np.where(limited, bounds[..., 1], np.inf)
        joint = model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT
        hinge = np.isin(model.jnt_type, (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE))
        self._at_joint = np.flatnonzero(joint & hinge[np.where(joint, model.actuator_trnid[:, 0], 0)])
        self._dof = np.where(joint, model.jnt_dofadr[np.maximum(model.actuator_trnid[:, 0], 0)], 0)
        self._bands, self._sags = bool(self._band.any()), bool(self._sag.any() or self._follows.any())
        self._transmission = Transmission.of(plant, variants, self._low, self._high, dt)

    def bind(self, batch: mjbatch.Batch) -> None:
        """Attach to a batch."""
        self._batch = batch
        self._length, self._velocity = batch.bind("actuator_length"), batch.bind("actuator_velocity")
        self._first = True
        if self._transmission is not None:
            self._transmission.bind(batch)

    def step(self, control: Array, supply: Array | None = None, left: Array | None = None) -> tuple[Array, Array]:
        """(control that has the wanted effect (n, nu), joint forces (n, nv)).

        ``supply`` (n,): the measured voltage as a share of the usual. ``left`` (n, nu): the share of its torque that
        heat leaves each servo.
        """
        if self._first:
            self._batch.forward(stage=mujoco.mjtStage.mjSTAGE_VEL.value)
        # A step leaves what belongs to the state before it.
        length = self._length + (0.0 if self._first else self._dt) * self._velocity
        self._first = False
        extra = np.zeros_like(self._batch.qfrc_applied)
        if self._bands:
            # A servo compares in the unit of its command: the point of zero force is ctrl = -bias1 / gain * length.
            zero = -self._bias[..., 1] / np.where(self._gain == 0, 1.0, self._gain) * length
            error = control - zero
            outside = np.abs(error) > self._band
            answered = np.where(self._hard, error, error - np.sign(error) * self._band)
            control = np.where(self._band > 0, zero + np.where(outside, answered, 0.0), control)
        if left is not None or self._sags:
            asked = self._gain * control + self._bias[..., 0] + self._bias[..., 1] * length
            velocity = self._velocity.copy()
            at = self._at_joint
            velocity[:, at] = self._gear[:, at] * self._batch.qvel[:, self._dof[at]]
            asked += self._bias[..., 2] * velocity
            force = np.clip(asked, self._low, self._high)
            if left is not None:
                force *= left
            load = np.abs(force * self._gear).sum(axis=1, keepdims=True) / self._reference
            # What flows is what the reduced voltage still drives, of a servo at its limit as well.
            remains = 1.0 / (1.0 + self._sag * load)
            if supply is not None:
                remains = remains * (1.0 + self._follows * (supply[:, None] - 1.0))
            lost = asked - force * remains
            control = control - np.where(self._gain == 0, 0.0, lost / np.where(self._gain == 0, 1.0, self._gain))
        if self._transmission is not None:
            self._transmission.step(control, extra)
        return control, extra


class Switch:
    """Switches the actuators of all simulations off and on as those of the robot were.

    ``enabled`` (n,) of the recording's rows; simulation i reads it from row ``origin[i]`` on.
    """

    def __init__(self, batch: mjbatch.Batch, enabled: NDArray[np.bool_], origin: NDArray[np.int64]) -> None:
        self._enabled, self._origin = enabled, origin
        self._fields = [batch.expand(f"actuator_{field}") for field in ("gainprm", "biasprm")]
        self._values = [field.copy() for field in self._fields]
        self._now: NDArray[np.bool_] | None = None

    def on(self, position: float) -> NDArray[np.bool_]:
        """Whether those of each simulation (n,) are on, ``position`` rows after its origin."""
        found: NDArray[np.bool_] = self._enabled[
            np.minimum(self._origin + int(position + _ROUNDING), len(self._enabled) - 1)
        ]
        return found

    def at(self, position: float) -> None:
        """Switch them for the coming step."""
        on = self.on(position)
        if self._now is None or (on != self._now).any():
            self._now = on
            for field, value in zip(self._fields, self._values, strict=True):
                field[:] = np.where(on[:, None, None], value, 0.0)


class LoadFriction:
    """Friction loss of all simulations that changes with speed and load; ``variants`` gives the variant of each."""

    def __init__(self, variants: Sequence[Variant]) -> None:
        self._stribeck = np.stack([v.friction.stribeck for v in variants])
        self._slow = np.stack([v.friction.stribeck_velocity for v in variants])
        self._load = np.stack([v.friction.load for v in variants])

    def at(self, loss: Array, velocity: Array, force: Array) -> Array:
        """Friction loss (n, nv) at joint velocities (n, nv) under transmitted forces (n, nv)."""
        fading = self._stribeck * np.exp(-((velocity / self._slow) ** 2))
        result: Array = np.maximum(loss + fading + self._load * np.abs(force), 0.0)
        return result


class Ripple:
    """Torque of all simulations that goes to and fro with joints' positions; ``variants`` gives the variant of each."""

    def __init__(self, plant: Plant, variants: Sequence[Variant]) -> None:
        paths, model = [v.friction for v in variants], plant.model
        self.dofs = np.flatnonzero(np.any([p.ripple != 0.0 for p in paths], axis=0))
        """Degrees of freedom (k,) at which some simulation has one."""
        self._coordinates = model.jnt_qposadr[model.dof_jntid[self.dofs]]
        self._size = np.stack([p.ripple[self.dofs] for p in paths])
        self._period = np.stack([p.ripple_period[self.dofs] for p in paths])
        self._origin = np.stack([p.ripple_origin[self.dofs] for p in paths])

    def at(self, position: Array) -> Array:
        """Torques (n, k) at the coordinates (n, nq)."""
        turned = (position[:, self._coordinates] - self._origin) / self._period
        result: Array = self._size * np.sin(2.0 * np.pi * turned)
        return result
