"""Driver and emulator on a real pseudo-terminal and a real socket."""

from __future__ import annotations

import contextlib
import re
import subprocess
import sys
import threading

import numpy as np
import psutil
import pytest
from emulated import PATIENCE, EmulatedDevice, until
from pwm_host import need_compiler

from nermo_description.robots import load_robot
from nermo_hw.device.fault_injection import FaultError
from nermo_hw.device.setup import EmulatorSettings, make_emulator
from nermo_hw.sbcp.boards import BODY_BOARD
from nermo_hw.serial.calibration import Calibration, Mounting, save_calibration
from nermo_hw.serial.driver import Driver
from nermo_hw.serial.port import find_port, open_port
from nermo_hw.types import Fault, LineError, LineLostError, SensorSample, ServoTargets, SilentLineError

ROBOT = load_robot("nermo_lite")
NEUTRAL = np.array([servo.neutral for servo in ROBOT.servos.values()])
SERVO_BOARD_1 = (2, 1)
BUSES = ["servo_boards", "pwm_board"]


@pytest.fixture(scope="module", params=BUSES)
def device(request, tmp_path_factory):
    """One of each bus for all tests that leave it as it was."""
    if request.param == "pwm_board":
        need_compiler()
    made = EmulatedDevice(tmp_path_factory.mktemp("device"), "--tcp-port", "0", "--bus", request.param)
    yield made
    made.kill()


@pytest.fixture(scope="module")
def boards(tmp_path_factory):
    """One with sensors."""
    made = EmulatedDevice(tmp_path_factory.mktemp("boards"), "--bus", "servo_boards")
    yield made
    made.kill()


def ready(port: object, **settings) -> Driver:
    driver = Driver(ROBOT, str(port), **settings)
    until(lambda: opened(driver), "the device answers")
    set_watchdogs(driver, 10_000)  # a busy machine is no reason to go limp
    driver.release()
    return driver


def set_watchdogs(driver: Driver, milliseconds: int) -> None:
    for address in driver.bus.servo_boards:
        driver.write(address, "watchdog", milliseconds)


def energised(device: EmulatedDevice) -> list[str]:
    return device.control.do("state")["energised"]


def opened(driver: Driver) -> bool:
    try:
        driver.open()
    except LineError:
        return False
    return True


def exchange(driver: Driver, targets: ServoTargets | None = None) -> SensorSample:
    """One that got an answer: on a busy machine one may come too late."""
    samples: list[SensorSample] = []

    def tried() -> bool:
        try:
            samples.append(driver.exchange(targets))
        except SilentLineError:
            return False
        return not samples[-1].missing

    until(tried, "an exchange is answered")
    return samples[-1]


@pytest.mark.parametrize(("bus", "count"), zip(BUSES, (6, 1), strict=True))
def test_who_is_there_and_servos_that_go_where_they_are_told(emulate, bus, count):
    if bus == "pwm_board":
        need_compiler()
    device = emulate("--bus", bus)
    with Driver(ROBOT, str(device.link)) as driver:
        identity = driver.identify()
        assert (identity.robot, identity.protocol_version) == ("nermo_lite", "1.2")
        assert (driver.bus.name, len(identity.boards)) == (bus, count)
        assert exchange(driver, ServoTargets(NEUTRAL)).faults == Fault.RESTARTED
        set_watchdogs(driver, 10_000)
        driver.release()
        goal = NEUTRAL + 0.1

        def arrived() -> bool:
            exchange(driver, ServoTargets(goal))
            there = device.control.do("state")["positions"]
            return np.abs(np.array([there[name] for name in driver.names]) - goal).max() < 5e-3

        until(arrived, "the servos have moved")
        sample = exchange(driver, ServoTargets(goal))
        assert sample.faults == 0 and not sample.limp and sample.missing == ()
        assert sample.elapsed > 0.0
        assert 6.0 < sample.battery_voltage < 8.5
        limp = exchange(driver, ServoTargets(goal, energised=False))
        assert limp.limp and limp.faults == 0
    assert device.end() == 0
    assert not device.link.is_symlink()


