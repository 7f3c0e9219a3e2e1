"""What may be wrong with a hidden mouse, as mechanisms of their own: nothing here is shared with the diagnosis."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from nermo_description.parameters import LEGS

Array = NDArray[np.float64]
Path = Callable[[Array], Array]
"""What servos make of their commands (n,) [rad], tick by tick."""
Force = Callable[[mujoco.MjModel, mujoco.MjData], None]
"""Adds to the forces on bodies (`xfrc_applied`), tick by tick."""

HIPS, KNEES, FEET = (tuple(f"{leg}_{part}" for leg in LEGS) for part in ("hip", "knee", "foot"))
ANKLES = tuple(f"{leg}_ankle_joint" for leg in LEGS)


@dataclass(frozen=True)
class Fault:
    """One thing that is wrong.

    Attributes:
        kind: its name among `KINDS` or `UNKNOWN`.
        parts: the parts of the mouse that it sits in, by names of the model: a servo's is its joint's too.
        says: the effect of the library that is nearest to it, without its site; empty where there is none.
        site: where the library would say that it is.
        parameter, value, unit: how much, in the library's terms.
        enter: changes the model, in place.
        servos: makes what the commands become, for servos in this order at this period [s].
        forces: makes what pulls at bodies, anew for each segment.
    """

    kind: str
    parts: tuple[str, ...] = ()
    says: str = ""
    site: str = ""
    parameter: str = ""
    value: float = 0.0
    unit: str = ""
    enter: Callable[[mujoco.MjModel], None] = lambda model: None
    servos: Callable[[list[str], float], Path] = lambda names, period: lambda commands: commands
    forces: Callable[[], Force] = lambda: lambda model, data: None


def _about(random: np.random.Generator, size: float) -> float:
    """A size that nobody can know from the source."""
    return float(size * np.exp(random.uniform(-0.15, 0.15)))


def _side(random: np.random.Generator) -> float:
    return float(random.choice([-1.0, 1.0]))


# -- faults that the library has a word for ----------------------------------------------------------------------------


def weak_knee(random: np.random.Generator) -> Fault:
    """The worn motor of one knee gives 30 % less torque for the same error."""
    return _weak("weak_knee", f"{random.choice(LEGS)}_knee", 0.7)


def weak_hip(random: np.random.Generator) -> Fault:
    """That of one hip gives about 40 % less."""
    return _weak("weak_hip", f"{random.choice(LEGS)}_hip", _about(random, 0.6))


def _weak(kind: str, servo: str, factor: float) -> Fault:
    def enter(model: mujoco.MjModel) -> None:
        number = model.actuator(servo).id
        model.actuator_gainprm[number, :3] *= factor
        model.actuator_biasprm[number, :3] *= factor

    return Fault(kind, (servo,), "servo_gain", servo, "factor", factor, "1", enter)


def hip_offset(random: np.random.Generator) -> Fault:
    """A hip's horn was put on its shaft a few degrees off."""
    servo, offset = f"{random.choice(LEGS)}_hip", float(random.choice([-1, 1]) * random.uniform(0.06, 0.1))

    def servos(names: list[str], period: float) -> Path:
        shift = np.array([offset if name == servo else 0.0 for name in names])
        return lambda commands: commands + shift

    return Fault("hip_offset", (servo,), "servo_offset", servo, "offset", offset, "rad", servos=servos)


def slack_spine(random: np.random.Generator) -> Fault:
    """A cable of the spine has stretched by 2 mm."""
    return _slack("slack_spine", str(random.choice(["spine_left", "spine_right"])), 0.002)


def slack_knee(random: np.random.Generator) -> Fault:
    """The cable of one knee has stretched by about 1.5 mm."""
    return _slack("slack_knee", f"{random.choice(LEGS)}_knee_tendon", _about(random, 0.0015))


def _slack(kind: str, tendon: str, slack: float) -> Fault:
    def enter(model: mujoco.MjModel) -> None:
        model.tendon_range[model.tendon(tendon).id, 1] += slack

    return Fault(kind, (tendon,), "tendon_slack", tendon, "slack", slack, "m", enter)


def com_back(random: np.random.Generator) -> Fault:
    """The battery was mounted too far back: the torso's centre of mass lies 10 mm behind its place."""

    def enter(model: mujoco.MjModel) -> None:
        model.body_ipos[model.body("torso").id, 0] -= 0.010

    return Fault("com_back", ("torso",), "com_shift", "torso", "x", -0.010, "m", enter)


def heavy_torso(random: np.random.Generator) -> Fault:
    """Somebody screwed a camera of some 50 g on the torso, where its centre of mass is."""
    load = _about(random, 0.05)

    def enter(model: mujoco.MjModel) -> None:
        body = model.body("torso").id
        share = 1.0 + load / model.body_mass[body]
        model.body_mass[body] *= share
        model.body_inertia[body] *= share

    return Fault("heavy_torso", ("torso",), "mass", "torso", "change", load, "kg", enter)


