"""The feet on their trajectories: asked for one tick ahead, taken when they come, evaluated tick by tick."""

from __future__ import annotations

import math

from nermo_control.gait.knowledge_base import GaitParameters
from nermo_control.gait.phase import NONE_REQUESTED, LegStateMachine
from nermo_control.gait.trajectory import foot_position
from nermo_control.oscillators.legs import OscillatorLegs
from nermo_control.types import FootTrajectory, Four, LegStates

_LEGS = range(4)


class Feet:
    """Where the four feet are in their leg planes, and on which trajectories."""

    def __init__(self, parameters: GaitParameters, legs: LegStateMachine | OscillatorLegs, period_ns: int) -> None:
        self._legs, self._period = legs, period_ns
        self.x, self.z = neutral_feet(parameters)
        """[m], in the order of the legs."""
        self._trajectories: list[FootTrajectory | None] = [None] * 4
        self._coming: list[FootTrajectory | None] = [None] * 4
        self._awaited: list[int | None] = [None] * 4
        self._first_fractions = [0.0] * 4
        """Where in its phase each leg's newest trajectory begins."""

    def stand(self) -> None:
        """The gait cycle ends; trajectories still to come are of no use."""
        self._legs.stand()
        self._trajectories = [None] * 4
        self._coming = [None] * 4
        self._awaited = [None] * 4

    def accept(self, trajectory: FootTrajectory) -> None:
        """Takes an answer of the trajectory generator; one that nobody is waiting for is ignored.

        Raises ValueError where it is not finite.
        """
        numbers = trajectory.x_first + trajectory.x_second + trajectory.z_first + trajectory.z_second
        if not (math.isfinite(sum(numbers)) and 0.0 < trajectory.duration < math.inf):
            raise ValueError(f"foot trajectory of leg {trajectory.leg} is not finite or has no duration")
        if trajectory.leg in _LEGS and trajectory.start_time == self._awaited[trajectory.leg]:
            self._coming[trajectory.leg] = trajectory

    def follow(self, stamp: int) -> None:
        """Puts the feet where their trajectories have them at a tick [ns]."""
        for leg in _LEGS:
            coming = self._coming[leg]
            if coming is not None and coming.start_time <= stamp:
                self._trajectories[leg], self._coming[leg] = coming, None
            trajectory = self._trajectories[leg]
            if trajectory is not None:
                when = stamp if isinstance(self._legs, LegStateMachine) else self._place_on_path(leg, trajectory)
                self.x[leg], self.z[leg] = foot_position(trajectory, when)

    def _place_on_path(self, leg: int, trajectory: FootTrajectory) -> int:
        """The time [ns] at which a clock would have the foot as far on its path as its oscillator has it now."""
        if trajectory.phase is not self._legs.now.phases[leg]:
            return _end(trajectory)  # the next one is late
        first = self._first_fractions[leg]
        share = (self._legs.now.fractions[leg] - first) / (1.0 - first)
        return trajectory.start_time + round(share * trajectory.duration * 1e9)

    def leg_states(self, stamp: int, velocities: Four) -> LegStates:
        """State of the legs and the request for trajectories that begin one tick ahead, where the feet will then be."""
        legs, start = self._legs, stamp + self._period
        x, z = list(self.x), list(self.z)
        if legs.requested is not NONE_REQUESTED:
            for leg, trajectory in enumerate(self._trajectories):
                if legs.requested[leg]:
                    self._awaited[leg] = start
                    self._first_fractions[leg] = legs.next.fractions[leg]
                    if trajectory is not None:
                        when = start if isinstance(legs, LegStateMachine) else _end(trajectory)
                        x[leg], z[leg] = foot_position(trajectory, when)
        a, b, c, d = legs.next.fractions
        return LegStates(
            stamp=stamp,
            phases=legs.now.phases,
            phase_fractions=legs.now.fractions,
            velocities=velocities,
            requested=legs.requested,
            next_phases=legs.next.phases,
            start_time=start,
            durations=legs.next.remaining,
            remaining_fractions=(1.0 - a, 1.0 - b, 1.0 - c, 1.0 - d),
            start_x=(x[0], x[1], x[2], x[3]),
            start_z=(z[0], z[1], z[2], z[3]),
            gait_frequency=legs.frequency,
            duty_factor=legs.duty_factor,
        )


def neutral_feet(parameters: GaitParameters) -> tuple[list[float], list[float]]:
    """Feet of the neutral stance, x and z [m], in the order of the legs."""
    strides = [parameters.stride(leg) for leg in _LEGS]
    return [s.neutral_stride_position for s in strides], [s.neutral_stance_height for s in strides]


def _end(trajectory: FootTrajectory) -> int:
    """[ns]"""
    return trajectory.start_time + round(trajectory.duration * 1e9)