def test_what_the_sensors_of_a_board_say_and_what_a_board_without_them_does_not(boards, emulate):
    need_compiler()
    sample = exchange(ready(boards.link))
    np.testing.assert_allclose(sample.servo_positions, NEUTRAL, atol=0.2)
    np.testing.assert_allclose(sample.orientation, [1, 0, 0, 0], atol=1e-3)
    nothing = exchange(ready(emulate("--bus", "pwm_board").link))
    assert np.isnan(nothing.servo_positions).all() and np.isnan(nothing.orientation).all()


def test_over_tcp_as_a_wifi_microcontroller_does_it(device):
    url = re.search(r"socket://\S+", device.greeting)[0]
    driver = ready(url)
    assert not exchange(driver, ServoTargets(NEUTRAL)).limp
    driver.close()


def test_a_calibration_makes_joint_angles_of_what_servos_report(emulate, tmp_path):
    mounting = Calibration(
        robot="nermo_lite",
        servos={"front_left_hip": Mounting(zero=0.2, direction=-1), "tail": Mounting(zero=-0.1)},
        knee_encoders={"rear_left": Mounting(zero=0.3, direction=-1)},
    )
    save_calibration(mounting, tmp_path / "mounting.yaml")
    device = emulate("--bus", "servo_boards", "--mounting", str(tmp_path / "mounting.yaml"))
    sample = exchange(ready(device.link))
    assert sample.servo_positions[0] == pytest.approx(0.2 - NEUTRAL[0], abs=1e-3)
    calibrated = exchange(ready(device.link, calibration=mounting))
    np.testing.assert_allclose(calibrated.servo_positions, NEUTRAL, atol=1e-3)
    assert calibrated.knee_angles[2] == pytest.approx(ROBOT.rear_leg_dynamics.knee.rest, abs=1e-3)


def test_a_pulled_cable_is_told_and_the_servos_are_limp_when_it_is_back(device):
    driver = ready(device.link)
    set_watchdogs(driver, 100)
    exchange(driver, ServoTargets(NEUTRAL))
    device.control.do("unplug", seconds=0.5)
    with pytest.raises(LineLostError, match="is gone"):
        exchange(driver)
    assert not driver.is_open
    until(lambda: opened(driver), "the cable is back")
    assert Fault.WATCHDOG in exchange(driver, ServoTargets(NEUTRAL)).faults
    driver.release()
    assert exchange(driver, ServoTargets(NEUTRAL)).faults == 0


def test_a_host_that_is_killed_leaves_limp_servos(device):
    code = f"""
import numpy as np, sys, time
from nermo_description.robots import load_robot
from nermo_hw.serial.driver import Driver
from nermo_hw.types import ServoTargets, SilentLineError
robot = load_robot("nermo_lite")
driver = Driver(robot, {str(device.link)!r})
while not driver.is_open:
    try:
        driver.open(); driver.release()
    except SilentLineError:  # a busy machine: the device had no turn for half a second
        driver.close()
while True:
    try:
        driver.exchange(ServoTargets(np.zeros(len(robot.servos))))
    except SilentLineError:
        pass
    time.sleep(0.005)
"""
    driver = ready(device.link)
    exchange(driver, ServoTargets(NEUTRAL))
    set_watchdogs(driver, 500)
    driver.close()
    until(lambda: energised(device) == [], "the servos are limp")
    host = subprocess.Popen([sys.executable, "-c", code])
    until(lambda: len(energised(device)) == len(ROBOT.servos), "the servos have power")
    host.kill()
    host.wait()
    until(lambda: energised(device) == [], "the watchdog has made the servos limp")


def test_bad_frames_are_counted_and_survived(device):
    driver = ready(device.link, reply_timeout=0.005)
    for name in ("drop", "double", "corrupt", "garbage", "delay"):
        device.control.do("line_fault", name=name, value=0.05)

    def all_seen() -> bool:
        with contextlib.suppress(SilentLineError):
            driver.exchange(ServoTargets(NEUTRAL))
        counters = driver.counters
        return min(counters.lost, counters.late, counters.corrupt, counters.garbage_bytes) > 5

    until(all_seen, "all kinds of damage were seen")
    for name in ("drop", "double", "corrupt", "garbage", "delay"):
        device.control.do("line_fault", name=name, value=0.0)
    assert exchange(driver, ServoTargets(NEUTRAL)).faults == 0


