"""Node `device_emulator` with the MuJoCo twin behind its electronics; its ground truth as truth/odom.

The truth is for tests and recordings: nothing in the graph of a real robot has it.
"""

from __future__ import annotations

import sys
from typing import Literal

from nav_msgs.msg import Odometry
from pydantic import Field

from nermo_bringup.twin_plant import TwinPlant
from nermo_description.parameters import RobotParameters
from nermo_hw.device.setup import EmulatorSettings
from nermo_hw.nodes.device_emulator import DeviceEmulatorNode
from nermo_node import qos
from nermo_node.run import run
from nermo_sim.nodes.sensor_publishers import fill_odometry
from nermo_sim.twin import BaseState


class TwinDeviceSettings(EmulatorSettings):
    """Parameters of the node."""

    bus: Literal["", "servo_boards", "pwm_board"] = Field(
        "servo_boards", description="As of an emulator; the twin has sensors to show, also where its robot has none"
    )
    scene: str = Field("flat", description="Where it is: a name, as hung, or an MJCF file")


class TwinDeviceNode(DeviceEmulatorNode):
    """The twin as a robot at a cable."""

    def __init__(self) -> None:
        super().__init__(self._make_plant, TwinDeviceSettings)

    def _make_plant(self, robot: RobotParameters) -> TwinPlant:
        self._truth = self.create_publisher(Odometry, "truth/odom", qos.SENSOR)
        scene = str(self.get_parameter("scene").value)
        return TwinPlant(robot, scene, on_truth=self._publish_truth)

    def _publish_truth(self, state: BaseState) -> None:
        if not self.context.ok():
            return
        message = Odometry(child_frame_id="base_link")
        message.header.stamp = self.get_clock().now().to_msg()
        message.header.frame_id = "odom"
        fill_odometry(message, state)
        self._truth.publish(message)


def main() -> int:
    """Runs the node."""
    return run(TwinDeviceNode)


if __name__ == "__main__":
    sys.exit(main())
