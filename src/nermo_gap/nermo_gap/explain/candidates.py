"""Effects that a published table may be explained by, as deviations of the robot at a few sizes each."""

from __future__ import annotations

from dataclasses import dataclass

from nermo_description.parameters import LEGS, Deviation, RobotParameters


@dataclass(frozen=True)
class Candidate:
    """An effect at a site, whose size is one number; ``sizes`` are those that are tried, weak to strong."""

    key: str
    unit: str
    sizes: tuple[float, ...]
    effect: str
    sites: tuple[str, ...]
    names: tuple[str, ...]
    """Values that get the size; one with a minus in front gets it with the other sign."""

    def deviation(self, size: float) -> Deviation:
        """The effect at a size."""
        values = {name.lstrip("-"): -size if name.startswith("-") else size for name in self.names}
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
        Candidate("joint_stiffness@spine", "1", (0.6, 0.3), "joint_stiffness", vertebrae, ("factor",)),
        Candidate("joint_range@spine", "rad", (0.07, 0.04), "joint_range", vertebrae, ("-lower", "upper")),
        Candidate(
            "tendon_slack@spine", "m", (0.5e-3, 1.5e-3), "tendon_slack", ("spine_left", "spine_right"), ("slack",)
        ),
        Candidate("tendon_slack@spine_left", "m", (0.5e-3, 1.5e-3), "tendon_slack", ("spine_left",), ("slack",)),
        Candidate("tendon_slack@all_knees", "m", (0.5e-3, 1.5e-3), "tendon_slack", strings, ("slack",)),
        Candidate("joint_stiffness@front", "1", stiffness, "joint_stiffness", joints["front"], ("factor",)),
        Candidate("joint_stiffness@all_knees", "1", stiffness, "joint_stiffness", joints["all"], ("factor",)),
        Candidate("servo_gain@all", "1", (0.7, 0.4), "servo_gain", servos, ("factor",)),
        Candidate("servo_dead_band@all", "rad", (0.02, 0.05), "servo_dead_band", servos, ("half_width",)),
        Candidate("servo_delay@all", "s", (0.02, 0.05), "servo_delay", servos, ("delay",)),
        Candidate("servo_rate_limit@all", "rad/s", (6.0, 3.5), "servo_rate_limit", servos, ("limit",)),
        Candidate("servo_offset@front_left_hip", "rad", (0.05, 0.12), "servo_offset", hips[:1], ("offset",)),
        Candidate("coulomb_friction@servos", "N m", (0.006, 0.015), "coulomb_friction", shafts, ("friction",)),
        Candidate("ground_friction@all", "1", (0.5, 0.25), "ground_friction", feet, ("factor",)),
        Candidate("mass@torso", "kg", (0.02, 0.05), "mass", ("torso",), ("change",)),
        Candidate("com_shift@torso_forward", "m", (0.002, 0.005), "com_shift", ("torso",), ("x",)),
        Candidate("com_shift@torso_back", "m", (0.002, 0.005), "com_shift", ("torso",), ("-x",)),
    ]
