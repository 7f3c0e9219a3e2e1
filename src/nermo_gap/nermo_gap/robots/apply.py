"""A diagnosis written down as a robot: a parameter file whose deviations are the effects that were found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco

from nermo_description.model import build_robot
from nermo_description.parameter_files import read_yaml, write_yaml
from nermo_description.parameters import DEVIATIONS, Deviation
from nermo_description.robots import load_robot, robot_names
from nermo_gap.robots.sites import groups
from simgap.data.channels import model_names
from simgap.data.errors import GapInputError

Obj = mujoco.mjtObj
_KINDS = {
    "servo": Obj.mjOBJ_ACTUATOR,
    "joint": Obj.mjOBJ_JOINT,
    "coulomb": Obj.mjOBJ_JOINT,
    "viscous": Obj.mjOBJ_JOINT,
    "armature": Obj.mjOBJ_JOINT,
    "tendon": Obj.mjOBJ_TENDON,
    "mass": Obj.mjOBJ_BODY,
    "com": Obj.mjOBJ_BODY,
    "inertia": Obj.mjOBJ_BODY,
    "ground": Obj.mjOBJ_GEOM,
    "foot": Obj.mjOBJ_GEOM,
}
"""First word of an effect's name -> what its sites are."""


@dataclass(frozen=True)
class Applied:
    """What became of the effects: the deviations that were written, and what cannot be said in a robot file."""

    deviations: tuple[Deviation, ...]
    left_out: tuple[str, ...]


def deviations_of(report: dict[str, Any], robot: str) -> Applied:
    """The effects of a diagnosis as deviations of a robot (its name or file).

    Raises:
        GapInputError: a site that the robot's model has not.
        ParameterError: the robot cannot be read.
    """
    model = build_robot(load_robot(robot)).compile()
    found: list[Deviation] = []
    left_out: list[str] = []
    for effect in report["effects"]:
        name, site = str(effect["name"]), str(effect["site"])
        values = {n: float(p["value"]) for n, p in effect["parameters"].items()}
        name = {"link_latency": "servo_delay", "gravity_lean": "ground_slope"}.get(name, name)
        if name not in DEVIATIONS:
            where = "is a matter of calibration" if name.startswith("sensor") else "has no place in a robot file"
            left_out.append(f"{name}@{site} {where}")
            continue
        sites = () if name == "ground_slope" else _sites(model, name, site)
        found.append(Deviation(effect=name, sites=sites, values=values))
        if effect.get("form") in ("motor", "part"):
            left_out.append(f"{name}@{site}: form {effect['form']} is written as the simpler one of the twin")
    return Applied(tuple(found), tuple(left_out))


def write_robot(deviations: Sequence[Deviation], robot: str, path: Path) -> None:
    """Write a robot file that is ``robot`` (a name or a file) with the deviations added.

    Raises:
        ParameterError: the file cannot be written, or would not be a valid robot.
    """
    new = [d.model_dump(mode="json") for d in deviations]
    if robot in robot_names():
        data: dict[str, Any] = {"base": robot}
    else:
        data = dict(read_yaml(Path(robot)))
    data["name"] = path.stem
    data["deviations"] = [*data.get("deviations", []), *new]
    write_yaml(data, path)
    load_robot(path)


def _sites(model: mujoco.MjModel, effect: str, site: str) -> tuple[str, ...]:
    """Names of the model behind the site of an effect."""
    kind = _KINDS[effect.split("_")[0]]
    names = [n for n in model_names(model, kind) if n]
    if site in names:
        return (site,)
    members = groups(model).get(site, ())
    chosen = tuple(n for n in names if n in members)
    if site == "all":
        chosen = tuple(n for n in names if n not in ("world", "root") and not n.startswith("scene"))
        if effect == "joint_stiffness":
            chosen = tuple(n for n in chosen if model.joint(n).stiffness[0] > 0)
    if not chosen:
        raise GapInputError(f"effects: site {site!r} is not in the model of this robot")
    return chosen
