"""A recorded minute of the motion module: what is not meant to change the motion does not change it.

After a change that is meant to, record it anew: `python src/nermo_control/test/test_motion_trace.py`.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from nermo_control.gait.knowledge_base import GaitParameters
from nermo_control.gait.trajectory import TrajectoryGenerator
from nermo_control.motion.config import MotionModuleConfig
from nermo_control.motion_module import MotionModule
from nermo_control.types import MotionCommand, Posture, SpineModes
from nermo_description.robots import load_robot

RECORDED = Path(__file__).with_name("data") / "motion_trace.json"
PERIOD = 5_000_000
EVERY = 100
"""Ticks between two servo commands that are kept."""
ALL_MODES = SpineModes(True, True, True, True)
WALK = MotionCommand(0, 0.08, 0.0, Posture.WALK, "trot", 0.8)
LOWER_FRONT = GaitParameters().front.model_copy(update={"neutral_stance_height": -0.042})

SCRIPT: list[tuple[float, MotionCommand | None]] = [
    (0.3, None),
    (1.5, replace(WALK, posture=Posture.STAND)),
    (4.0, WALK),
    (3.0, replace(WALK, turn_rate_normalized=0.7, turning_strategy="mix")),
    (2.0, replace(WALK, turn_rate_normalized=-1.0, turning_strategy="spine", spine_modes=ALL_MODES)),
    (3.5, replace(WALK, gait="walking_trot", gait_frequency=1.0, spine_modes=SpineModes(stride_extension=True))),
    (3.0, replace(WALK, gait="lateral_walk", gait_frequency=0.6, spine_modes=SpineModes(balance_compensation=True))),
    (0.7, replace(WALK, posture=Posture.STOP)),
    (1.5, replace(WALK, posture=Posture.STILL)),
    (2.5, replace(WALK, forward_velocity=-0.05)),
    (1.2, replace(WALK, posture=Posture.SIT)),
    (0.5, replace(WALK, posture=Posture.CROUCH)),
    (3.0, replace(WALK, posture=Posture.LIFT_REAR_LEFT, spine_modes=ALL_MODES)),
    (2.5, replace(WALK, posture=Posture.LIFT_FRONT_RIGHT, spine_modes=ALL_MODES)),
    (1.5, replace(WALK, posture=Posture.STAND)),
    (2.0, replace(WALK, gait="nonsense")),
    (2.5, replace(WALK, forward_velocity=0.3)),
    (0.2, replace(WALK, posture=Posture.STILL)),
    (2.5, WALK),
]
"""Seconds, and what is commanded."""
SILENT = (6, 2.0)
"""A step of the script and after how much of it [s] its command is not repeated any more."""
RETUNED = {9: MotionModuleConfig(gaze="off", tail="spine", tail_angle=0.3, arch=0.1), 14: MotionModuleConfig()}
"""Settings that change at the begin of a step."""


def trace() -> dict[str, Any]:
    """Servo commands [rad] every half second, and the sum over all ticks of each servo's."""
    robot, parameters = load_robot("nermo"), GaitParameters()
    module, generator = MotionModule(robot, parameters, PERIOD), TrajectoryGenerator(parameters)
    servos = tuple(0.1 for _ in robot.servos)
    stamp, ticks = -PERIOD, 0
    kept: list[list[float]] = []
    sums = [0.0] * len(servos)
    for number, (seconds, command) in enumerate(SCRIPT):
        if number in RETUNED:
            module.set_config(RETUNED[number])
            parameters = parameters.model_copy(update={"front": LOWER_FRONT})
            module.set_parameters(parameters)
            generator.set_parameters(parameters)
        for tick in range(round(seconds * 1e9 / PERIOD)):
            stamp += PERIOD
            module.sign_of_life("gait_knowledge_base", stamp)
            silent = number == SILENT[0] and tick * PERIOD * 1e-9 > SILENT[1]
            if command is not None and not silent:
                command = replace(command, stamp=stamp)
            output = module.step(stamp, command, servos)
            for trajectory in generator.step(output.leg_states):
                module.accept(trajectory)
            module.sign_of_life("trajectory_generator", stamp)
            servos = output.servo_positions
            sums = [total + value for total, value in zip(sums, servos, strict=True)]
            if ticks % EVERY == 0:
                kept.append([round(value, 7) for value in servos])
            ticks += 1
    return {"servos": list(robot.servos), "ticks": ticks, "positions": kept, "sums": [round(one, 4) for one in sums]}


def test_the_motion_is_that_which_was_recorded() -> None:
    recorded, now = json.loads(RECORDED.read_text()), trace()
    assert (now["servos"], now["ticks"]) == (recorded["servos"], recorded["ticks"])
    for number, (a, b) in enumerate(zip(now["positions"], recorded["positions"], strict=True)):
        assert a == pytest.approx(b, abs=1e-6), f"{number * EVERY * PERIOD * 1e-9} s"
    assert now["sums"] == pytest.approx(recorded["sums"], abs=1e-3)


if __name__ == "__main__":
    recorded = trace()
    rows = ",\n  ".join(json.dumps(row) for row in recorded.pop("positions"))
    head = json.dumps(recorded)[1:-1]
    RECORDED.write_text(f'{{{head},\n "positions": [\n  {rows}\n ]}}\n')
