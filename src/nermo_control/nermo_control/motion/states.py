"""The states of the motion module, and which follows which.

Holding (servos rest) -> Moving (to another posture, blended in servo space) -> Holding, and from Holding on four feet
-> Walking -> Settling (swing feet straight down, stance feet stay where they are) -> Holding, and from the stand
-> Lifting (one leg up, for as long as it is asked for, and down again) -> Holding. From Holding and Moving -> Following
(the servos do what is told them from outside) -> Moving. STOP leads from each to Holding.

In each tick a state says which one is to follow the goal, at most one step on; that one then acts, and returns the
state in which it ends.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod

from nermo_control.gait.knowledge_base import gait_speed
from nermo_control.lift import LIFTED_LEG, LegLift
from nermo_control.motion.context import MotionContext
from nermo_control.motion.feet import neutral_feet
from nermo_control.oscillators.legs import OscillatorLegs
from nermo_control.turning import leg_modulation
from nermo_control.types import Four, MotionCommand, Posture, SpineModes
from nermo_description.blend import Approach, Blend, smooth

ELSEWHERE = Posture.STOP
"""Where a body stands that was stopped on its way: in no posture that has a name."""


class State(ABC):
    """What the robot does."""

    def next(self, context: MotionContext, goal: Posture | None) -> State:
        """The state of this tick, for the posture that is wanted; None while nothing ever was."""
        if goal is Posture.STOP:
            return self._freeze(context)
        return self if goal is None else self.towards(context, goal)

    def _freeze(self, context: MotionContext) -> State:
        context.body.freeze()
        return Holding.begin(context, ELSEWHERE)

    @abstractmethod
    def towards(self, context: MotionContext, goal: Posture) -> State:
        """The state that follows a goal other than STOP."""

    @abstractmethod
    def step(self, context: MotionContext) -> State:
        """One tick; returns the state in which it ends."""

    def stance_changed(self) -> None:  # noqa: B027  most states do not go by it
        """The neutral stance is another one: where the stand was, it is no more."""


class _Posed(State):
    """In a posture or on the way to one."""

    def __init__(self, posture: Posture | None, at: Posture | None) -> None:
        self.posture = posture
        """That it is in, or moves to."""
        self.at = at
        """That it is in, or was in when it left; None after a start."""

    @property
    def on_feet(self) -> bool:
        """Whether the feet are where the gait has them."""
        return False

    def towards(self, context: MotionContext, goal: Posture) -> State:
        """Walking begins on four feet; nothing moves before it is asked to."""
        if goal is Posture.STILL and (self.on_feet or self.at is None):
            return self
        if goal is Posture.WALK and self.on_feet:
            return Walking.begin(context)
        if goal is Posture.DIRECT:
            return Following.begin(context)
        target = Posture.STAND if goal in (Posture.WALK, Posture.STILL, *LIFTED_LEG) else goal
        return self if target is self.posture else Moving.begin(context, target, self.at)

    def stance_changed(self) -> None:
        if self.posture is Posture.STAND:
            self.posture = ELSEWHERE


class Holding(_Posed):
    """Rests in a posture, or on four feet wherever they are (STILL)."""

    def __init__(self, at: Posture | None) -> None:
        super().__init__(at, at)

    @classmethod
    def begin(cls, context: MotionContext, at: Posture | None) -> Holding:
        """The gait cycle, if there was one, has ended."""
        if at is Posture.STAND:
            context.stand_neutral()
        context.feet.stand()
        return cls(at)

    @property
    def on_feet(self) -> bool:
        return self.posture is Posture.STAND or self.posture is Posture.STILL

    def _freeze(self, context: MotionContext) -> State:
        return self if self.posture is ELSEWHERE else super()._freeze(context)

    def towards(self, context: MotionContext, goal: Posture) -> State:
        if goal in LIFTED_LEG and self.posture is Posture.STAND:
            return Lifting.begin(context, goal)
        return super().towards(context, goal)

    def step(self, context: MotionContext) -> State:
        if self.on_feet:
            context.place_feet()
        return self


class Moving(_Posed):
    """Goes to a posture, all servos together."""

    def __init__(self, posture: Posture, at: Posture | None, blend: Blend) -> None:
        super().__init__(posture, at)
        self._blend = blend

    @classmethod
    def begin(cls, context: MotionContext, posture: Posture, at: Posture | None) -> Moving:
        """From where the servos are, and as fast as they are."""
        end = context.body.posture(posture, context.parameters, context.tick.warnings)
        blend = Blend(*context.body.moving(), end, context.config.posture_velocity, context.tick.stamp)
        return cls(posture, at, blend)

    def step(self, context: MotionContext) -> State:
        context.body.targets = self._blend.at(context.tick.stamp)
        if self._blend.done(context.tick.stamp):
            return Holding.begin(context, self.posture).step(context)
        return self


class Following(_Posed):
    """The servos go where they are told from outside, as far as they go; the feet count as standing."""

    def __init__(self, approach: Approach) -> None:
        super().__init__(Posture.DIRECT, ELSEWHERE)
        self._approach = approach

    @classmethod
    def begin(cls, context: MotionContext) -> Following:
        """From where the servos are; what is far from there is approached at the velocity of a change of posture."""
        context.feet.stand()
        context.feet.x, context.feet.z = neutral_feet(context.parameters)
        context.body.freeze()
        return cls(Approach(*context.body.moving(), context.config.posture_velocity, context.tick.stamp))

    def next(self, context: MotionContext, goal: Posture | None) -> State:
        # As a walk without any command that is valid any more.
        return super().next(context, Posture.STAND if goal is None else goal)

    def towards(self, context: MotionContext, goal: Posture) -> State:
        return self if goal is Posture.DIRECT else super().towards(context, goal)

    def step(self, context: MotionContext) -> State:
        told = context.tick.targets
        assert told is not None, "following nobody"
        wanted = context.body.within_ranges(told.positions, context.tick.warnings)
        context.body.targets = self._approach.at(context.tick.stamp, wanted)
        return self


class Walking(State):
    """Command -> leg phases -> foot positions."""

    @classmethod
    def begin(cls, context: MotionContext) -> Walking:
        """Out of standing on four feet."""
        command = _command(context)
        context.legs.start(context.tick.stamp, context.parameters.gaits[command.gait], command.gait_frequency)
        return cls()

    def towards(self, context: MotionContext, goal: Posture) -> State:
        return self if goal is Posture.WALK else Settling.begin(context)

    def next(self, context: MotionContext, goal: Posture | None) -> State:
        # Without any command that is valid any more, as after a gait was taken away, it comes to a stand too.
        return Settling.begin(context) if goal is None else super().next(context, goal)

    def step(self, context: MotionContext) -> State:
        command = _command(context)
        gait, legs = context.parameters.gaits[command.gait], context.legs
        if isinstance(legs, OscillatorLegs):
            legs.step(context.tick.stamp, gait, command.gait_frequency, _fresh_loads(context))
        else:
            legs.step(context.tick.stamp, gait, command.gait_frequency)
        context.feet.follow(context.tick.stamp)
        context.velocities = _leg_velocities(context, command)
        context.place_feet()
        return self


class Settling(State):
    """All feet to the neutral stance height where they are: swing feet go straight down, stance feet stay."""

    def __init__(self, start: int, duration: int, begin: list[float], end: list[float]) -> None:
        self._start, self._duration = start, duration
        self._from, self._to = begin, end

    @classmethod
    def begin(cls, context: MotionContext) -> Settling:
        """From wherever in the gait the feet are."""
        duration = round(context.parameters.settle_duration * 1e9)
        context.feet.stand()
        return cls(context.tick.stamp, duration, list(context.feet.z), neutral_feet(context.parameters)[1])

    def towards(self, context: MotionContext, goal: Posture) -> State:
        return self

    def step(self, context: MotionContext) -> State:
        share = smooth((context.tick.stamp - self._start) / self._duration)
        context.feet.z = [start + share * (end - start) for start, end in zip(self._from, self._to, strict=True)]
        if share >= 1.0:
            return Holding.begin(context, Posture.STILL).step(context)
        context.place_feet()
        return self


class Lifting(State):
    """One leg up for as long as it is asked for; then it comes down first, and until it stands the balance is kept."""

    def __init__(self, posture: Posture, lift: LegLift) -> None:
        self._posture, self._lift = posture, lift
        self._modes = SpineModes()

    @classmethod
    def begin(cls, context: MotionContext, posture: Posture) -> State:
        """From the stand."""
        return cls(posture, LegLift(LIFTED_LEG[posture], context.tick.stamp)).towards(context, posture)

    def next(self, context: MotionContext, goal: Posture | None) -> State:
        return self._freeze(context) if goal is Posture.STOP else self._keep(context, goal)

    def towards(self, context: MotionContext, goal: Posture) -> State:
        return self._keep(context, goal)

    def _keep(self, context: MotionContext, goal: Posture | None) -> State:
        if goal is not self._posture:
            self._lift.lower(context.tick.stamp)
        elif context.tick.command is not None:
            self._modes = context.tick.command.spine_modes
        return Holding.begin(context, Posture.STILL) if self._lift.down(context.tick.stamp) else self

    def step(self, context: MotionContext) -> State:
        context.place_feet(self._modes, self._lift.lifted)
        context.body.pull_knee(self._lift.leg, self._lift.knee(context.tick.stamp))
        return self


def _command(context: MotionContext) -> MotionCommand:
    assert context.tick.command is not None, "walking without a command"
    return context.tick.command


def _fresh_loads(context: MotionContext) -> Four | None:
    """What the feet bear [N], if that is known and wanted."""
    if context.config.coordination != "tegotae":
        return None
    loads = context.tick.loads
    if loads is None or abs(context.tick.stamp - loads.stamp) > context.timeout:
        context.tick.warnings.append("no leg_loads: the legs run free of their loads")
        return None
    return loads.load


def _leg_velocities(context: MotionContext, command: MotionCommand) -> Four:
    """v_legs [m/s]: the target velocity, within the longest stride, modulated for turning (5.38)-(5.39)."""
    parameters, velocity = context.parameters, command.forward_velocity
    fastest = gait_speed(context.legs.frequency, parameters.longest_stride, 1.0 / context.legs.duty_factor)
    if abs(velocity) > fastest * (1.0 + 1e-9):
        context.tick.warnings.append(
            f"forward_velocity = {velocity:.3f} m/s: stride too long, clipped to {fastest:.3f} m/s"
        )
        velocity = math.copysign(fastest, velocity)
    turn = 0.0 if command.turning_strategy == "spine" else command.turn_rate_normalized
    left, right = leg_modulation(turn, parameters.turn_response_exponent)
    return velocity * left, velocity * right, velocity * left, velocity * right
