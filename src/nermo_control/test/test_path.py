"""Paths: geometry against independent derivations, and what the high-level controller makes of them."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from nermo_control.gait.knowledge_base import GaitParameters
from nermo_control.high_level_controller import HighLevelController, HighLevelControllerConfig
from nermo_control.path import CycleMean, Path, PathFollower, PathStatus, Segment
from nermo_control.types import ControlCommand, Odometry, Posture, TrajectoryMode, TurningStrategy
from nermo_description.parameters import RobotParameters

ORIGIN = (0.0, 0.0, 0.0)
PERIOD = 5_000_000
SHOULDER = 0.0615
"""N table A.5 [m]."""
ALONG = ControlCommand(0, forward_velocity=0.08, trajectory_mode=TrajectoryMode.PATH)


@given(
    st.floats(-5.0, 5.0), st.floats(-5.0, 5.0), st.floats(-3.0, 3.0), st.floats(0.1, 2.0), st.sampled_from([-1, 1]),
    st.floats(0.1, 0.9), st.floats(-0.05, 0.05),
)  # fmt: skip
def test_a_point_beside_an_arc_is_located_where_it_was_put(
    x: float, y: float, yaw: float, radius: float, side: int, share: float, offset: float
) -> None:
    arc = Segment(x, y, yaw, 1.5 * radius, side / radius)
    px, py, heading = arc.pose(share * arc.length)
    distance, cross_track = arc.locate(px - math.sin(heading) * offset, py + math.cos(heading) * offset)
    assert distance == pytest.approx(share * arc.length, abs=1e-9)
    assert cross_track == pytest.approx(offset, abs=1e-9)
    assert math.dist((px, py), (x - side * radius * math.sin(yaw), y + side * radius * math.cos(yaw))) == pytest.approx(
        radius
    )


def test_a_polyline_runs_on_without_a_kink_and_meets_its_ends() -> None:
    points = [(0.0, 0.0), (1.0, 0.0), (1.0, 0.5), (0.2, 0.5), (0.2, 1.0)]
    path = Path.polyline(points, 0.2)
    for before, after in zip(path.segments, path.segments[1:], strict=False):
        assert before.pose(before.length)[:2] == pytest.approx((after.x, after.y))
        assert math.cos(before.pose(before.length)[2] - after.yaw) == pytest.approx(1.0)
    assert path.pose(0.0) == pytest.approx(ORIGIN)
    assert path.pose(path.length)[:2] == pytest.approx(points[-1])
    # Each right angle replaces two sides of 0.2 m by a quarter circle.
    assert path.length == pytest.approx(2.8 - 3 * (0.4 - 0.1 * math.pi))
    assert path.smallest_radius == pytest.approx(0.2)


@given(st.floats(-5.0, 5.0), st.floats(-5.0, 5.0), st.floats(-3.0, 3.0), st.floats(0.0, 1.5))
def test_a_path_that_is_placed_is_seen_alike_from_where_it_stands(x: float, y: float, yaw: float, way: float) -> None:
    path = Path.polyline([(0.0, 0.0), (1.0, 0.0), (1.0, 0.5), (0.2, 0.5)], 0.2)
    own, there = path.pose(way), path.placed((x, y, yaw)).pose(way)
    ahead, left = math.cos(yaw) * own[0] - math.sin(yaw) * own[1], math.sin(yaw) * own[0] + math.cos(yaw) * own[1]
    assert there == pytest.approx((x + ahead, y + left, yaw + own[2]), abs=1e-9)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Path([]),
        lambda: Path([Segment(0.0, math.nan, 0.0, 1.0)]),
        lambda: Path.line(ORIGIN, 0.0),
        lambda: Path.arc(ORIGIN, 0.0, 1.0),
        lambda: Path.arc(ORIGIN, 1.0, math.inf),
        lambda: Path.polyline([(0.0, 0.0)], 0.1),
        lambda: Path.polyline([(0.0, 0.0), (1.0, 0.0), (1.0, 0.3)], 0.5),
        lambda: Path.polyline([(0.0, 0.0), (1.0, 0.0), (0.0, 0.0)], 0.1),
    ],
)
def test_an_impossible_path_is_refused(make) -> None:
    with pytest.raises(ValueError, match=r"path|arc|polyline"):
        make()


def test_a_follower_on_a_path_that_touches_itself_keeps_its_place() -> None:
    path = Path.polyline([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.5, 1.0), (0.5, -0.5)], 0.1)
    follower = PathFollower(path)
    progress = [follower.step(path.pose(0.01 * step)).progress for step in range(int(100 * path.length))]
    assert progress == pytest.approx([0.01 * step for step in range(len(progress))], abs=1e-9)


def test_the_curvature_is_read_ahead() -> None:
    path = Path.polyline([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0)], 0.2)
    assert PathFollower(path, 0.1).step((0.69, 0.0, 0.0)).curvature == 0.0
    assert PathFollower(path, 0.1).step((0.71, 0.0, 0.0)).curvature == pytest.approx(5.0)


def test_what_swings_with_the_gait_drops_out_of_the_mean() -> None:
    mean, frequency = CycleMean(), 0.8
    for tick in range(1000):
        swing = math.sin(2.0 * math.pi * frequency * tick * PERIOD * 1e-9)
        first, second = mean.step(tick * PERIOD, 0.3 + swing, 1e-4 * tick, 1.0 / frequency)
        if tick * PERIOD * 1e-9 > 1.0 / frequency:
            assert first == pytest.approx(0.3, abs=1e-9)
            assert second == pytest.approx(1e-4 * (tick - 124.5), abs=1e-9)


def test_a_mean_over_no_time_is_the_value_itself() -> None:
    mean = CycleMean()
    assert [mean.step(tick * PERIOD, float(tick), -1.0, 0.0) for tick in range(3)] == [
        (0.0, -1.0),
        (1.0, -1.0),
        (2.0, -1.0),
    ]


# The high-level controller


class Unicycle:
    """A point on the shoulder axis that goes as the turning model says, but turns by a share less."""

    def __init__(self, controller: HighLevelController, radius: float, share: float = 1.0) -> None:
        self.controller, self._radius, self._share = controller, radius, share
        self.x, self.y, self.yaw, self.stamp = 0.0, 0.0, 0.0, 0

    def step(self, command: ControlCommand) -> Posture:
        base = Odometry(
            self.stamp, self.x - SHOULDER * math.cos(self.yaw), self.y - SHOULDER * math.sin(self.yaw), self.yaw
        )
        motion = self.controller.step(self.stamp, replace(command, stamp=self.stamp), base)
        self.stamp += PERIOD
        advance = motion.forward_velocity * PERIOD * 1e-9
        self.x += advance * math.cos(self.yaw)
        self.y += advance * math.sin(self.yaw)
        self.yaw += advance * self._share * motion.turn_rate_normalized / self._radius
        return motion.posture

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds * 1e9 / PERIOD)):
            if self.step(ALONG) is Posture.STILL:
                break


@pytest.fixture
def controller(robot: RobotParameters) -> HighLevelController:
    return HighLevelController(robot, GaitParameters())


@pytest.mark.parametrize("share", [0.8, 1.0, 1.2])
def test_an_arc_is_followed_to_its_end_though_the_mouse_turns_otherwise_than_predicted(
    controller: HighLevelController, share: float
) -> None:
    path = Path.arc(ORIGIN, 0.5, math.pi)
    controller.follow(path)
    mouse = Unicycle(controller, 0.1499, share)
    mouse.run(30.0)
    assert controller.path_status is PathStatus.FINISHED
    assert math.dist((mouse.x, mouse.y), path.pose(path.length)[:2]) < 0.01


def test_a_finished_path_leaves_the_mouse_standing(controller: HighLevelController) -> None:
    controller.follow(Path.line(ORIGIN, 0.1))
    mouse = Unicycle(controller, 0.15)
    mouse.run(10.0)
    assert [mouse.step(ALONG) for _ in range(5)] == [Posture.STILL] * 5
    assert mouse.x == pytest.approx(0.1, abs=2e-3)


@pytest.mark.parametrize(("strategy", "radius"), [("leg", 0.149), ("mix", 0.134), ("spine", 0.2)])
def test_a_path_tighter_than_the_smallest_radius_is_refused_in_words(
    controller: HighLevelController, strategy: TurningStrategy, radius: float
) -> None:
    controller.follow(Path.arc(ORIGIN, radius, 1.0))
    motion = controller.step(0, replace(ALONG, turning_strategy=strategy), Odometry(0, 0.0, 0.0, 0.0))
    assert (motion.posture, motion.forward_velocity) == (Posture.STILL, 0.0)
    assert controller.path_status is PathStatus.TOO_TIGHT
    assert "tighter" in controller.warnings[0]
    assert strategy in controller.warnings[0]


def test_a_mouse_that_cannot_turn_so_tightly_says_that_it_is_lost(robot: RobotParameters) -> None:
    controller = HighLevelController(robot, GaitParameters(), HighLevelControllerConfig(path_tolerance=0.05))
    controller.follow(Path.arc(ORIGIN, 0.2, math.pi))
    mouse = Unicycle(controller, 0.4)
    mouse.run(30.0)
    assert controller.path_status is PathStatus.LOST
    assert controller.cross_track == pytest.approx(-0.05, abs=1e-3)
    assert mouse.step(ALONG) is Posture.STILL


def test_without_a_path_the_mouse_stands_and_says_so(controller: HighLevelController) -> None:
    assert controller.step(0, ALONG, Odometry(0, 0.0, 0.0, 0.0)).posture is Posture.STILL
    assert "no path" in controller.warnings[0]


def test_a_new_path_is_taken_up_after_the_old_one(controller: HighLevelController) -> None:
    mouse = Unicycle(controller, 0.15)
    for end in (0.05, 0.1):
        controller.follow(Path.line((mouse.x, mouse.y, mouse.yaw), 0.05))
        mouse.run(5.0)
        assert controller.path_status is PathStatus.FINISHED
        assert mouse.x == pytest.approx(end, abs=2e-3)