def slippery_feet(random: np.random.Generator) -> Fault:
    """Dust under the feet: half of the friction."""
    return _slippery("slippery_feet", FEET, "all_feet", 0.5)


def slippery_foot(random: np.random.Generator) -> Fault:
    """One foot has lost its rubber: about two fifths of the friction."""
    foot = str(random.choice(FEET))
    return _slippery("slippery_foot", (foot,), foot, _about(random, 0.4))


def _slippery(kind: str, feet: tuple[str, ...], site: str, factor: float) -> Fault:
    def enter(model: mujoco.MjModel) -> None:
        model.geom_friction[[model.geom(foot).id for foot in feet], 0] *= factor

    return Fault(kind, feet, "ground_friction", site, "factor", factor, "1", enter)


def late_hips(random: np.random.Generator) -> Fault:
    """The hips hang on a bus of their own, which is 30 ms behind."""

    def servos(names: list[str], period: float) -> Path:
        late = np.array([name in HIPS for name in names])
        queue: deque[Array] = deque(maxlen=round(0.03 / period) + 1)

        def path(commands: Array) -> Array:
            queue.append(commands.copy())
            return np.where(late, queue[0], commands)

        return path

    return Fault("late_hips", HIPS, "servo_delay", "all_hips", "delay", 0.03, "s", servos=servos)


def slow_hips(random: np.random.Generator) -> Fault:
    """The hips' supply has dropped: they turn at no more than about 3 rad/s."""
    limit = _about(random, 3.0)

    def servos(names: list[str], period: float) -> Path:
        slow = np.array([name in HIPS for name in names])
        last: list[Array] = []

        def path(commands: Array) -> Array:
            before = last[0] if last else commands
            step = np.clip(commands - before, -limit * period, limit * period)
            last[:] = [np.where(slow, before + step, commands)]
            return last[0]

        return path

    return Fault("slow_hips", HIPS, "servo_rate_limit", "all_hips", "limit", limit, "rad/s", servos=servos)


def loose_hip(random: np.random.Generator) -> Fault:
    """The horn of one hip has about 0.1 rad of play on its shaft."""
    servo, width = f"{random.choice(LEGS)}_hip", _about(random, 0.1)

    def servos(names: list[str], period: float) -> Path:
        mine = np.array([name == servo for name in names])
        follows: list[Array] = []

        def path(commands: Array) -> Array:
            before = follows[0] if follows else commands
            behind = np.clip(before, commands - 0.5 * width, commands + 0.5 * width)
            follows[:] = [np.where(mine, behind, commands)]
            return follows[0]

        return path

    return Fault("loose_hip", (servo,), "servo_backlash", servo, "width", width, "rad", servos=servos)


def stiff_hip(random: np.random.Generator) -> Fault:
    """One hip rubs: about 0.03 N m of dry friction."""
    hip, friction = f"{random.choice(LEGS)}_hip_joint", _about(random, 0.03)

    def enter(model: mujoco.MjModel) -> None:
        model.dof_frictionloss[model.joint(hip).dofadr[0]] += friction

    return Fault("stiff_hip", (hip,), "coulomb_friction", hip, "friction", friction, "N m", enter)


def soft_ankles(random: np.random.Generator) -> Fault:
    """The ankles were printed in a softer material: half as stiff."""
    return _soft("soft_ankles", ANKLES, "all_ankles", 0.5)


def soft_spine(random: np.random.Generator) -> Fault:
    """The spine has fatigued: about half as stiff."""
    joints = tuple(f"spine_lateral_{i}_joint" for i in range(1, 5))
    return _soft("soft_spine", joints, "spine", _about(random, 0.5))


def _soft(kind: str, joints: tuple[str, ...], site: str, factor: float) -> Fault:
    def enter(model: mujoco.MjModel) -> None:
        names = [model.joint(i).name for i in range(model.njnt)]
        rows = [i for i, name in enumerate(names) if name in joints or _vertebra(name, site)]
        model.jnt_stiffness[rows] *= factor

    return Fault(kind, joints, "joint_stiffness", site, "factor", factor, "1", enter)


def _vertebra(joint: str, site: str) -> bool:
    """Whether a joint is one of the spine's, of which Nermo has twice as many as Nermo-Lite."""
    return site == "spine" and joint.startswith("spine_") and "pulley" not in joint


def crept_knees(random: np.random.Generator) -> Fault:
    """The knees' springs have crept, all alike: they rest by about 0.15 rad more bent."""
    shift = _about(random, 0.15)

    def enter(model: mujoco.MjModel) -> None:
        model.qpos_spring[[model.joint(f"{knee}_joint").qposadr[0] for knee in KNEES]] += shift

    joints = tuple(f"{knee}_joint" for knee in KNEES)
    return Fault("crept_knees", joints, "joint_rest_angle", "all_knees", "shift", shift, "rad", enter)


def none(random: np.random.Generator) -> Fault:
    """Nothing."""
    return Fault("none")


# -- faults that it has none for ---------------------------------------------------------------------------------------

