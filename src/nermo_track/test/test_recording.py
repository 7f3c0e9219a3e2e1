"""Recordings with the tracker's poses in them, and films read picture by picture."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from nermo_description.robots import load_robot
from nermo_node.recording_reader import Recording, RecordingError
from nermo_track.commands import recorded_commands
from nermo_track.errors import TrackError
from nermo_track.film import Film
from nermo_track.fuse import Poses
from nermo_track.recording import Source, clock_piece, write_beside


def poses(count: int) -> Poses:
    time = 0.5 + np.arange(count) / 30.0
    place = np.column_stack([0.1 * time, np.zeros(count), np.full(count, 0.045)])
    return Poses(time, place, Rotation.identity(count), np.tile(1e-6 * np.eye(6), (count, 1, 1)))


def write(path: Path, out: Path, count: int = 60) -> str:
    source = Source.at(path)
    recording = Recording(source.bag)
    commands = recorded_commands(recording, load_robot("nermo_lite"))
    return write_beside(source, recording, commands, poses(count), {}, out)


def test_all_is_in_the_order_of_its_times_and_told(bag: Path, tmp_path: Path, start: int) -> None:
    assert write(bag, tmp_path / "out") == "/nermo/tracker/odom"
    copy, original = Recording(tmp_path / "out"), Recording(bag)
    assert copy.complete
    times = [message.log_time for message in copy.raw()]
    assert times == sorted(times)
    assert copy.topics["/nermo/servo_command"].message_count == original.topics["/nermo/servo_command"].message_count
    data = copy.read(["/nermo/tracker/odom"])["/nermo/tracker/odom"]
    np.testing.assert_allclose((data.stamp - start) * 1e-9, poses(60).time, atol=1e-9)
    assert (data.log_time - data.stamp == 2_000_000).all()
    assert set(data["header.frame_id"]) == {"odom"} and set(data["child_frame_id"]) == {"base_link"}
    told = yaml.safe_load((tmp_path / "out" / "metadata.yaml").read_text("utf-8"))["rosbag2_bagfile_information"]
    assert told["message_count"] == len(times)


def test_a_segment_keeps_its_scene(bag: Path, tmp_path: Path) -> None:
    segment = tmp_path / "3_walking"
    shutil.copytree(bag, segment / "recording")
    (segment / "scene.yaml").write_text("segment: walking\n", "utf-8")
    write(segment, tmp_path / "filmed" / "3_walking")
    assert (tmp_path / "filmed" / "3_walking" / "scene.yaml").read_text("utf-8") == "segment: walking\n"
    assert "/nermo/tracker/odom" in Recording(tmp_path / "filmed" / "3_walking" / "recording").topics


def test_the_piece_that_tells_the_clock_is_found_in_the_scene(bag: Path, tmp_path: Path, start: int) -> None:
    segment = tmp_path / "3_walking"
    shutil.copytree(bag, segment / "recording")
    scene, recording = segment / "scene.yaml", Recording(segment / "recording")
    commands = recorded_commands(recording, load_robot("nermo_lite"))
    pieces = [{"name": n, "begin": b, "end": b + 6.0, "looks": [0.35]} for n, b in (("trot", 0.0), ("clock", 6.5))]
    for begun, pieces_told, expected in (
        (start + 250_000_000, pieces, (6.75, 12.75)),
        (None, pieces, (6.5, 12.5)),
        (start, pieces[:1], None),
    ):
        scene.write_text(yaml.safe_dump({"segment": "walking", "begun": begun, "pieces": pieces_told}), "utf-8")
        assert clock_piece(Source.at(segment), commands) == (None if expected is None else pytest.approx(expected))
    assert clock_piece(Source.at(segment / "recording"), commands) is None
    scene.write_text("pieces: [{name: clock, begin: soon, end: 1}]", "utf-8")
    with pytest.raises(RecordingError, match=r"scene.yaml: is no scene of a protocol"):
        clock_piece(Source.at(segment), commands)


def test_a_recording_that_was_cut_will_do(bag: Path, tmp_path: Path) -> None:
    whole = next(bag.glob("*.mcap")).read_bytes()
    cut = tmp_path / "cut"
    cut.mkdir()
    (cut / "cut.mcap").write_bytes(whole[:-200])
    write(cut, tmp_path / "out", 20)
    assert Recording(tmp_path / "out").topics["/nermo/tracker/odom"].message_count == 20


def test_one_film_is_enough(bag: Path, tmp_path: Path) -> None:
    write(bag, tmp_path / "out")
    with pytest.raises(RecordingError, match="has /nermo/tracker/odom already"):
        write(tmp_path / "out", tmp_path / "twice")
    assert not (tmp_path / "twice").exists()


def test_nothing_is_left_of_what_fails(bag: Path, tmp_path: Path) -> None:
    """A segment that holds what cannot be copied."""
    segment = tmp_path / "segment"
    shutil.copytree(bag, segment / "recording")
    other = tmp_path / "file"
    other.write_text("in the way", "utf-8")
    with pytest.raises(RecordingError, match="cannot be written"):
        write(segment, other / "out")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "segment"]


def test_commands_of_another_robot_are_refused(bag: Path) -> None:
    with pytest.raises(RecordingError, match=r"does not command .* of nermo \(--robot\)"):
        recorded_commands(Recording(bag), load_robot("nermo"))


@pytest.mark.parametrize("fps", [29.97, 60.0])
def test_pictures_come_at_the_times_of_their_file(tmp_path: Path, fps: float) -> None:
    path = tmp_path / "film.mp4"
    video = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), fps, (64, 48))
    for grey in range(0, 240, 10):
        video.write(np.full((48, 64, 3), grey, np.uint8))
    video.release()
    time, pictures = zip(*Film(path).pictures(), strict=True)
    np.testing.assert_allclose(time, np.arange(24) / fps, atol=2e-3)
    assert [picture.mean() for picture in pictures] == pytest.approx(list(range(0, 240, 10)), abs=4.0)
    slow = [when for when, _ in Film(path, fps=240.0).pictures()]
    np.testing.assert_allclose(slow, np.arange(24) / 240.0, atol=1e-12)


def test_a_film_without_a_picture_is_refused(tmp_path: Path) -> None:
    (tmp_path / "film.mp4").write_bytes(b"")
    with pytest.raises(TrackError, match="no film that OpenCV can read"):
        Film(tmp_path / "film.mp4")
