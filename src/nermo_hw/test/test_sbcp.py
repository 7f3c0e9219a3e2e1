"""Packets, the parser that finds them in garbage, and registers."""

from __future__ import annotations

import math
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nermo_hw.sbcp import boards, data_sheet, pwm_board, register_tables
from nermo_hw.sbcp.packet import HEADER, MAX_PAYLOAD, OVERHEAD, DeviceClass, Packet, Status, checksum, status_name
from nermo_hw.sbcp.parser import Parser
from nermo_hw.sbcp.registers import Kind, RegisterError, RegisterTable

byte = st.integers(0, 255)
packets = st.builds(Packet, byte, byte, byte, st.binary(max_size=MAX_PAYLOAD))
CLASS = 0x42
"""A device class of these tests: known packets carry it, garbage does not."""
known_packets = st.builds(Packet, st.just(CLASS), byte, byte, st.binary(max_size=MAX_PAYLOAD))


def known(device_class: int, device_id: int, size: int, code: int) -> bool:
    return device_class == CLASS


def test_the_packet_of_figure_5_5_byte_by_byte():
    assert Packet(0x02, 0x03, 0x10, b"\x01\xff").encode() == bytes(
        (HEADER, 0x02, 0x03, 2, 0x10, 0x01, 0xFF, (0x02 + 0x03 + 2 + 0x10 + 0x01 + 0xFF) & 0xFF)
    )
    assert len(Packet(1, 1, 1).encode()) == OVERHEAD


@pytest.mark.parametrize(
    ("fields", "what"), [((256, 1, 1), "device_class"), ((1, -1, 1), "device_id"), ((1, 1, 1, bytes(65)), "65 bytes")]
)
def test_what_does_not_fit_a_packet_is_refused(fields, what):
    with pytest.raises(ValueError, match=what):
        Packet(*fields)


@given(st.lists(packets, max_size=8), st.integers(1, 40))
def test_packets_come_through_whole_however_they_are_cut(sent, chunk):
    parser = Parser()
    stream = b"".join(packet.encode() for packet in sent)
    got = [packet for at in range(0, len(stream), chunk) for packet in parser.feed(stream[at : at + chunk])]
    assert got == sent
    assert (parser.corrupt, parser.garbage_bytes, parser.pending) == (0, 0, 0)


@given(
    st.lists(st.tuples(st.binary(max_size=60), known_packets), max_size=6), st.binary(max_size=60), st.integers(1, 99)
)
def test_packets_between_garbage_are_found_again(pieces, tail, chunk):
    garbage = [part.replace(bytes((CLASS,)), b"\0") for part, _ in pieces]
    stream = b"".join(part + packet.encode() for part, (_, packet) in zip(garbage, pieces, strict=True))
    stream += tail.replace(bytes((CLASS,)), b"\0")
    parser = Parser(known)
    got = [packet for at in range(0, len(stream), chunk) for packet in parser.feed(stream[at : at + chunk])]
    got += parser.flush()
    assert got == [packet for _, packet in pieces]
    assert parser.garbage_bytes + sum(len(packet.encode()) for packet in got) == len(stream)


@given(st.binary(max_size=400))
def test_no_garbage_breaks_the_parser_or_gives_a_wrong_checksum(data):
    parser = Parser()
    for packet in [*parser.feed(data), *parser.flush()]:
        assert packet.encode() in data
    assert parser.pending == 0


@given(known_packets, st.integers(min_value=1), st.integers(1, 255))
def test_a_packet_with_one_damaged_byte_is_not_taken(packet, where, change):
    raw = bytearray(packet.encode())
    raw[1 + where % (len(raw) - 1)] ^= change
    parser = Parser(known)
    # One byte changes the sum, unless it is the size; then the packet ends elsewhere and another must not appear.
    assert packet not in [*parser.feed(bytes(raw)), *parser.flush()]