@pytest.mark.parametrize("fault", ["wrong_id", "replay", "corrupt", "garbage", "delay"])
def test_a_line_on_which_no_frame_is_right_brings_no_sample_and_recovers(device, fault):
    driver = ready(device.link, reply_timeout=0.01)
    exchange(driver, ServoTargets(NEUTRAL))
    device.control.do("line_fault", name=fault, value=1.0)
    try:
        seen = [sample_or_none(driver) for _ in range(30)]
    finally:
        device.control.do("line_fault", name=fault, value=0.0)
    if fault != "garbage":  # between frames it does no harm
        assert [sample for sample in seen if sample is not None and not sample.missing] == []
    assert exchange(driver, ServoTargets(NEUTRAL)).missing == ()


def sample_or_none(driver: Driver) -> SensorSample | None:
    try:
        return driver.exchange(ServoTargets(NEUTRAL))
    except SilentLineError:
        return None


def test_a_silent_board_and_a_silent_servo_are_named(boards):
    driver = ready(boards.link)
    exchange(driver, ServoTargets(NEUTRAL))
    boards.control.do("silent_servos", names=["tail"])
    assert exchange(driver, ServoTargets(NEUTRAL)).silent_servos == ("tail",)
    boards.control.do("silent_servos", names=[])
    boards.control.do("silent_boards", names=["servo board 2"])
    until(lambda: driver.exchange().missing == ("servo board 2",), "the silent board is named")
    boards.control.do("silent_boards", names=[])
    with pytest.raises(FaultError, match="front_left_toe"):
        boards.control.do("silent_servos", names=["front_left_toe"])
    with pytest.raises(FaultError, match="unknown"):
        boards.control.do("explode")


def test_a_brown_out_makes_the_device_forget_and_release_sets_it_up_again(device):
    driver = ready(device.link, point_period=0.01)
    exchange(driver, ServoTargets(NEUTRAL))
    device.control.do("brown_out")
    assert exchange(driver, ServoTargets(NEUTRAL)).faults == Fault.RESTARTED
    assert energised(device) == []
    if driver.bus.name == "servo_boards":
        assert driver.read(SERVO_BOARD_1, "point_period") == 5
    else:
        assert driver.read(driver.bus.body, "watchdog") == 500
    driver.release()
    assert not exchange(driver, ServoTargets(NEUTRAL)).limp
    if driver.bus.name == "servo_boards":
        assert driver.read(SERVO_BOARD_1, "point_period") == 10


def test_stored_registers_outlive_the_device(emulate, tmp_path):
    store = tmp_path / "registers.yaml"
    device = emulate("--bus", "servo_boards", "--store", str(store))
    driver = ready(device.link)
    driver.write(SERVO_BOARD_1, "current_limit", 1234)
    until(lambda: store.exists() and "1234" in store.read_text(), "the register is on the disk")
    device.kill()  # without a last word; its link and its control socket stay behind
    device.start()
    assert ready(device.link).read(SERVO_BOARD_1, "current_limit") == 1234


def test_registers_are_checked_on_both_sides(boards):
    driver = ready(boards.link)
    with pytest.raises(ValueError, match="watchdog = 5: must be 20 to 10000 ms"):
        driver.write(SERVO_BOARD_1, "watchdog", 5)
    with pytest.raises(LineError, match="servo board 1 refused SET: read only"):
        driver.write(SERVO_BOARD_1, "uptime", 5)
    with pytest.raises(KeyError, match="no register 'speed'"):
        driver.read(BODY_BOARD, "speed")


@pytest.mark.parametrize(
    "targets", [np.zeros(3), np.full(len(NEUTRAL), np.nan), np.full(len(NEUTRAL), np.inf), np.zeros((len(NEUTRAL), 1))]
)
def test_targets_that_are_none_are_refused(targets):
    with pytest.raises(ValueError, match="finite positions"):
        Driver(ROBOT, "/dev/null").exchange(ServoTargets(targets))


