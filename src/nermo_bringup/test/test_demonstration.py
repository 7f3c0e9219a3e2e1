"""The demo's plan, and its verdict on runs that are known."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from nermo_bringup.demo.evaluation import (
    Balance,
    SpineTurn,
    Track,
    Walk,
    begun,
    complaints,
    judge_balance,
    judge_turn,
    judge_walk,
    plan_start,
    read_health,
    sitting_pitch,
)
from nermo_bringup.demo.plan import Scene, make_plan
from nermo_bringup.recording.errors import RecordingError
from nermo_bringup.recording.writer import BagWriter
from nermo_bringup.teleop.script import SECOND, CommandFile, file_script
from nermo_control.types import Posture, TrajectoryMode
from nermo_node.recording_reader import Recording

GAITS = ["trot", "lateral_walk"]
NO_SLIP = {"trot": 0.1, "lateral_walk": 0.07}
RATE = 200.0


@pytest.fixture
def plan():
    return make_plan(GAITS, 0.8, walk_duration=10.0, turn_duration=5.0)


def test_the_plan_is_a_command_file_that_does_what_its_scenes_say(plan) -> None:
    script = file_script(CommandFile.model_validate(plan.command_file))
    assert script.duration == plan.duration * SECOND
    for scene in plan.scenes:
        command = script.control_at(round((scene.begin + scene.end) / 2 * SECOND), 0)
        assert command is not None
        if scene.kind == "walk":
            assert (command.gait, command.gait_frequency) == (scene.gait, 0.8)
            assert command.trajectory_mode is TrajectoryMode.STRAIGHT_LINE
            assert command.forward_velocity > 0.0
        elif scene.kind in ("turn_left", "turn_right", "turn_spine"):
            assert command.trajectory_mode is TrajectoryMode.EXTERNAL
            assert (command.turn_rate > 0.0) == (scene.kind != "turn_right")
            assert command.spine_modes.turning == (scene.kind == "turn_spine")
        elif scene.kind == "balance":
            assert command.posture is Posture.LIFT_REAR_LEFT
            assert command.spine_modes.balance_compensation
        else:
            assert command.posture is (Posture.SIT if scene.kind == "sit" else Posture.STAND)
    assert [scene.gait for scene in plan.scenes if scene.kind == "walk"] == GAITS


def test_every_scene_begins_at_rest(plan) -> None:
    script = file_script(CommandFile.model_validate(plan.command_file))
    for scene in plan.scenes[1:]:
        before = script.control_at(round(scene.begin * SECOND) - 1, 0)
        assert before is not None
        assert before.forward_velocity == 0.0 or before.posture is not Posture.WALK


def track(begin: float, end: float, speed: float, heading: float, turn_rate: float, sway: float = 0.0) -> Track:
    """A mouse that stands until `begin` at (1, 2), then walks at a speed and turn rate, with an 0.8 Hz sway."""
    time = np.arange(0.0, end + 2.0, 1.0 / RATE)
    moving = np.clip(time - begin, 0.0, end - begin)
    yaw = heading + turn_rate * moving
    step = speed / RATE * ((time > begin) & (time <= end))
    x, y = 1.0 + np.cumsum(step * np.cos(yaw)), 2.0 + np.cumsum(step * np.sin(yaw))
    swing = sway * np.sin(2.0 * math.pi * 0.8 * moving)
    position = np.column_stack([x - swing * np.sin(heading), y + swing * np.cos(heading), np.full_like(x, 0.06)])
    return Track(time, position, np.column_stack([0.0 * time, 0.0 * time, yaw]))


@pytest.mark.parametrize("heading", [0.0, 2.0, -3.0])
def test_a_straight_walk_is_measured_along_its_line(heading: float) -> None:
    walk = judge_walk(track(1.0, 11.0, 0.08, heading, 0.0, sway=0.01), Scene("walk", 1.0, 11.0, "trot"), 0.8)
    assert walk.distance_m == pytest.approx(0.8, abs=1e-3)
    assert walk.speed_m_s == pytest.approx(0.08, abs=1e-4)
    assert walk.lateral_drift_m == pytest.approx(0.0, abs=1e-3)
    assert walk.heading_error_deg == pytest.approx(0.0, abs=1e-6)
    assert not walk.fell
    assert walk.stood_s == 0.0


def test_a_mouse_that_stands_in_the_middle_of_its_walk_is_seen_to() -> None:
    halted = track(1.0, 11.0, 0.08, 0.3, 0.0, sway=0.01)
    still = (halted.time > 4.0) & (halted.time < 5.5)
    halted.position[still] = halted.position[np.argmax(still)]
    assert judge_walk(halted, Scene("walk", 1.0, 11.0, "trot"), 0.8).stood_s == pytest.approx(1.5, abs=0.1)


def test_a_walk_that_bends_to_the_left_drifts_to_the_left() -> None:
    walk = judge_walk(track(1.0, 11.0, 0.08, 1.0, 0.02), Scene("walk", 1.0, 11.0, "trot"), 0.8)
    radius = 0.08 / 0.02
    assert walk.distance_m == pytest.approx(radius * math.sin(0.2), abs=1e-3)
    # Drift and heading are those of the middle of the last gait cycle, 0.625 s before the end.
    angle = 0.02 * (10.0 - 0.625)
    assert walk.lateral_drift_m == pytest.approx(radius * (1.0 - math.cos(angle)), abs=1e-3)
    assert walk.heading_error_deg == pytest.approx(math.degrees(angle), abs=0.01)


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_a_turn_has_its_angle_and_radius(direction: float) -> None:
    kind = "turn_left" if direction > 0.0 else "turn_right"
    turn = judge_turn(track(1.0, 6.0, 0.05, 0.0, 0.2 * direction, sway=0.002), Scene(kind, 1.0, 6.0))
    assert turn.turned_deg == pytest.approx(math.degrees(direction), abs=0.1)
    assert turn.radius_m == pytest.approx(0.25, rel=0.05)
    assert turn.direction == kind.removeprefix("turn_")


@pytest.mark.parametrize("how", ["tipped over", "on its belly"])
def test_a_fall_is_seen(how: str) -> None:
    fallen = track(1.0, 11.0, 0.08, 0.0, 0.0)
    if how == "tipped over":
        fallen.roll_pitch_yaw[1000:1100, 0] = 1.0
    else:
        fallen.position[1000:1100, 2] = 0.03
    assert judge_walk(fallen, Scene("walk", 1.0, 11.0, "trot"), 0.8).fell


def test_sitting_lifts_the_nose() -> None:
    seated = track(1.0, 3.0, 0.0, 0.0, 0.0)
    seated.roll_pitch_yaw[seated.time > 1.5, 1] = -0.2
    assert sitting_pitch(seated, Scene("sit", 1.0, 3.0)) == pytest.approx(0.2)


@pytest.mark.parametrize(("load", "tilt", "passed"), [(0.0, 0.05, True), (0.2, 0.05, False), (0.0, 0.5, False)])
def test_a_lift_passes_if_the_foot_is_free_and_the_mouse_stays_up(load: float, tilt: float, passed: bool) -> None:
    standing = track(1.0, 6.0, 0.0, 0.0, 0.0)
    standing.roll_pitch_yaw[standing.time > 2.5, 1] = tilt
    time = standing.time[::4]
    force = np.full((len(time), 4), 0.66)
    force[time > 2.2, 2] = load
    balance = judge_balance(standing, Scene("balance", 1.0, 5.0), (time, force), "rear_left")
    assert balance.passed == passed
    assert balance.foot_forces_n == pytest.approx((0.66, 0.66, load, 0.66))
    with pytest.raises(RecordingError, match="no foot forces between 2\\.4 s and 5\\.0 s"):
        judge_balance(standing, Scene("balance", 1.0, 5.0), (time[:100], force[:100]), "rear_left")


def test_a_lift_is_judged_from_its_command_on_however_late_the_player_was() -> None:
    planned, time = Scene("balance", 1.0, 5.0), np.arange(0.0, 8.0, 0.1)
    posture = np.where((time > 1.55) & (time < 5.2), Posture.LIFT_REAR_LEFT, Posture.STAND)
    assert begun(planned, time, posture, Posture.LIFT_REAR_LEFT) == replace(planned, begin=pytest.approx(1.6))
    assert begun(planned, time - 0.7, posture, Posture.LIFT_REAR_LEFT) == planned
    with pytest.raises(RecordingError, match=r"no command to lift_rear_left is recorded before 5\.0 s"):
        begun(planned, time + 4.0, posture, Posture.LIFT_REAR_LEFT)


def good_walks() -> list[Walk]:
    return [Walk(gait, 0.8, False, 10.0, 0.6, 0.06, 0.01, 2.0, False, 0.0) for gait in GAITS]


def turns(degrees: float = 40.0):
    return [
        judge_turn(track(1.0, 6.0, 0.05, 0.0, sign * math.radians(degrees) / 5.0), Scene(kind, 1.0, 6.0))
        for sign, kind in ((1.0, "turn_left"), (-1.0, "turn_right"))
    ]


BENT = SpineTurn("mix", 5.0, 40.0, 0.2, 0.4, False)
BALANCED = Balance("rear_left", True, True, (1.2, 0.2, 0.0, 1.2), 0.0, -1.0, 5.0)


def test_a_good_run_passes(plan) -> None:
    assert complaints(good_walks(), turns(), BENT, BALANCED, 0.2, plan, NO_SLIP) == []


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"fell": True}, "trot: the mouse fell"),
        ({"speed_m_s": 0.02}, "trot: 0.020 m/s, at least 0.040 wanted"),
        ({"lateral_drift_m": -0.2}, "trot: -0.200 m beside its line"),
        ({"heading_error_deg": 30.0}, "trot: heading off by +30 deg"),
        ({"gait": "lateral_walk"}, "not every gait was walked"),
    ],
)
def test_a_bad_walk_is_named(plan, change: dict, complaint: str) -> None:
    values = {name: getattr(good_walks()[0], name) for name in Walk.__slots__}
    found = complaints([Walk(**{**values, **change}), good_walks()[1]], turns(), BENT, BALANCED, 0.2, plan, NO_SLIP)
    assert any(complaint in text for text in found), found


def test_turns_and_sitting_are_judged(plan) -> None:
    def found(turned: float = 40.0, bent: SpineTurn = BENT, balanced: Balance = BALANCED, lift: float = 0.2) -> str:
        return " ".join(complaints(good_walks(), turns(turned), bent, balanced, lift, plan, NO_SLIP))

    assert "turn left: 5 deg" in found(turned=5.0)
    assert "spine: 40 deg, spine servo at 0.05 rad" in found(bent=replace(BENT, spine_rad=0.05))
    assert "spine: 4 deg, spine servo at 0.40 rad" in found(bent=replace(BENT, turned_deg=4.0))
    assert "rear left lifted: its foot carried something for 40%" in found(
        balanced=replace(BALANCED, passed=False, loaded_share=0.4)
    )
    assert "sit: the nose rose by 0.6 deg" in found(lift=0.01)


def test_a_recording_without_ground_truth_is_no_verdict(tmp_path: Path) -> None:
    BagWriter(tmp_path / "walk").close()
    with pytest.raises(RecordingError, match="no topic control_command"):
        read_health(Recording(tmp_path / "walk"))
    with pytest.raises(RecordingError, match="no ground truth between"):
        track(1.0, 2.0, 0.1, 0.0, 0.0).between(100.0, 101.0)


def test_the_start_of_the_plan_is_known_though_its_first_commands_were_lost(plan) -> None:
    script, begin = file_script(CommandFile.model_validate(plan.command_file)), 5 * SECOND
    time = np.arange(0, round(plan.duration * SECOND), SECOND // 20)
    posture = np.array([command.posture if (command := script.control_at(int(t), 0)) else -1 for t in time])
    for lost in (0, 14):
        assert plan_start(begin + time[lost:], posture[lost:], plan) == begin
    with pytest.raises(RecordingError, match="no command to walk"):
        plan_start(time[:10], posture[:10], plan)
