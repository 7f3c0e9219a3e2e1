"""The mouse under diagnosis: its channels, recordings, sites, phases, robot files, and a small diagnosis."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pytest
import yaml
from mouse_mcap import write_mcap
from numpy.typing import NDArray
from typer.testing import CliRunner

from nermo_description.model import build_model
from nermo_description.robots import load_robot
from nermo_gap.cli import gap_app
from nermo_gap.robots.channels import GYRO, TRACKER, command, encoder, marker, position, resolution
from nermo_gap.robots.diagnosis import REPORTING_HORIZON, REPORTING_WARM_UP, diagnose_recordings, robot_plant
from nermo_gap.robots.live import LiveGap
from nermo_gap.robots.mcap_table import mcap_table
from nermo_gap.robots.menu import MouseMenu
from nermo_gap.robots.model import diagnosis_spec
from nermo_gap.robots.phases import gait_phases
from nermo_gap.robots.simulated import simulate
from nermo_gap.robots.sites import groups, nuisances, worth_a_look
from nermo_sim.twin import Twin
from simgap.analysis.diagnose import write_report
from simgap.analysis.options import Options
from simgap.data.align import align
from simgap.data.errors import GapInputError
from simgap.data.mapping import parse_map
from simgap.data.noise_floor import noise_floor
from simgap.data.plant import build_plant
from simgap.data.recording import load_recording, recording_from_table
from simgap.effects.base import Context
from simgap.effects.library import enumerate_effects
from simgap.inference.fit import Fitter
from simgap.inference.hypothesis import Fit, Hypothesis
from simgap.inference.residual import Residuals, channel_gap
from simgap.report.evidence import gather
from simgap.report.html import write_page
from simgap.simulation.replay import Replayer
from simgap.simulation.scales import measure_scales
from simgap.simulation.variant import Variant
from simgap.simulation.windows import cut

Array = NDArray[np.float64]
SECONDS = 6.0


@cache
def table(name: str) -> dict[str, Array]:
    return simulate(load_robot(name), SECONDS, seed=1)


@pytest.mark.parametrize(("name", "sees"), [("nermo", 10 * 2 + 4 + 3 + 7), ("nermo_lite", 7)])
def test_each_mouse_measures_what_it_really_can(name: str, sees: int) -> None:
    plant = robot_plant(load_robot(name), list(table(name)))
    assert len(plant.outputs) == sees
    assert len(plant.inputs) == len(load_robot(name).servos) and not plant.warnings
    assert {o.name for o in plant.outputs} >= set(TRACKER)


def test_an_unchanged_twin_is_replayed_to_its_noise_and_a_weak_knee_is_not() -> None:
    robot, columns = load_robot("nermo"), table("nermo")
    plant = robot_plant(robot, list(columns))
    aligned = align(recording_from_table(columns, plant), plant)
    floor = np.maximum(noise_floor(aligned), [resolution(list(columns)).get(o.name, 0.0) for o in plant.outputs])
    replayer = Replayer(plant, aligned, cut(aligned, REPORTING_HORIZON, REPORTING_WARM_UP, most=6), floor, 1)
    nominal = Variant.nominal(plant)
    # What MuJoCo's sensors say after a step was so before it.
    nominal.outputs.lead[[not o.name.startswith("base") for o in plant.outputs]] -= build_model(robot).opt.timestep
    residuals = Residuals.build(replayer, nominal)
    changed = nominal.copy()
    knee = plant.model.actuator("front_left_knee").id
    changed.model.actuator_gainprm[knee, 0] *= 0.5
    changed.model.actuator_biasprm[knee, 1] *= 0.5
    found = residuals.of([nominal, changed])
    same, other = (channel_gap(r, residuals.mask) for r in found)
    gaps = dict(zip(residuals.channels, same, strict=True))
    # Windows that begin with a landing are farther off.
    assert np.median(np.sqrt((found[0] ** 2).mean(axis=(1, 2)))) < 1.4
    worse = dict(zip(residuals.channels, other, strict=True))
    assert worse["front_left_knee_position"] > 3.0 * gaps["front_left_knee_position"]
    assert worse["front_left_knee_position"] > worse["rear_right_knee_position"]


def test_candidates_are_places_that_a_mouse_has_and_shows() -> None:
    columns = table("nermo_lite")
    plant = robot_plant(load_robot("nermo_lite"), list(columns))
    aligned = align(recording_from_table(columns, plant), plant)
    replayer = Replayer(plant, aligned, cut(aligned, 0.4, most=6), noise_floor(aligned), 1)
    context = Context(plant, measure_scales(replayer, Variant.nominal(plant)), groups(plant.model))
    keep = worth_a_look(plant)
    keys = {e.key for e in enumerate_effects(context) if keep(e)}
    for expected in (
        "servo_gain@front_left_knee",
        "servo_delay@all_knees",
        "tendon_slack@spine_left",
        "joint_stiffness@spine",
        "joint_stiffness@all",
        "ground_friction@all_feet",
        "mass@torso",
        "joint_rest_angle@front",
    ):
        assert expected in keys
    assert not [k for k in keys if "tail" in k or "head" in k]
    assert len(keys) < 250
    rubbing = {e.key: e.aliases for e in enumerate_effects(context, only=("coulomb_friction",)) if keep(e)}
    assert rubbing["coulomb_friction@rear_left_knee_joint"] == ("tendon_friction@rear_left_knee_tendon",)
    assert {aliases for key, aliases in rubbing.items() if "knee_joint" not in key} == {()}


def test_phases_of_a_leg_and_of_the_body_cover_every_row_once() -> None:
    columns = table("nermo")
    plant = robot_plant(load_robot("nermo"), list(columns))
    aligned = align(recording_from_table(columns, plant), plant)
    for name in ("front_left_hip_position", "base_x"):
        phases = gait_phases(aligned, next(o for o in plant.outputs if o.name == name))
        assert phases is not None
        assert (sum(m.astype(int) for m in phases.values()) == 1).all()
    leg = gait_phases(aligned, next(o for o in plant.outputs if o.name == "rear_right_knee_position"))
    assert (
        leg is not None
        and min(m.mean() for m in leg.values()) > 0.02
        and set(leg)
        == {
            "swing",
            "touch-down",
            "stance",
        }
    )


# Recordings of the graph


def test_a_recording_of_the_graph_gives_the_same_table(tmp_path: Path) -> None:
    robot, columns = load_robot("nermo"), table("nermo")
    short = {n: v[:300] for n, v in columns.items()}
    write_mcap(tmp_path / "walk.mcap", short, list(robot.servos))
    read = mcap_table(tmp_path / "walk.mcap", robot)
    np.testing.assert_allclose(read["t"], short["t"] - short["t"][0], atol=1e-9)
    for name in (command("tail"), position("rear_left_hip")):
        np.testing.assert_array_equal(read[name], short[name])
    knee = encoder("front_right")
    np.testing.assert_array_equal(read[knee][::4], short[knee][::4])
    assert np.isnan(read[knee][1::4]).all()
    assert not set(GYRO) & set(read) and not set(TRACKER) & set(read)
    assert not any(name.startswith("marker_") for name in read)


def test_markers_of_a_tracker_are_read_and_may_be_hidden_for_a_while(tmp_path: Path) -> None:
    robot = load_robot("nermo_lite")
    columns = {n: v[:100] for n, v in table("nermo_lite").items()}
    x, y, z = marker("rear_left_foot")
    columns |= {name: np.linspace(0.0, k, 100) for k, name in enumerate((x, y, z), 1)}
    columns[x][20:30] = np.nan
    write_mcap(tmp_path / "walk.mcap", columns, list(robot.servos))
    read = mcap_table(tmp_path / "walk.mcap", robot)
    assert not set(marker("rear_torso")) & set(read)
    assert np.isnan(read[y][20:30]).all() and np.isfinite(read[y][:20]).all() and np.isfinite(read[y][30:]).all()
    np.testing.assert_array_equal(read[z][:20], columns[z][:20])
    plant = robot_plant(robot, list(read))
    assert [output.subsystem for output in plant.outputs if output.name in (x, y, z)] == ["rear_left foot"] * 3


def test_a_recording_of_another_robot_is_refused(tmp_path: Path) -> None:
    lite = load_robot("nermo_lite")
    write_mcap(tmp_path / "walk.mcap", {n: v[:50] for n, v in table("nermo_lite").items()}, list(lite.servos))
    with pytest.raises(GapInputError, match=r"spine_vertical of nermo.*another robot"):
        mcap_table(tmp_path / "walk.mcap", load_robot("nermo"))
    answer = CliRunner().invoke(gap_app, ["diagnose", str(tmp_path / "nothing.mcap")])
    assert answer.exit_code == 2 and "nothing.mcap" in answer.output


def test_a_bag_of_the_mouse_reads_alike_through_a_map(tmp_path: Path) -> None:
    """As `nermo gap diagnose BAG --model --map` reads it: by the messages' definitions in the bag, without ROS."""
    lite = load_robot("nermo_lite")
    columns = table("nermo_lite")
    write_mcap(tmp_path / "walk.mcap", columns, list(lite.servos))
    topic = {"unit": "rad", "field": "position"}
    inputs = [{"topic": "/nermo/servo_command", "named": s, "actuator": s, "kind": "position"} for s in lite.servos]
    outputs = [{"topic": "/nermo/servo_states", "named": s, "sensor": f"{s}_position"} for s in lite.servos]
    mapping = {"inputs": [i | topic for i in inputs], "outputs": [o | topic for o in outputs]}
    plant = build_plant(diagnosis_spec(lite), parse_map(mapping))
    read, own = load_recording(tmp_path / "walk.mcap", plant), mcap_table(tmp_path / "walk.mcap", lite)
    np.testing.assert_allclose(np.diff(read.time), np.diff(own["t"]), atol=1e-9)
    for i, servo in enumerate(lite.servos):
        np.testing.assert_allclose(read.inputs[:, i], own[f"{servo}_command"], atol=1e-9)
        if f"{servo}_position" in own:
            np.testing.assert_allclose(read.outputs[:, i], own[f"{servo}_position"], atol=1e-9)


