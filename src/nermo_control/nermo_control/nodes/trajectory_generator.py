"""Node `trajectory_generator`: leg_states, gait_parameters -> foot_trajectories."""

from __future__ import annotations

import sys

from pydantic import BaseModel, ConfigDict
from rclpy.node import Node

from nermo_control.gait.knowledge_base import GaitParameters
from nermo_control.gait.trajectory import TrajectoryGenerator
from nermo_control.nodes import conversions
from nermo_control.nodes.gait_parameters import GaitParametersInput
from nermo_interfaces.msg import FootTrajectories, LegStates
from nermo_node import qos, run
from nermo_node.complaints import Complaints
from nermo_node.diagnostics import Diagnostics
from nermo_node.inputs import Inputs
from nermo_node.parameters import declare


class NoParameters(BaseModel):
    """This node has none."""

    model_config = ConfigDict(extra="forbid")


class TrajectoryGeneratorNode(Node):
    """Answers every LegStates; with an empty answer where nothing was asked, as a sign of life."""

    def __init__(self) -> None:
        super().__init__("trajectory_generator")
        declare(self, NoParameters)
        self._generator: TrajectoryGenerator | None = None
        self._refused = Complaints(self, "refused")
        self._answers = self.create_publisher(FootTrajectories, "foot_trajectories", qos.EVENT)
        GaitParametersInput(self, self._refused, self._on_gait_parameters)
        Inputs(self, self._refused.add_one).subscribe(LegStates, "leg_states", self._on_leg_states, qos.EVENT)
        Diagnostics(self, "nermo", {"requests": self._refused.status})

    def _on_gait_parameters(self, parameters: GaitParameters) -> None:
        if self._generator is None:
            self._generator = TrajectoryGenerator(parameters)
        else:
            self._generator.set_parameters(parameters)

    def _on_leg_states(self, message: LegStates) -> None:
        if self._generator is None:
            return
        states = conversions.leg_states_from_message(message)
        trajectories = self._generator.step(states)
        self._answers.publish(conversions.foot_trajectories_to_message(states.stamp, trajectories))


def main() -> int:
    """Runs the node."""
    return run(TrajectoryGeneratorNode)


if __name__ == "__main__":
    sys.exit(main())
