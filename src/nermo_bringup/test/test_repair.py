"""Cut recordings made whole: nothing is lost, nothing is made up, and what cannot be read is left alone."""

from __future__ import annotations

import os
import random
from pathlib import Path

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from rclpy.serialization import serialize_message
from rosbags.highlevel import AnyReader
from std_msgs.msg import String
from typer.testing import CliRunner

from nermo_bringup.cli import app
from nermo_bringup.recording.errors import RecordingError
from nermo_bringup.recording.repair import repair
from nermo_bringup.recording.salvage import scan
from nermo_bringup.recording.schema import ros2msg
from nermo_bringup.recording.writer import BagWriter, Topic
from nermo_description.results import CommandError
from nermo_node.recording_reader import Recording

MAGIC = b"\x89MCAP0\r\n"


def record(folder: Path, *, close: bool, count: int = 60, every: int = 7) -> Path:
    """Two topics of texts that do not compress, a chunk every few of them; the second comes in the third chunk."""
    bag = BagWriter(folder)
    chance = random.Random(3)
    topics = [Topic(name, "std_msgs/msg/String", ros2msg("std_msgs/msg/String")) for name in ("/first", "/second")]
    for number in range(count):
        text = f"{number} {chance.randbytes(40).hex()}"
        topic = topics[number % 2 if number > 2 * every else 0]
        bag.write(topic, 1000 + number, number, number, serialize_message(String(data=text)))
        if number % every == every - 1:
            bag.flush()
    if close:
        bag.close()
    else:
        bag.flush()
    return bag.path


def texts(path: Path) -> list[tuple[str, str]]:
    """Topic and text by rosbags, which needs a whole bag."""
    with AnyReader([path]) as reader:
        return [(c.topic, reader.deserialize(data, c.msgtype).data) for c, _, data in reader.messages()]


@settings(max_examples=40)
@given(st.floats(0.0, 1.0), st.booleans())
def test_a_file_cut_anywhere_keeps_every_whole_chunk(
    tmp_path_factory: pytest.TempPathFactory, share: float, closed: bool
) -> None:
    """Also in the middle of a chunk, of a message index, of the summary."""
    folder = tmp_path_factory.mktemp("cut") / "walk"
    path = record(folder, close=closed)
    (folder / "metadata.yaml").unlink(missing_ok=True)
    size = path.stat().st_size
    cut = 1000 + round(share * (size - 1001))
    os.truncate(path, cut)
    by_reader = [
        (message.topic, len(message.data)) for message in Recording(folder).raw()
    ]  # the library's own stream reader, which needs no index
    done = repair(folder)
    assert done.message_count == len(by_reader) > 0
    assert (done.backup is None) == (cut == size and closed)
    assert [topic for topic, _ in texts(folder)] == [topic for topic, _ in by_reader]
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None and summary.statistics is not None
    assert summary.statistics.message_count == done.message_count
    assert summary.statistics.message_start_time == 1000
    information = yaml.safe_load((folder / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert information["message_count"] == done.message_count


def test_what_is_read_back_is_what_was_recorded(tmp_path: Path) -> None:
    whole = record(tmp_path / "whole", close=True)
    cut = record(tmp_path / "cut", close=False)
    assert repair(tmp_path / "cut").backup == cut.with_name("cut_0.mcap.orig")
    assert texts(tmp_path / "cut") == texts(tmp_path / "whole")
    assert len(texts(tmp_path / "cut")) == 60
    assert Recording(tmp_path / "cut").complete and Recording(whole).complete


def test_a_damaged_chunk_is_left_out_and_said(tmp_path: Path) -> None:
    path = record(tmp_path / "walk", close=False)
    data = bytearray(path.read_bytes())
    begin = data.index(b"\x28\xb5\x2f\xfd", len(data) // 2)  # of a chunk's compressed bytes
    data[begin + 60] ^= 0xFF
    path.write_bytes(data)
    done = repair(tmp_path / "walk")
    assert done.damaged_chunks == 1
    assert done.message_count == len(texts(tmp_path / "walk")) == 60 - 7
    with (tmp_path / "walk" / "walk_0.mcap").open("rb") as file:
        assert len(list(make_reader(file, validate_crcs=True).iter_messages())) == 53


def test_a_second_repair_changes_nothing(tmp_path: Path) -> None:
    path = record(tmp_path / "walk", close=False)
    repair(tmp_path / "walk")
    before = path.read_bytes()
    assert repair(tmp_path / "walk").backup is None
    assert path.read_bytes() == before


def test_a_whole_file_without_metadata_gets_it_and_stays_as_it_is(tmp_path: Path) -> None:
    path = record(tmp_path / "walk", close=True)
    before = path.read_bytes()
    (tmp_path / "walk" / "metadata.yaml").unlink()
    assert repair(tmp_path / "walk").backup is None
    assert path.read_bytes() == before
    assert len(texts(tmp_path / "walk")) == 60


@pytest.mark.parametrize("content", [MAGIC + random.Random(1).randbytes(3000), MAGIC, MAGIC + bytes(3000), MAGIC * 2])
def test_junk_behind_the_magic_is_refused_and_left_alone(tmp_path: Path, content: bytes) -> None:
    folder = tmp_path / "walk"
    folder.mkdir()
    path = folder / "walk_0.mcap"
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=f"walk_0.mcap holds no message that can be read .*{len(content)} bytes"):
        repair(folder)
    assert [file.name for file in folder.iterdir()] == ["walk_0.mcap"]
    assert path.read_bytes() == content
    done = CliRunner().invoke(app, ["repair", str(folder)])
    assert isinstance(done.exception, CommandError) and done.exception.status == 1


@settings(max_examples=60)
@given(st.binary(max_size=400), st.integers(0, 2000))
def test_no_file_makes_the_scan_fail_but_in_words(
    tmp_path_factory: pytest.TempPathFactory, junk: bytes, place: int
) -> None:
    """Junk in the place of some of a recording's bytes."""
    path = record(tmp_path_factory.mktemp("junk") / "walk", close=False, count=20)
    data = path.read_bytes()
    place %= len(data)
    path.write_bytes(data[:place] + junk + data[place + len(junk) :])
    try:
        salvage = scan(path)
    except RecordingError as error:
        told = str(error)
    else:
        told = f"{path}, {salvage.message_count} messages"
        assert 0 < salvage.message_count <= 20
    assert told.startswith(str(path))


def test_a_backup_is_never_overwritten(tmp_path: Path) -> None:
    path = record(tmp_path / "walk", close=False)
    backup = path.with_name("walk_0.mcap.orig")
    backup.write_text("years of work")
    before = path.read_bytes()
    with pytest.raises(RecordingError, match="exists already: move it away"):
        repair(tmp_path / "walk")
    assert path.read_bytes() == before and backup.read_text() == "years of work"


def test_the_command_says_what_it_did_and_where_the_cut_file_is(tmp_path: Path) -> None:
    record(tmp_path / "walk", close=False)
    done = CliRunner().invoke(app, ["repair", str(tmp_path / "walk")])
    assert done.exit_code == 0
    assert "is whole, with 60 messages; the cut file is kept as" in done.stdout.replace("\n", " ")
    again = CliRunner().invoke(app, ["repair", str(tmp_path / "walk")])
    assert "its file is as it was" in again.stdout
