"""Who steers an emulated mouse that nobody watches: it goes by the mouse's truth, as an operator by sight."""

from __future__ import annotations

from dataclasses import replace

from nermo_control.gait.knowledge_base import GaitParameters
from nermo_control.high_level_controller import HighLevelController, HighLevelControllerConfig
from nermo_control.path import PathStatus
from nermo_control.types import Odometry, TrajectoryMode
from nermo_description.parameters import RobotParameters
from nermo_gap.protocol.types import REST, Piece


class Pilot:
    """Leads the mouse along the path of a piece that is steered; elsewhere it holds, and steers nothing.

    It leads as the high-level controller would if it were told where the mouse is, and says it as an operator does: a
    turn. At the end of the path, or where the path is lost, it lets go.
    """

    def __init__(self, robot: RobotParameters) -> None:
        parameters = GaitParameters()
        self._controller = HighLevelController(robot, parameters, HighLevelControllerConfig(lockstep=True))
        self._piece: Piece | None = None

    def steer(self, piece: Piece | None, truth: Odometry | None) -> float | None:
        """The turn in [-1, 1], left positive, for the piece that is played now; None to let go.

        ``truth``: where the mouse is; None where nobody knows, then it goes straight on.
        """
        if piece is None or piece.steering is None or truth is None:
            return 0.0
        said, controller = piece.said(REST, 0.0), self._controller
        if said is None:
            return 0.0
        if piece is not self._piece:
            self._piece = piece
            controller.follow(piece.steering.path.placed(controller.guide_pose(truth)))
        along = replace(said, stamp=truth.stamp, trajectory_mode=TrajectoryMode.PATH)
        motion = controller.step(truth.stamp, along, truth)
        if controller.path_status is not PathStatus.FOLLOWING:
            return None
        return max(-1.0, min(controller.turn_rate(motion) / piece.steering.turn_rate, 1.0))