# A diagnosis


STIFF = """
name: stiff
base: nermo
front_leg_dynamics: {knee: {rest: 0.40}}
rear_leg_dynamics: {knee: {rest: 1.50}}
"""
"""Knees so pretensioned that no load of a walk takes them over."""


@pytest.fixture(scope="module", params=[("stiff", 6), ("own", 12)], ids=["stiff", "own"])
def weak_knee(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Fit, Fit]:
    """Which knees the robot has; a weak one of them by its own gain, and by its neighbour's."""
    knees, windows = request.param

    def weak(model: mujoco.MjModel) -> None:
        knee = model.actuator("front_left_knee").id
        model.actuator_gainprm[knee, 0] *= 0.6
        model.actuator_biasprm[knee, 1] *= 0.6

    stiff = tmp_path_factory.mktemp("robots") / "stiff.yaml"
    stiff.write_text(STIFF)
    robot = load_robot(str(stiff) if knees == "stiff" else "nermo")
    columns = simulate(robot, SECONDS, change=weak, seed=2)
    plant = robot_plant(robot, list(columns))
    aligned = align(recording_from_table(columns, plant), plant)
    floor = np.maximum(noise_floor(aligned), [resolution(list(columns)).get(o.name, 0.0) for o in plant.outputs])
    replayer = Replayer(plant, aligned, cut(aligned, REPORTING_HORIZON, REPORTING_WARM_UP, most=windows), floor, 1)
    known = nuisances(plant, aligned.outputs.std(axis=0), np.zeros(len(plant.inputs)), aligned.period)
    ages = [n for n in known if n.name.startswith("age")]
    fitter = Fitter(Residuals.build(replayer, Variant.nominal(plant)), ages)
    context = Context(plant, measure_scales(replayer, Variant.nominal(plant)), groups(plant.model))
    gains = {e.site.name: e for e in enumerate_effects(context, (), ("servo_gain",))}

    def fitted(knee: str) -> Fit:
        """From the start that promises most, as the search does."""
        hypothesis, nominal = Hypothesis((gains[knee],)), np.zeros(len(ages))
        points = [(np.array(start), nominal) for start in gains[knee].starts()]
        costs = [fitter.cost(residual, nominal) for residual in fitter.replay(hypothesis, points)]
        return fitter.fit(hypothesis, *points[int(np.argmin(costs))], iterations=3)

    return knees, fitted("front_left_knee"), fitted("front_right_knee")


