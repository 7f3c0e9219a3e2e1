"""The same recording in every container that we read: tables, LeRobot datasets and bags of ROS."""

from __future__ import annotations

import copy
import json
import re
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pyarrow
import pyarrow.parquet
import pytest
import yaml
from numpy.typing import NDArray
from robots import MAPS, MODELS, simulate
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

import simgap
from simgap.data.align import Aligned, align
from simgap.data.bag import topics
from simgap.data.errors import GapInputError
from simgap.data.mapping import parse_map
from simgap.data.plant import Plant, build_plant
from simgap.data.recording import load_recording
from simgap.preparation.guess import guess_map

Array = NDArray[np.float64]
STORE = get_typestore(Stores.ROS2_JAZZY)
STORE.register(get_types_from_msg("float32[2] angle\nfloat64 effort\nbool on", "acme_msgs/msg/Actuator"))
STORE.register(get_types_from_msg("std_msgs/Header header\nActuator[2] actuators", "acme_msgs/msg/Actuators"))
TYPES = STORE.types
JOINTS = ("shoulder", "elbow")
EPOCH = 1_700_000_000 * 10**9


def _plant(mapping: dict[str, Any], robot: str = "arm") -> Plant:
    return build_plant(mujoco.MjSpec.from_string(MODELS[robot]), parse_map(mapping))


