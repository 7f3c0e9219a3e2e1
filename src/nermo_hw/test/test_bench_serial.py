"""What `nermo bench serial` claims, on a smaller scale; and the fuzzer."""

from __future__ import annotations

import json

import pytest

from nermo_hw.bench import serial as bench_serial
from nermo_hw.bench.cli import bench_app
from nermo_hw.bench.serial import Scenario, track
from nermo_hw.sbcp.fuzz import fuzz

DURATION = 100.0


@pytest.mark.parametrize(("mismatch", "lead"), [(0.0, 0.0), (50.0, 0.0), (760.0, 0.0), (-50.0, 100.0)])
def test_a_host_that_is_not_slower_than_its_boards_misses_no_point(mismatch, lead):
    row = track(Scenario(mismatch, host_lead_ppm=lead), DURATION)
    assert row["missed_points"] == row["dropped_points"] == [0, 0, 0, 0]
    drift = DURATION * (mismatch + lead) * 1e-6 * 1e3  # loops
    assert row["filled_buffer_steps"] == pytest.approx([drift] * 4, abs=1.5)


def test_a_slower_host_lacks_one_point_for_each_loop_of_drift_and_nobody_feels_it():
    row = track(Scenario(-50.0), DURATION)
    assert row["missed_points"] == pytest.approx([5] * 4, abs=1.5)
    assert row["hiccups"] == [0, 0, 0, 0]


@pytest.mark.parametrize("mismatch", [50.0, -50.0])
def test_without_heuristics_the_servos_hiccup(mismatch):
    on, off = (track(Scenario(mismatch, heuristics), DURATION) for heuristics in (True, False))
    assert min(off["hiccups"]) > 50 * max(on["hiccups"])
    assert min(off["dropped_points"]) > 100


def test_the_line_is_fast_enough_for_500_hz():
    facts = bench_serial.line_facts()
    assert facts["minimum_baud_bit_s"]["thesis_1000_hz"] == pytest.approx(1.28e6)
    assert facts["minimum_baud_bit_s"]["with_body_board_500_hz"] < facts["line_baud_bit_s"]
    assert facts["largest_rate_hz"] > 500.0


def test_the_command_writes_the_keys_that_others_rely_on(tmp_path):
    file = tmp_path / "serial.json"
    with pytest.raises(SystemExit) as end:
        bench_app(args=["serial", "--duration", "2", "--real-time", "0.5", "--json", str(file)], prog_name="bench")
    assert end.value.code == 0
    facts = json.loads(file.read_text())
    keys = {"cycles", "rate_hz", "missed_points", "filled_buffer_steps", "clock_mismatch_ppm", "rtt_ms", "schema"}
    assert keys <= facts.keys()
    assert (facts["cycles"], len(facts["missed_points"])) == (1000, 4)
    assert facts["real_time"]["cycles"] > 0
    assert facts["rtt_ms"]["p50"] > 0.9, "an exchange cannot be faster than its bytes on the line"


@pytest.mark.parametrize("knowing", [True, False])
def test_the_fuzzer_finds_nothing(knowing):
    report = fuzz(100_000, seed=7) if knowing else fuzz(100_000, seed=7, plausible=None)
    assert report.passed, report
    assert report.packets > 800
    assert report.found + report.overlapped == report.packets
    assert report.overlapped <= (0 if knowing else 0.05 * report.packets)
