"""What the states of the motion module work on: what lasts, and what is new in a tick."""

from __future__ import annotations

from dataclasses import dataclass, replace

from nermo_control.gait.knowledge_base import GaitParameters
from nermo_control.gait.phase import Flags, LegStateMachine
from nermo_control.motion.body import Body
from nermo_control.motion.config import MotionModuleConfig
from nermo_control.motion.feet import Feet, neutral_feet
from nermo_control.motion.tick import Tick
from nermo_control.oscillators.legs import OscillatorLegs
from nermo_control.spine.controller import NOT_LIFTED
from nermo_control.types import Four, SpineModes

STANDING_STILL: Four = (0.0, 0.0, 0.0, 0.0)
NO_OFFSETS: Four = (0.0, 0.0, 0.0, 0.0)


@dataclass(slots=True)
class MotionContext:
    """The robot's parts and settings, and the present control tick."""

    config: MotionModuleConfig
    parameters: GaitParameters
    timeout: int
    """Silence after which what was heard no longer counts [ns]."""
    legs: LegStateMachine | OscillatorLegs
    feet: Feet
    body: Body
    tick: Tick
    velocities: Four = STANDING_STILL
    """v_legs [m/s]."""

    def stand_neutral(self) -> None:
        """All feet stand in the neutral stance; spine, neck and tail go on from where they are."""
        self.feet.x, self.feet.z = neutral_feet(self.parameters)
        self.body.reset()

    def place_feet(self, modes: SpineModes | None = None, lifted: Flags = NOT_LIFTED) -> None:
        """Foot positions -> spine and its offsets -> neck and tail, inverse kinematics.

        `modes` stand in for the command's; `lifted`: feet off the ground, or about to leave it, of a standing robot.
        """
        tick, offsets = self.tick, NO_OFFSETS
        if tick.command is not None:
            command = tick.command if modes is None else replace(tick.command, spine_modes=modes)
            offsets = self.body.bend(tick, command, self.config, self.feet, self.legs, lifted)
        self.body.place(self.feet, offsets, lifted is not NOT_LIFTED, tick.warnings)
