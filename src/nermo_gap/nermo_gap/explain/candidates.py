"""Effects that a published table may be explained by, as deviations of the robot at a few sizes each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nermo_description.effects import EFFECTS
from nermo_description.parameters import LEGS, Deviation, RobotParameters


@dataclass(frozen=True)
class Candidate:
    """An effect at a site, whose size is one number; ``sizes`` are those that are tried, weak to strong."""

    effect: str
    where: str
    """What its sites are called together."""
    sizes: tuple[float, ...]
    sites: tuple[str, ...]
    names: tuple[str, ...] = ()
    """Values that get the size, all by default; one with a minus in front gets it with the other sign."""

    @property
    def key(self) -> str:
        """name@site, as the diagnosis writes it."""
        return f"{self.effect}@{self.where}"

    @property
    def unit(self) -> str:
        """Of the size."""
        return next(iter(EFFECTS[self.effect].values.values())).unit

    @property
    def ladder(self) -> tuple[float, ...]:
        """Sizes by position: 0 is no effect at all, 1 the first of ``sizes``, and so on."""
        neutral = 1.0 if self.unit == "1" else 0.0
        if self.effect in ("joint_range", "servo_rate_limit"):
            neutral = 2.0 * self.sizes[0]
        return (neutral, *self.sizes)

    def size(self, position: float) -> float:
        """Size at a position, which may lie between two of them."""
        return round(float(np.interp(position, np.arange(len(self.ladder)), self.ladder)), 6)

    def position(self, size: float) -> float:
        """Position of a size."""
        ladder = np.array(self.ladder)
        order = np.argsort(ladder)
        return float(np.interp(size, ladder[order], np.arange(len(ladder))[order]))

    def excludes(self, other: Candidate) -> bool:
        """Whether it is the same effect at the same sites, as a mass further forward and one further back are."""
        return (self.effect, self.sites) == (other.effect, other.sites)

    def deviation(self, size: float) -> Deviation:
        """The effect at a size."""
        values = {
            name.lstrip("-"): -size if name.startswith("-") else size
            for name in self.names or EFFECTS[self.effect].values
        }
        if self.effect == "com_shift":
            values = {axis: values.get(axis, 0.0) for axis in "xyz"}
        return Deviation(effect=self.effect, sites=self.sites, values=values)


def candidates(robot: RobotParameters) -> list[Candidate]:
    """What a mouse that was printed, strung and driven until it tired may suffer from."""
    hips, knees = (tuple(f"{leg}_{part}" for leg in LEGS) for part in ("hip", "knee"))
    servos = (*hips, *knees)
    shafts = (*(f"{h}_joint" for h in hips), *(f"{k}_pulley_joint" for k in knees))
    joints = {"front": tuple(f"{k}_joint" for k in knees[:2]), "all": tuple(f"{k}_joint" for k in knees)}
    vertebrae = tuple(f"spine_lateral_{i}_joint" for i in range(1, 5))
    feet = tuple(f"{leg}_foot" for leg in LEGS)
    strings = tuple(f"{k}_tendon" for k in knees)
    stiffness = (0.7, 0.4)
    return [
        Candidate("joint_stiffness", "spine", (0.6, 0.3), vertebrae),
        Candidate("joint_range", "spine", (0.07, 0.04), vertebrae, ("-lower", "upper")),
        Candidate("tendon_slack", "spine", (0.5e-3, 1.5e-3), ("spine_left", "spine_right")),
        Candidate("tendon_slack", "spine_left", (0.5e-3, 1.5e-3), ("spine_left",)),
        Candidate("tendon_slack", "all_knees", (0.5e-3, 1.5e-3), strings),
        Candidate("joint_stiffness", "front", stiffness, joints["front"]),
        Candidate("joint_stiffness", "all_knees", stiffness, joints["all"]),
        Candidate("servo_gain", "all", (0.7, 0.4), servos),
        Candidate("servo_dead_band", "all", (0.02, 0.05), servos),
        Candidate("servo_delay", "all", (0.02, 0.05), servos),
        Candidate("servo_rate_limit", "all", (6.0, 3.5), servos),
        Candidate("servo_offset", "front_left_hip", (0.05, 0.12), hips[:1]),
        Candidate("coulomb_friction", "servos", (0.006, 0.015), shafts),
        Candidate("ground_friction", "all", (0.5, 0.25), feet),
        Candidate("mass", "torso", (0.02, 0.05), ("torso",)),
        Candidate("com_shift", "torso_forward", (0.002, 0.005, 0.01), ("torso",), ("x",)),
        Candidate("com_shift", "torso_back", (0.002, 0.005, 0.01), ("torso",), ("-x",)),
    ]