def _stamp(ns: int) -> Any:
    return TYPES["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)


def _header(ns: int) -> Any:
    return TYPES["std_msgs/msg/Header"](stamp=_stamp(ns), frame_id="")


def _joint_state(ns: int, names: Sequence[str], position: Sequence[float], velocity: Sequence[float] = ()) -> Any:
    return TYPES["sensor_msgs/msg/JointState"](
        header=_header(ns),
        name=list(names),
        position=np.array(position),
        velocity=np.array(velocity),
        effort=np.zeros(0),
    )


def _floats(values: Sequence[float]) -> Any:
    layout = TYPES["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
    return TYPES["std_msgs/msg/Float64MultiArray"](layout=layout, data=np.array(values))


def _write(
    path: Path, messages: Sequence[tuple[str, int, Any]], storage: StoragePlugin, zstd: CompressionMode | None = None
) -> Path:
    """A bag of (topic, time of reception [ns], message)."""
    writer = Writer(path, version=9, storage_plugin=storage)
    if zstd is not None:
        writer.set_compression(zstd, CompressionFormat.ZSTD)
    with writer:
        made = {}
        for topic, at, message in messages:
            kind = message.__msgtype__
            if topic not in made:
                made[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(made[topic], at, STORE.serialize_cdr(message, kind))
    return path


def _joint_bag(
    path: Path, table: dict[str, Array], storage: StoragePlugin, zstd: CompressionMode | None = None
) -> Path:
    """The arm's log as its controller and joints would publish it, the joints in another order."""
    messages: list[tuple[str, int, Any]] = []
    for k, t in enumerate(table["t"]):
        ns = EPOCH + round(t * 1e9)
        messages.append(("/command", ns + 1_000_000, _joint_state(ns, JOINTS, [table["u0"][k], table["u1"][k]])))
        messages.append(
            ("/joint_states", ns + 1_200_000, _joint_state(ns, JOINTS[::-1], [table["q1"][k], table["q0"][k]]))
        )
    return _write(path, messages, storage, zstd)


def _bag_map(edit: Callable[[dict[str, Any]], None] | None = None) -> dict[str, Any]:
    servos = {"shoulder": "shoulder_servo", "elbow": "elbow_servo"}
    mapping: dict[str, Any] = {
        "inputs": [
            {
                "topic": "/command",
                "field": "position",
                "joint": j,
                "actuator": servos[j],
                "kind": "position",
                "unit": "rad",
            }
            for j in JOINTS
        ],
        "outputs": [
            {"topic": "/joint_states", "field": "position", "joint": j, "quantity": "position", "unit": "rad"}
            for j in JOINTS
        ],
    }
    if edit:
        edit(mapping)
    return mapping


@pytest.fixture(scope="module")
def table() -> dict[str, Array]:
    return simulate("arm", 6.0)


@pytest.fixture(scope="module")
def reference(table: dict[str, Array], tmp_path_factory: pytest.TempPathFactory) -> Aligned:
    path = tmp_path_factory.mktemp("npz") / "log.npz"
    np.savez(path, **table)  # type: ignore[arg-type]
    plant = _plant(dict(MAPS["arm"]))
    return align(load_recording(path, plant), plant)


def _same(found: Aligned, reference: Aligned) -> None:
    assert found.period == pytest.approx(reference.period, abs=1e-12)
    np.testing.assert_allclose(found.inputs, reference.inputs, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.outputs, reference.outputs, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(found.valid, reference.valid)


@pytest.mark.parametrize("kind", ["csv", "semicolons", "parquet", "lerobot file", "lerobot folder"])
def test_tables_hold_the_same(kind: str, table: dict[str, Array], reference: Aligned, tmp_path: Path) -> None:
    mapping = copy.deepcopy(dict(MAPS["arm"]))
    names = list(table)
    if kind in ("csv", "semicolons"):
        path, mark = tmp_path / "log.csv", ";" if kind == "semicolons" else ","
        rows = [
            mark.join(names),
            *(mark.join(repr(float(v)) for v in row) for row in zip(*table.values(), strict=True)),
        ]
        path.write_text("\n".join(rows))
    elif kind == "parquet":
        path = tmp_path / "log.parquet"
        pyarrow.parquet.write_table(pyarrow.table(table), path)
    else:
        # One feature for all motors, as LeRobot has it; its names stand in meta/info.json.
        path = tmp_path / "data" / "chunk-000" / "episode_000000.parquet"
        path.parent.mkdir(parents=True)
        (tmp_path / "meta").mkdir()
        motors = [f"{j}.pos" for j in JOINTS]
        info = {"fps": 200, "features": {"action": {"names": motors}, "observation.state": {"names": motors}}}
        (tmp_path / "meta" / "info.json").write_text(json.dumps(info))
        frames = {
            "timestamp": table["t"],
            "action": list(np.stack([table["u0"], table["u1"]], 1)),
            "observation.state": list(np.stack([table["q0"], table["q1"]], 1)),
            "episode_index": np.zeros(len(table["t"]), np.int64),
        }
        pyarrow.parquet.write_table(pyarrow.table(frames), path)
        path = path if kind == "lerobot file" else tmp_path
        mapping["time"] = {"column": "timestamp", "unit": "s"}
        for i, joint in enumerate(JOINTS):
            mapping["inputs"][i]["column"] = f"action[{joint}.pos]"
            mapping["outputs"][i]["column"] = f"observation.state[{joint}.pos]"
        mapping["segments"] = {"column": "episode_index"}
    plant = _plant(mapping)
    _same(align(load_recording(path, plant), plant), reference)


@pytest.mark.parametrize(
    ("storage", "zstd", "as_file"),
    [
        (StoragePlugin.MCAP, None, False),
        (StoragePlugin.MCAP, None, True),
        (StoragePlugin.SQLITE3, None, False),
        (StoragePlugin.SQLITE3, None, True),
        (StoragePlugin.MCAP, CompressionMode.STORAGE, True),
        (StoragePlugin.MCAP, CompressionMode.FILE, False),
        (StoragePlugin.SQLITE3, CompressionMode.MESSAGE, True),
        (StoragePlugin.SQLITE3, CompressionMode.FILE, False),
    ],
)
def test_bags_hold_the_same(
    storage: StoragePlugin,
    zstd: CompressionMode | None,
    as_file: bool,
    table: dict[str, Array],
    reference: Aligned,
    tmp_path: Path,
) -> None:
    path = _joint_bag(tmp_path / "bag", table, storage, zstd)
    if as_file:
        (path,) = path.glob("*.mcap" if storage == StoragePlugin.MCAP else "*.db3")
    plant = _plant(_bag_map())
    recording = load_recording(path, plant)
    assert recording.warnings == []
    _same(align(recording, plant), reference)


def test_topics_with_stamps_of_their_own_keep_the_period(table: dict[str, Array], tmp_path: Path) -> None:
    """Commands and joints stamped 30 us apart: nothing of either is lost, and the grid stays theirs."""
    messages: list[tuple[str, int, Any]] = []
    for k, t in enumerate(table["t"]):
        ns = EPOCH + round(t * 1e9)
        messages.append(("/command", ns, _joint_state(ns, JOINTS, [table["u0"][k], table["u1"][k]])))
        late = ns + 30_000
        messages.append(("/joint_states", late, _joint_state(late, JOINTS, [table["q0"][k], table["q1"][k]])))
    plant = _plant(_bag_map())
    aligned = align(load_recording(_write(tmp_path / "bag", messages, StoragePlugin.MCAP), plant), plant)
    assert aligned.period == pytest.approx(0.005, rel=1e-6)
    assert len(aligned.time) == pytest.approx(len(table["t"]), abs=1)
    assert aligned.valid[1:].all()
    np.testing.assert_allclose(aligned.inputs[1:-1, 0], table["u0"][1 : len(aligned.time) - 1], atol=1e-12)


def test_arrays_and_messages_that_nobody_knows_are_read_by_index(
    table: dict[str, Array], reference: Aligned, tmp_path: Path
) -> None:
    """Float64MultiArray has no stamp, so the recorder's clock counts; the other message is defined in the bag alone."""
    messages: list[tuple[str, int, Any]] = []
    actuator = TYPES["acme_msgs/msg/Actuator"]
    for k, t in enumerate(table["t"]):
        ns = EPOCH + round(t * 1e9)
        messages.append(("/commands", ns, _floats([table["u0"][k], table["u1"][k]])))
        both = [
            actuator(angle=np.zeros(2, np.float32), effort=float(table[q][k]), on=bool(k % 2)) for q in ("q0", "q1")
        ]
        message = TYPES["acme_msgs/msg/Actuators"](header=_header(ns - 7 * 10**9), actuators=both)
        messages.append(("/acme", ns, message))

    def edit(mapping: dict[str, Any]) -> None:
        for i, row in enumerate(mapping["inputs"]):
            del row["joint"]
            row |= {"topic": "/commands", "field": "data", "index": i}
        for i, row in enumerate(mapping["outputs"]):
            row |= {"topic": "/acme", "field": f"actuators[{i}].effort"}
        mapping["enabled"] = {"topic": "/acme", "field": "actuators[0].on"}

    path = _write(tmp_path / "bag", messages, StoragePlugin.MCAP)
    plant = _plant(_bag_map(edit))
    recording = load_recording(path, plant)
    assert "no stamp" in recording.warnings[0]
    aligned = align(recording, plant)
    _same(aligned, reference)
    np.testing.assert_array_equal(aligned.enabled, np.arange(len(aligned.time)) % 2 == 1)
    fields = {t.name: t.fields for t in topics(path)}
    assert fields["/commands"]["data"] == 2
    assert fields["/acme"]["actuators[0].effort"] is None


def test_a_newer_trajectory_replaces_what_lies_ahead_of_the_older(tmp_path: Path) -> None:
    """Each lasts a second and is replaced after half of one, so half of its points act."""
    point_type, trajectory = (TYPES[f"trajectory_msgs/msg/JointTrajectory{n}"] for n in ("Point", ""))
    none = np.zeros(0)
    messages: list[tuple[str, int, Any]] = []
    for k in range(20):
        ns = EPOCH + k * 500_000_000
        points = []
        for i in range(10):
            after = TYPES["builtin_interfaces/msg/Duration"](sec=0, nanosec=100_000_000 * i)
            values = np.array([k + 0.01 * i, -k])
            points.append(
                point_type(positions=values, velocities=none, accelerations=none, effort=none, time_from_start=after)
            )
        messages.append(("/trajectory", ns, trajectory(header=_header(ns), joint_names=list(JOINTS), points=points)))
        for j in range(50):
            at = ns + j * 10_000_000
            messages.append(("/joint_states", at, _joint_state(at, JOINTS, [0.001 * j, 0.002 * j])))

    def edit(mapping: dict[str, Any]) -> None:
        for row in mapping["inputs"]:
            row |= {"topic": "/trajectory", "field": "points.positions", "hold": "linear"}

    plant = _plant(_bag_map(edit))
    recording = load_recording(_write(tmp_path / "bag", messages, StoragePlugin.MCAP), plant)
    told = np.isfinite(recording.inputs[:, 0])
    expected = [k + 0.01 * i for k in range(20) for i in range(5)] + [19 + 0.01 * i for i in range(5, 10)]
    np.testing.assert_allclose(recording.inputs[told, 0], expected)
    np.testing.assert_allclose(np.diff(recording.time[told]), 0.1, atol=1e-9)


def test_orientation_and_rates_of_a_body(tmp_path: Path) -> None:
    """Imu and Odometry: a vector by its component, a quaternion as the angle that the map asks for."""
    vector, quaternion = TYPES["geometry_msgs/msg/Vector3"], TYPES["geometry_msgs/msg/Quaternion"]
    messages: list[tuple[str, int, Any]] = []
    for k in range(500):
        ns, yaw = EPOCH + k * 10_000_000, 0.4 * np.sin(0.02 * k)
        imu = TYPES["sensor_msgs/msg/Imu"](
            header=_header(ns),
            orientation=quaternion(x=0.0, y=0.0, z=float(np.sin(yaw / 2)), w=float(np.cos(yaw / 2))),
            orientation_covariance=np.zeros(9),
            angular_velocity=vector(x=0.0, y=0.0, z=float(k)),
            angular_velocity_covariance=np.zeros(9),
            linear_acceleration=vector(x=0.0, y=0.0, z=9.81),
            linear_acceleration_covariance=np.zeros(9),
        )
        messages += [("/imu", ns, imu), ("/command", ns, _floats([0.0]))]
    mapping = {
        "time": {"clock": "received"},
        "inputs": [
            {"topic": "/command", "field": "data", "actuator": "hip_servo", "kind": "position", "unit": "rad"}
        ],
        "outputs": [
            {"topic": "/imu", "field": "orientation", "body": "trunk", "quantity": "orientation", "component": "yaw",
             "unit": "rad"},
            {"topic": "/imu", "field": "angular_velocity", "body": "trunk", "quantity": "angular_velocity",
             "component": "z", "unit": "rad/s"},
        ],
    }  # fmt: skip
    model = """<mujoco><worldbody><body name="trunk"><freejoint/><geom size=".1"/><body name="leg">
      <joint name="hip" axis="0 1 0"/><geom size=".05"/></body></body></worldbody>
      <actuator><position name="hip_servo" joint="hip" kp="5"/></actuator></mujoco>"""
    plant = build_plant(mujoco.MjSpec.from_string(model), parse_map(mapping))
    recording = load_recording(_write(tmp_path / "bag", messages, StoragePlugin.MCAP), plant)
    np.testing.assert_allclose(recording.outputs[:, 0], 0.4 * np.sin(0.02 * np.arange(500)), atol=1e-12)
    np.testing.assert_allclose(recording.outputs[:, 1], np.arange(500))


def test_a_map_of_a_bag_is_guessed_from_what_it_holds(table: dict[str, Array], tmp_path: Path) -> None:
    """Commands by index, positions by name, the body as it was seen, and nothing of a battery without a thermometer."""
    legs = [f"{leg}_{joint}" for leg in ("front_left", "front_right", "rear_left", "rear_right")
            for joint in ("hip", "knee")]  # fmt: skip
    covariance, messages = np.zeros(9), []
    vector = TYPES["geometry_msgs/msg/Vector3"]
    for k in range(400):
        ns, angles = EPOCH + 5_000_000 * k, np.sin(0.02 * k + np.arange(8))
        turn = TYPES["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0)
        place = TYPES["geometry_msgs/msg/Point"](x=0.001 * k, y=0.0, z=0.15)
        pose = TYPES["geometry_msgs/msg/Pose"](position=place, orientation=turn)
        messages += [("/servos/commands", ns, _floats(angles)), ("/joint_states", ns, _joint_state(ns, legs, angles))]
        for topic in ("/odometry", "/tracker/pose"):
            messages.append((topic, ns, TYPES["geometry_msgs/msg/PoseStamped"](header=_header(ns), pose=pose)))
        rates = {"angular_velocity": vector(x=0.1, y=0.0, z=0.0), "linear_acceleration": vector(x=0.0, y=0.0, z=9.8)}
        names = ("orientation", "angular_velocity", "linear_acceleration")
        imu = {"header": _header(ns), "orientation": turn, **rates, **{f"{n}_covariance": covariance for n in names}}
        messages.append(("/imu", ns, TYPES["sensor_msgs/msg/Imu"](**imu)))
        unknown = dict.fromkeys(("temperature", "current", "charge", "capacity", "design_capacity"), float("nan"))
        states = {f"power_supply_{name}": 0 for name in ("status", "health", "technology")}
        cells = {"cell_voltage": np.zeros(0, np.float32), "cell_temperature": np.zeros(0, np.float32)}
        rest = {"percentage": 1.0, "present": True, "location": "", "serial_number": ""}
        battery = TYPES["sensor_msgs/msg/BatteryState"](
            header=_header(ns), voltage=7.4 - 1e-4 * k, **unknown, **states, **cells, **rest
        )
        messages.append(("/battery", ns, battery))
    bag = _write(tmp_path / "bag", messages, StoragePlugin.MCAP)
    guess = guess_map(bag, mujoco.MjModel.from_xml_string(MODELS["quad"]))
    found = parse_map(yaml.safe_load(guess.text("bag")))
    assert [(row.topic, row.index, row.actuator) for row in found.inputs] == [
        ("/servos/commands", i, f"{leg}_servo") for i, leg in enumerate(legs)
    ]
    assert [row.joint for row in found.outputs if row.topic == "/joint_states"] == legs
    assert [row.component for row in found.outputs if row.body == "trunk"] == [*"xyz", *"wxyz"]
    assert {row.topic for row in found.outputs if row.body == "trunk"} == {"/tracker/pose"}
    assert [row.component for row in found.outputs if row.sensor == "imu_gyro"] == [*"xyz"]
    assert [(row.field, row.unit) for row in found.auxiliary] == [("voltage", "V")]
    assert "POWER_SUPPLY" not in guess.text("bag") and not guess.open
    plant = _plant(yaml.safe_load(guess.text("bag")), "quad")
    np.testing.assert_allclose(load_recording(bag, plant).inputs[7], np.sin(0.02 * 7 + np.arange(8)), atol=1e-12)


def test_clocks_that_are_apart_are_noticed(table: dict[str, Array], tmp_path: Path) -> None:
    messages: list[tuple[str, int, Any]] = []
    for k, t in enumerate(table["t"]):
        ns = EPOCH + round(t * 1e9)
        messages.append(("/command", ns, _joint_state(ns - 3 * 10**8, JOINTS, [table["u0"][k], table["u1"][k]])))
        messages.append(("/joint_states", ns, _joint_state(ns, JOINTS, [table["q0"][k], table["q1"][k]])))
    plant = _plant(_bag_map())
    recording = load_recording(_write(tmp_path / "bag", messages, StoragePlugin.MCAP), plant)
    assert "two clocks" in recording.warnings[0] and "0.3 s" in recording.warnings[0]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda m: m["outputs"][0].update(topic="/joint_state"), r"outputs\[0\]: no topic.*did you mean /joint_states"),
        (lambda m: m["outputs"][0].update(field="positoin"), "no field 'positoin'; did you mean position"),
        (lambda m: m["outputs"][0].update(named="elbo"), "no 'elbo'; did you mean elbow.*`named`"),
        (lambda m: m["inputs"][0].pop("joint"), "an array of 2; say which.*named: one of shoulder, elbow"),
        (lambda m: (m["inputs"][0].pop("joint"), m["inputs"][0].update(index=5)), "index 5 is beyond the 2"),
        (lambda m: m["outputs"][0].update(field="header"), "a message with stamp, frame_id; name one"),
        (lambda m: m["outputs"][0].update(field="a b"), "'a b' is no name of a field"),
        (lambda m: m["outputs"][0].update(field="velocity"), "no message holds a finite number"),
    ],
)
def test_a_map_that_the_bag_does_not_fit_is_refused(
    change: Callable[[dict[str, Any]], Any], message: str, table: dict[str, Array], tmp_path: Path
) -> None:
    few = {name: values[:50] for name, values in table.items()}
    path = _joint_bag(tmp_path / "bag", few, StoragePlugin.MCAP)
    with pytest.raises(GapInputError, match=message):
        load_recording(path, _plant(_bag_map(change)))


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (lambda m: m["outputs"][0].update(column="q"), "give column .of a table., or topic"),
        (lambda m: m["outputs"][0].pop("field"), "needs a field"),
        (lambda m: m["outputs"].append({"column": "q", "joint": "elbow", "quantity": "position", "unit": "rad"}),
         "a map is for tables or for bags"),
        (lambda m: m["outputs"][0].update(resolution=0), r"outputs\[0\].resolution: must be more than 0, not 0"),
        (lambda m: m.update(enabled={"colum": "on"}), "enabled.*give column"),
        (lambda m: m["outputs"][0].update(quantity="speed"), "must be one of 'position', 'velocity'.*not 'speed'"),
        (lambda m: m["inputs"][0].pop("kind"), r"inputs\[0\].kind: is missing"),
        (lambda m: m["inputs"][0].update(knid="position"), "there is no such key; did you mean kind"),
        (lambda m: m.update(gains=3), "gains: must be keys and values"),
        (lambda m: m.update(inputs={"a": 1}), "inputs: must be a list"),
        (lambda m: m["inputs"][0].update(unit=3), "unit: must be text"),
    ],
)  # fmt: skip
def test_a_map_is_refused_in_our_words(edit: Callable[[dict[str, Any]], Any], message: str) -> None:
    with pytest.raises(GapInputError, match=message):
        parse_map(_bag_map(edit))


