"""The mouse walks in process, again and again the same way."""

from __future__ import annotations

import math
from pathlib import Path

import mujoco
import numpy as np
import pytest

from nermo_control.gait.knowledge_base import GaitParameters
from nermo_control.types import ControlCommand, Posture, TrajectoryMode
from nermo_description.parameters import RobotParameters, TailModel
from nermo_sim.disturbance import Disturbance, DisturbedRun
from nermo_sim.loop import Loop, constant, schedule
from nermo_sim.run_table import Recording

ISLANDS = int(mujoco.mjtDisableBit.mjDSBL_ISLAND)


def walking(gait: str, frequency: float = 0.8, velocity: float = 0.06) -> ControlCommand:
    return ControlCommand(
        0,
        forward_velocity=velocity,
        gait=gait,
        gait_frequency=frequency,
        trajectory_mode=TrajectoryMode.STRAIGHT_LINE,
    )


@pytest.mark.parametrize("gait", ["trot", "walking_trot", "lateral_walk"])
def test_walks_forward_in_each_gait_without_falling(loop: Loop, gait: str) -> None:
    recording = loop.run(constant(walking(gait)), 6.0)
    way = recording.position[-1] - recording.position[0]
    assert way[0] > 0.2
    assert abs(way[1]) < 0.1 * way[0]
    assert np.degrees(np.abs(recording.roll_pitch_yaw)).max() < 20.0


def test_walks_backwards(loop: Loop) -> None:
    recording = loop.run(constant(walking("trot", velocity=-0.05)), 5.0)
    assert recording.position[-1, 0] < -0.1


def test_faster_is_faster(robot: RobotParameters) -> None:
    ways = [
        Loop.build(robot, GaitParameters()).run(constant(walking("trot", velocity=v)), 4.0).position[-1, 0]
        for v in (0.03, 0.06, 0.09)
    ]
    assert ways[0] < ways[1] < ways[2]


def test_same_commands_same_bytes(robot: RobotParameters) -> None:
    script = schedule([(0.0, walking("trot")), (1.0, walking("lateral_walk", 0.5)), (1.5, ControlCommand(0))])
    runs = [Loop.build(robot, GaitParameters()).run(script, 2.0) for _ in range(2)]
    assert runs[0].states.tobytes() == runs[1].states.tobytes()
    assert runs[0].commands.tobytes() == runs[1].commands.tobytes()


@pytest.mark.parametrize("tail", ["chain", "rigid"])
def test_looking_for_islands_would_change_no_bit(robot: RobotParameters, tail: TailModel) -> None:
    loops = [Loop.build(robot.with_tail(tail), GaitParameters()) for _ in range(2)]
    assert loops[0].twin.model.opt.disableflags & ISLANDS, "the mouse is one tree"
    loops[1].twin.model.opt.disableflags &= ~ISLANDS
    for loop in loops:
        loop.run(constant(walking("trot")), 2.0, record=False)
    np.testing.assert_array_equal(loops[0].twin.data.qpos, loops[1].twin.data.qpos)


def test_disturbances_follow_the_seed(robot: RobotParameters) -> None:
    def end(seed: int) -> bytes:
        loop = Loop.build(robot, GaitParameters())
        run = DisturbedRun(loop.twin, Disturbance(push=0.2, push_interval=0.2), seed)
        run.begin()
        return loop.run(constant(walking("trot")), 1.0, before_tick=run.tick).states[-1].tobytes()

    assert end(1) == end(1)
    assert end(1) != end(2)


def test_stands_still_without_a_command(loop: Loop) -> None:
    recording = loop.run(lambda stamp: None, 1.0)
    assert np.ptp(recording.commands, axis=0).max() < 0.02
    assert np.linalg.norm(recording.position[-1] - recording.position[0]) < 2e-3


def test_reset_while_walking_makes_no_servo_command_jump(loop: Loop) -> None:
    before = loop.run(constant(walking("trot")), 1.1)
    loop.sensors = loop.twin.reset("sit")
    after = loop.run(constant(walking("trot")), 3.0)
    steps = np.abs(np.diff(np.vstack([before.commands, after.commands]), axis=0))
    assert steps.max() < 0.15
    assert np.diff(np.concatenate([before.stamps, after.stamps])).tolist() == [5_000_000] * (len(steps))
    assert after.position[-1, 0] > after.position[0, 0] + 0.05


def test_falling_silent_script_stops_the_mouse_on_four_feet(loop: Loop) -> None:
    stop = ControlCommand(0, posture=Posture.STAND)
    recording = loop.run(schedule([(0.0, walking("trot")), (2.03, stop)]), 4.0)
    end = recording.time > 3.0
    assert np.ptp(recording.position[end], axis=0).max() < 5e-3
    assert (recording.foot_forces[end].min(axis=1) > 0.0).mean() > 0.95


def test_until_ends_a_run(loop: Loop) -> None:
    recording = loop.run(constant(walking("trot")), 10.0, until=lambda twin: twin.odometry().x > 0.05)
    assert recording.position[-1, 0] == pytest.approx(0.05, abs=5e-3)


def test_schedule_refuses_times_that_do_not_rise() -> None:
    with pytest.raises(ValueError, match="must rise"):
        schedule([(1.0, ControlCommand(0)), (0.5, ControlCommand(0))])


def test_schedule_says_nothing_before_its_first_time() -> None:
    script = schedule([(1.0, walking("trot"))])
    assert script(999_999_999) is None
    command = script(1_000_000_000)
    assert command is not None
    assert command.stamp == 1_000_000_000


def test_recording_agrees_with_the_twin_and_survives_the_disk(loop: Loop, tmp_path: Path) -> None:
    recording = loop.run(constant(walking("trot")), 1.0)
    state = loop.twin.base_state()
    assert recording.position[-1] == pytest.approx(state.position, abs=1e-3)
    assert recording.roll_pitch_yaw[-1, 2] == pytest.approx(loop.twin.odometry().yaw, abs=0.02)
    assert math.hypot(*recording.roll_pitch_yaw[-1, :2]) == pytest.approx(loop.twin.tilt(), abs=0.02)
    assert recording.servo_positions[-1] == pytest.approx(loop.twin.sensors().servo_positions)

    recording.save(tmp_path / "run.npz")
    loaded = Recording.load(tmp_path / "run.npz")
    assert loaded.servos == recording.servos
    assert loaded.states.tobytes() == recording.states.tobytes()
    assert len(loaded.part(0.2, 0.4).stamps) == 41