def test_a_weak_knee_is_told_from_its_neighbour_and_on_stiff_legs_its_size_found(
    weak_knee: tuple[str, Fit, Fit],
) -> None:
    """Where knees comply tendons go slack and taut, and its size is not told as well (docs/gap_nermo_record.md)."""
    knees, own, other = weak_knee
    assert own.cost < other.cost - 10.0
    if knees == "stiff":
        assert own.x[0] == pytest.approx(0.6, abs=0.03), own.z


@pytest.mark.long
def test_a_whole_diagnosis_finds_slippery_ground_and_hands_it_on(tmp_path: Path) -> None:
    def slippery(model: mujoco.MjModel) -> None:
        model.geom_friction[:, 0] *= 0.4

    np.savez(tmp_path / "walk.npz", **simulate(load_robot("nermo_lite"), SECONDS, change=slippery, seed=2))
    options = Options(only=("ground_friction",), baselines=False, threads=1, max_windows=4)
    found = diagnose_recordings([tmp_path / "walk.npz"], "nermo_lite", options)
    report = found.report
    assert report["verdict"] in ("effect", "ambiguous"), report["reasons"]
    assert report["effects"][0]["name"] == "ground_friction"
    assert report["effects"][0]["parameters"]["factor"]["value"] < 0.7
    assert report["gap"]["shrink"] > 0.1
    assert {row["phase"] for row in report["where"]} >= {"one leg up", "two or more legs up"}

    write_report(report, tmp_path / "diagnosis.json")
    html = write_page(report, gather(found), tmp_path / "report.html").read_text(encoding="utf-8")
    assert "ground friction" in html
    mine = tmp_path / "mine.yaml"
    answer = CliRunner().invoke(gap_app, ["apply", str(tmp_path / "diagnosis.json"), "--out", str(mine)])
    assert answer.exit_code == 0, answer.output
    assert all(d.effect == "ground_friction" and d.sites for d in load_robot(mine).deviations)


