"""The recorder as a process in a real graph."""

from __future__ import annotations

import signal
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Vector3
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosbags.highlevel import AnyReader
from std_msgs.msg import String
from std_srvs.srv import SetBool
from terminal import PATIENCE_S

from nermo_bringup.recording.errors import RecordingError
from nermo_bringup.recording.repair import repair
from nermo_node import qos
from nermo_node.recording_reader import Recording

RECORDER = "nermo_bringup.nodes.recorder"
BURST = QoSProfile(depth=300, reliability=ReliabilityPolicy.RELIABLE)
"""For many messages at once: with a shorter history those that were not received yet give way to newer ones."""


def count_on_disk(directory: Path, topic: str) -> int:
    """Messages of a topic that could be read if the recorder died now."""
    try:
        found = Recording(directory).topics.get(topic)
    except RecordingError:
        return 0
    return found.message_count if found else 0


def publish(graph, publisher: Publisher, count: int) -> None:
    graph.until(lambda: publisher.get_subscription_count() > 0, f"{publisher.topic_name} is recorded")
    for number in range(count):
        publisher.publish(Vector3(x=float(number)))


def test_every_topic_is_recorded_and_opens_everywhere(graph, tmp_path: Path) -> None:
    latched = graph.node.create_publisher(String, "/nermo/robot", qos.LATCHED)
    latched.publish(String(data="sent long before"))
    sensor = graph.node.create_publisher(Vector3, "/nermo/sensor", BURST)
    unwanted = graph.node.create_publisher(Vector3, "/nermo/unwanted", qos.SENSOR)
    counted: dict[str, int] = {}

    def note(message: DiagnosticArray) -> None:
        counted.update({value.key: int(value.value) for value in message.status[0].values if value.value.isdigit()})

    graph.node.create_subscription(DiagnosticArray, "/diagnostics", note, 10)
    directory = tmp_path / "walk"
    recorder = graph.start(RECORDER, *graph.parameters(directory=str(directory), exclude="*/unwanted"))
    publish(graph, sensor, 300)
    late = graph.node.create_publisher(Vector3, "/nermo/late", 10)
    publish(graph, late, 5)
    graph.until(lambda: count_on_disk(directory, "/nermo/sensor") == 300, "300 messages are on the disk")
    graph.until(lambda: counted.get("messages_written", 0) >= 306, "the recorder reports 306 messages")
    assert counted["messages_dropped"] == counted["messages_lost"] == 0
    assert unwanted.get_subscription_count() == 0
    status, output = graph.stop(recorder, signal.SIGTERM)
    assert status == 0, output

    data = Recording(directory).read(["/nermo/robot", "/nermo/sensor", "/nermo/late"])
    assert list(data["/nermo/robot"]["data"]) == ["sent long before"]
    assert list(data["/nermo/sensor"]["x"]) == list(range(300))
    assert list(data["/nermo/late"]["x"]) == list(range(5))
    assert (data["/nermo/sensor"].log_time >= data["/nermo/sensor"].publish_time).all()
    with AnyReader([directory]) as reader:
        counts = {connection.topic: connection.msgcount for connection in reader.connections}
        assert counts["/nermo/sensor"] == 300
        for connection, _, message in reader.messages():
            reader.deserialize(message, connection.msgtype)


def test_a_killed_recorder_leaves_all_up_to_the_cut(graph, tmp_path: Path) -> None:
    sensor = graph.node.create_publisher(Vector3, "/nermo/sensor", BURST)
    directory = tmp_path / "walk"
    recorder = graph.start(RECORDER, *graph.parameters(directory=str(directory)))
    publish(graph, sensor, 200)
    graph.until(lambda: count_on_disk(directory, "/nermo/sensor") == 200, "200 messages are on the disk")
    recorder.kill()
    recorder.wait()

    assert not Recording(directory).complete
    assert list(Recording(directory).read(["/nermo/sensor"])["/nermo/sensor"]["x"]) == list(range(200))
    repair(directory)
    with AnyReader([directory]) as reader:
        connections = [connection for connection in reader.connections if connection.topic == "/nermo/sensor"]
        assert [
            reader.deserialize(data, connection.msgtype).x for connection, _, data in reader.messages(connections)
        ] == list(range(200))


def test_a_topic_whose_publishers_change_is_still_heard(graph, tmp_path: Path) -> None:
    reliable = graph.node.create_publisher(Vector3, "/nermo/sensor", qos.COMMAND)
    directory = tmp_path / "walk"
    graph.start(RECORDER, *graph.parameters(directory=str(directory)))
    publish(graph, reliable, 1)
    graph.until(lambda: count_on_disk(directory, "/nermo/sensor") == 1, "the reliable publisher was heard")
    best_effort = graph.node.create_publisher(Vector3, "/nermo/sensor", qos.BEST_EFFORT)
    publish(graph, best_effort, 3)
    graph.until(lambda: count_on_disk(directory, "/nermo/sensor") == 4, "the best-effort publisher was heard")


def test_a_recorder_that_waits_records_when_it_is_asked_to_and_each_time_anew(graph, tmp_path: Path) -> None:
    sensor = graph.node.create_publisher(Vector3, "/nermo/sensor", BURST)
    told: dict[str, str] = {}

    def note(message: DiagnosticArray) -> None:
        told.update({status.name: status.message for status in message.status})

    graph.node.create_subscription(DiagnosticArray, "/diagnostics", note, 10)
    client = graph.node.create_client(SetBool, "/recorder/record")
    first = tmp_path / "first"
    recorder = graph.start(RECORDER, *graph.parameters(directory=str(first), waits=True))

    def ask(on: bool) -> SetBool.Response:
        future = client.call_async(SetBool.Request(data=on))
        graph.until(future.done, "the recorder answers")
        return future.result()

    graph.until(client.service_is_ready, "the recorder is there")
    graph.until(lambda: told.get("recorder: recording") == "waits", "it waits")
    assert sensor.get_subscription_count() == 0 and not first.exists()
    assert not ask(False).success
    assert ask(True).message == f"recording into {first}"
    assert not ask(True).success
    publish(graph, sensor, 20)
    graph.until(lambda: count_on_disk(first, "/nermo/sensor") == 20, "20 messages are on the disk")
    assert ask(False).message.endswith(f"dropped 0: {first}")
    graph.until(lambda: sensor.get_subscription_count() == 0, "nobody listens")
    sensor.publish(Vector3())
    assert ask(True).success
    publish(graph, sensor, 30)
    (second,) = [folder for folder in tmp_path.iterdir() if folder.is_dir() and folder != first]
    graph.until(lambda: count_on_disk(second, "/nermo/sensor") == 30, "30 messages are on the disk")
    status, output = graph.stop(recorder, signal.SIGTERM)
    assert status == 0, output
    assert Recording(first).topics["/nermo/sensor"].message_count == 20
    assert Recording(second).topics["/nermo/sensor"].message_count == 30


def test_an_existing_directory_is_refused(graph, tmp_path: Path) -> None:
    recorder = graph.start(RECORDER, *graph.parameters(directory=str(tmp_path)))
    output, _ = recorder.communicate(timeout=PATIENCE_S)
    assert recorder.returncode == 1
    assert f"{tmp_path} exists already" in output
    assert "Traceback" not in output
