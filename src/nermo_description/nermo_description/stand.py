"""The stand that a mouse hangs in: the torso on a spring and a damper to the world, its feet in the air."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Stand:
    """A torso plate on a soft arm.

    MuJoCo gives a free joint one stiffness for both motions, so the two have the same number. Soft enough that a leg's
    swing is seen at the torso (20 mN m turn it by 10 mrad), damped so that it comes to rest within a second.
    """

    height: float = 0.5
    """[m] of base_link over the floor: feet hang 9 cm lower, and 50 g more weight takes them down by 25 cm."""
    stiffness: float = 2.0
    """[N/m] and [N m/rad], chosen."""
    damping: float = 1.0
    """[N s/m], chosen: 0.7 of critical for the mouse's mass."""
    turning_damping: float = 0.02
    """[N m s/rad], chosen: a third of critical for the mouse's inertia."""

    def rest(self, nominal: mujoco.MjModel) -> Array:
        """(7,) Where the spring pulls to: as far above, and as far tilted, as this mouse's weight takes it back.

        A heavier mouse hangs lower, and one whose weight sits elsewhere hangs tilted.
        """
        data = mujoco.MjData(nominal)
        mujoco.mj_resetDataKeyframe(nominal, data, 0)
        mujoco.mj_kinematics(nominal, data)
        mujoco.mj_comPos(nominal, data)
        torso = nominal.body("torso").id
        weight = float(nominal.body_subtreemass[torso] * -nominal.opt.gravity[2])
        tilt = weight * float(data.subtree_com[torso, 0] - data.xpos[torso, 0]) / self.stiffness
        turn = (np.cos(tilt / 2.0), 0.0, -np.sin(tilt / 2.0), 0.0)
        return np.array([0.0, 0.0, self.height + weight / self.stiffness, *turn])

    def enter(self, model: mujoco.MjModel, rest: Array) -> None:
        """Put the mouse into the stand, in place; ``rest`` (7,) is the spring's."""
        joint = model.joint("root")
        qpos, dof = int(joint.qposadr[0]), int(joint.dofadr[0])
        model.jnt_stiffness[joint.id] = self.stiffness
        model.dof_damping[dof : dof + 3] += self.damping
        model.dof_damping[dof + 3 : dof + 6] += self.turning_damping
        model.qpos_spring[qpos : qpos + 7] = rest

    def pose(self) -> Array:
        """(7,) Where the mouse is put to begin with."""
        return np.array([0.0, 0.0, self.height, 1.0, 0.0, 0.0, 0.0])

    def hang(self, model: mujoco.MjModel) -> None:
        """Put the mouse into the stand and all its keyframes with it, in place: the scene `hung`."""
        joint = int(model.joint("root").qposadr[0])
        self.enter(model, self.rest(model))
        model.key_qpos[:, joint : joint + 7] = self.pose()
