"""How nodes hear of the gait parameters."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.node import Node

from nermo_control.gait.knowledge_base import GaitParameters
from nermo_control.nodes import conversions
from nermo_interfaces import msg
from nermo_node import qos
from nermo_node.complaints import Complaints
from nermo_node.inputs import Inputs
from nermo_node.time import to_nanoseconds


class GaitParametersInput:
    """Subscribes gait_parameters.

    `on_change` gets the parameters when they come first and whenever they differ; `on_life` the stamp [ns] of each
    message, since they are repeated as a sign of life.
    """

    def __init__(
        self,
        node: Node,
        refused: Complaints,
        on_change: Callable[[GaitParameters], None],
        on_life: Callable[[int], None] | None = None,
    ) -> None:
        self._on_change, self._on_life = on_change, on_life
        self._parameters: GaitParameters | None = None
        inputs = Inputs(node, refused.add_one)
        inputs.subscribe(msg.GaitParameters, "gait_parameters", self._on_message, qos.LATCHED)

    def _on_message(self, message: msg.GaitParameters) -> None:
        parameters = conversions.gait_parameters_from_message(message)
        if parameters != self._parameters:
            self._parameters = parameters
            self._on_change(parameters)
        if self._on_life is not None:
            self._on_life(to_nanoseconds(message.header.stamp))