@pytest.mark.parametrize(
    ("port", "text"),
    [
        ("/dev/no_such_port", "/dev/no_such_port"),
        ("usb:1234", "usb:VID:PID"),
        ("usb:dead:beef", "plugged in"),
        ("socket://127.0.0.1:1", "socket://127.0.0.1:1"),
        ("nonsense://x", "nonsense"),
    ],
)
def test_ports_that_cannot_be_opened_are_told_in_a_sentence(port, text):
    with pytest.raises(LineError, match=text):
        Driver(ROBOT, port).open()


def test_a_port_that_is_not_there_is_said_in_plain_words(tmp_path) -> None:
    with pytest.raises(LineError, match=r"^port \S+/none is not there \(yet\)$"):
        open_port(str(tmp_path / "none"), 0.1, 115_200)


def test_a_plain_port_is_taken_as_it_is():
    assert find_port("/dev/ttyACM3") == "/dev/ttyACM3"


def test_none_of_it_needs_ros_or_mujoco():
    code = (
        "import sys; import nermo_hw.serial.driver, nermo_hw.device.setup, nermo_hw.device.emulator, nermo_hw.cli; "
        "sys.exit(' '.join({'rclpy', 'mujoco', 'nermo_interfaces', 'scipy'} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stderr.strip() == ""


def test_a_mouse_that_says_other_ranges_is_held_to_those_of_the_firmware(emulate, tmp_path):
    need_compiler()
    file = tmp_path / "mouse.yaml"
    file.write_text("name: my_mouse\nbase: nermo_lite\nservos: {tail: {lower: -1.0, upper: 1.5}}\n")
    robot = load_robot(file)
    tail = list(robot.servos).index("tail")
    device = emulate("--robot", str(file))
    driver = ready(device.link)

    def tail_is_at(angle: float) -> bool:
        exchange(driver, ServoTargets(np.where(np.arange(len(NEUTRAL)) == tail, target, NEUTRAL)))
        return abs(device.control.do("state")["positions"]["tail"] - angle) < 5e-3

    target = 0.7
    until(lambda: tail_is_at(0.7), "the tail is where it was told to be")
    target = 1.5
    until(lambda: tail_is_at(ROBOT.servos["tail"].upper), "the tail is held")


def test_a_board_that_starts_anew_when_its_port_is_opened_is_waited_for(tmp_path):
    need_compiler()
    settings = EmulatorSettings(bus="pwm_board", boot_time=1.0, link=str(tmp_path / "device"))
    emulator = make_emulator(settings)
    emulator.device.brown_out()
    thread = threading.Thread(target=emulator.run)
    thread.start()
    try:
        with Driver(ROBOT, settings.link) as driver:
            assert driver.bus.name == "pwm_board"
    finally:
        emulator.stop()
        thread.join()


def test_an_emulator_whose_firmware_has_ended_says_so(emulate):
    need_compiler()
    device = emulate("--bus", "pwm_board")
    (firmware,) = psutil.Process(device.process.pid).children()
    firmware.kill()
    said, _ = device.process.communicate(timeout=PATIENCE)
    assert device.process.returncode == 1
    assert "the firmware has ended" in said and "Traceback" not in said


def test_a_servo_of_nermo_lite_that_sits_the_other_way_round_goes_where_it_is_told(emulate, tmp_path):
    need_compiler()
    hip = ROBOT.servos["front_right_hip"]
    mirrored = {"front_right_hip": Mounting(direction=-1, zero=round(hip.lower + hip.upper + 0.02, 4))}
    calibration = Calibration(robot="nermo_lite", servos=mirrored)
    save_calibration(calibration, tmp_path / "mounting.yaml")
    device = emulate("--mounting", str(tmp_path / "mounting.yaml"))
    driver = ready(device.link, calibration=calibration)
    goal = NEUTRAL - 0.2

    def arrived() -> bool:
        exchange(driver, ServoTargets(goal))
        return abs(device.control.do("state")["positions"]["front_right_hip"] - goal[2]) < 5e-3

    assert driver.names[2] == "front_right_hip"
    until(arrived, "the servo has moved")
