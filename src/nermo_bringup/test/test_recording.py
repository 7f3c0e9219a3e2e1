"""Bags on disk: written, cut, repaired, and read by three independent readers."""

from __future__ import annotations

import resource
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from geometry_msgs.msg import Vector3
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import Writer
from mcap_ros2.decoder import DecoderFactory
from rclpy.serialization import serialize_message
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from std_msgs.msg import String

from nermo_bringup.recording.background_writer import BackgroundWriter, Message
from nermo_bringup.recording.errors import RecordingError
from nermo_bringup.recording.qos import MINIMUM_DEPTH, Offer, Request, request_for
from nermo_bringup.recording.repair import repair
from nermo_bringup.recording.schema import dependencies, ros2msg
from nermo_bringup.recording.taps import LossCounter, TopicFilter, dated_directory
from nermo_bringup.recording.writer import BagWriter, Topic
from nermo_interfaces.msg import FootForces, ServoStates
from nermo_node.recording_reader import Recording

STRING_HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
LATCHED = Offer(durability="transient_local", history="keep_last", depth=1)


def text_topic(name: str = "/chatter") -> Topic:
    return Topic(name, "std_msgs/msg/String", ros2msg("std_msgs/msg/String"), STRING_HASH, [LATCHED])


def write_text(bag: BagWriter, count: int, topic: Topic | None = None) -> None:
    topic = topic or text_topic()
    for number in range(count):
        bag.write(topic, 1000 + number, 500 + number, number, serialize_message(String(data=f"text {number}")))


def servo_states(position: list[float], names: list[str]) -> bytes:
    message = ServoStates(name=names, position=position, velocity=position, torque=position, current=position)
    message.header.stamp.sec = 3
    message.header.stamp.nanosec = 5
    return serialize_message(message)


def test_schema_holds_every_type_that_is_needed_once() -> None:
    text = ros2msg("nermo_interfaces/msg/ControlCommand")
    sections = [part.strip().splitlines()[0] for part in text.split("=" * 80)[1:]]
    assert sorted(sections) == [
        "MSG: builtin_interfaces/Time",
        "MSG: nermo_interfaces/SpineModes",
        "MSG: std_msgs/Header",
    ]
    assert "float64 forward_velocity" in text


def test_schema_dependencies_ignore_constants_comments_and_primitives() -> None:
    assert dependencies("nermo_interfaces/msg/LegStates") == ["std_msgs/msg/Header", "builtin_interfaces/msg/Time"]


@pytest.mark.parametrize("type_name", ["nowhere/msg/Thing", "std_msgs/msg/Strong", "std_srvs/srv/Empty"])
def test_schema_of_an_unknown_type_names_it(type_name: str) -> None:
    with pytest.raises(RecordingError, match=type_name):
        ros2msg(type_name)


def test_three_readers_agree_on_a_bag(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / "walk")
    write_text(bag, 20)
    bag.close()

    with AnyReader([tmp_path / "walk"]) as reader:
        assert reader.message_count == 20
        by_rosbags = [reader.deserialize(data, connection.msgtype).data for connection, _, data in reader.messages()]
        (connection,) = reader.connections
        assert connection.ext.offered_qos_profiles[0].durability.name == "TRANSIENT_LOCAL"
    with bag.path.open("rb") as file:
        by_mcap = [
            item.decoded_message.data
            for item in make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages()
        ]
    data = Recording(tmp_path / "walk").read()["/chatter"]

    assert by_rosbags == by_mcap == list(data["data"]) == [f"text {number}" for number in range(20)]
    np.testing.assert_array_equal(data.log_time, np.arange(1000, 1020))
    np.testing.assert_array_equal(data.publish_time, np.arange(500, 520))


