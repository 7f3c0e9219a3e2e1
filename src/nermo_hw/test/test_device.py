"""The emulated electronics in virtual time: packets in, packets out, servos that move or go limp."""

from __future__ import annotations

import math
import random
import struct
from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nermo_description.robots import load_robot
from nermo_hw.device.device import DeviceSettings
from nermo_hw.device.fault_injection import FaultError
from nermo_hw.device.plant import ServoPlant
from nermo_hw.device.servo_boards import ServoBoards
from nermo_hw.sbcp import boards
from nermo_hw.sbcp.packet import DeviceClass, Instruction, Packet, Status
from nermo_hw.sbcp.parser import Parser
from nermo_hw.types import Fault

MS = 1_000_000
NERMO = load_robot("nermo")
NEUTRAL = np.array([servo.neutral for servo in NERMO.servos.values()])
SERVO_BOARD = int(DeviceClass.SERVO_BOARD)
PLACES = {
    (number, channel): list(NERMO.servos).index(name)
    for number, names in boards.SERVO_BOARDS.items()
    for channel, name in enumerate(names)
    if name is not None
}


class Host:
    """Talks to a device in a time of its own."""

    def __init__(self, **settings: float) -> None:
        self.device = ServoBoards(NERMO, ServoPlant(NERMO), DeviceSettings(**settings))
        self.now = 0
        self.sequence = 0

    def transfer(self, *packets: Packet, wait_ms: float = 5.0) -> list[Packet]:
        """Sends packets together; what came back within a while."""
        self.device.receive(b"".join(packet.encode() for packet in packets), self.now)
        self.now += round(wait_ms * MS)
        return Parser().feed(self.device.collect(self.now))

    def exchange(self, targets: np.ndarray | None = None, flags: int = 0x0F, wait_ms: float = 5.0) -> list[Packet]:
        self.sequence = (self.sequence + 1) & 0xFF
        packets = []
        for number in boards.SERVO_BOARDS:
            angles = [0.0] * 4
            for channel in range(4):
                if targets is not None and (number, channel) in PLACES:
                    angles[channel] = targets[PLACES[number, channel]]
            point = boards.POINT if targets is not None else 0
            request = boards.ServoRequest(self.sequence, flags | point, tuple(angles))
            packets.append(Packet(SERVO_BOARD, number, Instruction.EXCHANGE, request.encode()))
        acknowledge = flags & boards.ACKNOWLEDGE
        body = boards.BodyRequest(self.sequence, acknowledge)
        packets.append(Packet(*boards.BODY_BOARD, Instruction.EXCHANGE, body.encode()))
        return self.transfer(*packets, wait_ms=wait_ms)

    def release(self) -> None:
        self.exchange(flags=boards.ACKNOWLEDGE | 0x0F)

    def walk(self, cycles: int, targets: np.ndarray = NEUTRAL) -> list[boards.ServoAnswer]:
        """Exchanges at 200 Hz; the last answers of the servo boards."""
        for _ in range(cycles):
            packets = self.exchange(targets)
        return [boards.ServoAnswer.decode(packet.payload) for packet in packets[:4]]

    def read(self, address: tuple[int, int], register: int, kind: str = "<I") -> int:
        (answer,) = self.transfer(Packet(*address, Instruction.GET, bytes((register,))))
        return struct.unpack(kind, answer.payload)[0]

    def positions(self) -> np.ndarray:
        return self.device.plant.sensors().positions


@pytest.fixture
def host() -> Host:
    return Host()


def test_servos_are_limp_until_the_start_is_acknowledged_then_they_go_where_they_are_told(host):
    goal = NEUTRAL + 0.1
    host.walk(20, goal)
    np.testing.assert_allclose(host.positions(), NEUTRAL, atol=1e-6)
    assert boards.ServoAnswer.decode(host.exchange()[0].payload).faults & Fault.RESTARTED
    host.release()
    answers = host.walk(40, goal)
    np.testing.assert_allclose(host.positions(), goal, atol=2e-3)
    assert [answer.energised for answer in answers] == [0b0111, 0b0111, 0b1111, 0b0111]
    assert answers[0].faults & 0xFF == 0
    np.testing.assert_allclose(answers[0].positions[:2], goal[:2], atol=2e-3)


