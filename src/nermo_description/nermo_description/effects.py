"""The catalogue of faults: what may differ in one mouse from its description, where, by which numbers and how far.

A robot file's `deviations`, the twin that is built with them, the diagnosis that names them (`nermo gap`) and the
search for the causes behind a published table (`nermo gap explain`) all take names, sites, values and units from here.
Imports no mujoco, so that the robot's end can read robot files.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from nermo_description.ranges import Range

SiteKind = Literal["actuator", "joint", "tendon", "body", "geom", "world"]
"""What a site is in the model, in MuJoCo's word; the world has no sites."""


@dataclass(frozen=True, slots=True)
class EffectKind:
    """One row of the catalogue."""

    name: str
    """Also that of `simgap`'s effect."""
    site: SiteKind
    values: dict[str, Range]
    """By name, with unit and what is allowed."""
    acts_on: Literal["model", "commands"] = "model"
    """What it is entered into: the model of the robot (`deviations.py`), or the commands on their way to its servos
    (`nermo_sim/command_path.py`)."""
    any_of: bool = False
    """Whether some of the values are enough."""
    also: str = ""
    """Another of `simgap`'s effects, that is this one in a robot file."""

    def error(self, values: dict[str, float]) -> str | None:
        """What is wrong with values, in words; None where nothing is."""
        wrong = set(values) - set(self.values) if self.any_of else set(values) ^ set(self.values)
        if wrong or not values:
            return f"values of {self.name} must be {', '.join(sorted(self.values))}, not {sorted(values)}"
        errors = (self.values[name].error(f"values.{name} of {self.name}", value) for name, value in values.items())
        return next(filter(None, errors), None)


_FACTOR = Range(1e-3, 1e3, "1")
_ANGLE = Range(-10.0, 10.0, "rad")
_WIDTH = Range(0.0, 10.0, "rad")
_TORQUE = Range(0.0, 100.0, "N m")
_DAMPING = Range(-100.0, 100.0, "N m s/rad")
_LENGTH = Range(-1.0, 1.0, "m")
_SLOPE = Range(-1.5, 1.5, "rad")

EFFECTS: dict[str, EffectKind] = {
    kind.name: kind
    for kind in (
        EffectKind("servo_gain", "actuator", {"factor": _FACTOR}),
        EffectKind("servo_torque_limit", "actuator", {"limit": _TORQUE}),
        EffectKind("servo_delay", "actuator", {"delay": Range(0.0, 1.0, "s")}, "commands", also="link_latency"),
        EffectKind("servo_offset", "actuator", {"offset": _ANGLE}, "commands"),
        EffectKind("servo_rate_limit", "actuator", {"limit": Range(0.0, 1e3, "rad/s")}, "commands"),
        EffectKind("servo_dead_band", "actuator", {"half_width": _WIDTH}, "commands"),
        EffectKind("servo_backlash", "actuator", {"width": _WIDTH}, "commands"),
        EffectKind("coulomb_friction", "joint", {"friction": _TORQUE}),
        EffectKind("viscous_friction", "joint", {"damping": _DAMPING}),
        EffectKind("joint_damping", "joint", {"damping": _DAMPING}),
        EffectKind("armature", "joint", {"inertia": Range(-1.0, 1.0, "kg m^2")}),
        EffectKind("joint_stiffness", "joint", {"factor": _FACTOR}),
        EffectKind("joint_rest_angle", "joint", {"shift": _ANGLE}),
        EffectKind("joint_range", "joint", {"lower": _ANGLE, "upper": _ANGLE}, any_of=True),
        EffectKind("tendon_slack", "tendon", {"slack": _LENGTH}),
        EffectKind("tendon_friction", "tendon", {"friction": Range(0.0, 1e3, "N")}),
        EffectKind("tendon_detached", "tendon", {"share": Range(0.0, 1.0, "1")}),
        EffectKind("mass", "body", {"change": Range(-100.0, 100.0, "kg")}),
        EffectKind("com_shift", "body", dict.fromkeys("xyz", _LENGTH)),
        EffectKind("inertia", "body", {"factor": _FACTOR}),
        EffectKind("ground_friction", "geom", {"factor": _FACTOR}),
        EffectKind("foot_compliance", "geom", {"time_factor": _FACTOR}),
        EffectKind("ground_slope", "world", dict.fromkeys(("pitch", "roll"), _SLOPE), also="gravity_lean"),
    )
}
"""By name."""


def effect_kind(name: str) -> EffectKind | None:
    """The row of an effect of `simgap`'s; None for one that a robot file has no place for."""
    return next((kind for kind in EFFECTS.values() if name in (kind.name, kind.also)), None)


def table() -> str:
    """The catalogue as a Markdown table, as it stands in the documentation."""
    rows = ["| effect | sites | values | acts on |", "|---|---|---|---|"]
    for kind in EFFECTS.values():
        values = ", ".join(f"`{n}` {allowed}" for n, allowed in kind.values.items())
        rows.append(f"| `{kind.name}` | {kind.site} | {values} | {kind.acts_on} |")
    return "\n".join(rows)
