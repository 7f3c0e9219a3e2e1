"""Which names of the model, of a group or of a page stand for a part of the mouse: a judge of answers asks."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache

import mujoco

from nermo_description.model import build_robot
from nermo_description.robots import load_robot
from nermo_gap.robots.sites import groups
from simgap.data.channels import model_names

_KINDS = (
    mujoco.mjtObj.mjOBJ_ACTUATOR,
    mujoco.mjtObj.mjOBJ_JOINT,
    mujoco.mjtObj.mjOBJ_TENDON,
    mujoco.mjtObj.mjOBJ_BODY,
    mujoco.mjtObj.mjOBJ_GEOM,
)


def part(name: str) -> str:
    """Joint, servo, pulley and cable of one knee are one part."""
    for ending in ("_pulley_joint", "_tendon", "_joint"):
        name = name.removesuffix(ending)
    return name


@cache
def _model(robot: str) -> mujoco.MjModel:
    return build_robot(load_robot(robot)).compile()


def parts_at(robot: str, site: str) -> set[str]:
    """Parts behind the site of an effect."""
    return {part(name) for name in groups(_model(robot)).get(site, (site,))}


def sites_of(robot: str, parts: Iterable[str]) -> tuple[str, ...]:
    """All sites that are exactly these parts: single names, and groups, of which the joints (or servos, ...) count."""
    model, meant = _model(robot), {part(name) for name in parts}
    found = set(parts)
    for names in (set(model_names(model, kind)) for kind in _KINDS):
        found |= {name for name in names if {part(name)} == meant}
        found |= {group for group, all_ in groups(model).items() if {part(n) for n in names & set(all_)} == meant}
    return tuple(sorted(found))
