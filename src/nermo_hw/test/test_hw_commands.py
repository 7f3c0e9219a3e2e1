"""`nermo hw scan`, `calibrate` and `monitor` against an emulated device."""

from __future__ import annotations

import json
import threading

import pytest
from emulated import until
from pwm_host import need_compiler

from nermo_description.parameter_files import ParameterError
from nermo_description.results import CommandError
from nermo_description.robots import load_robot
from nermo_hw import monitor
from nermo_hw.cli import hw_app
from nermo_hw.device.fault_injection import FaultError
from nermo_hw.serial.calibrate import CalibrationError, Calibrator, calibrate
from nermo_hw.serial.calibration import Calibration, Mounting, load_calibration, save_calibration
from nermo_hw.serial.driver import Driver

ROBOT = load_robot("nermo_lite")
MOUNTING = Calibration(
    robot="nermo_lite",
    servos={
        name: Mounting(zero=0.05 * number - 0.2, direction=-1 if number % 3 else 1)
        for number, name in enumerate(ROBOT.servos)
    },
    knee_encoders={"front_left": Mounting(zero=0.25, direction=-1)},
)


def run(*words: str) -> int:
    with pytest.raises(SystemExit) as end:
        hw_app(args=list(words), prog_name="nermo hw")
    return end.value.code


class Hands:
    """Does to an emulated robot what it is told, as soon as the calibration has looked at where it was."""

    def __init__(self, device, driver: Driver, wrong: str = "") -> None:
        self._device, self._driver, self._wrong = device, driver, wrong
        self.told: list[str] = []

    def tell(self, text: str) -> None:
        self.told.append(text)
        name = text.split(":")[0]
        if name in ROBOT.servos and "direction" not in text:
            threading.Thread(target=self._move, args=(self._wrong or name, self._driver.counters.received)).start()
        elif text.startswith("hold"):
            for servo, angle in ROBOT.posture("sit").items():
                self._device.control.do("move_by_hand", servo=servo, position=angle)

    def _move(self, name: str, received: int) -> None:
        until(lambda: self._driver.counters.received >= received + 10, "the calibration has looked twice")
        self._device.control.do("move_by_hand", servo=name, position=ROBOT.servos[name].neutral + 0.35)


def test_a_calibration_finds_how_the_servos_are_mounted(emulate, tmp_path):
    file = tmp_path / "mounting.yaml"
    save_calibration(MOUNTING, file)
    assert load_calibration(file, ROBOT) == MOUNTING
    device = emulate("--bus", "servo_boards", "--mounting", str(file))
    with Driver(ROBOT, str(device.link), reply_timeout=0.1) as driver:
        hands = Hands(device, driver)
        found = calibrate(driver, "sit", None, hands.tell, directions=True, knees=False, timeout=60.0)
        for name, mounting in MOUNTING.servos.items():
            assert found.servos[name].direction == mounting.direction, name
            assert found.servos[name].zero == pytest.approx(mounting.zero, abs=1e-3), name
        rests = {leg: monitor_rest(leg) for leg in ("front_left", "front_right", "rear_left", "rear_right")}
        encoders = Calibrator(driver, print, still_for=0.2).encoders(rests, MOUNTING.knee_encoders)
        assert encoders["front_left"].zero == pytest.approx(0.25, abs=1e-3)
        assert encoders["front_left"].direction == -1
        assert encoders["rear_right"].zero == pytest.approx(0.0, abs=1e-3)


def monitor_rest(leg: str) -> float:
    return (ROBOT.front_leg_dynamics if leg.startswith("front") else ROBOT.rear_leg_dynamics).knee.rest


def test_hands_that_move_the_wrong_servo_are_told_so(emulate):
    device = emulate("--bus", "servo_boards")
    with Driver(ROBOT, str(device.link), reply_timeout=0.1) as driver:
        hands = Hands(device, driver, wrong="tail")
        with pytest.raises(CalibrationError, match="tail was moved while front_left_hip was asked for"):
            Calibrator(driver, hands.tell).directions()
        with pytest.raises(CalibrationError, match="in vain for front_left_hip to move"):
            Calibrator(driver, lambda _: None, timeout=0.2).directions()


def test_a_sensor_without_a_reading_is_not_calibrated(emulate):
    device = emulate("--bus", "servo_boards")
    with Driver(ROBOT, str(device.link), reply_timeout=0.1) as driver:
        device.control.do("unreadable", names=["tail"])
        with pytest.raises(CalibrationError, match="^tail has no reading"):
            Calibrator(driver, print, still_for=0.2).zeros(ROBOT.posture("sit"), dict.fromkeys(ROBOT.servos, 1))


def test_lost_answers_do_not_end_a_calibration_and_a_board_that_is_gone_does(emulate, tmp_path):
    device, signs = emulate("--bus", "servo_boards"), dict.fromkeys(ROBOT.servos, 1)
    with Driver(ROBOT, str(device.link), reply_timeout=0.05) as driver:
        calibrator = Calibrator(driver, print, still_for=0.5)
        device.control.do("line_fault", name="drop", value=0.03)
        assert calibrator.zeros(ROBOT.posture("stand"), signs)["tail"] == pytest.approx(0.0, abs=1e-3)
        until(lambda: calibrator.zeros(ROBOT.posture("stand"), signs) and driver.counters.lost, "an answer is lost")
        device.control.do("line_fault", name="drop", value=0.0)
        device.control.do("silent_boards", names=["servo board 2"])
        with pytest.raises(CalibrationError, match="^servo board 2 does not answer"):
            calibrator.zeros(ROBOT.posture("stand"), signs)
    seen = tmp_path / "now.json"
    assert run("monitor", "--port", str(device.link), "--once", "--json", str(seen)) == 0
    assert json.loads(seen.read_text())["missing_boards"] == ["servo board 2"]


