"""The firmware of the PWM board, built for this machine with sanitizers, in virtual time."""

from __future__ import annotations

import json
import shutil
import struct
import subprocess

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pwm_host import LOWER, MIDDLE, ROBOT, UPPER, PwmHost, need_compiler, need_sanitizers, pulse

from nermo_description.silence import HOLD, WATCHDOG
from nermo_hw.firmware import build, header
from nermo_hw.firmware.cli import bench_app
from nermo_hw.sbcp.boards import ACKNOWLEDGE, POINT
from nermo_hw.sbcp.packet import Instruction, Packet, Status
from nermo_hw.sbcp.pwm_board import (
    ADDRESS,
    CHANNELS,
    FLAGS,
    POWER,
    PULSE,
    STAGGER,
    Answer,
    DamagedPayloadError,
    Request,
    State,
)
from nermo_hw.sbcp.register_tables import PWM_BOARD_REGISTERS
from nermo_hw.types import Fault

NEUTRAL = np.array([servo.neutral for servo in ROBOT.servos.values()])


@pytest.fixture(scope="module")
def running():
    need_sanitizers()
    made = PwmHost()
    yield made
    made.close()


@pytest.fixture
def host(running):
    """A board that has just got power, its supply full; the process is the same in all tests."""
    running.wait(1)
    running.power_up()
    running.firmware.supply(8.0, running.now)
    return running


def test_the_constants_of_the_firmware_are_those_of_the_driver():
    file = build.firmware_folder() / "lib" / "pwm_board" / "constants.hpp"
    assert file.read_text(encoding="utf-8") == header.header(), "python -m nermo_hw.firmware.header"


@pytest.mark.parametrize("wifi", [(), ('-DNERMO_WIFI_SSID="a"', '-DNERMO_WIFI_PASSWORD="b"')])
@pytest.mark.parametrize("core", [2, 3])
def test_what_is_for_the_microcontroller_only_compiles_against_the_names_that_it_uses(core, wifi):
    need_compiler()
    root = build.firmware_folder()
    folders = (word for part in ("host/arduino", "lib/pwm_board") for word in ("-I", str(root / part)))
    command = [build.compiler(), *build.FLAGS, f"-DESP_ARDUINO_VERSION_MAJOR={core}", *wifi, "-fsyntax-only", *folders]
    run = subprocess.run([*command, str(root / "src" / "main.cpp")], capture_output=True, text=True)
    assert run.returncode == 0, run.stderr


def test_the_logic_needs_neither_heap_nor_exceptions_nor_hardware(tmp_path):
    need_compiler()
    if shutil.which("nm") is None:
        pytest.skip("nm is not there, which comes with most compilers")
    root = build.firmware_folder() / "lib" / "pwm_board"
    made = tmp_path / "board.o"
    subprocess.run([build.compiler(), *build.FLAGS, "-O2", "-c", str(root / "board.cpp"), "-o", str(made)], check=True)
    listed = subprocess.run(["nm", "-u", str(made)], capture_output=True, text=True, check=True).stdout
    assert {line.split()[-1] for line in listed.splitlines()} <= {
        "memcpy",
        "memmove",
        "memset",
        "__stack_chk_fail",
        "_GLOBAL_OFFSET_TABLE_",
    }