def test_damaged_files_are_refused_with_a_remedy(table: dict[str, Array], tmp_path: Path) -> None:
    few = {name: values[:200] for name, values in table.items()}
    bag = _joint_bag(tmp_path / "bag", few, StoragePlugin.MCAP)
    (whole,) = bag.glob("*.mcap")
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    (tmp_path / "noise.db3").write_bytes(b"no database")
    (tmp_path / "empty.mcap").write_bytes(b"")
    for name in ("cut.mcap", "noise.db3", "empty.mcap"):
        with pytest.raises(GapInputError, match=rf"{name}: cannot read the bag.*mcap recover"):
            load_recording(tmp_path / name, _plant(_bag_map()))
    np.savez(tmp_path / "objects.npz", t=np.array([{"a": 1}], dtype=object))
    (tmp_path / "cut.csv").write_text("t,u0,u1,q0,q1\n0,0,0,0,0\n0.1,0,")
    (tmp_path / "words.csv").write_text("t,u0,u1,q0,q1\n0,0,0,0,0\n0.1,0,0,ERR,0\n0.2,0,0,0,0\n")
    for name, words in (
        ("objects.npz", "not read because they can run code"),
        ("cut.csv", "row 3 has 3 cells where the header has 5"),
        ("words.csv", "column 'q0': row 3 holds 'ERR'"),
        ("nothing.csv", "no such recording"),
        ("nothing.mcap", "no such recording"),
    ):
        with pytest.raises(GapInputError, match=words):
            load_recording(tmp_path / name, _plant(_bag_map() if name.endswith("mcap") else dict(MAPS["arm"])))