def test_scan_monitor_and_calibrate_from_the_command_line(emulate, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(monitor, "serial_ports", lambda: [str(tmp_path / "empty_port")])
    device = emulate("--bus", "servo_boards")
    link, scanned, seen, out = str(device.link), tmp_path / "scan.json", tmp_path / "now.json", tmp_path / "mouse.yaml"

    assert run("scan", "--port", link, "--timeout", "0.5", "--json", str(scanned)) == 0
    nobody, somebody = json.loads(scanned.read_text())["rows"]
    assert "empty_port" in nobody["error"]
    assert (somebody["robot"], somebody["protocol"], somebody["error"]) == ("nermo_lite", "1.2", None)

    assert run("monitor", "--port", link, "--once", "--json", str(seen)) == 0
    facts = json.loads(seen.read_text())
    assert facts["limp"] and facts["faults"] == ["RESTARTED"]
    assert facts["servos"]["tail"]["position_rad"] == pytest.approx(0.0, abs=1e-3)
    assert "front_left_hip" in capsys.readouterr().out

    assert run("calibrate", "--port", link, "--out", str(out)) == 0
    assert load_calibration(out, ROBOT).servos["tail"] == Mounting()


def test_a_board_without_sensors_is_seen_and_is_not_calibrated(emulate, tmp_path, capsys, monkeypatch):
    need_compiler()
    monkeypatch.setattr(monitor, "serial_ports", lambda: [])
    device = emulate()  # of a nermo_lite: its own board
    link, seen = str(device.link), tmp_path / "now.json"
    assert run("scan", "--port", link, "--timeout", "0.5") == 0
    assert run("monitor", "--port", link, "--once", "--json", str(seen)) == 0
    facts = json.loads(seen.read_text())
    assert facts["blind"] and facts["limp"] and facts["faults"] == ["RESTARTED"]
    assert 6.0 < facts["battery_v"] < 8.5
    assert "no sensors" in capsys.readouterr().out
    with pytest.raises(CommandError, match="reads no angles.*nothing was written"):
        hw_app(
            args=["calibrate", "--port", link, "--out", str(tmp_path / "mouse.yaml")],
            prog_name="nermo hw",
            standalone_mode=False,
        )
    for words, text in (
        (["silent_servos", {"names": ["tail"]}], "a PWM board has nothing that could be so"),
        (["charge", {"value": 2.0}], "within 0 and 1"),
    ):
        with pytest.raises(FaultError, match=text):
            device.control.do(words[0], **words[1])


def test_what_cannot_be_done_is_said_in_a_sentence(tmp_path, monkeypatch):
    monkeypatch.setattr(monitor, "serial_ports", lambda: [])
    out = str(tmp_path / "mouse.yaml")
    for words, text, status in (
        (["scan"], "no serial port", 1),
        (["scan", "--port", "/dev/no_such_port"], "no Nermo", 1),
        (["monitor", "--port", "/dev/no_such_port"], "/dev/no_such_port", 1),
        (["monitor", "--port", "x", "--robot", "elephant"], "elephant", 2),
        (["calibrate", "--port", "/dev/no_such_port", "--out", out], "nothing was written", 1),
        (["calibrate", "--port", "x", "--out", out, "--posture", "headstand"], "headstand", 2),
        (["emulate"], "link, or tcp_port", 2),
        (["emulate", "--tcp-port", "70000"], "tcp_port", 2),
        (["emulate", "--tcp-port", "0", "--bus", "can"], "bus", 2),
        (["emulate", "--tcp-port", "0", "--robot", "nermo", "--bus", "pwm_board"], "no channel for spine_vertical", 2),
        (["emulate", "--tcp-port", "0", "--store", "x.yaml"], "no non-volatile registers", 2),
    ):
        with pytest.raises(CommandError, match=text) as error:
            hw_app(args=words, prog_name="nermo hw", standalone_mode=False)
        assert error.value.status == status, words


@pytest.mark.parametrize(
    ("content", "text"),
    [
        ("robot: nermo", "this robot is 'nermo_lite'"),
        ("robot: nermo_lite\nservos: {toe: {zero: 0.1}}", "unknown toe"),
        ("robot: nermo_lite\nservos: {tail: {zero: 9.0}}", "servos.tail.zero: is 9.0"),
        ("robot: nermo_lite\nservos: {tail: {direction: 0}}", "servos.tail.direction"),
        ("robot: nermo_lite\nknee_encoders: {left: {}}", "unknown leg left"),
    ],
)
def test_a_bad_calibration_file_names_what_is_wrong(tmp_path, content, text):
    file = tmp_path / "mouse.yaml"
    file.write_text(content)
    with pytest.raises(ParameterError, match=text):
        load_calibration(file, ROBOT)
