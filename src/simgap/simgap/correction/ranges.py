"""The intervals of a diagnosis as ranges for domain randomisation, in the words of those who train on them.

`ranges.yaml` has four parts:

- ``fields``: fields of mjModel, for MuJoCo Playground and whoever sets them: {field, element, name, low, high}, in the
  unit of MJCF with angles in radians. `draw` sets them in a model.
- ``mjlab``: events. ``func`` is a function of `mjlab.envs.mdp.dr`, the rest are its parameters and those of
  `SceneEntityCfg`.
- ``isaaclab``: events. ``func`` is a function of `isaaclab.envs.mdp`, the rest as above.
- ``signals``: what no model holds (delays, dead bands, friction of gears), for the wrapper.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import yaml

from simgap.correction.changes import ATTRIBUTES, OBJECTS, Change, Signal
from simgap.data.channels import model_names
from simgap.data.errors import GapInputError

_MJLAB = {
    "damping": "joint_damping",
    "armature": "joint_armature",
    "frictionloss": "joint_friction",
    "stiffness": "joint_stiffness",
    "mass": "body_mass",
    "ipos": "body_com_offset",
    "friction": "geom_friction",
}
"""MJCF attribute -> function of mjlab's `dr`."""
_MJLAB_TENDON = {"damping": "tendon_damping", "frictionloss": "tendon_friction", "stiffness": "tendon_stiffness"}
_ISAAC_JOINT = {"frictionloss": "friction_distribution_params", "armature": "armature_distribution_params"}


def ranges(changes: Sequence[Change], signals: Sequence[Signal]) -> dict[str, Any]:
    """See the module; only what has a range of its own is in it."""
    found: dict[str, Any] = {"fields": [], "mjlab": [], "isaaclab": [], "signals": []}
    for change in changes:
        if not change.low or change.low == change.high:
            continue
        low, high = list(change.low), list(change.high)
        field = change.attribute
        if change.element != "option":
            field = next(a.field for a in ATTRIBUTES if (a.element, a.name) == (change.element, change.attribute))
        found["fields"].append(
            {"field": field, "element": change.element, "name": change.name, "low": low, "high": high}
        )
        found["mjlab"] += _mjlab(change, changes)
        found["isaaclab"] += _isaaclab(change)
    for signal in signals:
        if signal.low is not None and signal.low != signal.high:
            row = {k: getattr(signal, k) for k in ("where", "name", "quantity", "low", "high", "unit")}
            found["signals"].append(row)
    return found


def write_ranges(path: Path, changes: Sequence[Change], signals: Sequence[Signal], source: str) -> int:
    """Write `ranges.yaml`; returns how many numbers have a range.

    Raises:
        GapInputError: the file cannot be written.
    """
    found = ranges(changes, signals)
    heading = f"# Ranges for domain randomisation: 90 % intervals of {source}. SI, angles in radians.\n"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(heading + yaml.safe_dump(found, sort_keys=False), encoding="utf-8")
    except OSError as error:
        raise GapInputError(f"{path}: cannot be written ({error.strerror})") from error
    return len(found["fields"]) + len(found["signals"])


def draw(model: mujoco.MjModel, fields: Sequence[dict[str, Any]], rng: np.random.Generator) -> None:
    """Set the ``fields`` of a `ranges.yaml` in a model, in place, each drawn uniformly from its range."""
    for row in fields:
        value = rng.uniform(row["low"], row["high"])
        if row["element"] == "option":
            setattr(model.opt, row["field"], value if len(value) > 1 else value[0])
            continue
        index = model_names(model, OBJECTS[row["element"]]).index(row["name"])
        attribute = next(a for a in ATTRIBUTES if (a.element, a.field) == (row["element"], row["field"]))
        target = getattr(model, row["field"])
        at = attribute.row(model, index)
        if np.ndim(target[at]):
            target[at][: len(value)] = value
        else:
            target[at] = value[0]
    mujoco.mj_setConst(model, mujoco.MjData(model))


def _mjlab(change: Change, changes: Sequence[Change]) -> list[dict[str, Any]]:
    if change.attribute == "gainprm":
        damping = next((c for c in changes if (c.name, c.attribute) == (change.name, "biasprm")), None)
        params: dict[str, Any] = {"kp_range": [change.low[0], change.high[0]], "operation": "abs"}
        if damping is not None and damping.low:
            params["kd_range"] = [-damping.high[2], -damping.low[2]]
        entity = {"name": "robot", "actuator_names": [change.name]}
        return [{"func": "pd_gains", "mode": "startup", "asset_cfg": entity, "params": params}]
    func = (_MJLAB_TENDON if change.element == "tendon" else _MJLAB).get(change.attribute)
    if change.attribute == "forcerange":
        entity = {"name": "robot", "actuator_names": [change.name]}
        params = {"effort_limit_range": [change.low[1], change.high[1]], "operation": "abs"}
        return [{"func": "effort_limits", "mode": "startup", "asset_cfg": entity, "params": params}]
    if func is None:
        return []
    entity = {"name": "robot", f"{change.element}_names": [change.name]}
    made = []
    for axis, (low, high) in enumerate(zip(change.low, change.high, strict=True)):
        if low != high:
            params = {"ranges": [low, high], "operation": "abs", "distribution": "uniform"}
            if len(change.low) > 1:
                params["axes"] = [axis]
            made.append({"func": func, "mode": "startup", "asset_cfg": entity, "params": params})
    return made


def _isaaclab(change: Change) -> list[dict[str, Any]]:
    bounds = [change.low[0], change.high[0]]
    how = {"operation": "abs", "distribution": "uniform"}
    params: dict[str, Any]
    if change.element == "joint" and change.attribute in _ISAAC_JOINT:
        func, params = "randomize_joint_parameters", {_ISAAC_JOINT[change.attribute]: bounds, **how}
    elif change.element == "body" and change.attribute == "mass":
        func, params = "randomize_rigid_body_mass", {"mass_distribution_params": bounds, **how}
    elif change.element == "body" and change.attribute == "ipos":
        shifts = {
            axis: [low - nominal, high - nominal]
            for axis, low, high, nominal in zip("xyz", change.low, change.high, change.nominal, strict=True)
        }
        func, params = "randomize_rigid_body_com", {"com_range": shifts}
    elif change.element == "actuator" and change.attribute == "gainprm":
        # Isaac Lab names the gains of a joint by the joint.
        func, params = "randomize_actuator_gains", {"stiffness_distribution_params": bounds, **how}
    else:
        return []
    key = "joint_names" if change.element == "actuator" else f"{change.element}_names"
    entity = {"name": "robot", key: [change.name]}
    return [{"func": func, "mode": "startup", "asset_cfg": entity, "params": params}]
