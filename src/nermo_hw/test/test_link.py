"""The link between two real zenoh sessions, encrypted as in use, and who is turned away at its door."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from emulated import until
from link_door import Door, Intruder, config, free_port

from nermo_description.parameter_files import ParameterError
from nermo_hw.link import stamp
from nermo_hw.link.clock import LinkClock, SteadyClock
from nermo_hw.link.config import DEFAULT, LinkConfig, Side, Topic, load_link
from nermo_hw.link.end import LinkEnd
from nermo_hw.link.keys import KeysError, make_keys
from nermo_hw.link.messages import decode_command, encode_command
from nermo_hw.link.transport import LinkError
from nermo_hw.link.transports import TRANSPORTS, transport_at, words

PATIENCE_S = 60.0
MS = 1_000_000


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("keys")
    make_keys(folder, ["robot", "workstation", "listener"])
    return folder


class Ends:
    """Both ends in this process, each with a clock of its own."""

    def __init__(self, settings: LinkConfig, lead: int = 0) -> None:
        here = SteadyClock()
        self.clock = here
        self.at_robot: list[tuple[str, bytes]] = []
        self.at_workstation: list[tuple[str, bytes]] = []
        self.robot = LinkEnd(settings, Side.ROBOT, self._keep(self.at_robot), lambda: here() + lead)
        self.workstation = LinkEnd(settings, Side.WORKSTATION, self._keep(self.at_workstation), here)

    def _keep(self, place: list[tuple[str, bytes]]) -> Callable[[Topic, bytes, str], None]:
        return lambda topic, payload, _: place.append((topic.name, payload))

    def __enter__(self) -> Ends:
        self.robot.open()
        self.workstation.open()
        until(lambda: self.workstation.link_clock.offset is not None, "the clocks are known")
        return self

    def __exit__(self, *_: object) -> None:
        self.workstation.close()
        self.robot.close()

    def command(self, at: int, position: float = 0.0) -> bytes:
        return encode_command(at, ["tail"], [position])


@pytest.fixture(params=["quic/127.0.0.1:{}?rel=0", "tls/127.0.0.1:{}"])
def encrypted(request: pytest.FixtureRequest, keys: Path) -> Iterator[Ends]:
    # The robot's clock is a day ahead.
    with Ends(config(keys, request.param.format(free_port())), lead=86_400_000 * MS) as ends:
        yield ends


def test_messages_cross_encrypted_and_their_stamps_change_clocks(encrypted: Ends) -> None:
    ends = encrypted
    until(lambda: ends.workstation.send("servo_command", ends.command(ends.clock())) and ends.at_robot, "one came")
    name, payload = ends.at_robot[-1]
    at, names, positions = decode_command(payload)
    assert (name, list(names), list(positions)) == ("servo_command", ["tail"], [0.0])
    assert abs(at - (ends.clock() + 86_400_000 * MS)) < 10_000 * MS

    measured = ends.clock() + 86_400_000 * MS
    until(lambda: ends.robot.send("servo_states", ends.command(measured)) and ends.at_workstation, "data came")
    assert abs(stamp.read(ends.at_workstation[0][1]) - (measured - 86_400_000 * MS)) < 1000 * MS
    assert "workstation" in str(ends.robot.status()["peers"])
    assert abs(float(str(ends.workstation.status()["clock_offset_ms"])) - 86_400_000) < 1000


def test_a_stop_is_a_state_that_is_told_with_every_heartbeat(encrypted: Ends) -> None:
    here, there = encrypted.workstation, encrypted.robot
    there.answer_release(there.stops.release)
    until(lambda: _asked(encrypted) == "", "the service is known")

    here.stops.say(b"\x01", True, "/nermo/teleop")
    until(lambda: there.stops.active, "it came with a heartbeat")
    refusal = "emergency_stop (/nermo/teleop still says stop: end it there first)"
    until(lambda: _asked(encrypted) == refusal, "the release is refused")
    here.stops.say(b"\x01", False)
    here.stops.say(b"\x01", True, "/nermo/teleop")
    here.stops.say(b"\x01", False)
    until(lambda: "waits for a release" in str(there.stops), "its end came")
    until(lambda: _asked(encrypted) == "", "the release is granted")
    assert not there.stops.active and not here.stops.active

    here.stops.press("SIGUSR1")  # begun and ended between two heartbeats
    until(lambda: there.stops.active, "the second stop came")
    there.stops.press("SIGUSR1")
    assert str(there.stops) == "SIGUSR1 has said stop and waits for a release"


def test_the_release_is_asked_for_and_answered_in_words(encrypted: Ends) -> None:
    answers = ["fallen (tilted by 1.5 rad)", ""]
    encrypted.robot.answer_release(lambda: answers.pop(0))
    until(lambda: _asked(encrypted) is not None, "the service is known")
    assert answers == [] or encrypted.workstation.ask_release() == ""


def _asked(ends: Ends) -> str | None:
    try:
        return ends.workstation.ask_release(0.5)
    except LinkError:
        return None


def test_old_malformed_and_too_frequent_messages_are_left_out(encrypted: Ends) -> None:
    ends = encrypted
    assert not ends.workstation.send("servo_command", ends.command(ends.clock() - 300 * MS))
    assert not ends.workstation.send("servo_command", b"\x00\x01")
    ends.robot.send("battery", ends.command(ends.clock()))
    assert not ends.robot.send("battery", ends.command(ends.clock()))
    assert ends.workstation.counters["left_out_stale"] == ends.workstation.counters["left_out_malformed"] == 1
    assert ends.robot.counters["left_out_rate"] == 1
    with pytest.raises(KeyError):
        ends.robot.send("servo_command", b"")


def test_the_workstation_comes_back_when_the_robot_does(keys: Path) -> None:
    settings = config(keys, f"quic/127.0.0.1:{free_port()}?rel=0", lease=0.5)
    with Ends(settings) as ends:
        ends.robot.close()
        until(lambda: not ends.workstation.connected, "the loss is noticed")
        again = LinkEnd(settings, Side.ROBOT, lambda *_: None, ends.clock)
        until(lambda: opens(again), "the port of the session that ended is free")
        try:
            until(lambda: ends.workstation.connected and again.connected, "they found each other again")
        finally:
            again.close()


def opens(end: LinkEnd) -> bool:
    try:
        end.open()
    except LinkError:
        return False
    return True


@pytest.mark.parametrize(
    ("who", "protocol", "words"),
    [
        ("nobody", "quic/127.0.0.1:{}?rel=0", "a peer without a certificate was turned away"),
        ("foreigner", "quic/127.0.0.1:{}?rel=0", "a peer whose certificate is not ours was turned away"),
        ("foreigner", "tls/127.0.0.1:{}", "a peer whose certificate is not ours was turned away"),
        ("listener", "quic/127.0.0.1:{}?rel=0", "listener may not put nermo/servo_command"),
    ],
)
def test_whoever_may_not_command_does_not_and_is_named(
    keys: Path, tmp_path: Path, who: str, protocol: str, words: str
) -> None:
    settings = config(keys, protocol.format(free_port()), observers=["listener"])
    name, folder = who, keys
    if who == "foreigner":  # the right name, from an authority of their own
        name, folder = "workstation", tmp_path
        make_keys(folder, [name])
    tls: dict[str, object] = {"root_ca_certificate": str(keys / "ca.pem"), "verify_name_on_connect": False}
    if who != "nobody":
        tls |= {
            "enable_mtls": True,
            "connect_certificate": str(folder / f"{name}.pem"),
            "connect_private_key": str(folder / f"{name}.key"),
        }
    door = Door(settings)
    intruder = Intruder(settings, tls)
    try:
        assert door.until("away:") == f"away: {words}"
    finally:
        intruder.close()
        door.close()
    assert not [line for line in door.lines if line.startswith("got:")]


def test_a_clock_offset_comes_from_the_shortest_round_trip() -> None:
    clock = LinkClock()
    assert clock.offset is None
    clock.add(0, 1000 * MS + 5 * MS, 10 * MS)
    assert clock.offset == 1000 * MS
    clock.add(100 * MS, 1180 * MS, 200 * MS)  # 80 ms there, 20 ms back: says 1030 ms, and is not believed
    assert clock.offset == 1000 * MS
    assert clock.statistics()["delay_p50_ms"] == pytest.approx(27.5)
    clock.add(10 * MS, 5 * MS, 5 * MS)  # came before it was sent
    assert clock.statistics()["clock_offset_ms"] == pytest.approx(1000.0)


def test_a_stamp_is_read_and_moved_in_place() -> None:
    payload = encode_command(1_234_567_890_123_456_789, ["tail", "head_pan"], [0.25, -1.0])
    assert stamp.read(payload) == 1_234_567_890_123_456_789
    moved = stamp.moved(payload, -2_000_000_001)
    assert decode_command(moved) == (1_234_567_888_123_456_788, ["tail", "head_pan"], [0.25, -1.0])
    assert stamp.moved(payload, -(10**19)) == payload
    for bad in (b"", b"\x00\x01\x00\x00", b"\x07" + payload[1:], payload[:8] + b"\xff" * 4):
        with pytest.raises(ValueError):
            stamp.read(bad)


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        ("robot.endpoints", ["tcp/0.0.0.0:1"], "a link encrypted is quic/ or tls/"),
        ("lease", 0.0, "lease: is 0.0"),
        ("leese", 1.0, "leese: no such field; did you mean 'lease'"),
        ("topics", [{"name": "a b", "type": "x/msg/Y", "to": "robot", "kind": "sensor"}], "topics.0.name"),
        ("topics", [{"name": "a", "type": "x/msg/Y", "to": "workstation", "kind": "command"}], "must go to the robot"),
    ],
)
def test_a_bad_list_names_file_field_and_value(field: str, value: object, words: str) -> None:
    with pytest.raises(ParameterError, match=words) as error:
        load_link(DEFAULT, [(field, value)])
    assert "link.yaml" in str(error.value)


def test_keys_are_made_once_and_are_the_owners(tmp_path: Path) -> None:
    folder = tmp_path / "keys"
    assert {path.name for path in make_keys(folder, ["robot"])} == {"ca.pem", "robot.pem"}
    before = (folder / "robot.key").read_bytes()
    assert [path.name for path in make_keys(folder, ["robot", "workstation"])] == ["workstation.pem"]
    assert (folder / "robot.key").read_bytes() == before
    assert (folder / "robot.key").stat().st_mode & 0o777 == 0o600
    with pytest.raises(KeysError, match="'../x'"):
        make_keys(folder, ["../x"])


def test_missing_keys_say_how_to_make_them(tmp_path: Path) -> None:
    with pytest.raises(LinkError, match="nermo hw keys"):
        LinkEnd(config(tmp_path, "quic/127.0.0.1:1?rel=0"), Side.ROBOT, lambda *_: None, SteadyClock()).open()


def test_keys_and_topics_are_those_of_the_official_bridge() -> None:
    settings = load_link()
    keys = {topic.name: topic.key(settings.namespace) for topic in settings.topics}
    assert keys["servo_command"] == "nermo/servo_command"
    assert keys["imu/data_raw"] == "nermo/imu/data_raw"
    assert keys["/diagnostics"] == "diagnostics"


def test_every_endpoint_that_a_link_may_have_is_carried() -> None:
    assert {*words(encrypts=True), *words(encrypts=False)} == set(TRANSPORTS)
    for word in TRANSPORTS:
        assert callable(transport_at(f"{word}/127.0.0.1:1"))


def test_a_transport_is_imported_where_it_is_used() -> None:
    code = "import sys, nermo_hw.link.end; assert 'zenoh' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)
