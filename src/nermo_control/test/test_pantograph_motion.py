"""What a robot with pantograph legs does with commands: those it cannot follow, silence, STOP."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest

from nermo_control.pantograph_motion import (
    PantographMotion,
    PantographMotionConfig,
    SavedGait,
    command_error,
    read_saved_gait,
)
from nermo_control.types import ControlCommand, MotionOutput, Posture
from nermo_description.pantograph import PantographParameters
from nermo_description.parameter_files import ParameterError
from nermo_description.robots import load_any_robot

PERIOD = 5_000_000
WALK = ControlCommand(0, forward_velocity=0.3, gait="trot")


class Robot:
    """A robot that is at once where its servos are told to be."""

    def __init__(self) -> None:
        robot = load_any_robot("cheetah_cub")
        assert isinstance(robot, PantographParameters)
        self.motion = PantographMotion(robot, SavedGait(), PERIOD, PantographMotionConfig())
        self.servos = list(robot.posture("stand").values())
        self.stamp = 0

    def run(self, seconds: float, command: ControlCommand | None, repeat: bool = True) -> list[MotionOutput]:
        outputs = []
        for _ in range(round(seconds * 1e9 / PERIOD)):
            self.stamp += PERIOD
            if command is not None and repeat:
                command = replace(command, stamp=self.stamp)
            outputs.append(self.motion.step(self.stamp, command, self.servos, None))
            self.servos = list(outputs[-1].servo_positions)
        return outputs


def test_walks_at_the_gaits_own_frequency_and_stands_when_nobody_speaks() -> None:
    robot = Robot()
    walking = robot.run(1.0, WALK)
    assert walking[-1].leg_states.gait_frequency == SavedGait().frequency_hz
    assert len({output.servo_positions for output in walking[-50:]}) == 50
    silent = robot.run(1.2, replace(WALK, stamp=robot.stamp), repeat=False)
    frequencies = [output.leg_states.gait_frequency for output in silent]
    assert frequencies[50] > 0.0 and frequencies[-1] == 0.0
    assert silent[-1].servo_positions == silent[-2].servo_positions


def test_before_any_command_it_stays_where_it_was_first_though_the_servos_give_way() -> None:
    robot = Robot()
    first = robot.run(0.005, None)[0]
    robot.servos = [position - 0.05 for position in robot.servos]
    sagged = robot.run(0.005, None)[0]
    assert sagged.servo_positions == first.servo_positions


def test_stop_freezes_every_servo_where_it_is() -> None:
    robot = Robot()
    last = robot.run(0.73, WALK)[-1]
    stopped = robot.run(0.2, replace(WALK, posture=Posture.STOP))
    assert {output.servo_positions for output in stopped} == {last.servo_positions}
    moving = robot.run(1.0, replace(WALK, posture=Posture.STAND))
    assert moving[0].servo_positions == pytest.approx(last.servo_positions, abs=0.01)
    assert moving[-1].servo_positions != last.servo_positions


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"gait": "walking_trot"}, "gait = 'walking_trot' is unknown; allowed: trot, lateral_sequence"),
        ({"gait_frequency": 9.0}, "gait_frequency = 9.0 Hz: allowed 0.1 to 5.0 Hz"),
        ({"forward_velocity": math.nan}, "forward_velocity = nan m/s: allowed -10 to 10 m/s"),
        ({"posture": Posture.LIFT_FRONT_LEFT}, "posture = LIFT_FRONT_LEFT: allowed WALK, STAND"),
    ],
)
def test_unusable_commands_are_refused_in_words_and_nothing_changes(changes: dict, reason: str) -> None:
    robot = Robot()
    robot.run(0.5, WALK)
    command = replace(WALK, **changes)
    assert reason in (command_error(command) or "")
    output = robot.run(0.05, command)[0]
    assert any(reason in warning for warning in output.warnings)
    assert output.leg_states.gait_frequency > 0.0


def test_too_fast_is_clipped_and_said() -> None:
    (output,) = Robot().run(0.005, replace(WALK, forward_velocity=2.0, gait_frequency=2.0))
    assert any("forward_velocity = 2.000 m/s: clipped to 0.464" in warning for warning in output.warnings)


def test_gait_of_a_search_is_read_and_a_wrong_one_refused(tmp_path: Path) -> None:
    file = tmp_path / "gait.yaml"
    file.write_text("frequency_hz: 3.4\nstep_length_m: 0.12\ngait: {duty_factor: 0.6}\n")
    assert read_saved_gait(file).gait.duty_factor == 0.6
    file.write_text("frequency_hz: 34\n")
    with pytest.raises(ParameterError, match=r"gait\.yaml: frequency_hz"):
        read_saved_gait(file)