_ON_THE_GROUND = 0.09
"""[m] A rear torso that is higher hangs in the stand."""


def dragged_weight(random: np.random.Generator) -> Fault:
    """A weight on a string is dragged behind the rear torso: it pulls back while the mouse walks."""
    pull = _about(random, 0.25)

    def forces() -> Force:
        def pulls(model: mujoco.MjModel, data: mujoco.MjData) -> None:
            body = model.body("rear_torso").id
            moving = data.cvel[body, 3:5]
            speed = float(np.hypot(*moving))
            if data.xpos[body, 2] < _ON_THE_GROUND and speed > 0.0:
                data.xfrc_applied[body, :2] -= pull * np.tanh(speed / 0.02) * moving / speed

        return pulls

    return Fault("dragged_weight", ("rear_torso",), forces=forces)


def taut_harness(random: np.random.Generator) -> Fault:
    """The wires to the battery are too short: beyond 0.15 m from where a segment began they pull the torso back."""
    stiffness = _about(random, 1.5)

    def forces() -> Force:
        begun: list[Array] = []

        def pulls(model: mujoco.MjModel, data: mujoco.MjData) -> None:
            body = model.body("torso").id
            begun[:] = begun or [data.xpos[body].copy()]
            away = data.xpos[body] - begun[0]
            far = float(np.linalg.norm(away))
            if far > 0.15:
                data.xfrc_applied[body, :3] -= min(stiffness * (far - 0.15), 0.5) * away / far

        return pulls

    return Fault("taut_harness", ("torso",), forces=forces)


def sticky_foot(random: np.random.Generator) -> Fault:
    """Chewing gum under one foot: it is held down with about 0.3 N while it is less than 3 mm above the ground."""
    foot, hold = str(random.choice(FEET)), _about(random, 0.3)

    def forces() -> Force:
        def pulls(model: mujoco.MjModel, data: mujoco.MjData) -> None:
            geom = model.geom(foot).id
            if 0.0 <= data.geom_xpos[geom, 2] - model.geom_size[geom, 0] < 0.003:
                data.xfrc_applied[model.geom_bodyid[geom], 2] -= hold

        return pulls

    return Fault("sticky_foot", (foot,), forces=forces)


def draught(random: np.random.Generator) -> Fault:
    """A neighbour's fan blows on the torso from the side, on and off every 1.5 s."""
    push = _about(random, 0.15) * _side(random)

    def forces() -> Force:
        def pulls(model: mujoco.MjModel, data: mujoco.MjData) -> None:
            if data.time % 3.0 > 1.5:
                data.xfrc_applied[model.body("torso").id, 1] += push

        return pulls

    return Fault("draught", ("torso",), forces=forces)


def catching_cable(random: np.random.Generator) -> Fault:
    """A knee's cable catches in its guide: each time that it is pulled, the knee stands still for 0.15 s first."""
    servo = f"{random.choice(LEGS)}_knee"

    def servos(names: list[str], period: float) -> Path:
        mine, wait = np.array([name == servo for name in names]), round(0.15 / period)
        held: list[Array] = []
        before: list[Array] = []
        left = 0

        def path(commands: Array) -> Array:
            nonlocal left
            last, last_held = (before[0], held[0]) if before else (commands, commands)
            step = float((commands - last)[mine].sum())
            if left == 0 and abs(step) > 1e-4 and np.array_equal(last[mine], last_held[mine]):
                left = wait
            left = max(left - 1, 0)
            before[:] = [commands.copy()]
            held[:] = [np.where(mine & (left > 0), last_held, commands)]
            return held[0]

        return path

    return Fault("catching_cable", (servo,), servos=servos)


def _by_name(*makers: Callable[[np.random.Generator], Fault]) -> dict[str, Callable[[np.random.Generator], Fault]]:
    return {maker.__name__: maker for maker in makers}


KINDS = _by_name(weak_knee, hip_offset, slack_spine, com_back, slippery_feet, late_hips, soft_ankles, none)
"""What `--hidden` and the demo draw from."""
KNOWN = {name: maker for name, maker in KINDS.items() if name != "none"} | _by_name(
    weak_hip, slack_knee, heavy_torso, slippery_foot, slow_hips, loose_hip, stiff_hip, soft_spine, crept_knees
)
"""What the check draws as one fault, or as one of two."""
UNKNOWN = _by_name(dragged_weight, taut_harness, sticky_foot, draught, catching_cable)
"""What nothing in the library is like."""


def all_servos(faults: Sequence[Fault], names: list[str], period: float) -> Path:
    """What servos with all of these faults make of their commands."""
    paths = [fault.servos(names, period) for fault in faults]

    def path(commands: Array) -> Array:
        for one in paths:
            commands = one(commands)
        return commands

    return path


def all_forces(faults: Sequence[Fault]) -> Force:
    """What pulls at bodies, anew at each tick."""
    every = [fault.forces() for fault in faults]

    def force(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        data.xfrc_applied[:] = 0.0
        for one in every:
            one(model, data)

    return force
