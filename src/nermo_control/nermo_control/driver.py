"""What a person at the controls has chosen, and the control command that follows from it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from pydantic import BaseModel, ConfigDict, Field

from nermo_control.lift import LIFTED_LEG
from nermo_control.path import Path
from nermo_control.spine.functions import SPINE_FUNCTIONS
from nermo_control.types import ControlCommand, Posture, SpineModes, TrajectoryMode

SPEED_STEPS = 10
FREQUENCY_STEP_HZ = 0.1
FREQUENCY_RANGE_HZ = (0.1, 3.0)
TRIM_STEP = 0.1
"""[rad/m] of turning for each metre walked: 0.1 takes out a drift of 5 cm in a metre."""


@dataclass(frozen=True)
class Steering:
    """How whoever sees the mouse leads it along a path, while something else says how fast it walks.

    Attributes:
        path: from where its shoulders are, x along its heading.
        turn_rate: [rad/s] with the stick fully to the left, in the way of going that is told.
    """

    path: Path
    turn_rate: float


class Limits(BaseModel):
    """How fast the mouse is driven with the stick fully pushed and the speed setting at its highest."""

    model_config = ConfigDict(frozen=True)

    max_forward_velocity: float = Field(
        0.12, gt=0.0, le=1.0, description="at full stick and full speed", json_schema_extra={"unit": "m/s"}
    )
    max_turn_rate: float = Field(0.8, gt=0.0, le=10.0, description="at full stick", json_schema_extra={"unit": "rad/s"})


@dataclass
class Driver:
    """The settings that buttons and keys change, and the command made of them and the sticks.

    A posture stays until the stick is moved or another is chosen. An emergency stop is said until the mouse is
    told to stand; the servos have power again when no other source says stop either.
    """

    limits: Limits
    gaits: Sequence[str] = ()
    gait: str = ""
    """Empty: the knowledge-base's default."""
    default_gait: str = ""
    """From which the first change of the gait starts."""
    gait_frequency: float = 0.0
    """[Hz]; 0: the knowledge-base's default."""
    default_frequency: float = 0.8
    """[Hz] from which the first change of the frequency starts."""
    speed: int = SPEED_STEPS // 2
    """Speed setting, 1 to SPEED_STEPS."""
    trim: float = 0.0
    """[rad/m], positive left."""
    posture: Posture = Posture.WALK
    straight_line: bool = False
    spine_modes: SpineModes = field(default_factory=SpineModes)
    stopped: bool = False
    """This source says stop."""
    release_wanted: bool = False
    """The servos shall have power again, if they have none; whoever asks for that takes it back."""

    def emergency_stop(self) -> None:
        """Stop at once, and stay so."""
        self.stopped = True
        self.release_wanted = False
        self.posture = Posture.STOP

    def take(self, posture: Posture) -> None:
        """Take a posture. Standing takes back this source's stop and asks for the release; nothing else does."""
        if posture is Posture.STAND:
            self.stopped = False
            self.release_wanted = True
        if not self.stopped:
            self.posture = posture

    def lift_leg(self) -> None:
        """Stand with one leg lifted: the first, or the one after that which is lifted; after the last, on all four."""
        lifts = (*LIFTED_LEG, Posture.STAND)
        place = lifts.index(self.posture) if self.posture in LIFTED_LEG else -1
        if not self.stopped:
            self.posture = lifts[place + 1]

    def change_speed(self, steps: int) -> None:
        """Drive faster or slower by some steps of a tenth of the highest speed."""
        self.speed = min(max(self.speed + steps, 1), SPEED_STEPS)

    def change_frequency(self, steps: int) -> None:
        """Step faster or slower by tenths of a Hz."""
        lower, upper = FREQUENCY_RANGE_HZ
        wanted = (self.gait_frequency or self.default_frequency) + steps * FREQUENCY_STEP_HZ
        self.gait_frequency = round(min(max(wanted, lower), upper), 3)

    def change_trim(self, steps: int) -> None:
        """Turn a little more to the left (positive) for each metre walked."""
        self.trim = round(self.trim + steps * TRIM_STEP, 3)

    def next_gait(self) -> None:
        """Choose the gait after the present one in the knowledge-base's list."""
        if self.gaits:
            present = self.gait or self.default_gait
            place = self.gaits.index(present) if present in self.gaits else -1
            self.gait = self.gaits[(place + 1) % len(self.gaits)]

    def toggle_spine(self, mode: str) -> None:
        """Switch one spine function, a field of `SpineModes`, on or off."""
        self.spine_modes = replace(self.spine_modes, **{mode: not getattr(self.spine_modes, mode)})

    def command(self, stamp: int, forward: float, turn: float) -> ControlCommand:
        """Command for stick positions in [-1, 1], forward and left positive. `stamp` in ns of ROS time."""
        if (forward or turn) and not self.stopped and self.posture is not Posture.STOP:
            self.posture = Posture.WALK
        walking = self.posture is Posture.WALK
        velocity = forward * self.limits.max_forward_velocity * self.speed / SPEED_STEPS if walking else 0.0
        turn_rate = turn * self.limits.max_turn_rate + self.trim * velocity if walking else 0.0
        return ControlCommand(
            stamp=stamp,
            forward_velocity=velocity,
            turn_rate=turn_rate,
            posture=self.posture,
            trajectory_mode=TrajectoryMode.STRAIGHT_LINE if self.straight_line else TrajectoryMode.EXTERNAL,
            gait=self.gait,
            gait_frequency=self.gait_frequency,
            spine_modes=self.spine_modes,
        )

    def __str__(self) -> str:
        spine = [name for name in SPINE_FUNCTIONS if getattr(self.spine_modes, name)]
        return (
            f"{'EMERGENCY STOP' if self.stopped else self.posture.name.lower()}, speed {self.speed}/{SPEED_STEPS}, "
            f"gait {self.gait or 'default'}, {f'{self.gait_frequency:g} Hz' if self.gait_frequency else 'default Hz'}, "
            f"trim {self.trim:+.1f} rad/m, spine {', '.join(spine) or 'off'}"
            f"{', holding its line' if self.straight_line else ''}"
        )