def test_metadata_says_what_the_file_holds(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / "walk")
    bag.add(text_topic("/silent"))
    write_text(bag, 3)
    bag.close()
    information = yaml.safe_load((tmp_path / "walk" / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert information["message_count"] == 3
    assert information["relative_file_paths"] == ["walk_0.mcap"]
    assert information["duration"]["nanoseconds"] == 2
    counts = {
        topic["topic_metadata"]["name"]: topic["message_count"] for topic in information["topics_with_message_count"]
    }
    assert counts == {"/silent": 0, "/chatter": 3}


def test_an_empty_bag_can_be_opened(tmp_path: Path) -> None:
    BagWriter(tmp_path / "walk").close()
    recording = Recording(tmp_path / "walk")
    assert recording.complete
    assert recording.topics == {}
    with AnyReader([tmp_path / "walk"]) as reader:
        assert reader.message_count == 0


def test_an_existing_directory_is_never_overwritten(tmp_path: Path) -> None:
    (tmp_path / "walk").mkdir()
    (tmp_path / "walk" / "thesis.txt").write_text("years of work")
    with pytest.raises(RecordingError, match="exists already"):
        BagWriter(tmp_path / "walk")
    assert [path.name for path in (tmp_path / "walk").iterdir()] == ["thesis.txt"]


def test_a_directory_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordingError, match=f"cannot record into {tmp_path}/file/walk: Not a directory"):
        BagWriter(tmp_path / "file" / "walk")


FULL_DISK = """
import sys
from pathlib import Path
from nermo_bringup.recording.writer import BagWriter, Topic
from nermo_bringup.recording.errors import RecordingError
import os
topic = Topic("/noise", "std_msgs/msg/String", "string data")
bag = BagWriter(Path(sys.argv[1]))
try:
    for number in range(200):
        bag.write(topic, number, number, number, os.urandom(1000))
        bag.flush()
    bag.close()
except RecordingError as error:
    sys.exit(str(error))
"""


def test_a_full_disk_ends_the_recording_with_a_clear_message(tmp_path: Path) -> None:
    def small_files() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, 50_000))

    done = subprocess.run(
        [sys.executable, "-c", FULL_DISK, str(tmp_path / "walk")],
        preexec_fn=small_files,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1
    assert "stopped after" in done.stderr
    assert "File too large" in done.stderr
    assert "Traceback" not in done.stderr
    recording = Recording(tmp_path / "walk")
    assert not recording.complete
    assert recording.topics["/noise"].message_count > 20


@pytest.mark.parametrize("cut", [9, 60, 300, 1000])
def test_a_cut_file_is_read_up_to_the_cut_and_repaired(tmp_path: Path, cut: int) -> None:
    bag = BagWriter(tmp_path / "walk")
    topic = text_topic()
    for number in range(40):
        bag.write(topic, number, number, number, serialize_message(String(data=f"text {number}")))
        bag.flush()
    whole = bag.path.stat().st_size
    assert whole > 1000 + cut
    with bag.path.open("r+b") as file:
        file.truncate(whole - cut)

    recording = Recording(tmp_path / "walk")
    assert not recording.complete
    texts = list(recording.read()["/chatter"]["data"])
    assert 0 < len(texts) <= 40
    assert len(texts) < 40 or cut < 100
    assert texts == [f"text {number}" for number in range(len(texts))]

    cut_file = bag.path.read_bytes()
    done = repair(tmp_path / "walk")
    assert done.message_count == len(texts)
    assert done.backup is not None and done.backup.read_bytes() == cut_file
    names = sorted(path.name for path in (tmp_path / "walk").iterdir())
    assert names == ["metadata.yaml", "walk_0.mcap", "walk_0.mcap.orig"]
    assert Recording(tmp_path / "walk").complete
    with AnyReader([tmp_path / "walk"]) as reader:
        assert [reader.deserialize(data, connection.msgtype).data for connection, _, data in reader.messages()] == texts
        assert reader.connections[0].ext.offered_qos_profiles[0].durability.name == "TRANSIENT_LOCAL"


def test_repair_leaves_a_whole_recording_alone(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / "walk")
    write_text(bag, 5)
    bag.close()
    before = bag.path.read_bytes()
    done = repair(tmp_path / "walk")
    assert (done.message_count, done.backup) == (5, None)
    assert bag.path.read_bytes() == before


def test_repair_of_a_renamed_recording_keeps_the_name_of_its_file(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / "walk")
    write_text(bag, 5)
    bag.flush()
    (tmp_path / "walk").rename(tmp_path / "trot")
    assert repair(tmp_path / "trot").message_count == 5
    with AnyReader([tmp_path / "trot"]) as reader:
        assert reader.message_count == 5


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda path: None, "does not exist"),
        (lambda path: path.mkdir(), "holds 0 .mcap files"),
        (lambda path: path.write_text("hello, this is a text"), "is no MCAP file"),
        (lambda path: path.write_bytes(b""), None),
    ],
)
def test_what_is_no_recording_is_said(tmp_path: Path, make, message: str | None) -> None:
    make(tmp_path / "thing")
    if message is None:
        assert not Recording(tmp_path / "thing").complete
        return
    with pytest.raises(RecordingError, match=message):
        Recording(tmp_path / "thing")


