"""The protocols that come with the mouse. Nobody diagnoses a robot from a walk alone: hang it up, stand it, walk it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

from nermo_control.gait.knowledge_base import GaitParameters
from nermo_control.types import ControlCommand, Posture, SpineModes
from nermo_description.parameters import LEGS, RobotParameters
from nermo_gap.protocol.types import REST, Piece, Protocol, Segment, Wave
from nermo_gap.robots.channels import Channels
from simgap.data.errors import GapInputError

SLOW, FAST = (0.5, 0.7, 0.9, 1.1), (1.6, 2.0, 2.4, 2.8)
"""[Hz] of the four legs, each its own: what one leg does is then told from what another does in every window."""
WALKING = "walking"
STEP = 0.6
"""[s] of a servo's step to both sides."""


def standard(robot: RobotParameters, markers: bool = False) -> Protocol:
    """A minute or a minute and a half: hung in a stand, standing, walking, still.

    A swinging leg of two grams does not move a torso that a tracker could see it: a mouse whose servos report nothing,
    and that wears no ``markers``, hangs for its spine alone.
    """
    legs = markers or Channels.of(robot).servos
    return Protocol("standard", (_hung(robot, legs), _standing(robot), _walking(), _still()))


def walk(robot: RobotParameters, markers: bool = False) -> Protocol:
    """A minute of walking alone, without a stop, to compare with; a diagnosis looks all along it."""
    del robot, markers
    says = tuple((6.0 * k, _say(*how)) for k, how in enumerate(_WALKS * 2))
    piece = Piece("walk", "walk, in turns slowly and fast, straight and to both sides", 60.0 + 2.0 * REST, (), says)
    return Protocol("walk", (Segment(WALKING, "floor", "Set the mouse down with three metres around it.", (piece,)),))


PROTOCOLS: dict[str, Callable[[RobotParameters, bool], Protocol]] = {"standard": standard, "walk": walk}


def protocol_of(name: str, robot: RobotParameters, markers: bool = False, filmed: bool = False) -> Protocol:
    """A protocol by its name, for a mouse with or without markers on its feet.

    ``filmed``: what is walked begins with what tells a film's clock. A mouse with a leg that is off steps earlier or
    later than the twin, and its walk tells the clock wrong.

    Raises:
        GapInputError: there is none of this name.
    """
    if name not in PROTOCOLS:
        raise GapInputError(f"protocol {name!r} is unknown: choose one of {', '.join(PROTOCOLS)}")
    found = PROTOCOLS[name](robot, markers)
    if not filmed:
        return found
    parts = [dataclasses.replace(s, pieces=(clock(), *s.pieces)) if s.name == WALKING else s for s in found.segments]
    return dataclasses.replace(found, segments=tuple(parts))


def _hung(robot: RobotParameters, seen: bool) -> Segment:
    spine = [s for s in robot.servos if s.startswith("spine")]
    # Not faster: the tail swings at 3 Hz, and nobody knows how.
    bends = [Wave(s, 0.35, 0.3, 1.5, one_way=robot.servos[s].lower >= 0.0) for s in spine]
    back = [dataclasses.replace(w, size=w.size if w.one_way else -w.size, frequency=0.8, until=None) for w in bends]
    together = [
        wave
        for k, leg in enumerate(LEGS)
        for wave in (Wave(f"{leg}_hip", 0.35, 1.3 + 0.2 * k), Wave(f"{leg}_knee", -0.4, 1.9 - 0.2 * k, one_way=True))
    ]
    # A weight that sits elsewhere shows where a mouse hangs, before anything moves; pieces are held out one by one, so
    # more than one must show it.
    hang = Piece("hang", "let it hang", 3.0, looks=(0.3, 1.7))
    bend = Piece("spine", "bend the spine, ever faster", 6.0, tuple(bends), looks=(0.5, 2.0, 3.5))
    again = Piece("spine back", "and the other way about", 3.0, tuple(back), looks=(0.7,))
    legs = (
        Piece("hips slowly", "swing each hip slowly", 5.0, _legs("hip", 0.5, SLOW)),
        Piece("hips fast", "swing each hip fast", 4.0, _legs("hip", 0.25, FAST), looks=(1.0,)),
        Piece("knees slowly", "move each knee slowly", 5.0, _legs("knee", 0.5, SLOW)),
        Piece("knees fast", "move each knee fast", 4.0, _legs("knee", 0.25, FAST), looks=(1.0,)),
        _steps("steps", "step one servo after the other", 0.3, LEGS, ("hip", "knee")),
        Piece("legs together", "all legs at once", 5.0, tuple(together), looks=(1.5,)),
    )
    pieces = (hang, *(legs if seen else ()), bend, again)
    return Segment("hung", "hung", "Clamp the torso into the stand; no foot may touch anything.", pieces)