def test_a_transfer_takes_the_time_that_its_bytes_need_on_the_bus(host):
    host.exchange(wait_ms=0.0)
    sent = 4 * (boards.SERVO_REQUEST_SIZE + boards.SERVO_ANSWER_SIZE + 12)
    sent += boards.BODY_REQUEST_SIZE + boards.BODY_ANSWER_SIZE + 12
    expected = sent * boards.BITS_PER_BYTE / boards.BUS_BAUD + 5 * boards.REPLY_DELAY
    assert (host.device.next_output() - host.now) * 1e-9 == pytest.approx(expected, abs=1e-7)


def test_the_watchdog_makes_servos_limp_and_stays_until_acknowledged(host):
    host.release()
    host.walk(20, NEUTRAL + 0.1)
    host.device.advance(host.now + 490 * MS)
    assert all(board.energised for board in host.device.servo_boards)
    host.now += 510 * MS
    host.device.advance(host.now)
    assert not any(board.energised for board in host.device.servo_boards)
    answers = host.walk(3)
    assert all(answer.faults & Fault.WATCHDOG and answer.energised == 0 for answer in answers)
    host.release()
    assert all(answer.energised and answer.faults & 0xFF == 0 for answer in host.walk(1))


def test_a_brown_out_makes_the_device_deaf_then_limp_and_forgetful(host):
    host.release()
    host.walk(5)
    board = (SERVO_BOARD, 2)
    host.transfer(Packet(*board, Instruction.SET, struct.pack("<BH", 0x10, 9)))
    host.transfer(Packet(*board, Instruction.SET, struct.pack("<BH", 0x12, 250)))
    host.device.brown_out()
    assert host.exchange(NEUTRAL) == []
    host.now += 300 * MS
    answers = [boards.ServoAnswer.decode(packet.payload) for packet in host.exchange(NEUTRAL)[:4]]
    assert all(answer.faults & 0xFF == Fault.RESTARTED and answer.energised == 0 for answer in answers)
    assert host.read(board, 0x10, "<H") == 5  # volatile
    assert host.read(board, 0x12, "<H") == 250  # stored


def test_a_silent_servo_stays_where_it_is_and_is_named(host):
    host.release()
    host.walk(10)
    host.device.set_silent_servos(["rear_left_knee"])
    answers = host.walk(40, NEUTRAL + 0.2)
    assert answers[2].energised >> 4 == 0b0010
    assert answers[2].faults & Fault.SILENT_SERVO
    knee = list(NERMO.servos).index("rear_left_knee")
    assert host.positions()[knee] == pytest.approx(NEUTRAL[knee], abs=0.02)
    host.device.set_silent_servos([])
    answers = host.walk(40, NEUTRAL + 0.2)
    assert answers[2].faults & 0xFF == 0
    assert host.positions()[knee] == pytest.approx(NEUTRAL[knee] + 0.2, abs=0.02)


def test_sensors_without_a_reading_say_so_and_the_servo_goes_on_moving(host):
    host.release()
    host.device.set_unreadable(["tail", "battery"])
    answers = host.walk(40, NEUTRAL + 0.2)
    told = np.array([answers[3].positions, answers[3].velocities, answers[3].currents])
    assert np.isnan(told).tolist() == [[False, False, True, False]] * 3
    assert host.positions()[list(NERMO.servos).index("tail")] == pytest.approx(0.2, abs=0.02)
    body = boards.BodyAnswer.decode(host.exchange()[4].payload)
    assert math.isnan(body.voltage) and math.isnan(body.current)
    assert np.isfinite(body.angular_velocity).all()
    host.device.set_unreadable([])
    assert np.isfinite(host.walk(1)[3].positions).all()


