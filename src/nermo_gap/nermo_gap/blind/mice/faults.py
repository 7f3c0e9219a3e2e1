"""What may be wrong with a hidden mouse, as mechanisms of their own: nothing here is shared with the diagnosis."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from nermo_description.parameters import LEGS

Array = NDArray[np.float64]
Path = Callable[[Array], Array]
"""What servos make of their commands (n,) [rad], tick by tick."""


@dataclass(frozen=True)
class Fault:
    """One thing that is wrong.

    Attributes:
        kind: its name among `KINDS`.
        parts: the parts of the mouse that it sits in, by names of the model: a servo's is its joint's too.
        says: the effect of the library that is nearest to it, without its site; empty where nothing is wrong.
        value, unit: how much.
        enter: changes the model, in place.
        servos: makes what the commands become, for servos in this order at this period [s].
    """

    kind: str
    parts: tuple[str, ...] = ()
    says: str = ""
    value: float = 0.0
    unit: str = ""
    enter: Callable[[mujoco.MjModel], None] = lambda model: None
    servos: Callable[[list[str], float], Path] = lambda names, period: lambda commands: commands


def weak_knee(random: np.random.Generator) -> Fault:
    """The worn motor of one knee gives 30 % less torque for the same error."""
    servo = f"{random.choice(LEGS)}_knee"

    def enter(model: mujoco.MjModel) -> None:
        number = model.actuator(servo).id
        model.actuator_gainprm[number, :3] *= 0.7
        model.actuator_biasprm[number, :3] *= 0.7

    return Fault("weak_knee", (servo,), "servo_gain", 0.7, "1", enter)


def hip_offset(random: np.random.Generator) -> Fault:
    """A hip's horn was put on its shaft a few degrees off."""
    servo, offset = f"{random.choice(LEGS)}_hip", float(random.choice([-1, 1]) * random.uniform(0.06, 0.1))

    def servos(names: list[str], period: float) -> Path:
        shift = np.array([offset if name == servo else 0.0 for name in names])
        return lambda commands: commands + shift

    return Fault("hip_offset", (servo,), "servo_offset", offset, "rad", servos=servos)


def slack_spine(random: np.random.Generator) -> Fault:
    """A cable of the spine has stretched by 2 mm."""
    tendon = str(random.choice(["spine_left", "spine_right"]))

    def enter(model: mujoco.MjModel) -> None:
        model.tendon_range[model.tendon(tendon).id, 1] += 0.002

    return Fault("slack_spine", (tendon,), "tendon_slack", 0.002, "m", enter)


def com_back(random: np.random.Generator) -> Fault:
    """The battery was mounted too far back: the torso's centre of mass lies 10 mm behind its place."""

    def enter(model: mujoco.MjModel) -> None:
        model.body_ipos[model.body("torso").id, 0] -= 0.010

    return Fault("com_back", ("torso",), "com_shift", -0.010, "m", enter)


def slippery_feet(random: np.random.Generator) -> Fault:
    """Dust under the feet: half of the friction."""
    feet = tuple(f"{leg}_foot" for leg in LEGS)

    def enter(model: mujoco.MjModel) -> None:
        model.geom_friction[[model.geom(foot).id for foot in feet], 0] *= 0.5

    return Fault("slippery_feet", feet, "ground_friction", 0.5, "1", enter)


def late_hips(random: np.random.Generator) -> Fault:
    """The hips hang on a bus of their own, which is 30 ms behind."""
    hips = tuple(f"{leg}_hip" for leg in LEGS)

    def servos(names: list[str], period: float) -> Path:
        late = np.array([name in hips for name in names])
        queue: deque[Array] = deque(maxlen=round(0.03 / period) + 1)

        def path(commands: Array) -> Array:
            queue.append(commands.copy())
            return np.where(late, queue[0], commands)

        return path

    return Fault("late_hips", hips, "servo_delay", 0.03, "s", servos=servos)


def soft_ankles(random: np.random.Generator) -> Fault:
    """The ankles were printed in a softer material: half as stiff."""
    joints = tuple(f"{leg}_ankle_joint" for leg in LEGS)

    def enter(model: mujoco.MjModel) -> None:
        model.jnt_stiffness[[model.joint(joint).id for joint in joints]] *= 0.5

    return Fault("soft_ankles", joints, "joint_stiffness", 0.5, "1", enter)


def none(random: np.random.Generator) -> Fault:
    """Nothing."""
    return Fault("none")


KINDS: dict[str, Callable[[np.random.Generator], Fault]] = {
    one.__name__: one
    for one in (weak_knee, hip_offset, slack_spine, com_back, slippery_feet, late_hips, soft_ankles, none)
}