def test_a_build_that_fails_and_a_machine_without_a_compiler_are_told_in_a_sentence(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CXX", raising=False)
    with pytest.raises(build.FirmwareError, match=r"no C\+\+ compiler"):
        build.host_program("serve")
    monkeypatch.setenv("NERMO_ROOT", str(tmp_path))
    with pytest.raises(build.FirmwareError, match="checkout"):
        build.firmware_folder()


# Getting power


def test_it_starts_limp_and_needs_an_acknowledgement_of_its_own_session(host):
    assert host.last.state == State.FAULT
    for flags in (POWER, POWER | POINT):
        answer = host.exchange(NEUTRAL, flags=flags)
        assert (answer.state, answer.faults, answer.last) == (State.FAULT, Fault.RESTARTED, answer.echo)
        assert not answer.pulses.any()
    stale = host.exchange(NEUTRAL, flags=FLAGS, session=host.session ^ 1)
    assert (stale.state, stale.stale_frames) == (State.FAULT, 1)
    answer = host.exchange(flags=POWER | ACKNOWLEDGE)
    assert (answer.state, answer.faults) == (State.LIMP, 0), "nobody has said where to go"
    assert host.exchange(NEUTRAL).state == State.DRIVING


def test_servos_get_their_first_pulse_one_after_another(host):
    host.exchange(NEUTRAL, flags=POWER | ACKNOWLEDGE)
    for channel in range(CHANNELS):
        on = [bool(width) for width in host.last.pulses]
        assert on == [place <= channel for place in range(CHANNELS)]
        host.wait(STAGGER * 1e3 / 2)
        host.exchange(NEUTRAL)
        host.wait(STAGGER * 1e3 / 2)


# Where servos go


@given(st.lists(st.floats(-4.0, 4.0), min_size=CHANNELS, max_size=CHANNELS))
@settings(max_examples=50, deadline=None)
def test_pulses_are_those_of_the_data_sheet_within_the_ranges_of_the_robot(running, angles):
    running.wait(1)
    running.power_up()
    targets = np.array(angles)
    answer = running.drive(targets, 45)
    clamped = np.clip(np.clip(np.round(targets, 4), -3.2767, 3.2767), LOWER, UPPER)
    np.testing.assert_allclose(running.last.pulses, pulse(clamped), atol=2.0 * PULSE)
    beyond = (targets < LOWER - 1e-4) | (targets > UPPER + 1e-4)
    assert answer.clamped >= 45 * beyond.sum()


def test_a_target_is_reached_in_its_time_at_a_constant_speed(host):
    host.drive(MIDDLE)
    begin = host.last.pulses[0]
    goal = MIDDLE + 0.2
    host.exchange(goal, time=0.1)
    widths = [host.wait(10).pulses[0] for _ in range(12)]
    way = pulse(goal)[0] - begin
    shares = [min((number + 1) / 10.0, 1.0) for number in range(12)]
    np.testing.assert_allclose(widths, [begin + share * way for share in shares], atol=1e-6)


@pytest.mark.parametrize(("limp_ms", "jumps"), [(0, False), (19, False), (20, True)])
def test_a_servo_that_has_missed_no_pulse_is_still_where_it_was(host, limp_ms, jumps):
    host.drive(MIDDLE)
    before = host.last.pulses[0]
    goal = MIDDLE + 0.5
    frames = host.frame(flags=0), host.frame(goal)
    host.send(frames[0])
    host.wait(limp_ms)
    host.send(frames[1])
    assert host.last.pulses[0] == pytest.approx(pulse(goal)[0] if jumps else before, abs=2.0 * PULSE)


def test_no_servo_is_told_to_be_faster_than_it_turns(host):
    host.drive(np.clip(MIDDLE - 9.0, LOWER, UPPER))
    begin = host.last.pulses
    host.exchange(np.clip(MIDDLE + 9.0, LOWER, UPPER), time=0.001)
    host.wait(50)
    fastest = ROBOT.servo_type.max_velocity * 0.05
    np.testing.assert_allclose(host.last.pulses - begin, pulse(MIDDLE + fastest) - pulse(MIDDLE), rtol=0.01)


# Frames that must not count


@pytest.mark.parametrize(
    "fields",
    [{"time": 0.0}, {"time": 0.201}, {"time": 65.0}, {"flags": POWER | 0x02}, {"flags": 0xFF}],
)
def test_what_cannot_be_is_refused_and_changes_nothing(host, fields):
    host.drive(NEUTRAL)
    before = host.last
    (answer,) = host.send(host.frame(NEUTRAL + 0.1, **fields))
    assert answer.code == Status.OUT_OF_RANGE
    assert (host.last.pulses == before.pulses).all()
    host.wait(300)
    host.send(host.frame(NEUTRAL + 0.1, **fields))
    assert host.wait(201).state == State.FAULT, "it has fed no watchdog"


@pytest.mark.parametrize("channel", [0, 5, CHANNELS - 1])
def test_a_target_that_is_no_number_is_refused_with_all_others(host, channel):
    host.drive(NEUTRAL)
    before = host.last.pulses
    targets = NEUTRAL + 0.1
    targets[channel] = np.nan
    (answer,) = host.send(host.frame(targets))
    assert answer.code == Status.OUT_OF_RANGE
    assert (host.wait(20).pulses == before).all()
    assert host.exchange().refused_frames == 1


def test_repeated_and_overtaken_frames_are_stale(host):
    host.drive(NEUTRAL)
    frames = [host.frame(NEUTRAL + 0.01 * number) for number in range(3)]
    for raw in (frames[0], frames[2]):
        host.send(raw)
    host.wait(20)
    before = host.last.pulses
    for raw in (frames[2], frames[1], frames[0]):
        (packet,) = host.send(raw)
        assert Answer.decode(packet.payload).last == host.sequence
    assert (host.wait(20).pulses == before).all()
    assert host.exchange(NEUTRAL).stale_frames == 3


def test_newer_sequences_count_over_the_wrap_and_those_more_than_half_of_all_ahead_are_behind(host):
    host.drive(NEUTRAL)
    for sequence in (0x7000, 0xEFFF, 0xFFFD, 0xFFFE, 0xFFFF, 0, 1, 0x7FFF):
        answer = host.exchange(NEUTRAL, sequence=sequence)
        assert (answer.last, answer.stale_frames) == (sequence, 0)
    for sequence in (0xFFFF, 0x7FFF, 0x7FFE, 0x8000 + 0x7FFF):
        assert host.exchange(NEUTRAL, sequence=sequence).last == 0x7FFF


def test_a_frame_from_before_a_fault_never_moves_a_servo_again(host):
    host.drive(NEUTRAL)
    late = [host.frame(NEUTRAL + 0.3, flags=flags) for flags in (POWER, POWER | ACKNOWLEDGE)]
    host.wait(600)
    assert (host.last.state, host.last.session) == (State.FAULT, host.session + 1)
    for raw in late * 3:
        host.send(raw)
        assert host.last.state == State.FAULT and not host.last.pulses.any()
    assert host.exchange().stale_frames == 7, "this one did not know yet either"
    host.drive(NEUTRAL)
    host.send(late[1])
    np.testing.assert_allclose(host.wait(50).pulses, pulse(NEUTRAL), atol=2.0 * PULSE)


@given(st.integers(0, 36), st.integers(1, 255))
@settings(max_examples=80, deadline=None)
def test_one_wrong_byte_anywhere_and_nothing_moves(running, place, change):
    running.wait(1)
    running.power_up()
    running.drive(NEUTRAL, 45)
    before = running.last.pulses
    raw = bytearray(running.frame(NEUTRAL + 0.1))
    raw[place] ^= change
    running.send(bytes(raw))
    running.wait(3)
    assert (running.wait(20).pulses == before).all()


def test_a_sum_that_is_right_does_not_help_a_wrong_crc(host):
    host.drive(NEUTRAL)
    before = host.last.pulses
    raw = bytearray(host.frame(NEUTRAL))
    raw[20] ^= 0x10
    raw[-1] = sum(raw[1:-1]) & 0xFF
    assert host.send(bytes(raw)) == []
    assert (host.wait(20).pulses == before).all()
    assert host.exchange().bad_frames == 1


@pytest.mark.parametrize("cut", [1, 4, 5, 6, 20, 36])
def test_half_a_frame_swallows_nothing_that_comes_after_a_pause(host, cut):
    host.drive(NEUTRAL)
    assert host.send(host.frame(NEUTRAL + 0.1)[:cut]) == []
    host.wait(3)
    assert host.exchange(NEUTRAL).last == host.sequence


def test_a_frame_may_come_byte_by_byte_and_between_garbage(host):
    host.drive(NEUTRAL)
    got = []
    for byte in b"\xa5\xa5\x00\x04\xa5\x04" + host.frame(NEUTRAL) + b"\xa5\x04\x01":
        got += host.send(bytes([byte]))
        host.now += 11
    assert [Answer.decode(packet.payload).last for packet in got] == [host.sequence]


# Silence and supply


def test_silence_holds_then_makes_limp_at_the_times_of_the_one_table(host):
    host.drive(NEUTRAL)
    host.exchange(NEUTRAL + 0.01, time=0.2)
    passed, seen = 0, {}
    while passed < 700:
        seen.setdefault(host.wait(1).state, passed + 1)
        passed += 1
    assert seen[State.HOLDING] == pytest.approx(HOLD.after * 1e3, abs=1)
    assert seen[State.FAULT] == pytest.approx(WATCHDOG.after * 1e3, abs=1)
    answer = host.exchange(NEUTRAL)
    assert answer.faults == Fault.WATCHDOG and not answer.pulses.any()
    assert host.drive(NEUTRAL).state == State.DRIVING


def test_a_clock_that_is_behind_changes_nothing(host):
    host.drive(NEUTRAL)
    before, now = host.last, host.now
    host.now -= 100_000
    answer = host.exchange(NEUTRAL)
    assert (answer.state, answer.last) == (State.DRIVING, host.sequence)
    assert (host.last.pulses == before.pulses).all()
    host.now = now
    assert host.wait(500).state == State.FAULT


def test_a_host_that_talks_without_points_has_the_servos_held(host):
    host.drive(NEUTRAL)
    before = host.last.pulses
    for _ in range(20):
        answer = host.exchange()
        host.wait(100)
    assert answer.state == State.HOLDING and (answer.pulses == before).all()
    assert host.exchange(flags=0).state == State.LIMP
    assert host.exchange(NEUTRAL).state == State.DRIVING, "what was told limp needs no acknowledgement"


def test_a_low_supply_is_told_and_an_empty_one_makes_limp_as_long_as_it_is_empty(host):
    host.drive(NEUTRAL)
    host.firmware.supply(6.5, host.now)
    host.wait(1)
    assert host.exchange(NEUTRAL).faults == Fault.UNDER_VOLTAGE
    host.firmware.supply(5.9, host.now)
    for _ in range(4):
        host.wait(100)
        assert host.exchange(NEUTRAL).state == State.DRIVING
    host.wait(101)
    answer = host.exchange(NEUTRAL)
    assert answer.state == State.FAULT and answer.faults & Fault.EMPTY_BATTERY
    assert host.exchange(NEUTRAL, flags=POWER | ACKNOWLEDGE).state == State.FAULT
    host.firmware.supply(7.5, host.now)
    host.wait(1)
    assert host.drive(NEUTRAL).faults == 0


def test_a_brown_out_forgets_all_and_needs_a_release(host):
    host.drive(NEUTRAL)
    assert host.ask(Instruction.SET, struct.pack("<BH", 0x12, 9000)).code == Status.OK
    old = host.frame(NEUTRAL, flags=POWER | ACKNOWLEDGE)
    host.firmware.power_up(host.session + 4711, host.now)
    host.send(old)
    assert host.last.state == State.FAULT and not host.last.pulses.any()
    assert struct.unpack("<H", host.ask(Instruction.GET, b"\x12").payload) == (500,)
    answer = host.exchange(NEUTRAL)
    assert answer.faults & Fault.RESTARTED and not answer.pulses.any()
    assert host.drive(NEUTRAL).state == State.DRIVING


def test_a_restart_by_command_is_one(host):
    host.drive(NEUTRAL)
    assert host.ask(Instruction.RESTART).code == Status.OK
    assert host.last.state == State.FAULT and host.last.session == host.session + 1
    assert not host.last.pulses.any()


# Registers


def test_every_register_of_the_data_sheet_is_there_with_its_size_and_access(host):
    for register in PWM_BOARD_REGISTERS:
        answer = host.ask(Instruction.GET, bytes([register.address]))
        assert answer.code == Status.OK
        register.decode(answer.payload)
        written = host.ask(Instruction.SET, bytes([register.address]) + bytes(register.kind.size))
        assert written.code == (Status.OUT_OF_RANGE if register.name == "watchdog" else Status.READ_ONLY)
    addresses = {register.address for register in PWM_BOARD_REGISTERS}
    for unknown in sorted(set(range(256)) - addresses):
        for code in (Instruction.GET, Instruction.SET):
            assert host.ask(code, bytes([unknown])).code == Status.UNKNOWN_REGISTER
    assert host.ask(0x77).code == Status.UNKNOWN_INSTRUCTION
    get, write = Instruction.GET, Instruction.SET
    for code, payload in ((get, b""), (write, b""), (Instruction.EXCHANGE, b"123"), (write, b"\x12")):
        assert host.ask(code, payload).code == Status.WRONG_SIZE


def test_other_devices_are_none_of_its_business(host):
    assert host.send(Packet(2, 1, Instruction.GET, b"\x02").encode()) == []
    assert host.send(Packet(ADDRESS[0], 2, Instruction.GET, b"\x02").encode()) == []


@given(
    st.integers(0, 0xFFFF),
    st.integers(0, 0xFFFF),
    st.integers(0, 0xFF),
    st.integers(0, 0xFFFF),
    st.lists(st.integers(-0x7FFF, 0x7FFF), min_size=CHANNELS, max_size=CHANNELS),
)
def test_a_request_comes_back_as_it_went(session, sequence, flags, milliseconds, angles):
    targets = tuple(angle * 1e-4 for angle in angles)
    request = Request(session, sequence, flags, milliseconds * 1e-3, targets)
    again = Request.decode(request.encode())
    assert (again.session, again.sequence, again.flags) == (session, sequence, flags)
    assert again.time == pytest.approx(request.time)
    np.testing.assert_allclose(again.targets, targets, atol=1e-9)


def test_the_bench_measures_what_it_says(tmp_path, capsys):
    need_sanitizers()
    file = tmp_path / "firmware.json"
    words = ["firmware", "--bytes", "20000", "--trials", "3", "--real-time", "0.5", "--json", str(file)]
    with pytest.raises(SystemExit) as end:
        bench_app(args=words, prog_name="bench")
    assert end.value.code == 0
    facts = json.loads(file.read_text())
    assert facts["fuzz"]["bytes"] >= 20_000 and facts["fuzz"]["passed"]
    assert [(row["state"], row["expected_ms"]) for row in facts["silences"]] == [("HOLDING", 200.0), ("FAULT", 500.0)]
    assert facts["line"]["largest_rate_hz"] > 500.0
    assert facts["real_time"]["cycles"] > 0
    assert facts["real_time"]["rtt_ms"]["p50"] >= facts["line"]["exchange_ms"], "no faster than its bytes on the line"
    assert "HOLDING" in capsys.readouterr().out


@given(st.integers(5, 50), st.integers(1, 255))
@settings(max_examples=50, deadline=None)
def test_an_answer_that_was_damaged_is_not_believed(running, place, change):
    running.wait(1)
    running.power_up()
    (packet,) = running.send(running.frame(NEUTRAL))
    raw = bytearray(packet.encode())
    raw[place] ^= change
    with pytest.raises(DamagedPayloadError):
        Answer.decode(bytes(raw[5:-1]))


@pytest.mark.parametrize("seed", [1, 2])
def test_random_and_mutated_bytes_bring_nothing_about_that_must_not_be(seed):
    need_sanitizers()
    run = subprocess.run(
        [str(build.host_program("fuzz", sanitized=True)), "400000", str(seed)], capture_output=True, text=True
    )
    assert run.returncode == 0, run.stdout + run.stderr
    found = {name: int(value) for name, value in (line.split() for line in run.stdout.splitlines())}
    assert found["accepted"] > 500 and found["driving_loops"] > 10_000