# Robot files


def test_a_diagnosis_becomes_a_robot_that_the_twin_loads(tmp_path: Path) -> None:
    def effect(name: str, site: str, **values: float) -> dict[str, object]:
        return {"name": name, "site": site, "parameters": {n: {"value": v} for n, v in values.items()}}

    report = {
        "schema": "nermo_gap/diagnosis/1",
        "robot": "nermo_lite",
        "verdict": "effect",
        "effects": [
            effect("servo_gain", "front_left_knee", factor=0.7),
            effect("joint_stiffness", "spine", factor=0.5),
            effect("ground_friction", "all_feet", factor=0.4),
            effect("tendon_slack", "spine_left", slack=0.002),
            effect("mass", "torso", change=0.02),
            effect("servo_delay", "all_hips", delay=0.012),
            effect("sensor_bias", "rear_left_hip_position", bias=0.1),
        ],
    }
    (tmp_path / "diagnosis.json").write_text(json.dumps(report), encoding="utf-8")
    mine = tmp_path / "mine.yaml"
    answer = CliRunner().invoke(gap_app, ["apply", str(tmp_path / "diagnosis.json"), "--out", str(mine)])
    assert answer.exit_code == 0, answer.output
    assert "sensor_bias" in answer.output
    robot, own = load_robot(mine), load_robot("nermo_lite")
    assert robot.name == "mine" and len(robot.deviations) == 6
    changed, model = build_model(robot), build_model(own)
    knee = "front_left_knee"
    assert changed.actuator(knee).gainprm[0] == pytest.approx(0.7 * model.actuator(knee).gainprm[0])
    assert changed.actuator(knee).biasprm[1] == pytest.approx(0.7 * model.actuator(knee).biasprm[1])
    for i in range(1, 5):
        joint = f"spine_lateral_{i}_joint"
        assert changed.joint(joint).stiffness[0] == pytest.approx(0.5 * model.joint(joint).stiffness[0])
    assert changed.geom("rear_left_foot").friction[0] == pytest.approx(0.4 * own.contact.friction)
    string = model.tendon("spine_left").id
    assert changed.tendon_range[string, 1] == pytest.approx(model.tendon_range[string, 1] + 0.002)
    assert changed.body_mass.sum() == pytest.approx(model.body_mass.sum() + 0.02)
    one, two = Twin(robot, model=model), Twin(own, model=model)
    target = [s.neutral for s in own.servos.values()]
    target[0] += 0.3
    moved = [[twin.step(target).servo_positions[0] for _ in range(6)] for twin in (one, two)]
    assert moved[0][1] < moved[1][1], "the hip of the slow mouse starts later"


