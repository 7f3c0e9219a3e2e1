"""A hidden mouse: every number of it is a little off, it runs in another time step, and one thing is wrong with it."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from nermo_description.markers import MARKERS
from nermo_description.model import build_model
from nermo_description.parameters import RobotParameters
from nermo_gap.blind.mice.faults import KINDS, KNOWN, UNKNOWN, Fault, all_forces, all_servos
from nermo_gap.protocol.play import Body
from simgap.data.errors import GapInputError

Array = NDArray[np.float64]

TIME_STEP = 0.0005
"""[s], half of the twin's."""
PERIOD = 0.005
"""[s] of a control tick."""
LEAST, MOST = 0.03, 0.08
"""By what share a number is off, up or down."""
GLUED = 5e-4
"""[m] by which markers are off, along each axis."""


def draw(robot: RobotParameters, number: int, kind: str | None = None, markers: bool = False) -> tuple[Body, Fault]:
    """Mouse ``number`` of a robot, and what is wrong with it; ``kind`` asks for a fault instead of drawing one.

    ``markers``: it wears some, glued on by eye.

    Raises:
        GapInputError: a kind that is not known.
    """
    every = KINDS | KNOWN | UNKNOWN
    if kind is not None and kind not in every:
        raise GapInputError(f"fault {kind!r} is unknown: choose one of {', '.join(every)}")
    random = np.random.default_rng([number, 0x6E65])
    drawn = str(random.choice(list(KINDS)))
    fault = every[kind or drawn](random)
    return with_faults(robot, number, [fault], int(random.integers(2**31)), markers), fault


def with_faults(robot: RobotParameters, number: int, faults: Sequence[Fault], off: int, markers: bool = False) -> Body:
    """A mouse with these faults, whose every number is off as the seed ``off`` says."""

    def model() -> mujoco.MjModel:
        built = build_model(robot)
        _make_real(built, np.random.default_rng(off))
        for fault in faults:
            fault.enter(built)
        mujoco.mj_setConst(built, mujoco.MjData(built))
        return built

    def servos() -> Callable[[Array], Array]:
        return all_servos(faults, list(robot.servos), PERIOD)

    glued = GLUED * np.random.default_rng([number, 0x676C]).standard_normal((len(MARKERS), 3)) if markers else None
    return Body(robot, model, servos, forces=lambda: all_forces(faults), markers=glued)


def _make_real(model: mujoco.MjModel, random: np.random.Generator) -> None:
    """Put every number off by 3 to 8 %, in place, each by itself."""

    def off(count: int) -> Array:
        return np.exp(random.choice([-1.0, 1.0], count) * random.uniform(LEAST, MOST, count))

    model.opt.timestep = TIME_STEP
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICIT
    mass = off(model.nbody)
    model.body_mass *= mass
    model.body_inertia *= (mass * off(model.nbody))[:, None]
    gyration = np.sqrt(model.body_inertia.sum(axis=1) / 2.0 / np.maximum(model.body_mass, 1e-9))
    model.body_ipos += gyration[:, None] * np.log(off(3 * model.nbody)).reshape(-1, 3)
    model.jnt_stiffness *= off(model.njnt)
    model.dof_damping *= off(model.nv)
    model.dof_armature *= off(model.nv)
    # Motors are as strong as they are: gain, brake and integrator go together.
    gain = off(model.nu)[:, None]
    model.actuator_gainprm[:, :3] *= gain
    model.actuator_biasprm[:, :3] *= gain
    model.geom_friction[:, 0] *= off(model.ngeom)
    model.geom_solref[:, 0] *= off(model.ngeom)