def test_a_reading_is_off_by_an_angle_where_its_servo_is_not(host):
    host.release()
    host.device.set_angle_error("tail", 2.0)
    answers = host.walk(40, NEUTRAL + 0.2)
    assert answers[3].positions[2] == pytest.approx(2.2, abs=0.02)
    assert host.positions()[list(NERMO.servos).index("tail")] == pytest.approx(0.2, abs=0.02)
    with pytest.raises(FaultError, match="within -3 and 3"):
        host.device.set_angle_error("tail", 4.0)
    with pytest.raises(FaultError, match="front_left_toe is unknown"):
        host.device.set_angle_error("front_left_toe", 0.1)


def test_a_silent_board_is_spoken_for_by_the_bus_controller(host):
    host.device.set_silent_boards(["servo board 3"])
    packets = host.exchange()
    assert [packet.code for packet in packets] == [0, 0, Status.NO_ANSWER, 0, 0]
    assert host.read(boards.BUS_CONTROLLER, 0x13) == 1


def test_too_much_current_makes_one_servo_limp(host):
    host.release()
    host.device.set_extra_current("tail", 3.0)
    host.walk(150)
    answers = host.walk(1)
    assert answers[3].faults & 0xFF == Fault.OVER_CURRENT
    assert answers[3].faults >> 8 & 0xF == 0b0100
    assert answers[3].energised == 0b0011
    host.device.set_extra_current("tail", 0.0)
    host.release()
    assert host.walk(1)[3].energised == 0b0111


def test_an_empty_battery_is_told_and_a_dead_one_is_a_brown_out():
    host = Host(brown_out_voltage=6.5)
    host.release()
    host.device.set_charge(0.0)
    host.walk(1)
    body = boards.BodyAnswer.decode(host.exchange()[4].payload)
    assert body.voltage < 6.6
    assert body.faults & Fault.UNDER_VOLTAGE
    host.device.battery.model = host.device.battery.model.__class__(empty=6.0)
    host.walk(5)
    assert host.exchange() == []


def test_points_are_counted_where_clocks_differ():
    """Boards that run 5000 ppm fast lack a point every 200 loops, and say so."""
    host = Host(clock_ppm=5000.0)
    host.release()
    host.walk(400)
    missed = host.read((SERVO_BOARD, 1), 0x18)
    assert 8 <= missed <= 12
    assert host.read((SERVO_BOARD, 1), 0x19) == 0


def test_the_line_can_be_broken_in_every_way_and_the_same_seed_breaks_it_the_same_way():
    def counts() -> dict[str, int]:
        host = Host()
        for name in ("drop", "double", "corrupt", "delay", "garbage", "wrong_id", "replay"):
            host.device.line_faults.set(name, 0.2)
        for _ in range(60):
            host.exchange(NEUTRAL)
        return host.device.state()["line_faults"]

    first = counts()
    assert min(first.values()) > 20
    assert counts() == first


@pytest.mark.parametrize(
    ("name", "value", "text"), [("drip", 0.1, "drip"), ("drop", 1.5, "drop = 1.5"), ("delay_s", -1.0, "delay_s")]
)
def test_a_fault_that_does_not_exist_is_refused(host, name, value, text):
    with pytest.raises(FaultError, match=text):
        host.device.line_faults.set(name, value)


def test_unknown_servos_and_boards_cannot_be_broken(host):
    with pytest.raises(FaultError, match="front_left_toe"):
        host.device.set_silent_servos(["front_left_toe"])
    with pytest.raises(FaultError, match="servo board 9"):
        host.device.set_silent_boards(["servo board 9"])


def test_errors_come_back_by_name(host):
    board = (SERVO_BOARD, 1)
    wrong = (
        Packet(*board, 0x77),
        Packet(*board, Instruction.GET, b"\xee"),
        Packet(*board, Instruction.GET),
        Packet(*board, Instruction.SET, b"\x00\x05"),
        Packet(*board, Instruction.SET, struct.pack("<BH", 0x10, 1)),
        Packet(*board, Instruction.EXCHANGE, b"12"),
        Packet(SERVO_BOARD, 9, Instruction.GET, b"\0"),
    )
    assert [answer.code for answer in host.transfer(*wrong)] == [
        Status.UNKNOWN_INSTRUCTION,
        Status.UNKNOWN_REGISTER,
        Status.WRONG_SIZE,
        Status.READ_ONLY,
        Status.OUT_OF_RANGE,
        Status.WRONG_SIZE,
        Status.NO_ANSWER,
    ]


