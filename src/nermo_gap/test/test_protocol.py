"""The experiment protocol: what it asks of a mouse, its recordings, the stand, and where a diagnosis looks."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray
from typer.testing import CliRunner

from nermo_description.markers import MARKERS
from nermo_description.model import build_model
from nermo_description.parameter_files import write_yaml
from nermo_description.parameters import LEGS
from nermo_description.robots import load_robot
from nermo_description.stand import Stand
from nermo_gap.cli import gap_app
from nermo_gap.protocol.detectable import channels_of, detectable
from nermo_gap.protocol.looks import LENGTH, looker
from nermo_gap.protocol.play import Body, play
from nermo_gap.protocol.record import record
from nermo_gap.protocol.recorded import read
from nermo_gap.protocol.scene import SCENE_FILE, scene_of, segments
from nermo_gap.protocol.standard import PROTOCOLS, clock, protocol_of, standard
from nermo_gap.protocol.types import REST, Piece, Protocol, Segment, Wave
from nermo_gap.robots.channels import TRACKER, command, marker
from nermo_gap.robots.diagnosis import placed, robot_plant
from nermo_gap.robots.simulated import Noise
from nermo_gap.robots.sites import nuisances, worth_a_look
from nermo_sim.twin import Twin
from simgap.data.align import align
from simgap.data.errors import GapInputError
from simgap.data.recording import concatenate, recording_from_table
from simgap.effects.sensor import SensorBias, sensor_sites
from simgap.simulation.replay import Replayer
from simgap.simulation.variant import Variant

Array = NDArray[np.float64]
QUIET = Noise(0.0, 0.0, 0.0, 0.0, 0.0)


def short(robot: str) -> Protocol:
    """A hung and a standing piece and two more, a few seconds in all."""
    spine = Piece("spine", "bend it", 3.0, (Wave("spine_lateral", 0.3, 0.8),), looks=(0.5, 1.2))
    knees = tuple(Wave(f"{leg}_knee", -0.2, 1.0, one_way=True) for leg in LEGS)
    squat = Piece("squat", "squat", 3.0, knees, looks=(0.6,))
    sway = Piece("sway", "sway", 3.0, tuple(Wave(f"{leg}_hip", 0.15, 1.0) for leg in LEGS), looks=(0.6,))
    return Protocol(
        "short",
        (Segment("hung", "hung", "hang it up", (spine,)), Segment("standing", "floor", "set it", (squat, sway))),
    )


@cache
def played(name: str) -> tuple[dict[str, Array], dict[str, Array]]:
    robot = load_robot(name)
    stand, body = Stand(), Body(robot, lambda: build_model(robot), noise=QUIET)
    rest, random = stand.rest(build_model(robot)), np.random.default_rng(0)
    hung, standing = (play(s, body, stand, rest, random)[0] for s in short(name).segments)
    return hung, standing


@pytest.mark.parametrize("name", ["nermo", "nermo_lite"])
@pytest.mark.parametrize("protocol", sorted(PROTOCOLS))
def test_every_protocol_keeps_to_the_servos_of_a_mouse_and_rests_between_pieces(name: str, protocol: str) -> None:
    robot = load_robot(name)
    asked = PROTOCOLS[protocol](robot)
    assert 50.0 < asked.seconds < 120.0
    neutral = {s: servo.neutral for s, servo in robot.servos.items()}
    for piece in (piece for segment in asked.segments for piece in segment.pieces):
        assert {wave.servo for wave in piece.waves} <= set(robot.servos)
        assert piece.targets(0.0, robot) == piece.targets(piece.seconds - 0.5 * REST, robot) == neutral
        for look in piece.looks:
            assert look + LENGTH < piece.seconds
        for t in np.arange(0.0, piece.seconds, 0.1):
            for servo, angle in piece.targets(float(t), robot).items():
                assert robot.servos[servo].lower <= angle <= robot.servos[servo].upper


def test_a_mouse_whose_servos_say_nothing_hangs_for_its_spine_alone() -> None:
    names = {n: [p.name for p in standard(load_robot(n)).segments[0].pieces] for n in ("nermo", "nermo_lite")}
    assert names["nermo_lite"] == ["hang", "spine", "spine back"] and {"hips slowly", "spine"} < set(names["nermo"])
    seen = standard(load_robot("nermo_lite"), markers=True).segments[0].pieces
    assert [p.name for p in seen] == names["nermo"], "with markers at its feet each leg is seen"


@pytest.mark.parametrize("name", sorted(PROTOCOLS))
def test_a_walk_that_is_filmed_begins_with_what_tells_the_clock(name: str) -> None:
    robot = load_robot("nermo_lite")
    plain, filmed = (protocol_of(name, robot, filmed=f).segments for f in (False, True))
    assert [s.name for s in plain] == [s.name for s in filmed]
    for one, other in zip(plain, filmed, strict=True):
        added = [clock()] if one.name == "walking" else []
        assert [*other.pieces] == [*added, *one.pieces]


def test_markers_are_where_they_are_glued_and_are_not_always_seen() -> None:
    robot, glued = load_robot("nermo_lite"), np.zeros((len(MARKERS), 3))
    glued[:, 0] = 0.001
    still = Segment("still", "floor", "stand", (Piece("still", "stand still", 4.0),))
    table = {}
    for off in (0.0, 1.0):
        body = Body(robot, lambda: build_model(robot), noise=replace(QUIET, hidden=0.2), markers=off * glued)
        table[off], _ = play(still, body, Stand(), np.zeros(7), np.random.default_rng(1))
    hidden = [np.isnan(table[0.0][marker(place)[0]]).mean() for place in MARKERS]
    assert 0.05 < np.mean(hidden) < 0.4
    for place in MARKERS:
        seen, shifted = (np.array([table[off][c] for c in marker(place)]).T for off in (0.0, 1.0))
        assert (np.isnan(seen).all(axis=1) == np.isnan(seen).any(axis=1)).all(), "all of a marker is hidden"
        away = np.linalg.norm(shifted - seen, axis=1)
        np.testing.assert_allclose(away[np.isfinite(away)], 0.001, rtol=1e-6)
    foot = np.nanmean(table[0.0][marker("front_left_foot")[2]])
    assert 0.0 < foot < 0.01 < np.nanmean(table[0.0][marker("rear_torso")[2]]), "feet are on the floor"
    plain, _ = play(still, Body.twin(robot), Stand(), np.zeros(7), np.random.default_rng(1))
    assert not any(name.startswith("marker_") for name in plain)


def test_each_leg_has_numbers_of_its_own_and_each_marker_too() -> None:
    robot, told = load_robot("nermo_lite"), [command(s) for s in load_robot("nermo_lite").servos]
    names = {}
    for markers in (False, True):
        columns = [*told, *TRACKER, *(c for place in MARKERS for c in marker(place) if markers)]
        plant = robot_plant(robot, columns)
        sizes = np.ones(len(plant.outputs)), np.ones(len(plant.inputs))
        names[markers] = {n.name for n in nuisances(plant, *sizes, 0.005)}
        assert not [s for s in sensor_sites(plant) if worth_a_look(plant)(SensorBias(s, ()))]
    own = {"gain front_left_knee", "stiffness rear_right_ankle_joint", "friction front_right_foot"}
    assert own < names[False] and names[False] < names[True]
    assert {"marker front_left_foot x", "marker rear_right_foot z"} < names[True] - names[False]


def test_a_wave_swells_dies_down_and_stays_on_its_side() -> None:
    t = np.arange(-0.5, 5.0, 0.01)
    both = np.array([Wave("x", 0.3, 1.0, 3.0).value(s, 4.0) for s in t])
    one = np.array([Wave("x", -0.3, 1.0, one_way=True).value(s, 4.0) for s in t])
    step = np.array([Wave("x", 0.3, shape="steps", begin=1.0, end=2.0).value(s, 4.0) for s in t])
    assert np.abs(np.diff(both)).max() < 0.1 and both.min() < -0.28 and both.max() > 0.28
    assert (one <= 0.0).all() and one.min() < -0.29
    assert set(np.round(step, 3)) == {0.0, 0.3, -0.3}
    for wave in (both, one, step):
        assert not wave[(t <= 0.0) | (t >= 4.0)].any()


@pytest.mark.parametrize("name", ["nermo", "nermo_lite"])
def test_a_hung_mouse_is_level_at_its_height_touches_nothing_and_hangs_lower_when_it_is_heavier(name: str) -> None:
    robot = load_robot(name)
    stand, nominal = Stand(), build_model(robot)
    rest = stand.rest(nominal)
    places = []
    for more in (0.0, 0.02):
        model = build_model(robot)
        model.body_mass[model.body("torso").id] += more
        stand.enter(model, rest)
        twin = Twin(robot, model=model)
        root = twin.layout.root_position
        twin.data.qpos[root : root + 7] = stand.pose()
        mujoco.mj_forward(twin.model, twin.data)
        for _ in range(800):
            twin.step([servo.neutral for servo in robot.servos.values()])
        assert not any(twin.foot_forces()[1]) and twin.tilt() < 0.02
        places.append(float(twin.data.qpos[root + 2]))
    assert places[0] == pytest.approx(stand.height, abs=2e-3)
    assert places[0] - places[1] == pytest.approx(0.02 * 9.81 / stand.stiffness, rel=0.1)


@pytest.mark.parametrize("name", ["nermo", "nermo_lite"])
def test_a_hung_spine_moves_the_torso_and_standing_lets_the_feet_bear(name: str) -> None:
    hung, standing = played(name)
    assert np.ptp(hung["base_y"]) > 1e-3
    assert abs(hung["base_z"].mean() - Stand().height) < 0.005 and standing["base_z"].mean() < 0.06
    assert list(np.unique(standing["run"])) == [0.0, 1.0]
    assert np.ptp(standing[command("front_left_knee")]) == pytest.approx(0.2, abs=0.01)


def test_recordings_say_their_scene_and_are_replayed_in_it(tmp_path: Path) -> None:
    robot = load_robot("nermo_lite")
    body = Body(robot, lambda: build_model(robot), noise=Noise())
    folders = record(short("nermo_lite"), body, tmp_path / "made", 0)
    assert segments(tmp_path / "made") == folders
    scenes = [scene_of(folder) for folder in folders]
    assert [s.scene for s in scenes if s] == ["hung", "floor"]
    made = read(folders, scenes, robot)
    assert list(made.looks) == [0.0, 1.0, 2.0] and len(made.looks[0.0]) == 2
    plant = robot_plant(robot, list(made.tables[0]))
    plant, recordings = placed(plant, made.tables, made.stands, ["hung", "standing"])
    aligned = align(concatenate(recordings), plant)
    assert [run.setup for run in aligned.runs] == [1, 0, 0]
    windows = looker(made.looks, 0.15)(aligned)
    assert len(windows) == 4 and windows.folds == 3
    floor = np.array([2e-4] * 3 + [1e-3] * 4)
    found = Replayer(plant, aligned, windows, floor, 1).run([Variant.nominal(plant)])[0]
    away = np.sqrt((((aligned.outputs[windows.rows()] - found) / floor) ** 2).mean(axis=(1, 2)))
    # Without the stand the mouse would have fallen by a metre and a quarter. The replay's tail is stiff, the twin's is
    # not, and a hung torso feels it swing.
    assert (away[:2] < 7.0).all() and (away[2:] < 1.3).all()


def test_a_protocol_that_was_cut_short_is_refused_where_too_little_is_left() -> None:
    robot = load_robot("nermo_lite")
    columns = played("nermo_lite")[1]
    plant = robot_plant(robot, list(columns))
    aligned = align(recording_from_table(columns, plant), plant)
    with pytest.raises(GapInputError, match="record it anew"):
        looker({0.0: (0.6,), 1.0: (0.6,)}, 0.15)(aligned)


def test_where_nothing_was_measured_there_is_nothing_to_look_at() -> None:
    """As where a filmed mouse has walked out of the picture."""
    robot = load_robot("nermo_lite")
    columns = played("nermo_lite")[1]
    run = np.floor(np.arange(len(columns["t"])) / len(columns["t"]) * 4.0)
    plant = robot_plant(robot, list(columns))
    aligned = align(recording_from_table(columns | {"run": run}, plant), plant)
    looks = dict.fromkeys((0.0, 1.0, 2.0, 3.0), (0.6,))
    seen = looker(looks, 0.15)(aligned)
    gone = aligned.runs[2]
    aligned.valid[gone.start : gone.stop] = False
    left = looker(looks, 0.15)(aligned)
    assert len(seen) == 4 and len(left) == 3
    assert not ((left.start >= gone.start) & (left.start < gone.stop)).any()


def test_record_is_a_command(tmp_path: Path) -> None:
    run = CliRunner().invoke(gap_app, ["record", "--protocol", "walk", "--out", str(tmp_path / "walk")])
    assert run.exit_code == 0 and "next: nermo gap diagnose" in run.output
    table = np.load(tmp_path / "walk" / "1_walking" / "recording.npz")
    assert {*TRACKER, "run", "t"} <= set(table)
    again = CliRunner().invoke(gap_app, ["record", "--out", str(tmp_path / "walk")])
    assert again.exit_code == 2 and "holds something already" in again.output
    unknown = CliRunner().invoke(gap_app, ["record", "--protocol", "dance", "--out", str(tmp_path / "new")])
    assert unknown.exit_code == 2 and "standard, walk" in unknown.output


def test_a_scene_that_cannot_be_read_is_said(tmp_path: Path) -> None:
    write_yaml({"protocol": "standard", "segment": "hung", "robot": "nermo", "scene": "pool"}, tmp_path / SCENE_FILE)
    with pytest.raises(GapInputError, match=r"scene\.yaml: scene"):
        scene_of(tmp_path)


def test_a_protocol_shows_a_spine_and_feet_and_says_where() -> None:
    robot = load_robot("nermo_lite")
    rows = {(r.found.effect, r.found.site): r for r in detectable(robot, short("nermo_lite"), channels_of("", robot))}
    slack, rough = rows["tendon_slack", "spine_left"], rows["com_shift", "torso"]
    assert slack.found.smallest is not None and slack.piece == "hung: spine"
    assert slack.found.rival == "tendon_detached@spine_left", "a swing alone does not tell how slack the cable is"
    assert rough.found.smallest is not None and rough.piece.startswith(("hung", "standing")), "no walk is needed for it"
    assert not any("tail" in site for _, site in rows)
    with pytest.raises(GapInputError, match="choose from servos, knees, gyro, tracker, markers"):
        channels_of("nose", robot)