def test_a_cut_off_packet_does_not_hide_the_next():
    first, second = Packet(CLASS, 1, 2, bytes(40)), Packet(CLASS, 3, 4, b"abc")
    parser = Parser()
    assert parser.feed(first.encode()[:20] + second.encode()) == []
    assert parser.flush() == [second]


def test_of_two_overlapping_frames_with_right_checksums_the_later_is_taken_by_who_knows_what_can_come():
    """The first was cut off after 5 of its 8 bytes of payload; three bytes of the second happen to complete it."""
    second = Packet(CLASS, 7, 1, b"the true one")
    raw = second.encode()
    cut = bytearray(Packet(CLASS, 1, 2, bytes(8)).encode()[:10])
    cut[-1] = (raw[3] - sum(cut[1:-1]) - sum(raw[:3])) % 256
    stream = bytes(cut) + raw
    assert len(Parser().feed(stream)) == 1  # takes the false one
    for chunk in (15, 16, 40):
        parser = Parser(known, prefer_later=True)
        got = [packet for at in range(0, len(stream), chunk) for packet in parser.feed(stream[at : at + chunk])]
        assert got == [second]
        assert parser.garbage_bytes == len(cut)


def test_statuses_have_names():
    assert status_name(Status.READ_ONLY) == "read only"
    assert status_name(0x77) == "status 0x77"


small = st.floats(-3.0, 3.0)


@given(st.integers(0, 255), st.tuples(small, small, small, small))
def test_servo_targets_survive_the_line(sequence, targets):
    request = boards.ServoRequest(sequence, boards.POINT | 0x0F, targets)
    back = boards.ServoRequest.decode(request.encode())
    assert (back.sequence, back.flags) == (sequence, request.flags)
    assert back.targets == pytest.approx(targets, abs=boards.ANGLE / 2 + 1e-12)


def limited(values, largest, lower=None):
    """What a field makes of values; NaN stays."""
    return np.clip(values, -largest if lower is None else lower, largest)


READINGS = 13 + len(boards.TACTILE_CHANNELS)


@given(st.lists(st.floats(-100, 100) | st.just(math.nan), min_size=READINGS, max_size=READINGS))
def test_sensor_data_survives_the_line_or_saturates_and_no_reading_is_told(values):
    answer = boards.ServoAnswer(
        *(7, 0x3F, 0x0511, 2**32 + 5),
        *(np.array(values[start : start + 4]) for start in (0, 4, 8)),
        values[12],
        np.array(values[13:]),
    )
    back = boards.ServoAnswer.decode(answer.encode())
    assert (back.sequence, back.energised, back.faults, back.time) == (7, 0x3F, 0x0511, 5)
    np.testing.assert_allclose(back.positions, limited(values[0:4], 3.2767), atol=boards.ANGLE)
    np.testing.assert_allclose(back.velocities, limited(values[4:8], 32.767), atol=boards.SPEED)
    np.testing.assert_allclose(back.currents, limited(values[8:12], 65.534, 0.0), atol=boards.CURRENT)
    assert back.knee_angle == pytest.approx(limited(values[12], 3.2767), abs=boards.ANGLE, nan_ok=True)
    np.testing.assert_allclose(back.cells, limited(values[13:], 6.5534), atol=boards.TACTILE)


def test_the_body_answer_survives_the_line_with_or_without_an_orientation():
    answer = boards.BodyAnswer(
        1, 4, 99, np.array([0.5, -0.5, 0.5, 0.5]), np.array([0.1, -2, 3]), np.array([0, -1, 9.81]), 7.412, 0.8
    )
    back = boards.BodyAnswer.decode(answer.encode())
    np.testing.assert_allclose(back.orientation, answer.orientation, atol=1e-4)
    np.testing.assert_allclose(back.linear_acceleration, answer.linear_acceleration, atol=boards.ACCELERATION)
    assert (back.voltage, back.current) == pytest.approx((7.412, 0.8))
    lost = boards.BodyAnswer.decode(bytes(boards.BODY_ANSWER_SIZE))
    assert lost.orientation.tolist() == [0.0] * 4, "no orientation is not made one: the supervisor sees to it"
    with pytest.raises(struct.error):
        boards.BodyAnswer.decode(b"")