def test_enabled_is_zero_or_one(table: dict[str, Array], tmp_path: Path) -> None:
    mapping = {**MAPS["arm"], "enabled": {"column": "on"}}
    plant, on = _plant(mapping), (table["t"] > 2.0).astype(float)
    np.savez(tmp_path / "log.npz", **table, on=on)  # type: ignore[arg-type]
    aligned = align(load_recording(tmp_path / "log.npz", plant), plant)
    np.testing.assert_array_equal(aligned.enabled, aligned.time > 2.0)
    for wrong, message in ((on * 50.0, "holds 50; it must be true or false"), (0.0 * on, "is never 1")):
        np.savez(tmp_path / "log.npz", **table, on=wrong)  # type: ignore[arg-type]
        with pytest.raises(GapInputError, match=message):
            load_recording(tmp_path / "log.npz", plant)


def test_resolution_is_in_the_unit_of_its_row() -> None:
    mapping = copy.deepcopy(dict(MAPS["arm"]))
    mapping["outputs"][0] |= {"unit": "deg", "resolution": 360 / 4096}
    assert _plant(mapping).outputs[0].resolution == pytest.approx(2 * np.pi / 4096)
    assert _plant(mapping).outputs[1].resolution == 0.0


def test_bags_are_read_where_no_ros_is(table: dict[str, Array], tmp_path: Path) -> None:
    few = {name: values[:50] for name, values in table.items()}
    path = _joint_bag(tmp_path / "bag", few, StoragePlugin.MCAP)
    script = (
        "import sys; from pathlib import Path; from simgap.data.bag import topics; "
        f"print([t.name for t in topics(Path({str(path)!r}))]); "
        "assert not [m for m in sys.modules if m.split('.')[0] in ('rclpy', 'rosidl_runtime_py', 'pyarrow')]"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.returncode == 0 and "/joint_states" in done.stdout, done.stderr


def test_the_maps_in_the_documentation_are_valid() -> None:
    docs = Path(simgap.__file__).resolve().parents[3] / "docs"
    blocks = [
        yaml.safe_load(block)
        for page in ("gap.md", "simgap/recordings.md")
        for block in re.findall(r"```yaml\n(.*?)```", (docs / page).read_text(encoding="utf-8"), re.DOTALL)
    ]
    maps = [parse_map(block) for block in blocks if "inputs" in block]
    assert [m.of_bag for m in maps] == [False, True]
