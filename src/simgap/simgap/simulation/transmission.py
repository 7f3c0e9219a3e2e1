"""Motors that turn by themselves, behind a play or a spring: `backlash` and `compliance` of the servos."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from mujoco import batch as mjbatch
from numpy.typing import NDArray

from simgap.data.plant import Plant
from simgap.simulation.variant import Variant

Array = NDArray[np.float64]

_CONTACT_STIFFNESS = 0.7
"""Stiffness of the flanks of a play, as a share of what one time step can carry: inertia / dt^2."""


class Transmission:
    """One step of the motors of all simulations. Arrays are (n, motors) where nothing else is said.

    What does not change from step to step is computed once: of few simulations the arithmetic takes longer than MuJoCo.
    """

    @classmethod
    def of(cls, plant: Plant, variants: Sequence[Variant], low: Array, high: Array, dt: float) -> Transmission | None:
        """Of the servos that some variant has behind a play or a spring, see `__init__`; None where there are none."""
        apart = np.any([(v.servos.backlash > 0) | (v.servos.compliance > 0) for v in variants], axis=0)
        joint = plant.model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT
        motors = [int(a) for a in np.flatnonzero(apart & joint)]
        return cls(plant, variants, motors, low, high, dt) if motors else None

    def __init__(
        self, plant: Plant, variants: Sequence[Variant], motors: list[int], low: Array, high: Array, dt: float
    ) -> None:
        """``variants`` gives the variant of each simulation; ``low`` and ``high`` (n, nu) bound the servos' forces."""
        model, a, self._dt, self._motors = plant.model, motors, dt, motors
        joints = model.actuator_trnid[a, 0]
        self._coordinate, self._dofs = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
        width, give = (np.stack([getattr(v.servos, name)[a] for v in variants]) for name in ("backlash", "compliance"))
        self._apart, self._half, self._elastic = (width > 0) | (give > 0), 0.5 * width, give > 0
        self._no_play = self._half == 0
        self._gain = np.stack([v.model.actuator_gainprm[a, 0] for v in variants])
        self._offset, self._by_angle, self._by_speed = (
            np.stack([v.model.actuator_biasprm[a, k] for v in variants]) for k in range(3)
        )
        self._gear = np.stack([v.model.actuator_gear[a, 0] for v in variants])
        self._low, self._high = low[:, a], high[:, a]
        self._armature = np.stack([v.model.dof_armature[self._dofs] for v in variants])
        # What a flank feels: the joint's inertia with all others free to give way, without the motor's.
        total = 1.0 / np.stack([v.model.dof_invweight0[self._dofs] for v in variants])
        link = np.maximum(total - self._armature, 0.05 * total)
        inertia = np.maximum(self._armature, 0.02 * link)
        # What is between motor and joint: the flanks of a play are as stiff as a time step can carry, and no spring is
        # stiffer.
        hardest = _CONTACT_STIFFNESS * link / dt**2
        self._stiffness = 1.0 / np.maximum(give, 1.0 / hardest)
        ratio, most = np.stack([v.servos.ringing[a] for v in variants]), (1.0 - _CONTACT_STIFFNESS) / dt
        yielding = np.minimum(2.0 * ratio * np.sqrt(self._stiffness / link), most)
        self._damping = link * np.where(self._elastic, yielding, most)
        # The implicit step of a motor: what it has and what resists it, free and with a flank or a spring.
        squared = self._gear**2
        self._inertia, self._brake = inertia / dt, squared * self._by_speed
        resists = (-self._by_angle * dt - self._by_speed) * squared
        self._free = self._inertia + resists + np.stack([v.model.dof_damping[self._dofs] for v in variants])
        self._held = self._free + self._by_angle * dt * squared + self._stiffness * dt + self._damping
        self._angle: Array | None = None
        self._speed = np.zeros_like(link)

    def bind(self, batch: mjbatch.Batch) -> None:
        """Attach to a batch. A joint leaves its inertia and damping to its motor."""
        self._qpos, self._qvel = batch.bind("qpos"), batch.bind("qvel")
        gain, bias = batch.expand("actuator_gainprm"), batch.expand("actuator_biasprm")
        armature, damping = batch.expand("dof_armature"), batch.expand("dof_damping")
        for j, (a, dof) in enumerate(zip(self._motors, self._dofs, strict=True)):
            loose = self._apart[:, j]
            gain[loose, a, 0] = 0.0
            bias[loose, a, :3] = 0.0
            armature[loose, dof] -= self._armature[loose, j]
            damping[loose, dof] = 0.0

    def step(self, control: Array, extra: Array) -> None:
        """Advance the motors by an implicit step under controls (n, nu); add to ``extra`` (n, nv) what joints feel."""
        h, gear, stiffness, damping = self._dt, self._gear, self._stiffness, self._damping
        q, rate = self._qpos[:, self._coordinate], self._qvel[:, self._dofs]
        drive = self._gain * control[:, self._motors] + self._offset
        if self._angle is None:
            # Where its servo would bring it, as far as flanks or spring let it.
            pull = gear * self._by_angle
            rest = np.divide(-drive, pull, out=q.copy(), where=pull != 0)
            own = -gear * pull
            between = (own * rest + stiffness * q) / (own + stiffness)
            self._angle = np.where(self._elastic, between, np.clip(rest, q - self._half, q + self._half))
            self._speed = rate.copy()
        gap = self._angle - q
        asked = drive + gear * (self._by_angle * self._angle + self._by_speed * self._speed)
        force = np.minimum(np.maximum(asked, self._low), self._high)
        lead = self._inertia * self._speed + gear * force - self._brake * self._speed
        free = lead / self._free
        # The flank that the motor would be behind after this step, so that it is never shot through a narrow play.
        ahead = gap + h * (free - rate)
        side = np.where(np.abs(ahead) >= self._half, np.sign(ahead), 0.0)
        away = side * self._half
        held = (lead - stiffness * (gap - h * rate - away) + damping * rate) / self._held
        # The joint takes an explicit step, to which a spring at its end would be a damper; a flank may be one.
        faster = held - rate
        coming = np.where(self._elastic, 0.0, h * faster)
        torque = stiffness * (gap + coming - away) + damping * faster
        # A flank pushes; it does not pull. A spring without play does both.
        pushes = (torque * side > 0) | self._no_play
        self._speed = np.where(pushes, held, free)
        self._angle = self._angle + h * self._speed
        felt = np.where(pushes & self._apart, torque, 0.0)
        for j, dof in enumerate(self._dofs):
            extra[:, dof] += felt[:, j]