def test_arrays_have_named_columns(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / "walk")
    servos = Topic("/servo_states", "nermo_interfaces/msg/ServoStates", ros2msg("nermo_interfaces/msg/ServoStates"))
    feet = Topic("/truth/feet", "nermo_interfaces/msg/FootForces", ros2msg("nermo_interfaces/msg/FootForces"))
    bag.write(servos, 1, 1, 1, servo_states([0.1, 0.2], ["a", "b"]))
    bag.write(servos, 2, 2, 2, servo_states([0.4, 0.3], ["b", "a"]))
    force = [Vector3(x=float(leg), z=0.5) for leg in range(4)]
    bag.write(feet, 3, 3, 3, serialize_message(FootForces(force=force, contact=[True, False, True, True])))
    bag.close()
    data = Recording(tmp_path / "walk").read()
    states = data["/servo_states"]
    np.testing.assert_array_equal(states.stamp, [3_000_000_005] * 2)
    np.testing.assert_allclose(states["position"], [[0.1, 0.2], [0.4, 0.3]])
    np.testing.assert_allclose(states.by_name("position", ["b", "a"]), [[0.2, 0.1], [0.4, 0.3]])
    assert np.isnan(states.by_name("position", ["c"])).all()
    np.testing.assert_allclose(data["/truth/feet"]["force.x"], [[0.0, 1.0, 2.0, 3.0]])
    np.testing.assert_array_equal(data["/truth/feet"]["contact"], [[True, False, True, True]])
    with pytest.raises(RecordingError, match="has no field angle; it has .*position"):
        states["angle"]


def test_arrays_of_changing_length_stay_rows(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / "walk")
    servos = Topic("/servo_states", "nermo_interfaces/msg/ServoStates", ros2msg("nermo_interfaces/msg/ServoStates"))
    bag.write(servos, 1, 1, 1, servo_states([0.1], ["a"]))
    bag.write(servos, 2, 2, 2, servo_states([0.4, 0.3], ["b", "a"]))
    bag.close()
    position = Recording(tmp_path / "walk").read(["/servo_states"])["/servo_states"]["position"]
    assert [list(row) for row in position] == [[0.1], [0.4, 0.3]]


def test_topics_are_found_in_any_namespace(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / "walk")
    for name in ("/nermo/odom", "/nermo/truth/odom", "/left/clock", "/right/clock"):
        write_text(bag, 1, text_topic(name))
    bag.close()
    recording = Recording(tmp_path / "walk")
    assert recording.topic_ending("odom") == "/nermo/odom"
    assert recording.topic_ending("truth/odom") == "/nermo/truth/odom"
    with pytest.raises(RecordingError, match="/left/clock, /right/clock for clock"):
        recording.topic_ending("clock")
    with pytest.raises(RecordingError, match="no topic imu"):
        recording.topic_ending("imu")
    with pytest.raises(RecordingError, match="has no topic /imu; its topics: /left/clock"):
        recording.read(["/imu"])


def test_a_backlog_past_its_limit_is_dropped_and_counted(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / "walk")
    writer = BackgroundWriter(bag, backlog_bytes=100)
    topic = text_topic()
    data = serialize_message(String(data="x" * 200))
    assert not writer.put(Message(topic, 1, 1, 1, data))
    assert writer.put(Message(topic, 2, 2, 2, serialize_message(String(data="y"))))
    writer.close()
    assert (writer.written, writer.dropped, writer.backlog) == (1, 1, 0)
    assert list(Recording(tmp_path / "walk").read()["/chatter"]["data"]) == ["y"]


def test_the_background_writer_keeps_the_order(tmp_path: Path) -> None:
    writer = BackgroundWriter(BagWriter(tmp_path / "walk"), flush_period=0.0)
    topic = text_topic()
    for number in range(500):
        writer.put(Message(topic, number, number, number, serialize_message(String(data=str(number)))))
    writer.close()
    assert list(Recording(tmp_path / "walk").read()["/chatter"]["data"]) == [str(number) for number in range(500)]