def _standing(robot: RobotParameters) -> Segment:
    knees = tuple(f"{leg}_knee" for leg in LEGS)
    squat = tuple(Wave(k, -0.35, 1.0, 3.0, one_way=True) for k in knees)
    # All hips turn the same way, so that the body sways over its feet.
    sway = tuple(Wave(f"{leg}_hip", 0.2, 1.0, 4.0) for leg in LEGS)
    single = tuple(Wave(k, -0.3, 2.0 * f, one_way=True) for k, f in zip(knees, SLOW, strict=True))
    spine = tuple(Wave(s, 0.25, 0.8, one_way=robot.servos[s].lower >= 0.0) for s in robot.servos if "spine" in s)
    balance = SpineModes(balance_compensation=True)
    lifts = [ControlCommand(0, posture=Posture[f"LIFT_{leg.upper()}"], spine_modes=balance) for leg in LEGS]
    lifted = tuple((3.0 * k, lift) for k, lift in enumerate(lifts))
    pieces = (
        _steps("knee steps", "kick with one knee after the other", -0.2, LEGS, ("knee",)),
        _steps("knee steps back", "and the other way about", 0.2, LEGS[::-1], ("knee",)),
        _steps("hip steps", "kick with one hip after the other", 0.15, LEGS, ("hip",)),
        _steps("hip steps back", "and the other way about", -0.15, LEGS[::-1], ("hip",)),
        Piece("squats", "squat, ever faster", 4.0, squat, looks=(2.4,)),
        Piece("sway", "sway to and fro over the feet, ever faster", 4.0, sway, looks=(1.6,)),
        Piece("knees in turn", "each knee at its own pace under load", 5.0, (*single, *spine), looks=(0.9,)),
        Piece("lifts", "lift one leg after the other", 3.0 * len(LEGS) + 2.0 * REST, (), lifted, looks=(0.9, 9.9)),
    )
    return Segment("standing", "floor", "Set the mouse down on the floor.", pieces)


_USUAL = GaitParameters().default_gait_frequency
_WALKS = (
    (0.06, 0.0, "trot", 0.7 * _USUAL),
    (0.08, 0.0, "trot", 1.2 * _USUAL),
    (0.05, 0.0, "lateral_walk", _USUAL),
    (0.06, 0.4, "trot", _USUAL),
    (0.06, -0.4, "trot", _USUAL),
)
"""Speed [m/s], turn rate [rad/s], gait and its frequency [Hz]."""


def clock() -> Piece:
    """What tells a film's clock before a walk, which looks alike after each stride.

    Squats that get faster while the sway gets slower never repeat themselves, and each second tells as much as another.
    """
    squat = tuple(Wave(f"{leg}_knee", -0.35, 0.7, 2.0, one_way=True) for leg in LEGS)
    sway = tuple(Wave(f"{leg}_hip", 0.2, 1.9, 0.6) for leg in LEGS)
    return Piece("clock", "squat and sway, for the film's clock", 6.0 + 2.0 * REST, (*squat, *sway), looks=(0.6,))


def _walking() -> Segment:
    told = ("trot slowly", "trot fast", "lateral walk", "turn left")
    pieces = tuple(_walk(name, name, *say) for name, say in zip(told, _WALKS, strict=False))
    return Segment(WALKING, "floor", "Leave it on the floor, with a metre in front of it.", pieces)


def _walk(name: str, tell: str, speed: float, turn: float, gait: str, frequency: float) -> Piece:
    say = _say(speed, turn, gait, frequency)
    # The first steps from the stand: later on a replay does not know enough of where everything is.
    return Piece(name, tell, 6.0, commands=((0.0, say),), looks=(0.35,))


def _say(speed: float, turn: float, gait: str, frequency: float) -> ControlCommand:
    return ControlCommand(0, forward_velocity=speed, turn_rate=turn, gait=gait, gait_frequency=frequency)


def _still() -> Segment:
    return Segment("still", "floor", "Leave it standing.", (Piece("still", "stand still", 4.0),))


def _legs(joint: str, size: float, frequencies: tuple[float, ...]) -> tuple[Wave, ...]:
    return tuple(Wave(f"{leg}_{joint}", size, f) for leg, f in zip(LEGS, frequencies, strict=True))


def _steps(name: str, tell: str, size: float, legs: Sequence[str], joints: Sequence[str]) -> Piece:
    servos = [f"{leg}_{joint}" for joint in joints for leg in legs]
    waves = [Wave(s, size, shape="steps", begin=STEP * k, end=STEP * (k + 1)) for k, s in enumerate(servos)]
    # A first look at every other step; the piece that goes the other way about has the rest.
    looks = tuple(REST + STEP * k - 0.05 for k in range(0, len(servos), 2))
    return Piece(name, tell, STEP * len(servos) + 2.0 * REST, tuple(waves), looks=looks)