def test_a_board_gets_another_id_and_two_with_the_same_speak_at_once(host):
    old, new = (SERVO_BOARD, 4), (SERVO_BOARD, 9)
    (answer,) = host.transfer(Packet(*old, Instruction.SET, b"\x01\x09"))
    assert (answer.code, answer.address) == (Status.OK, old)
    host.device.brown_out()
    host.now += 400 * MS
    assert host.read(new, 0x01, "<B") == 9
    (answer,) = host.transfer(Packet(*old, Instruction.GET, b"\x01"))
    assert answer.code == Status.NO_ANSWER
    host.transfer(Packet(*new, Instruction.SET, b"\x01\x03"))
    (answer,) = host.transfer(Packet(SERVO_BOARD, 3, Instruction.GET, b"\x01"))
    assert answer.code == Status.DAMAGED_ANSWER


def test_a_transfer_cut_off_does_not_swallow_the_next(host):
    whole = Packet(SERVO_BOARD, 1, Instruction.GET, b"\x00").encode()
    host.device.receive(whole[:4], host.now)
    host.now += 10 * MS
    assert [answer.payload for answer in host.transfer(Packet(SERVO_BOARD, 1, Instruction.GET, b"\x00"))] == [b"\x02"]


@given(st.integers(0, 2**32), st.integers(1, 300))
@settings(max_examples=20)
def test_no_garbage_from_the_host_breaks_the_device(seed, chunk):
    host, dice = Host(), random.Random(seed)
    stream = b"".join(
        dice.choice((dice.randbytes(dice.randrange(1, 60)), Packet(SERVO_BOARD, 1, 0x10, dice.randbytes(10)).encode()))
        for _ in range(40)
    )
    for at in range(0, len(stream), chunk):
        host.device.receive(stream[at : at + chunk], host.now)
        host.now += dice.randrange(3) * MS
    assert host.device.collect(host.now + MS)
    assert host.exchange()


def test_the_trace_tells_what_the_boards_took(host):
    host.device.trace = True
    host.exchange(NEUTRAL)  # limp: not taken
    host.release()
    host.exchange(NEUTRAL + 0.05)
    (point,) = host.device.points
    np.testing.assert_allclose(point.targets, NEUTRAL + 0.05, atol=boards.ANGLE)


def test_a_long_sleep_of_the_machine_is_skipped_and_told(host):
    host.device.advance(10_000 * MS)
    assert host.device.time >= 9_999 * MS
    assert host.device.skipped == pytest.approx(9_950 * MS, abs=2 * MS)


def test_who_serves_in_real_time_hears_the_line_while_time_is_caught_up(host):
    host.release()
    host.walk(10)
    host.device.trace, host.device.largest_catch_up = True, 3 * MS
    begin = host.now
    for caught_up in (3, 6, 9):
        host.device.advance(begin + 40 * MS)
        assert host.device.time == begin + caught_up * MS
    host.now += 40 * MS
    for _ in range(20):
        (*answers, _) = host.exchange(NEUTRAL)
        assert all(boards.ServoAnswer.decode(answer.payload).faults & 0xFF == 0 for answer in answers)
    assert host.device.skipped == 0
    assert [point.time for point in host.device.points] == [begin + (40 + 5 * cycle) * MS for cycle in range(20)]


def test_a_board_that_is_asked_on_a_slow_bus_runs_no_loop_twice(monkeypatch):
    """The last board of a transfer is asked up to two loops after the first."""
    host = Host(baud=boards.BUS_BAUD // 4)
    loops: Counter[tuple[int, int]] = Counter()
    for board in host.device.servo_boards:
        real = board.interpolator.step
        monkeypatch.setattr(
            board.interpolator, "step", lambda real=real, who=board.address: (loops.update([who]), real())[1]
        )
    host.now = round(0.9 * MS)
    host.walk(200)
    assert all(count <= host.now / MS + 3 for count in loops.values()), loops
    assert min(loops.values()) >= host.now / MS - 3
