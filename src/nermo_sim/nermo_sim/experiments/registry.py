"""All experiments, by name: `nermo experiment` offers those that stand here, on the twin and on the real mouse."""

from __future__ import annotations

from typing import Any

from nermo_sim.experiments import (
    balance,
    balance_robot,
    compliance,
    coordination,
    footstep,
    gap_step,
    gaze,
    maze,
    maze_robot,
    push,
    stability,
    straight_line,
    straight_line_robot,
    transition,
    turning,
    turning_robot,
)
from nermo_sim.experiments.experiment import Experiment
from nermo_sim.experiments.on_robot import OnRobot

EXPERIMENTS: dict[str, Experiment[Any]] = {
    module.EXPERIMENT.name: module.EXPERIMENT
    for module in (
        straight_line,
        turning,
        balance,
        maze,
        gaze,
        compliance,
        coordination,
        push,
        footstep,
        gap_step,
        transition,
        stability,
    )
}

ON_ROBOT: dict[str, OnRobot[Any]] = {
    module.ON_ROBOT.experiment.name: module.ON_ROBOT
    for module in (straight_line_robot, turning_robot, balance_robot, maze_robot)
}
"""Those that can be done on the real mouse too."""
