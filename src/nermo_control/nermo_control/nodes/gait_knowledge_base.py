"""Node `gait_knowledge_base`: the gait parameters (k_g) as ROS parameters, told to all; and the robot's parameters."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from pydantic import Field
from rclpy.node import Node

from nermo_control.gait.kept_changes import KeptChanges
from nermo_control.gait.knowledge_base import GaitKnowledgeBase, GaitParameters, default_sets_folder
from nermo_control.nodes import conversions
from nermo_control.nodes.robot import RobotChoice
from nermo_interfaces import msg
from nermo_interfaces.srv import ListParameterSets, LoadParameterSet, SaveParameterSet
from nermo_node import qos, run
from nermo_node.diagnostics import OK, Diagnostics, Status
from nermo_node.parameters import NodeParameters, blame

REPEAT_PERIOD_S = 0.1
"""The gait parameters are repeated as a sign of life: `silence.WALK` stops the mouse."""


class GaitKnowledgeBaseParameters(GaitParameters, RobotChoice):
    """Parameters of the node: every value of the knowledge-base, and where its named sets are kept."""

    sets_folder: str = Field(
        "",
        description="Folder of the named sets; empty: nermo/gaits in the user's data folder",
        json_schema_extra={"readOnly": True},
    )
    start_set: str = Field(
        "",
        description="Named set to begin with, in place of all values given; empty: none",
        json_schema_extra={"readOnly": True},
    )

    kept_changes: str = Field(
        "",
        description="File for values that are changed live, so that a respawned node goes on with them; empty: none",
        json_schema_extra={"readOnly": True},
    )

    def gait_parameters(self) -> GaitParameters:
        """The values of the knowledge-base alone."""
        return GaitParameters(**{name: getattr(self, name) for name in GaitParameters.model_fields})

    def with_gait_parameters(self, parameters: GaitParameters) -> GaitKnowledgeBaseParameters:
        """The same node with other values in the knowledge-base."""
        return self.model_copy(update={name: getattr(parameters, name) for name in GaitParameters.model_fields})


class GaitKnowledgeBaseNode(Node):
    """Values change only as ROS parameters; loading a named set sets these too."""

    def __init__(self) -> None:
        super().__init__("gait_knowledge_base")
        self._settings = NodeParameters(self, GaitKnowledgeBaseParameters, self._on_parameters)
        values = self._settings.values
        robot = values.load()
        folder = Path(values.sets_folder).expanduser() if values.sets_folder else default_sets_folder()
        self._knowledge_base = GaitKnowledgeBase(folder, values.gait_parameters())
        self._changes = KeptChanges(Path(values.kept_changes)) if values.kept_changes else None

        self._gait_parameters = self.create_publisher(msg.GaitParameters, "gait_parameters", qos.LATCHED)
        self._robot_parameters = self.create_publisher(msg.RobotParameters, "robot_parameters", qos.LATCHED)
        self._robot_parameters.publish(conversions.robot_parameters_to_message(self._now(), robot))
        kept = self._kept()
        if kept is not None:
            self._settings.change(values.with_gait_parameters(kept))
            self.get_logger().info("goes on with the values that were set before it was started again")
        elif values.start_set:
            with blame("start_set"):
                self._settings.change(values.with_gait_parameters(self._knowledge_base.load(values.start_set)))
        self._publish()
        self.create_timer(REPEAT_PERIOD_S, self._publish)
        self.create_service(SaveParameterSet, "~/save_parameter_set", self._on_save)
        self.create_service(LoadParameterSet, "~/load_parameter_set", self._on_load)
        self.create_service(ListParameterSets, "~/list_parameter_sets", self._on_list)
        Diagnostics(self, robot.name, {"gait parameters": self._status})

    def _now(self) -> int:
        return int(self.get_clock().now().nanoseconds)

    def _publish(self) -> None:
        base = self._knowledge_base
        self._gait_parameters.publish(
            conversions.gait_parameters_to_message(self._now(), base.parameters, base.revision)
        )

    def _on_parameters(self, values: GaitKnowledgeBaseParameters) -> None:
        self._knowledge_base.change(values.gait_parameters())
        self._publish()
        if self._changes is not None:
            try:
                self._changes.keep(values.gait_parameters())
            except ValueError as error:
                self.get_logger().warning(f"a change is lost if this node is started again: {error}")

    def _kept(self) -> GaitParameters | None:
        try:
            return None if self._changes is None else self._changes.kept()
        except ValueError as error:
            self.get_logger().warning(f"what was changed before is not known: {error}")
            return None

    # Services

    def _on_save(self, request: Any, response: Any) -> Any:
        try:
            response.path = str(self._knowledge_base.save(request.name, request.overwrite))
        except ValueError as error:
            response.message = str(error)
            return response
        response.success = True
        response.message = f"saved as {request.name}"
        return response

    def _on_load(self, request: Any, response: Any) -> Any:
        try:
            loaded = self._knowledge_base.load(request.name)
            self._settings.change(self._settings.values.with_gait_parameters(loaded))
        except ValueError as error:
            response.message = str(error)
            return response
        response.success = True
        response.message = f"loaded {request.name}"
        return response

    def _on_list(self, request: Any, response: Any) -> Any:
        response.names = self._knowledge_base.names()
        return response

    def _status(self) -> Status:
        base = self._knowledge_base
        values = {"revision": base.revision, "gaits": ", ".join(base.parameters.gaits)}
        return OK, f"default gait {base.parameters.default_gait}", values


def main() -> int:
    """Runs the node."""
    return run(GaitKnowledgeBaseNode)


if __name__ == "__main__":
    sys.exit(main())
