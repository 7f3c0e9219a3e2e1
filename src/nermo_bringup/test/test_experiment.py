"""What an experiment on the real mouse plans, keeps and measures, without a graph."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from nermo_bringup.experiment.cli import experiment_app
from nermo_bringup.experiment.command import row_of
from nermo_bringup.experiment.film import Filming, films_of, shot_of
from nermo_bringup.experiment.measure import Measured, Seen, measure, summary
from nermo_bringup.experiment.plan import PLAN_FILE, Plan, PlanFile, Run
from nermo_bringup.protocol.pilot import Pilot
from nermo_control.driver import Steering
from nermo_control.gait.knowledge_base import GaitParameters
from nermo_control.path import Path as ControlPath
from nermo_control.path import PathFollower
from nermo_control.types import ControlCommand, Odometry
from nermo_description.parameter_files import ParameterError
from nermo_description.results import CommandError
from nermo_description.robots import load_robot
from nermo_gap.protocol.scene import PieceRow, SceneFile
from nermo_gap.protocol.types import REST, Piece
from nermo_node.recording_reader import RecordingError
from nermo_sim.experiments import balance, maze
from nermo_sim.experiments.on_robot import RobotRequest, Way
from nermo_sim.experiments.registry import ON_ROBOT
from nermo_sim.experiments.runs import Settings
from nermo_sim.experiments.straight_line import measure as straight
from nermo_sim.experiments.straight_line_robot import OVER_TWIN, cases
from nermo_sim.experiments.turning_robot import RADIUS, arc
from nermo_track.camera import Camera, save_camera

LINE = ON_ROBOT["straight-line"]
MOUSE = load_robot("nermo_lite")
BEGUN = 1_700_000_000 * 10**9


def asked(folder: Path, **said: object) -> RobotRequest:
    usual = RobotRequest(
        name="straight-line",
        folder=folder,
        json=None,
        robot=None,
        seed=0,
        quick=False,
        repeats=None,
        workers=None,
        distance=None,
        target="sim",
        port="twin",
        calibration=None,
        dead_man=None,
        pad="xbox",
        yes=True,
        film=(),
        camera=(),
        tags=None,
        fps=None,
    )
    return replace(usual, **said)


def test_the_runs_are_those_of_the_thesis(tmp_path: Path) -> None:
    """Table 6.1, real world: 3 frequencies, trot without and with spine, lateral walk without; A.4.2: thrice."""
    plan = Plan.of(asked(tmp_path), LINE)
    assert plan.about.distance == 1.5
    assert len(plan.runs) == 27 and len(plan.cases) == 9
    assert {case.frequency_hz for case in cases()} == {0.5, 0.67, 0.8}
    assert not any(case.spine for case in cases() if case.gait == "lateral_walk")
    assert [run.name for run in plan.runs[:4]] == [
        "01_trot_0.5Hz_no_spine_1",
        "02_trot_0.5Hz_no_spine_2",
        "03_trot_0.5Hz_no_spine_3",
        "04_trot_0.67Hz_no_spine_1",
    ]
    walk = plan.segment(plan.runs[0]).pieces[-1]
    ((_, command),) = walk.commands
    assert command.forward_velocity == pytest.approx(0.06)  # f l_st / d = 0.5 Hz 0.06 m / 0.5
    assert walk.seconds > 1.5 / 0.06 / 0.83, "also N's slowest robot arrives"


def test_a_plan_goes_on_as_it_began(tmp_path: Path) -> None:
    Plan.of(asked(tmp_path, distance=0.8, repeats=2), LINE).save()
    again = Plan.of(asked(tmp_path, target=None), LINE)
    assert (again.about.distance, again.about.repeats) == (0.8, 2)
    with pytest.raises(CommandError, match=r"experiment.yaml: distance is 0.8, asked for is 1.0.*another --out") as no:
        Plan.of(asked(tmp_path, distance=1.0), LINE)
    assert no.value.status == 2
    (tmp_path / "robot" / PLAN_FILE).write_text("experiment: straight-line\nrobot: nermo_lite\ndistance: 90\n")
    with pytest.raises(ParameterError, match=r"experiment.yaml: distance: .*0.25 to 20.0 m"):
        Plan.of(asked(tmp_path), LINE)


def test_an_arc_is_of_one_length(tmp_path: Path) -> None:
    turning = ON_ROBOT["turning"]
    plan = Plan.of(asked(tmp_path, name="turning", quick=True), turning)
    assert plan.about.distance == pytest.approx(0.25 * math.pi)
    assert len(plan.cases) == 3 and plan.segment(plan.runs[0]).seconds > 22.0, "also N's slowest robot arrives"
    with pytest.raises(CommandError, match=r"--distance: is 1; turning is over 0.785 m always"):
        Plan.of(asked(tmp_path, name="turning", distance=1.0), turning)


def test_a_run_that_was_broken_off_is_missing_and_what_is_set_aside_stays(tmp_path: Path) -> None:
    plan = Plan(PlanFile(experiment="straight-line", robot="nermo_lite", distance=0.5, repeats=1), LINE, tmp_path)
    run = plan.runs[0]
    folder = tmp_path / run.name
    for times in (1, 2):
        (folder / "recording").mkdir(parents=True)
        assert plan.recorded(run) is None, "a crash leaves no scene"
        (folder / "scene.yaml").write_text(scene(("clock",)).model_dump_json())
        assert plan.recorded(run) is None, "it did not walk"
        plan.set_aside(run)
        assert not folder.exists()
        assert len(list((tmp_path / "set_aside").glob(f"{run.name}_*/scene.yaml"))) == times
    (folder / "recording").mkdir(parents=True)
    (folder / "scene.yaml").write_text(scene(("clock", "walk")).model_dump_json())
    assert plan.recorded(run) == scene(("clock", "walk"))


def scene(names: tuple[str, ...], seconds: float = 6.0) -> SceneFile:
    pieces = tuple(PieceRow(name=name, begin=7.0 * k, end=7.0 * k + seconds) for k, name in enumerate(names))
    return SceneFile(
        protocol="straight-line", segment="01", robot="nermo_lite", scene="floor", begun=BEGUN, pieces=pieces
    )


def walked(speed: float, heading: float, deviation: float, fps: float = 30.0) -> Seen:
    """A mouse that stands until it is told to walk, and then goes straight on at once."""
    begin = 7.0 + REST
    time = np.arange(0.0, 13.0, 1.0 / fps)
    along = speed * np.maximum(time - begin, 0.0)
    place = np.column_stack([along * math.cos(heading), along * math.sin(heading), np.full(len(time), 0.045)])
    spread = np.tile(deviation**2 * np.eye(6), (len(time), 1, 1))
    stamp = BEGUN + np.round(time * 1e9).astype(np.int64)
    return Seen("tracker/odom", stamp, place, Rotation.from_euler("z", np.full((len(time), 1), heading)), spread)


def speed_of(way: Way) -> dict[str, float]:
    """As the straight line has it, with its end line at 0.2 m."""
    return straight(way.until(0.2), 0.67)


@settings(deadline=None, max_examples=25)
@given(st.floats(0.04, 0.12), st.floats(-3.0, 3.0), st.floats(1e-5, 1e-4))
def test_a_speed_is_as_uncertain_as_the_poses_at_both_ends(speed: float, heading: float, deviation: float) -> None:
    found = measure(walked(speed, heading, deviation), scene(("clock", "walk")), 6.0, speed_of)
    assert found.result["speed_m_s"] == pytest.approx(speed, rel=1e-6)
    assert found.result["lateral_drift_m"] == pytest.approx(0.0, abs=1e-9)
    # The end line is crossed with the noise too, where it is, within a picture.
    said = math.sqrt(2.0) * deviation / found.result["duration_s"]
    assert found.tracker["speed_m_s"] == pytest.approx(said, rel=0.35)


def test_a_clock_that_is_not_known_is_a_time_that_is_not_known() -> None:
    seen = walked(0.06, 0.0, 0.0)
    found = measure(seen, scene(("clock", "walk")), 6.0, speed_of, clock=0.05)
    assert found.tracker["speed_m_s"] == pytest.approx(0.06 * 0.05 / found.result["duration_s"], rel=0.3)
    assert measure(seen, scene(("clock", "walk")), 6.0, speed_of).tracker == {}, "nobody tells an error"


def test_the_stand_at_a_piece_s_end_is_no_walk() -> None:
    """One that ends by itself stands for `REST`; whoever lets go ends the walk there."""
    seen = walked(0.02, 0.0, 0.0)
    by_itself = measure(seen, scene(("clock", "walk")), 6.0, speed_of).result["duration_s"]
    let_go = measure(seen, scene(("clock", "walk"), 4.0), 6.0, speed_of).result["duration_s"]
    assert by_itself == pytest.approx(6.0 - 2.0 * REST, abs=0.04)
    assert let_go == pytest.approx(4.0 - REST, abs=0.04)


def test_who_was_not_seen_before_the_walk_is_refused() -> None:
    seen = walked(0.06, 0.0, 0.0)
    late = seen.stamp > BEGUN + 8 * 10**9
    part = replace(seen, stamp=seen.stamp[late], position=seen.position[late], rotation=seen.rotation[late])
    with pytest.raises(RecordingError, match="film from before it moves"):
        measure(part, scene(("clock", "walk")), 6.0, speed_of)


@settings(deadline=None, max_examples=25)
@given(st.floats(0.3, 1.2), st.floats(0.04, 0.1), st.floats(-3.0, 3.0))
def test_an_arc_is_followed_by_who_goes_round_its_middle(radius: float, speed: float, heading: float) -> None:
    quarter = 0.5 * math.pi
    time = np.arange(0.0, 2.0 * RADIUS * quarter / speed, 1.0 / 30.0)
    yaw = heading + speed / radius * time
    ahead = np.column_stack([np.cos(yaw), np.sin(yaw)])
    left = np.column_stack([-np.sin(yaw), np.cos(yaw)])
    shoulders = radius * (left[0] - left)
    place = np.column_stack([shoulders - MOUSE.hip_positions[0][0] * ahead, np.full(len(time), 0.045)])
    way = Way(time, place, np.column_stack([0.0 * yaw, 0.0 * yaw, yaw]))
    found = arc(way, 0.67, quarter, MOUSE)
    assert found["radius_m"] == pytest.approx(radius, rel=0.02)
    if abs(radius - RADIUS) < 0.03:
        assert found["followed"] and found["time_s"] == pytest.approx(RADIUS * quarter / speed, rel=0.1)
    if radius > 0.75:
        assert not found["followed"]


def test_lifts_are_the_twin_s_own_servo_angles_after_the_rest(tmp_path: Path) -> None:
    """Table 6.5 and A.4.2: each leg without and with compensation, thrice; knee and hip as in process."""
    plan = Plan.of(asked(tmp_path, name="balance"), ON_ROBOT["balance"])
    assert plan.about.distance is None and len(plan.runs) == 24
    played = plan.segment(plan.runs[0]).pieces[-1]
    case = plan.runs[0].case
    angles = list(balance.servo_angles(case, MOUSE, GaitParameters(), 5_000_000))
    for at in (0.0, 1.2, 2.8, 4.0):
        expected = angles[round(at / 0.005)]
        assert played.targets(REST + at + 0.001, MOUSE) == pytest.approx(dict(zip(MOUSE.servos, expected, strict=True)))
    assert played.targets(0.5 * REST, MOUSE) == {name: servo.neutral for name, servo in MOUSE.servos.items()}
    with pytest.raises(CommandError, match="--distance: is 1; balance has no distance"):
        Plan.of(asked(tmp_path, name="balance", distance=1.0), ON_ROBOT["balance"])


def lifted(degrees: float, seconds: float, begin: float = 1.6) -> Way:
    """A body that rolls to the left from a moment [s] on, about its right feet, seen with 1 mm of noise."""
    time = np.arange(0.0, seconds, 1.0 / 30.0)
    roll = np.radians(np.where(time >= begin, -degrees, 0.0))
    half = abs(MOUSE.hip_positions[0][1])
    place = np.column_stack([0.0 * time, 0.0 * time, 0.05 + half * np.sin(roll)])
    place += np.random.default_rng(0).normal(0.0, 1e-3, place.shape)
    return Way(time, place, np.column_stack([roll, 0.0 * roll, 0.0 * roll]))


def test_a_body_that_comes_down_on_the_lifted_leg_has_tipped() -> None:
    """The corner above it must not sink; the one across may rise."""
    left, right = (balance.Case(leg, False) for leg in ("rear_left", "rear_right"))
    lift, upright = ON_ROBOT["balance"], Settings()
    for way, stands in ((lifted(0.0, 4.6), True), (lifted(0.5, 4.6), True), (lifted(12.0, 4.6), False)):
        found = lift.measure(left, way, upright)
        assert (found["passed"], found["reached"]) == (stands, True)
        assert found["up_s"] == pytest.approx(3.6 if stands else 0.6, abs=0.05)
    assert lift.measure(right, lifted(12.0, 4.6), upright)["passed"], "that leg's corner goes up"
    early = lift.measure(left, lifted(0.0, 3.0), upright)
    assert not early["passed"] and not early["reached"] and early["tipped"] is False, "nobody saw the sweep"
    assert lift.measure(left, lifted(0.0, 1.5), upright)["up_s"] is None


def maze_walk(lanes: int, speed: float, beside: float, heading: float) -> Way:
    """Shoulders on a line at a distance [m] left of the path through the maze, which lies along a heading [rad]."""
    path = maze.maze_path((0.0, 0.0, 0.0), lanes).placed((0.3, -0.2, heading))
    poses = [path.pose(speed * t) for t in np.arange(0.0, 1.05 * path.length / speed, 1.0 / 30.0)]
    off = beside * np.minimum(np.arange(len(poses)) / 300.0, 1.0)
    x, y, yaw = np.array(poses).T
    x, y = x - off * np.sin(yaw), y + off * np.cos(yaw)
    ahead = MOUSE.hip_positions[0][0]
    place = np.column_stack([x - ahead * np.cos(yaw), y - ahead * np.sin(yaw), np.full(len(x), 0.045)])
    return Way(np.arange(len(x)) / 30.0, place, np.column_stack([0.0 * yaw, 0.0 * yaw, np.unwrap(yaw)]))


@settings(deadline=None, max_examples=15)
@given(st.floats(0.05, 0.1), st.floats(-0.3, 0.12), st.floats(-3.0, 3.0))
def test_a_maze_is_finished_by_who_stays_in_its_lanes(speed: float, beside: float, heading: float) -> None:
    case = maze.Case(True, 2)
    found = ON_ROBOT["maze"].measure(case, maze_walk(2, speed, beside, heading), Settings())
    length = maze.maze_path((0.0, 0.0, 0.0), 2).length
    assert found["reached"] and found["cross_track_m"] == pytest.approx(abs(beside), abs=0.01)
    assert found["time_s"] == pytest.approx(length / speed, rel=0.01)
    assert found["speed_m_s"] * found["time_s"] == pytest.approx(length)
    if abs(abs(beside) - maze.CORNER_RADIUS) > 0.01:
        assert found["finished"] == (abs(beside) < maze.CORNER_RADIUS)


def test_a_maze_of_which_the_end_is_not_seen_has_no_time() -> None:
    way = maze_walk(2, 0.08, 0.0, 0.0)
    half = Way(way.time[:400], way.position[:400], way.roll_pitch_yaw[:400])
    found = ON_ROBOT["maze"].measure(maze.Case(False, 2), half, Settings())
    assert found["time_s"] is None and not found["reached"] and not found["finished"]


def test_the_robot_s_maze_is_smaller_and_steered(tmp_path: Path) -> None:
    plan = Plan.of(asked(tmp_path, name="maze"), ON_ROBOT["maze"])
    assert len(plan.runs) == 6 and plan.segment(plan.runs[0]).steered
    own, twin = (plan.segment(plan.runs[0]).pieces[-1].steering, maze.maze_path((0.0, 0.0, 0.0)))
    assert own is not None and own.path.length < twin.length
    curvatures = {segment.curvature for segment in own.path.segments}
    assert min(curvatures) < 0.0 < max(curvatures), "bends to both sides"
    assert "180 deg to the left about 0.2 m" in plan.segment(plan.runs[0]).tell
    claims = plan.on_robot.claims(
        [{"spine": spine, "finished": True, "time_s": 100.0 - 32.0 * spine} for spine in (False, True)]
    )
    assert [(claim["ratio"], claim["kind"]) for claim in claims] == [(pytest.approx(1.0), "robot")]
    assert plan.on_robot.claims([{"spine": False, "finished": True, "time_s": 9.0}]) == []


def test_nobody_plays_a_maze_whom_nobody_steers(tmp_path: Path) -> None:
    words = ["maze", "--target", "serial", "--port", "nowhere", "--dead-man", "none", "--out", str(tmp_path)]
    told = CliRunner().invoke(experiment_app, words)
    assert isinstance(told.exception, CommandError) and told.exception.status == 2
    assert "somebody has to steer a real mouse" in str(told.exception)


def test_a_pilot_leads_a_mouse_along_the_path_from_where_it_stands_and_lets_go_at_its_end() -> None:
    """A point that turns as it is told, at once, and is no slower for it: as with the spine alone."""
    path, speed = ControlPath.polyline([(0.0, 0.0), (1.0, 0.0), (1.0, 1.5)], 0.6), 0.08
    said = ControlCommand(0, forward_velocity=speed, gait="trot", gait_frequency=0.67, turning_strategy="spine")
    piece = Piece("walk", "walk", 90.0, commands=((0.0, said),), steering=Steering(path, speed / 0.15))
    pilot = Pilot(MOUSE)
    assert pilot.steer(None, None) == 0.0
    ahead, step = MOUSE.hip_positions[0][0], 0.02
    x, y, yaw, stamp, far = 1.0, -2.0, 0.6, 0, 0.0
    follower = PathFollower(path.placed((x + ahead * math.cos(yaw), y + ahead * math.sin(yaw), yaw)))
    while (turn := pilot.steer(piece, Odometry(stamp, x, y, yaw))) is not None:
        assert -1.0 <= turn <= 1.0 and stamp < 60 * 10**9
        yaw += turn * speed / 0.15 * step
        x, y, stamp = x + speed * step * math.cos(yaw), y + speed * step * math.sin(yaw), stamp + round(step * 1e9)
        seen = follower.step((x + ahead * math.cos(yaw), y + ahead * math.sin(yaw), yaw))
        far = max(far, abs(seen.cross_track))
    assert seen.progress >= path.length and far < 0.05


def test_scatter_and_tracker_are_said_apart() -> None:
    runs = [Measured({"speed_m_s": v}, {"speed_m_s": 0.001}, "tracker/odom", 0.0) for v in (0.06, 0.07, 0.08)]
    row = summary(runs, ("speed_m_s",))
    assert row["speed_m_s"] == pytest.approx(0.07)
    assert row["scatter_speed_m_s"] == pytest.approx(0.01), "of a sample"
    assert row["tracker_speed_m_s"] == pytest.approx(0.001), "the camera's place does not average out"
    assert summary([], ("speed_m_s",)) == dict.fromkeys(("speed_m_s", "scatter_speed_m_s", "tracker_speed_m_s"))


def test_what_the_thesis_says_of_its_robot_holds_of_its_robot() -> None:
    """Nine speeds that agree with all that N prints: 0.067 and 0.077 m/s, 11 %, and how far behind the twin."""
    speeds = {("trot", False): 0.067, ("trot", True): 0.077, ("lateral_walk", False): 0.067 / 1.11}
    rows = []
    for case in cases():
        speed = speeds[case.gait, case.spine]
        twin = speed / OVER_TWIN[case.gait, case.spine]
        rows.append({**LINE.describe(case), "speed_m_s": speed, "twin_speed_m_s": twin})
    claims = LINE.claims(rows)
    assert len(claims) == 7
    assert all(claim["within"] and claim["kind"] == "robot" for claim in claims)
    assert [claim["ratio"] for claim in claims[-3:]] == pytest.approx([1.0] * 3)


@pytest.mark.parametrize("name", sorted(ON_ROBOT))
def test_a_row_without_a_run_is_drawn_and_told_too(tmp_path: Path, name: str) -> None:
    plan = Plan.of(asked(tmp_path), ON_ROBOT[name])
    twin = dict.fromkeys((*plan.on_robot.measured, *plan.on_robot.every), 0.1)
    seen = Measured({**twin, **dict.fromkeys(plan.on_robot.every, True)}, {}, "tracker/odom", 0.0)
    first = plan.on_robot.measured[0]
    for found in ([], [seen], [seen, seen]):
        rows = [row_of(plan, case, found, [twin, twin]) for case in plan.cases]
        assert rows[0]["runs"] == len(found)
        assert rows[0]["robot_over_twin"] == (pytest.approx(1.0) if found else None)
        assert (rows[0][f"scatter_{first}"] is not None) == (len(found) > 1)
        plan.on_robot.picture(rows, tmp_path / f"{len(found)}.png")
        assert (tmp_path / f"{len(found)}.png").stat().st_size > 0


def test_films_belong_to_the_run_whose_number_begins_their_name(tmp_path: Path) -> None:
    runs = [Run(number, cases()[0], number, f"{number:02d}_trot_{number}") for number in (1, 2, 10)]
    names = ("01.mp4", "1_left.MOV", "10_trot_10.avi", "100.mp4", "left.mp4", "02.txt")
    for name in names:
        (tmp_path / name).touch()
    found, strange = films_of([tmp_path], runs)
    assert {number: [film.name for film in films] for number, films in found.items()} == {
        1: ["01.mp4", "1_left.MOV"],
        10: ["10_trot_10.avi"],
    }
    assert [film.name for film in strange] == ["100.mp4", "left.mp4"]
    with pytest.raises(CommandError, match=r"left.mp4 does not begin with the number of a run, 01 to 10"):
        films_of([tmp_path / "left.mp4"], runs)


def test_of_several_cameras_a_film_names_its_own(tmp_path: Path) -> None:
    cameras = [tmp_path / "left.yaml", tmp_path / "right.yaml"]
    for width, path in enumerate(cameras, 640):
        save_camera(Camera(width=width, height=480, fx=600.0, fy=600.0, cx=320.0, cy=240.0), path)
    filming = Filming([], cameras, None, 60.0)
    assert [shot_of(Path(f"01_{side}.mp4"), filming).camera.width for side in ("left", "right")] == [640, 641]
    with pytest.raises(CommandError, match=r"01.mp4: of several cameras its name must end in one of _left, _right"):
        shot_of(Path("01.mp4"), filming)
    assert shot_of(Path("01.mp4"), Filming([], cameras[:1], None, None)).camera.width == 640
    with pytest.raises(CommandError, match="--film needs --camera"):
        shot_of(Path("01.mp4"), Filming([], [], None, None))


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--film", "nowhere.mp4", "--camera", "c.yaml"], "nothing was recorded there; record with --target"),
        (["--camera", "c.yaml"], "--camera goes with --target or --film"),
        (["--dead-man", "pad"], "--dead-man goes with --target or --film"),
        (["--target", "serial", "--port", "/dev/null"], "this needs a terminal as its input"),
    ],
)
def test_what_cannot_be_done_is_said_before_anything_is_written(
    tmp_path: Path, words: list[str], sentence: str
) -> None:
    told = CliRunner().invoke(experiment_app, ["straight-line", "--out", str(tmp_path), *words])
    assert isinstance(told.exception, CommandError) and told.exception.status == 2
    assert sentence in str(told.exception)
    assert not list(tmp_path.iterdir())
