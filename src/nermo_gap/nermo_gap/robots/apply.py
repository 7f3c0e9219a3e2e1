"""A diagnosis written down as a robot: a parameter file whose deviations are the effects that were found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco

from nermo_description.effects import EffectKind, effect_kind
from nermo_description.model import build_robot
from nermo_description.parameter_files import read_yaml, write_yaml
from nermo_description.parameters import Deviation
from nermo_description.robots import load_robot, robot_names
from nermo_gap.robots.sites import by_site, groups
from simgap.data.channels import model_names
from simgap.data.errors import GapInputError


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
    for effect, site, found_values in ((e, *own) for e in report["effects"] for own in by_site(e)):
        key = f"{effect['name']}@{site}"
        kind = effect_kind(str(effect["name"]))
        if kind is None:
            sensor = str(effect["name"]).startswith("sensor")
            left_out.append(f"{key} {'is a matter of calibration' if sensor else 'has no place in a robot file'}")
            continue
        values = {n: v for n, v in found_values.items() if n in kind.values}
        if (wrong := kind.error(values)) is not None:
            left_out.append(f"{key} has no place in a robot file: {wrong}")
            continue
        found.append(Deviation(effect=kind.name, sites=_sites(model, kind, site), values=values))
        if more := ", ".join(n for n in found_values if n not in values):
            left_out.append(f"{key}: {more}, for which a robot file has no place")
        if effect.get("form") in ("motor", "part"):
            left_out.append(f"{key}: form {effect['form']} is written as the simpler one of the twin")
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


def _sites(model: mujoco.MjModel, kind: EffectKind, site: str) -> tuple[str, ...]:
    """Names of the model behind the site of an effect."""
    if kind.site == "world":
        return ()
    names = [n for n in model_names(model, getattr(mujoco.mjtObj, f"mjOBJ_{kind.site.upper()}")) if n]
    if site in names:
        return (site,)
    members = groups(model).get(site, ())
    chosen = tuple(n for n in names if n in members)
    if site == "all":
        chosen = tuple(n for n in names if n not in ("world", "root") and not n.startswith("scene"))
        if kind.name == "joint_stiffness":
            chosen = tuple(n for n in chosen if model.joint(n).stiffness[0] > 0)
    if not chosen:
        raise GapInputError(f"effects: site {site!r} is not in the model of this robot")
    return chosen
