"""The robot's end as a process without ROS, between a real link and an emulated device on a pseudo-terminal."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml
from emulated import until
from link_rig import PATIENCE_S, WITHOUT_ROS, Rig, Workstation
from pwm_host import need_compiler

from nermo_hw.link.config import DEFAULT

pytestmark = pytest.mark.ros  # one by one: watchdogs and time-outs of real processes do not go with a busy processor


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    made = Rig(tmp_path_factory.mktemp("rig"))
    try:
        until(lambda: made.workstation.states > 10, "sensor data comes")
        yield made
    finally:
        made.close()


def test_it_is_limp_until_released_and_then_follows_the_commands(rig: Rig) -> None:
    assert not rig.energised()
    rig.release()
    rig.move_tail(0.5)


def test_a_board_without_sensors_is_released_and_follows_too(tmp_path: Path) -> None:
    need_compiler()
    rig = Rig(tmp_path, bus="pwm_board")
    try:
        until(lambda: rig.workstation.states > 10, "sensor data comes")
        rig.release()
        rig.move_tail(0.5)
    finally:
        rig.close()


def test_a_stop_lasts_until_nobody_says_stop_and_somebody_releases(rig: Rig) -> None:
    rig.release()
    rig.workstation.stop(True)
    until(lambda: rig.state() == "limp" and not rig.energised(), "it is limp")
    until(lambda: rig.states()[-1]["causes"] == ["emergency_stop"], "and says why")
    refusal = "emergency_stop (pad still says stop: end it there first)"
    until(lambda: rig.workstation.release() == refusal, "the release is refused, and says by whom")
    rig.workstation.stop(False)
    rig.workstation.stop(True)
    until(lambda: rig.workstation.release() == refusal, "it is refused again")
    assert rig.state() == "limp" and not rig.energised()
    rig.workstation.stop(False)
    rig.release()


def test_the_end_of_the_pads_stop_does_not_end_that_of_a_signal(rig: Rig) -> None:
    rig.release()
    rig.process.send_signal(signal.SIGUSR1)
    until(lambda: not rig.energised(), "it is limp")
    seen = rig.workstation.states
    rig.workstation.stop(True)
    rig.workstation.stop(False)
    until(lambda: rig.workstation.states > seen + 100, "it has had time to think about it")
    assert rig.state() == "limp" and not rig.energised()
    rig.release()


def test_a_signal_stops_it_until_it_is_released(rig: Rig) -> None:
    rig.release()
    rig.process.send_signal(signal.SIGUSR1)
    until(lambda: rig.state() == "limp" and not rig.energised(), "it is limp")
    rig.release()


def test_a_second_workstation_does_not_move_it_and_is_named(rig: Rig) -> None:
    rig.release()
    rig.move_tail(0.5)
    other = Workstation(rig.link, "lap")
    other.tail = -0.5
    tails = []

    def refused() -> bool:
        tails.append(rig.tail())
        refusal = "refused: lap has to wait, desk commands until it is silent for 0.5 s"
        return bool(rig.workstation.told.get("robot_end: owner", {}).get("message") == refusal)

    try:
        until(refused, "it is refused and named")
    finally:
        other.close()
    # On a busy machine a command of the first one, or the line, may be late, and the robot holds for a moment.
    rig.release()
    assert [*tails, rig.tail()] == pytest.approx([0.5] * (len(tails) + 1), abs=0.01)


def test_silence_makes_it_hold_then_crouch_and_it_walks_on_by_itself(rig: Rig) -> None:
    # A busy machine may hold up the emulated line meanwhile, which makes the robot limp: then it is tried again.
    for _ in range(5):
        rig.workstation.walking = True
        rig.release()
        before = len(rig.states())
        rig.workstation.walking = False
        until(lambda: rig.state() in ("crouch", "limp"), "it crouches")
        if "line_lost" not in str(rig.states()[before:]):
            break
    assert [entry["state"] for entry in rig.states()[before:]] == ["hold", "crouch"]
    rig.workstation.walking = True
    until(lambda: rig.state() == "follow", "it follows again")
    assert rig.energised()


def test_a_killed_process_leaves_limp_servos_and_its_successor_waits_for_a_release(rig: Rig) -> None:
    rig.release()
    rig.process.send_signal(signal.SIGKILL)
    rig.process.wait()
    until(lambda: not rig.energised(), "the device's watchdog has made the servos limp")
    before = len(rig.states())
    rig.process = rig.start()
    until(lambda: len(rig.states()) > before, "the next one is there")
    assert rig.state() == "limp"
    rig.release()


def test_it_ends_limp_when_it_is_told_to(rig: Rig) -> None:
    rig.release()
    rig.process.send_signal(signal.SIGTERM)
    assert rig.process.wait(PATIENCE_S) == 0
    assert not rig.energised()


@pytest.mark.parametrize(
    ("arguments", "status", "words"),
    [
        (["--port", "/dev/null", "--robot", "cat"], 2, "robot 'cat' does not exist"),
        (["--port", "/dev/null", "--link", "/nowhere.yaml"], 2, "/nowhere.yaml"),
        ([], 2, "--port"),
    ],
)
def test_wrong_usage_is_said_in_one_sentence(arguments: list[str], status: int, words: str) -> None:
    done = subprocess.run([sys.executable, "-c", WITHOUT_ROS, *arguments], capture_output=True, text=True, timeout=120)
    assert done.returncode == status
    assert words in done.stderr
    assert "Traceback" not in done.stderr


def test_a_link_without_its_keys_is_wrong_usage_and_not_tried_again(tmp_path: Path) -> None:
    words = [sys.executable, "-c", WITHOUT_ROS, "--port", "/dev/null"]
    home = {key: value for key, value in os.environ.items() if key != "XDG_CONFIG_HOME"} | {"HOME": str(tmp_path)}
    done = subprocess.run(words, env=home, capture_output=True, text=True, timeout=120)
    assert done.returncode == 2
    assert "ca.pem is missing: `nermo hw keys` makes it" in done.stderr


RADIO = """
import sys
from nermo_hw.link.transport import LinkError
from nermo_hw.link.transports import TRANSPORTS, Carrier
from nermo_hw.robot_end import main

class Radio:
    def __init__(self, config, side): pass
    def tell_refused(self, refused): sys.stderr.write("tells\\n")
    def open(self, receive, answer): raise LinkError("no antenna")
    def close(self): pass

TRANSPORTS["radio"] = Carrier(True, "__main__:Radio")
sys.modules["zenoh"] = None
sys.exit(main())
"""


def test_another_transport_that_encrypts_needs_no_zenoh(tmp_path: Path) -> None:
    settings = yaml.safe_load(DEFAULT.read_text())
    settings["keys"] = "keys"
    settings["robot"]["endpoints"] = settings["workstation"]["endpoints"] = ["radio/here"]
    link = tmp_path / "link.yaml"
    link.write_text(yaml.safe_dump(settings))
    words = ["--port", "/dev/null", "--link", str(link)]
    done = subprocess.run([sys.executable, "-c", RADIO, *words], capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stderr) == (1, "tells\nrobot_end: no antenna\n")
