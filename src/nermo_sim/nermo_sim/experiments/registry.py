"""All experiments, by name: `nermo experiment` offers those that stand here."""

from __future__ import annotations

from typing import Any

from nermo_sim.experiments import (
    balance,
    compliance,
    coordination,
    footstep,
    gap_step,
    gaze,
    maze,
    push,
    stability,
    straight_line,
    transition,
    turning,
)
from nermo_sim.experiments.experiment import Experiment

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