@pytest.mark.parametrize(
    ("content", "words"),
    [("{", "is not JSON"), ('{"schema": "other"}', "is no diagnosis")],
)
def test_what_is_no_diagnosis_is_refused(tmp_path: Path, content: str, words: str) -> None:
    (tmp_path / "d.json").write_text(content, encoding="utf-8")
    answer = CliRunner().invoke(gap_app, ["apply", str(tmp_path / "d.json"), "--out", str(tmp_path / "r.yaml")])
    assert answer.exit_code == 2 and words in answer.output


# The live gap


def test_the_live_gap_is_nothing_for_the_twin_itself_and_shows_the_leg_that_differs() -> None:
    robot = load_robot("nermo_lite")
    own, weak = Twin(robot), Twin(robot)
    knee = weak.model.actuator("rear_right_knee").id
    weak.model.actuator_gainprm[knee, 0] *= 0.3
    weak.model.actuator_biasprm[knee, 1] *= 0.3
    servos = list(robot.servos)
    neutral = np.array([s.neutral for s in robot.servos.values()])
    gaps = []
    for twin in (own, weak):
        live = LiveGap(robot)
        stamp = twin.time_ns
        for tick in range(300):
            told = neutral + 0.2 * np.sin(0.1 * tick)
            live.command(stamp, dict(zip(servos, told.tolist(), strict=True)))
            sensors = twin.step(told.tolist())
            stamp = sensors.stamp
            live.measured(stamp, {position(s): v for s, v in zip(servos, sensors.servo_positions, strict=True)})
        gaps.append(live.gap())
    assert max(gaps[0].values()) < 0.01
    assert max(gaps[1], key=lambda name: gaps[1][name]) == "rear_right leg" and gaps[1]["rear_right leg"] > 3.0


@pytest.mark.parametrize("said", [1e200, -1e308])
def test_the_live_gap_stays_a_number_whatever_a_sensor_says(said: float) -> None:
    robot = load_robot("nermo_lite")
    live = LiveGap(robot)
    stand = {name: servo.neutral for name, servo in robot.servos.items()}
    for tick in range(1, 4):
        live.command(5_000_000 * tick, stand)
        live.measured(5_000_000 * tick, dict.fromkeys((*GYRO, encoder("front_left")), said))
    assert all(np.isfinite(value) and value > 1e3 for value in live.gap().values())


def test_every_nominal_number_of_the_mouse_has_a_unit_and_moves() -> None:
    plant = robot_plant(load_robot("nermo"), list(simulate(load_robot("nermo"), 0.1, seed=2)))
    size = np.ones(len(plant.inputs))
    for nuisance in nuisances(plant, np.ones(len(plant.outputs)), size, 0.005):
        number = nuisance.described()
        assert number.unit != "prior deviations", nuisance.name
        assert np.isfinite(number.value(0.0)) and number.value(1.0) != number.value(0.0), nuisance.name


# What next


def test_what_a_mouse_is_asked_to_do_keeps_it_on_its_feet_and_can_be_played(tmp_path: Path) -> None:
    robot, columns = load_robot("nermo"), table("nermo")
    plant = robot_plant(robot, list(columns))
    aligned = align(recording_from_table(columns, plant), plant)
    menu, names = MouseMenu(robot), [c.name for c in plant.inputs]
    for experiment in menu.experiments(plant, aligned, []):
        twin = Twin(robot)
        for row in experiment.inputs:
            twin.step([float(row[names.index(servo)]) for servo in robot.servos])
            assert twin.tilt() < 0.3
        path = menu.write(experiment, plant, tmp_path / experiment.name)
        commands = yaml.safe_load(path.read_text(encoding="utf-8"))["commands"]
        assert commands[0] == {"at": 0.0, "posture": "stand"}
        assert set(commands[1]["servos"]) == set(robot.servos)
        assert [c["at"] for c in commands] == sorted({c["at"] for c in commands})
