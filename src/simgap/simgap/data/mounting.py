"""The same robot on a mount that can tilt: a second model, with two hinges more below every fixed base."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import mujoco
import numpy as np
from mujoco import batch as mjbatch
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

FIELDS = tuple(
    sorted(
        f
        for f in mjbatch.MODEL_FIELDS
        if not f.startswith(("name", "cam_", "light_", "mat_", "flex", "tex", "key_", "text", "tuple"))
        and not f.startswith(("numeric", "plugin", "bvh"))
    )
)
"""Of mjModel, those in which two models of one structure may differ."""
_TURNS = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_BALL))
_TOLD = (
    *("type", "name", "align", "ref", "pos", "axis", "stiffness", "springref", "springdamper", "damping", "armature"),
    *("frictionloss", "limited", "range", "margin", "actfrclimited", "actfrcrange", "actgravcomp", "group", "userdata"),
    *("solref_limit", "solimp_limit", "solref_friction", "solimp_friction", "springyield", "info"),
)
"""All that a joint of a specification says of itself."""
_LEAST = 1e-9
"""[kg m^2] of a hinge without its spring, which nothing may stand on."""
_ALIKE = 1e-6
"""Rounding that two models of the same robot may differ by, as a share of the larger."""


@dataclass(frozen=True)
class Mounting:
    """A model with mounts, and where what it shares with the plain one is in it.

    Attributes:
        model: with two hinges about horizontal axes through the origin of each of ``bodies``; they come before its own
            joints.
        plain: the model without them, as its file says it.
        tilt: (nbodies, 2) degrees of freedom of the hinges.
        inertia: (nbodies, 2) of all that stands on each, about its hinges in the reference pose [kg m^2].
        rows: for `qpos`, `dof` and `jnt`: where each row of the plain model is in this one.
    """

    model: mujoco.MjModel
    plain: mujoco.MjModel
    bodies: tuple[int, ...]
    tilt: Ints
    inertia: Array
    rows: dict[str, Ints]

    def of(self, model: mujoco.MjModel) -> mujoco.MjModel:
        """A changed plain model on its mounts, which have neither springs nor inertia yet."""
        made = copy.copy(self.model)
        for field, usual in self._usual.items():
            value = read_field(model, field)
            if value.tobytes() != usual:
                self._enter(made, field, value)
        return made

    def rows_of(self, field: str) -> Ints | None:
        """Where a field's rows of the plain model are in this one; None of fields that have as many in both."""
        return self.rows.get(field.split("_")[0].rstrip("0"))

    @cached_property
    def _usual(self) -> dict[str, bytes]:
        return field_bytes(self.plain)

    def _enter(self, made: mujoco.MjModel, field: str, value: NDArray[np.generic]) -> None:
        if field.startswith("opt."):
            setattr(made.opt, field[4:], value if value.ndim else value.item())
            return
        rows, target = self.rows_of(field), getattr(made, field)
        if rows is not None:
            target[rows] = value
        elif target.shape == value.shape:
            target[:] = value


def read_field(model: mujoco.MjModel, name: str) -> NDArray[np.generic]:
    """A field of mjModel; ``opt.`` before one of its options."""
    return np.asarray(getattr(model.opt, name[4:]) if name.startswith("opt.") else getattr(model, name))


def field_bytes(model: mujoco.MjModel) -> dict[str, bytes]:
    """All of `FIELDS`, to compare models by."""
    return {field: read_field(model, field).tobytes() for field in FIELDS}


def fixed_bases(model: mujoco.MjModel) -> tuple[int, ...]:
    """Bodies by which robots stand fixed in the world: what is below turns about them, and nothing carries them.

    A body that slides in the world is none: planar models say so that it floats.
    """
    found = []
    for body in range(1, model.nbody):
        first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
        if (
            model.body_parentid[body]
            or model.body_mocapid[body] >= 0
            or (count and int(model.jnt_type[first]) not in _TURNS)
        ):
            continue
        above = np.arange(model.nbody)
        while (above > body).any():
            above = np.where(above > body, model.body_parentid[above], above)
        if model.body_jntnum[above == body].any():
            found.append(body)
    return tuple(found)


