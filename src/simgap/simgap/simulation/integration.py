"""What a time step does to a simulated robot: its joints seem to have more inertia than its equations say, and its feet
land when a step begins.
"""

from __future__ import annotations

import copy
import dataclasses

import mujoco
import numpy as np
from numpy.typing import NDArray

from simgap.data.plant import Plant
from simgap.simulation.contacts import colliding

Array = NDArray[np.float64]

FINER = 2
"""So many steps for one of the model's, where its bodies touch the ground. With a step of 1 ms two faults of the leg in
the blind set 16363903 (a knee's damping, a soft foot) fit 4 and 7 nats worse than what imitates them; with half of it 4
and 16 nats better, with a quarter, which takes twice as long again, 7 and 24."""


def semi_implicit(model: mujoco.MjModel) -> bool:
    """Whether the integrator is of the Euler kind (as all of MuJoCo's but Runge-Kutta are)."""
    return int(model.opt.integrator) != int(mujoco.mjtIntegrator.mjINT_RK4)


def finer(plant: Plant, times: int = FINER) -> Plant:
    """A plant with a time step ``times`` as fine, where its bodies can touch the ground; else the same.

    Damping that comes half a step early is a nuisance (`step_inertia`); what a contact does in a step is none.
    """
    if times == 1 or not colliding(plant.model)[0]:
        return plant
    model = copy.copy(plant.model)
    model.opt.timestep /= times
    return dataclasses.replace(plant, model=model)


def step_inertia(model: mujoco.MjModel) -> Array:
    """Inertia (nv,) that a semi-implicit step adds to each degree of freedom, to first order in the step h.

    The speed after a step is that of the middle of the way that it leads, so damping d that acts on it (joints',
    and of an implicit integrator servos' as well) comes half a step early: h d / 2 beside the inertia. Servos' damping
    that acts on the speed before comes as much late. About the reference pose; zero for Runge-Kutta.
    """
    if not semi_implicit(model):
        return np.zeros(model.nv)
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    moment = np.zeros((model.nu, model.nv))
    if model.nu:
        mujoco.mju_sparse2dense(
            moment, data.actuator_moment, data.moment_rownnz, data.moment_rowadr, data.moment_colind
        )
    affine = np.asarray(model.actuator_biastype == int(mujoco.mjtBias.mjBIAS_AFFINE))
    servo = (moment**2).T @ np.where(affine, np.maximum(-model.actuator_biasprm[:, 2], 0.0), 0.0)
    if model.opt.integrator == mujoco.mjtIntegrator.mjINT_EULER:
        servo = -servo
    added: Array = 0.5 * float(model.opt.timestep) * (np.array(model.dof_damping) + servo)
    return added