offers = st.builds(
    Offer,
    reliability=st.sampled_from(["reliable", "best_effort"]),
    durability=st.sampled_from(["volatile", "transient_local"]),
    depth=st.integers(0, 2000),
)


@given(st.lists(offers, min_size=1))
def test_a_request_can_hear_every_publisher(publishers: list[Offer]) -> None:
    request = request_for(publishers)
    for offer in publishers:
        assert not request.reliable or offer.reliability == "reliable"
        assert not request.transient_local or offer.durability == "transient_local"
        assert request.depth >= max(offer.depth, MINIMUM_DEPTH)


def test_a_request_to_equal_publishers_is_as_strong_as_they_are() -> None:
    assert request_for([LATCHED, LATCHED]) == Request(reliable=True, transient_local=True, depth=MINIMUM_DEPTH)


@pytest.mark.parametrize(
    ("include", "exclude", "topic", "expected"),
    [
        ("*", "", "/nermo/odom", True),
        ("*", "*/odom", "/nermo/odom", False),
        ("/clock /nermo/*", "", "/clock", True),
        ("/clock /nermo/*", "", "/tf", False),
        ("*", "", "/nermo/_action/feedback", False),
        ("* /*/_action/*", "", "/nermo/_action/feedback", True),
    ],
)
def test_topic_patterns(include: str, exclude: str, topic: str, expected: bool) -> None:
    assert TopicFilter(include, exclude)(topic) is expected


def test_losses_are_the_gaps_of_each_publisher() -> None:
    losses = LossCounter()
    for publisher, sequence in [(b"a", 7), (b"a", 8), (b"b", 100), (b"a", 11), (b"b", 101)]:
        losses.see(publisher, sequence)
    assert losses.lost == 2


def test_a_dated_directory_is_always_new(tmp_path: Path) -> None:
    names = set()
    for _ in range(3):
        directory = dated_directory(tmp_path)
        directory.mkdir()
        names.add(directory)
    assert len(names) == 3


@pytest.mark.parametrize(
    ("schema", "words"),
    [
        (b"\xff\xfe", "its schema cannot be read: 'utf-8' codec"),
        (b"float64[ x", "its schema cannot be read: Could not parse"),
        (b"nowhere/Thing thing", "its schema does not say what nowhere/msg/Thing is"),
        (b"float64[100] x", "a message does not fit its schema"),
    ],
)
def test_a_schema_that_cannot_be_used_is_said_with_file_and_topic(tmp_path: Path, schema: bytes, words: str) -> None:
    path = tmp_path / "other.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("/thing", "cdr", writer.register_schema("a/msg/B", "ros2msg", schema))
        writer.add_message(channel, log_time=1, publish_time=1, data=b"\x00\x01\x00\x00" + bytes(8))
        writer.finish()
    with pytest.raises(RecordingError) as error:
        Recording(path).read()
    said = str(error.value)
    assert said.startswith(f"{path}: topic /thing of type a/msg/B: {words}")
    assert len(said) < 500 and "\n" not in said


def test_a_recording_from_before_readings_had_names_is_read_as_one_of_today(tmp_path: Path) -> None:
    name = "nermo_interfaces/msg/Tactile"
    old = "std_msgs/Header header\nfloat64[4] piezoresistive\nfloat64[4] piezoelectric"
    header = ros2msg("std_msgs/msg/Header")
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(old, name))
    stamp = store.types["std_msgs/msg/Header"](store.types["builtin_interfaces/msg/Time"](7, 5), "base_link")
    message = store.types[name](stamp, np.array([1.0, 2.0, 3.0, 4.0]), np.array([-1.0, -2.0, -3.0, -4.0]))
    schema = f"{old}\n{'=' * 80}\nMSG: std_msgs/Header\n{header}"
    bag = BagWriter(tmp_path / "old")
    bag.write(Topic("/nermo/tactile", name, schema, "", [LATCHED]), 7, 7, 0, bytes(store.serialize_cdr(message, name)))
    bag.close()
    data = Recording(tmp_path / "old").read()["/nermo/tactile"]
    assert data.stamp.tolist() == [7_000_000_005]
    assert data.by_name("voltage", ["rear_left_piezoresistive", "front_right_piezoelectric"]).tolist() == [[3.0, -2.0]]
