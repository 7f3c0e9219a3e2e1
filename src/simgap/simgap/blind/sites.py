"""Where a fault can sit in a robot, and which names count as having found the place."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

_SCALAR = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
_AXES = {
    int(mujoco.mjtJoint.mjJNT_SLIDE): 0,
    int(mujoco.mjtJoint.mjJNT_HINGE): 1,
    int(mujoco.mjtJoint.mjJNT_BALL): 3,
    int(mujoco.mjtJoint.mjJNT_FREE): 3,
}
"""About which a joint turns its body."""
_TENDON = int(mujoco.mjtTrn.mjTRN_TENDON)
_SIDES = ("front", "rear", "left", "right")
_PARTS = ("hip", "knee")


@dataclass(frozen=True)
class Site:
    """A place: its public name, the names behind it (several for a group), and the names that point to the same place.

    For a sensor the members are column names of the recording.
    """

    name: str
    members: tuple[str, ...]
    places: tuple[str, ...]


def sites(model: mujoco.MjModel, mapping: dict[str, Any]) -> dict[str, list[Site]]:
    """Sites of each kind: joint, driven, geared, sprung, elastic, body, actuator, servo, play, cable, foot..."""
    scalar = [j for j in range(model.njnt) if int(model.jnt_type[j]) in _SCALAR]
    told = {row.get("actuator") for row in mapping["inputs"]}
    actuators = [a for a in range(model.nu) if model.actuator(a).name in told]
    feedback = [a for a in actuators if model.actuator_biasprm[a, 1] != 0]
    servos = [a for a in feedback if model.actuator_trntype[a] != _TENDON]
    # Cables only pull; a tendon that also pushes is a rod.
    pulls = (model.actuator_forcelimited == 1) & (model.actuator_forcerange[:, 1] <= 0)
    cables = [a for a in feedback if model.actuator_trntype[a] == _TENDON and pulls[a]]
    driven = sorted({int(model.actuator_trnid[a, 0]) for a in actuators if model.actuator_trntype[a] != _TENDON})
    still = model.body_weldid == 0
    # Nobody can find a fault in what hardly weighs, or in a joint that is neither driven nor seen.
    bodies = [b for b in range(1, model.nbody) if not still[b] and model.body_mass[b] > 0.02 * model.body_mass.sum()]
    seen = {_joint_of(model, row) for row in mapping["outputs"]}
    scalar = [j for j in scalar if j in driven or j in seen]
    feet = [
        g
        for g in range(model.ngeom)
        if not still[model.geom_bodyid[g]] and (model.geom_contype[g] or model.geom_conaffinity[g])
    ]
    floored = any(still[model.geom_bodyid[g]] for g in range(model.ngeom))
    free = bool((model.jnt_type == mujoco.mjtJoint.mjJNT_FREE).any())

    def of(kind: str, index: int) -> Site:
        name = str(getattr(model, kind)(index).name)
        return Site(name, (name,), tuple(sorted(_places(model, kind, index) | _measured_as(mapping, name))))

    found = {
        "joint": _grouped([of("joint", j) for j in scalar]),
        "driven": _grouped([of("joint", j) for j in driven]),
        "geared": [of("joint", j) for j in driven],
        # What damps a joint with a spring is called its damping, and is the same.
        "unsprung": _grouped([of("joint", j) for j in scalar if model.jnt_stiffness[j] == 0]),
        "mounted": [Site(name, (name,), (name,)) for name in _on_a_stand(model)],
        "sprung": [of("joint", j) for j in scalar if model.jnt_stiffness[j] > 0],
        "elastic": [of("joint", int(model.actuator_trnid[a, 0])) for a in servos],
        "body": [of("body", b) for b in bodies],
        "turned": [of("body", b) for b in bodies if _turns_about_several(model, b)],
        "unbalanced": [of("body", b) for b in bodies if not _turns_upright_only(model, b)],
        "actuator": _grouped([of("actuator", a) for a in actuators]),
        "servo": _grouped([of("actuator", a) for a in servos]),
        "play": [of("actuator", a) for a in servos],
        "flexing": [of("actuator", a) for a in servos if not _tilts_all(model, int(model.actuator_trnid[a, 0]))],
        "cable": [of("tendon", int(model.actuator_trnid[a, 0])) for a in cables],
        "strap": [of("tendon", t) for t in range(model.ntendon) if model.tendon_limited[t]],
        "foot": [of("geom", g) for g in feet] if floored else [],
        "ground": [Site("all", ("all",), ("all",))] if floored and free else [],
        "all": [Site("all", ("all",), ("all",))],
        # Of one actuator, what comes late over the link and what its servo does late are the same.
        "several": [Site("all", ("all",), ("all",))] if len(actuators) > 1 else [],
        "supply": [Site("all", ("all",), ("all",))] if len(servos) > 1 else [],
    }
    if len(found["foot"]) > 1:
        every = tuple(s.name for s in found["foot"])
        found["foot"] = [*found["foot"], Site("all", every, ("all", *every))]
    return found | _sensors(model, mapping)


def _sensors(model: mujoco.MjModel, mapping: dict[str, Any]) -> dict[str, list[Site]]:
    single, axes = [], []
    vectors: dict[str, list[tuple[str, str]]] = {}
    for row in mapping["outputs"]:
        name = row.get("sensor") or row.get("joint") or row.get("body")
        if "component" in row:
            vectors.setdefault(name if "sensor" in row else "", []).append((row["column"], str(row["component"])))
            continue
        places = {name}
        if "sensor" in row:
            joint = int(model.sensor_objid[model.sensor(name).id])
            places |= _places(model, "joint", joint)
        elif "joint" in row:
            places |= _places(model, "joint", model.joint(name).id)
        single.append(Site(name, (row["column"],), tuple(sorted(places))))
    for name, parts in vectors.items():
        if name and len(parts) == 3:
            columns = [column for column, _ in parts]
            near = {name, *columns, *(f"{name}:{part}" for _, part in parts)}
            axes.append(Site(name, tuple(columns), tuple(sorted(near))))
    return {"sensor": single, "filtered": single, "axes": axes}


def _ways(model: mujoco.MjModel, body: int) -> list[int]:
    """The joints that move a body, its own first."""
    found: list[int] = []
    while body > 0:
        first = int(model.body_jntadr[body])
        found += range(first, first + int(model.body_jntnum[body]))
        body = int(model.body_parentid[body])
    return found


def _turns_about_several(model: mujoco.MjModel, body: int) -> bool:
    """Whether more than one axis turns a body; of one axis, the inertia of the body and that of its motor are one."""
    return sum(_AXES[int(model.jnt_type[j])] for j in _ways(model, body)) > 1


def _turns_upright_only(model: mujoco.MjModel, body: int) -> bool:
    """Whether a body can but turn about one axis along gravity: where its mass lies then shows as inertia only."""
    ways = _ways(model, body)
    if len(ways) != 1 or model.jnt_type[ways[0]] != mujoco.mjtJoint.mjJNT_HINGE:
        return False
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    across = np.cross(data.xaxis[ways[0]], model.opt.gravity)
    return bool(np.linalg.norm(across) < 1e-6 * max(float(np.linalg.norm(model.opt.gravity)), 1e-9))


def _on_a_stand(model: mujoco.MjModel) -> list[str]:
    """Bodies that stand fixed in the world with more than one joint on them.

    Of a single joint, a stand that tilts is a link that flexes. A body that slides in the world may float.
    """
    found = []
    for body in np.flatnonzero(model.body_parentid == 0)[1:]:
        joints = [j for j in range(model.njnt) if model.body_rootid[model.jnt_bodyid[j]] == body]
        slides = int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_FREE)
        if len(joints) > 1 and int(model.jnt_type[joints[0]]) not in slides:
            found.append(str(model.body(int(body)).name))
    return found


def _tilts_all(model: mujoco.MjModel, joint: int) -> bool:
    """Whether a joint tilts a whole robot against the world, as a stand would that gives way: the two flex alike."""
    body = int(model.jnt_bodyid[joint])
    return bool(model.body_parentid[body] == 0) and not _turns_upright_only(model, body)


def _joint_of(model: mujoco.MjModel, row: dict[str, Any]) -> int:
    """The joint that an output measures, or -1."""
    if "joint" in row:
        return int(model.joint(row["joint"]).id)
    if "sensor" in row and model.sensor_objtype[model.sensor(row["sensor"]).id] == mujoco.mjtObj.mjOBJ_JOINT:
        return int(model.sensor_objid[model.sensor(row["sensor"]).id])
    return -1


def _grouped(single: list[Site]) -> list[Site]:
    """The sites and their groups: front, rear, left, right, all_hips, all_knees."""
    found = list(single)
    for word in (*_SIDES, *_PARTS):
        members = [s for s in single if word in s.name.split("_")]
        if 1 < len(members) < len(single):
            name = word if word in _SIDES else f"all_{word}s"
            places = {p for s in members for p in s.places} | {name}
            found.append(Site(name, tuple(s.name for s in members), tuple(sorted(places))))
    return found


def _places(model: mujoco.MjModel, kind: str, index: int) -> set[str]:
    """Names of the part that this element belongs to: a joint with its body, its drive and its sensors."""
    if kind == "body":
        first, count = int(model.body_jntadr[index]), int(model.body_jntnum[index])
        own = {str(model.body(index).name)}
        scalar = [j for j in range(first, first + count) if int(model.jnt_type[j]) in _SCALAR]
        return own.union(*(_places(model, "joint", j) for j in scalar))
    if kind == "geom":
        return {str(model.geom(index).name)} | _places(model, "body", int(model.geom_bodyid[index]))
    if kind == "actuator":
        target = int(model.actuator_trnid[index, 0])
        through = "tendon" if model.actuator_trntype[index] == _TENDON else "joint"
        return {str(model.actuator(index).name)} | _places(model, through, target)
    if kind == "tendon":
        first, count = int(model.tendon_adr[index]), int(model.tendon_num[index])
        parts = range(first, first + count)
        joints = [int(model.wrap_objid[w]) for w in parts if model.wrap_type[w] == mujoco.mjtWrap.mjWRAP_JOINT]
        return {str(model.tendon(index).name)}.union(*(_places(model, "joint", j) for j in joints))
    found = {str(model.joint(index).name), str(model.body(int(model.jnt_bodyid[index])).name)}
    for a in range(model.nu):
        through_tendon = model.actuator_trntype[a] == _TENDON
        target = int(model.actuator_trnid[a, 0])
        if through_tendon:
            first, count = int(model.tendon_adr[target]), int(model.tendon_num[target])
            if index in model.wrap_objid[first : first + count]:
                found |= {str(model.actuator(a).name), str(model.tendon(target).name)}
        elif target == index:
            found.add(str(model.actuator(a).name))
    joint_sensors = np.isin(model.sensor_objtype, [int(mujoco.mjtObj.mjOBJ_JOINT)])
    found |= {str(model.sensor(int(s)).name) for s in np.flatnonzero(joint_sensors & (model.sensor_objid == index))}
    return found


def _measured_as(mapping: dict[str, Any], name: str) -> set[str]:
    """Columns that measure this very joint or body."""
    return {row["column"] for row in mapping["outputs"] if name in (row.get("joint"), row.get("body"))}