def mounting(spec: mujoco.MjSpec, plain: mujoco.MjModel) -> Mounting | None:
    """The robots of a specification on mounts; None where none is fixed, or MuJoCo cannot say the same model so.

    ``plain`` is what the specification compiles to.
    """
    bodies = fixed_bases(plain)
    if not bodies:
        return None
    spec, plain = spec.copy(), copy.copy(plain)
    while spec.keys:
        spec.delete(spec.keys[0])
    try:
        for body in bodies:
            _put_on_mount(spec, plain, body)
        model = spec.compile()
    except ValueError:
        return None
    tilt = np.array([model.body_dofadr[b] + np.arange(2) for b in bodies])
    own = {
        "dof": np.setdiff1d(np.arange(model.nv), tilt),
        "jnt": np.setdiff1d(np.arange(model.njnt), [model.dof_jntid[d] for d in tilt.ravel()]),
        "qpos": np.setdiff1d(np.arange(model.nq), [model.jnt_qposadr[model.dof_jntid[d]] for d in tilt.ravel()]),
    }
    inertia = np.maximum(model.dof_M0[tilt] - _LEAST, _LEAST)
    made = Mounting(model, plain, bodies, tilt, inertia, own)
    return made if _alike(made) else None


def _put_on_mount(spec: mujoco.MjSpec, plain: mujoco.MjModel, body: int) -> None:
    """Add two hinges before a body's own joints."""
    base = spec.bodies[body]
    own: list[dict[str, Any]] = [{k: _value(joint, k) for k in _TOLD} for joint in base.joints]
    down = np.array(plain.opt.gravity) if np.any(plain.opt.gravity) else np.array([0.0, 0.0, -1.0])
    down /= np.linalg.norm(down)
    across = np.eye(3)[int(np.abs(down).argmin())]
    across -= (across @ down) * down
    across /= np.linalg.norm(across)
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, plain.body_quat[body])
    new = [base.add_joint() for _ in range(2)]
    empty = {k: _value(new[0], k) for k in _TOLD}
    tilts = [
        empty
        | {
            "type": mujoco.mjtJoint.mjJNT_HINGE,
            "name": f"mount of {body} {i}",
            "axis": turn.reshape(3, 3).T @ axis,
            "armature": _LEAST,
        }
        for i, axis in enumerate((across, np.cross(across, down)))
    ]
    # A body turns in the order of its joints, and new ones come last: so each takes the place of the one before.
    for joint, told in zip(base.joints, [*tilts, *own], strict=True):
        joint.name = f"{told['name']} in waiting"
    for joint, told in zip(base.joints, [*tilts, *own], strict=True):
        for key, value in told.items():
            setattr(joint, key, value)
    # What stood still beside the world's own things never touched them.
    if not own:
        collides = [bool(np.any(plain.geom_contype[plain.geom_bodyid == b])) for b in range(plain.nbody)]
        still = [b for b in np.flatnonzero(plain.body_weldid == 0) if collides[b]]
        mine = [b for b in still if plain.body_rootid[b] == body]
        for b in still:
            if b and not spec.bodies[b].name:
                spec.bodies[b].name = f"still {b}"
        for one in mine:
            for other in set(still) - set(mine):
                spec.add_exclude(bodyname1=spec.bodies[one].name, bodyname2=spec.bodies[other].name)


def _value(joint: Any, key: str) -> Any:
    value = getattr(joint, key)
    return np.array(value) if isinstance(value, np.ndarray) else value


def _alike(made: Mounting) -> bool:
    """Whether untilted mounts change nothing, somewhere off the reference pose."""
    one, two = mujoco.MjData(made.plain), mujoco.MjData(made.model)
    speed = np.random.default_rng(0).normal(0.0, 0.3, made.plain.nv)
    mujoco.mj_integratePos(made.plain, one.qpos, speed, 1.0)
    two.qpos[made.rows["qpos"]] = one.qpos
    one.qvel[:], two.qvel[made.rows["dof"]] = speed, speed
    for model, data in ((made.plain, one), (made.model, two)):
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mj_sensorPos(model, data)
        mujoco.mj_sensorVel(model, data)
    own = made.rows["dof"]
    pairs = [(one.qfrc_bias, two.qfrc_bias[own]), (one.qfrc_passive, two.qfrc_passive[own])]
    pairs += [(getattr(one, f), getattr(two, f)) for f in ("xpos", "actuator_velocity", "ten_velocity", "sensordata")]
    return all(bool((np.abs(a - b) <= _ALIKE * max(float(np.abs(a).max(initial=0.0)), 1.0)).all()) for a, b in pairs)