def test_a_body_board_without_readings_says_so():
    nothing = np.full(3, math.nan)
    back = boards.BodyAnswer.decode(
        boards.BodyAnswer(1, 0, 0, np.full(4, math.nan), nothing, nothing, math.nan, math.nan).encode()
    )
    told = (back.orientation, back.angular_velocity, back.linear_acceleration, [back.voltage, back.current])
    assert np.isnan(np.concatenate(told)).all()


def test_registers_are_read_written_and_outlive_a_restart_where_they_are_stored():
    table = RegisterTable(register_tables.SERVO_BOARD_REGISTERS)
    watchdog, period = 0x12, 0x10
    table.set(watchdog, struct.pack("<H", 250))
    table.set(period, struct.pack("<H", 2))
    assert table.get(watchdog) == struct.pack("<H", 250)
    table.restart()
    assert (table["watchdog"], table["point_period"]) == (250, 5)
    assert RegisterTable(register_tables.SERVO_BOARD_REGISTERS, table.stored)["watchdog"] == 250


@pytest.mark.parametrize(
    ("address", "data", "status"),
    [
        (0x00, b"\x02", Status.READ_ONLY),
        (0xEE, b"", Status.UNKNOWN_REGISTER),
        (0x10, b"\x02", Status.WRONG_SIZE),
        (0x10, struct.pack("<H", 1), Status.OUT_OF_RANGE),
        (0x10, struct.pack("<H", 1001), Status.OUT_OF_RANGE),
    ],
)
def test_a_bad_write_is_refused_by_name_and_changes_nothing(address, data, status):
    table = RegisterTable(register_tables.SERVO_BOARD_REGISTERS)
    with pytest.raises(RegisterError) as refused:
        table.set(address, data)
    assert refused.value.status == status
    assert table["point_period"] == 5


def test_a_text_register_holds_printable_ascii_only():
    table = RegisterTable(register_tables.BODY_BOARD_REGISTERS)
    table.set(0x10, b"nermo_lite".ljust(Kind.TEXT.size, b"\0"))
    assert table["robot"] == "nermo_lite"
    with pytest.raises(RegisterError, match="robot"):
        table.set(0x10, bytes(range(1, 17)))


def test_tables_have_no_address_or_name_twice_and_answers_fit_a_packet():
    for registers in register_tables.REGISTERS.values():
        assert len({r.address for r in registers}) == len({r.name for r in registers}) == len(registers)
        for register in registers:
            register.check(register.default)
    assert max(boards.SERVO_ANSWER_SIZE, boards.BODY_ANSWER_SIZE, pwm_board.ANSWER_SIZE) <= MAX_PAYLOAD


def test_equation_5_1_with_the_numbers_of_the_thesis():
    assert boards.minimum_baud(boards=4, payload=20, frequency=1000.0) == pytest.approx(1.28e6)


def test_the_checksum_leaves_the_header_out():
    body = Packet(DeviceClass.SERVO_BOARD, 4, 0x10, b"xyz").encode()[1:-1]
    assert checksum(body) == sum(body) % 256


def test_the_data_sheet_says_what_the_code_does():
    page = (Path(__file__).parents[3] / "docs" / "sbcp.md").read_text(encoding="utf-8")
    for title, table in data_sheet.tables().items():
        assert table in page, f"{title}: python -m nermo_hw.sbcp.data_sheet"
    assert f"request ({boards.SERVO_REQUEST_SIZE} bytes)" in page
    assert f"answer ({boards.SERVO_ANSWER_SIZE} bytes)" in page
    assert f"answer ({boards.BODY_ANSWER_SIZE} bytes)" in page
    assert f"request ({pwm_board.REQUEST_SIZE} bytes)" in page
    assert f"answer ({pwm_board.ANSWER_SIZE} bytes)" in page
