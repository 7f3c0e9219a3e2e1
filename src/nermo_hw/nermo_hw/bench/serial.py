"""`nermo bench serial`: C table 5.4 with our numbers.

What the heuristics of C 5.3.3 do to trajectory points is a matter of clocks, so it runs in virtual time: 2000 s in some
seconds. How long an exchange takes is a matter of the machine, so it runs in real time, on a real pseudo-terminal.
"""

from __future__ import annotations

import contextlib
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from nermo_description.results import CommandError
from nermo_description.robots import load_robot
from nermo_hw.device.interpolation import TrajectoryInterpolator
from nermo_hw.sbcp import boards
from nermo_hw.sbcp.boards import BITS_PER_BYTE, BUS_BAUD, REPLY_DELAY, SERVO_BOARDS, minimum_baud
from nermo_hw.sbcp.packet import OVERHEAD
from nermo_hw.sbcp.registers import Value
from nermo_hw.serial.driver import Driver
from nermo_hw.serial.schedule import FixedStepSchedule
from nermo_hw.types import LineError, ServoTargets, SilentLineError

RATE = 500.0
"""[Hz]: the fastest that leaves an interpolation period two loops (C 5.3.3)."""
JITTER = 8e-5
"""Scale of the half-normal lateness of the host's cycles [s]: 99 % are less than 0.21 ms late, as on an idle Linux."""
FLAWS = ("missed_points", "filled_buffer_steps")
"""Registers of servo boards that say how well points came."""
PATIENCE = 30.0
"""For the emulator to come up [s]."""

Progress = Callable[[str, float], None]


@dataclass(frozen=True, slots=True)
class Scenario:
    """One row: how much faster the host's clock runs than the boards', and what is done about it."""

    clock_mismatch_ppm: float
    heuristics: bool = True
    host_lead_ppm: float = 0.0
    """How much faster the host cycles than it says, on purpose."""


SCENARIOS = (
    Scenario(0.0),
    Scenario(50.0),
    Scenario(-50.0),
    Scenario(-50.0, host_lead_ppm=100.0),
    Scenario(760.0),
    Scenario(50.0, heuristics=False),
    Scenario(-50.0, heuristics=False),
)
"""The first is the top level of the JSON. 760 ppm is where one loop of correction at a time makes the thesis's 1500."""


def track(scenario: Scenario, duration: float, seed: int = 0) -> dict[str, Any]:
    """Sends a ramp of points to four boards for a time [s], in virtual time.

    A hiccup is a loop of a board in which its set-point moves more than half faster or slower than the trajectory.
    """
    random = np.random.default_rng(seed)
    cycles = round(duration * RATE)
    ratio = (1.0 + scenario.clock_mismatch_ppm * 1e-6) * (1.0 + scenario.host_lead_ppm * 1e-6)
    sent = np.arange(cycles) / (RATE * ratio) + np.abs(random.normal(0.0, JITTER, cycles))
    bytes_before = (boards.SERVO_REQUEST_SIZE + OVERHEAD) * BITS_PER_BYTE / BUS_BAUD
    period = round(1e9 / RATE / boards.LOOP_PERIOD_NS)
    result: dict[str, Any] = {
        "clock_mismatch_ppm": scenario.clock_mismatch_ppm,
        "host_lead_ppm": scenario.host_lead_ppm,
        "heuristics": scenario.heuristics,
        "cycles": cycles,
        "rate_hz": RATE * (1.0 + scenario.host_lead_ppm * 1e-6),
        "virtual_s": duration,
        "missed_points": [],
        "filled_buffer_steps": [],
        "dropped_points": [],
        "hiccups": [],
    }
    for number in range(len(SERVO_BOARDS)):
        # Loops that a board has run when each point arrives; the phase of its loop is its own.
        arrival = sent + (number + 1) * bytes_before
        loops = np.floor(arrival * 1e3 + random.uniform(0.0, 1.0)).astype(np.int64)
        interpolator = TrajectoryInterpolator(0.0, period, scenario.heuristics)
        hiccups = _run(interpolator, np.diff(loops, append=loops[-1]).tolist(), period)
        result["missed_points"].append(interpolator.missed_points)
        result["filled_buffer_steps"].append(interpolator.filled_buffer_steps)
        result["dropped_points"].append(interpolator.dropped_points)
        result["hiccups"].append(hiccups)
    return result


def _run(interpolator: TrajectoryInterpolator[float], loops: list[int], period: int) -> int:
    """Adds one point a cycle to a ramp of slope 1, with so many loops after each; how many were hiccups.

    The start from rest, before the second point, is none.
    """
    add, step = interpolator.add, interpolator.step
    slow, fast, hiccups, point = 0.5 / period, 1.5 / period, 0, 0.0
    for due in loops:
        point += 1.0
        add(point)
        for _ in range(due):
            step()
            speed = interpolator.speed
            if point > 1.0 and (speed > fast or speed < slow):
                hiccups += 1
    return hiccups


def exchange_in_real_time(
    robot_name: str,
    duration: float,
    progress: Progress | None = None,
    *,
    bus: str = "servo_boards",
    rate: float = RATE,
) -> dict[str, Any]:
    """Exchanges at a rate [Hz] with an emulator, a process of its own, on a pseudo-terminal.

    bus: what the emulated robot has. Raises CommandError where the emulator does not come up.
    """
    robot = load_robot(robot_name)
    neutral = np.array([servo.neutral for servo in robot.servos.values()])
    with tempfile.TemporaryDirectory(prefix="nermo_bench_") as folder:
        link = Path(folder) / "device"
        command = [sys.executable, "-m", "nermo_hw", "emulate", "--robot", robot_name, "--bus", bus]
        command += ["--link", str(link)]
        emulator = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        try:
            driver = _opened(Driver(robot, str(link), point_period=1.0 / rate), emulator)
            return _measure(driver, psutil.Process(emulator.pid), neutral, duration, rate, progress)
        finally:
            emulator.terminate()
            with contextlib.suppress(subprocess.TimeoutExpired):
                emulator.wait(5.0)
            emulator.kill()


def _opened(driver: Driver, emulator: subprocess.Popen[str]) -> Driver:
    deadline = time.monotonic() + PATIENCE
    while True:
        try:
            driver.open()
            return driver
        except LineError as error:
            if emulator.poll() is not None:
                assert emulator.stderr is not None, "it is a pipe"
                raise CommandError(f"the emulator has ended: {emulator.stderr.read().strip()}") from error
            if time.monotonic() > deadline:
                raise CommandError(f"the emulator did not answer within {PATIENCE:g} s: {error}") from error
            time.sleep(0.05)


def _measure(
    driver: Driver,
    emulator: psutil.Process,
    neutral: np.ndarray,
    duration: float,
    rate: float,
    progress: Progress | None,
) -> dict[str, Any]:
    driver.release()
    schedule = FixedStepSchedule(1.0 / rate)
    trips: list[float] = []
    silent = 0
    emulator.cpu_percent()
    own = psutil.Process()
    own.cpu_percent()
    begin = time.monotonic()
    while (passed := time.monotonic() - begin) < duration:
        tick = schedule.wait()
        targets = ServoTargets(neutral + 0.1 * np.sin(2.0 * np.pi * passed))
        before = time.perf_counter()
        try:
            driver.exchange(targets)
            trips.append(time.perf_counter() - before)
        except SilentLineError:
            silent += 1
        if progress is not None and tick.number % 100 == 0:
            progress("exchanging in real time", passed / duration)
    cpu = {"driver": own.cpu_percent(), "emulator": emulator.cpu_percent()}
    if not trips:
        raise CommandError("no exchange was answered: the machine is too busy to measure anything")
    p50, p99, largest = (np.percentile(trips, [50.0, 99.0, 100.0]) * 1e3).tolist()
    counters, jitter = driver.counters, schedule.jitter()
    result = {
        "cycles": len(trips),
        "rate_hz": len(trips) / passed,
        "duration_s": passed,
        "rtt_ms": {"p50": p50, "p99": p99, "max": largest},
        "jitter_ms": {name: value * 1e3 for name, value in jitter.items()},
        "overruns": schedule.overruns,
        "steps_missed": schedule.missed,
        "exchanges_without_answer": silent,
        "frames_lost": counters.lost,
        "frames_late": counters.late,
        "frames_corrupt": counters.corrupt,
        **({name: _of_boards(driver, name) for name in FLAWS} if driver.bus.name == "servo_boards" else {}),
        "cpu_percent": cpu,
    }
    driver.close()
    return result


def _of_boards(driver: Driver, register: str) -> list[Value]:
    return [driver.read(address, register) for address in driver.bus.servo_boards]


def line_facts() -> dict[str, Any]:
    """(5.1) for the thesis's boards and for ours, and how long a transfer keeps the bus busy."""
    payload = boards.SERVO_REQUEST_SIZE + boards.SERVO_ANSWER_SIZE
    body = boards.BODY_REQUEST_SIZE + boards.BODY_ANSWER_SIZE
    count = len(SERVO_BOARDS)
    transfer = count * (payload + 2 * OVERHEAD) + body + 2 * OVERHEAD
    busy = transfer * BITS_PER_BYTE / BUS_BAUD + (count + 1) * REPLY_DELAY
    return {
        "line_baud_bit_s": BUS_BAUD,
        "payload_bytes": payload,
        "transfer_bytes": transfer,
        "minimum_baud_bit_s": {
            "thesis_1000_hz": minimum_baud(4, 20, 1000.0),
            "servo_boards_500_hz": minimum_baud(count, payload, 500.0),
            "servo_boards_1000_hz": minimum_baud(count, payload, 1000.0),
            "with_body_board_500_hz": transfer * 500.0 * BITS_PER_BYTE,
        },
        "bus_time_ms": busy * 1e3,
        "largest_rate_hz": 1.0 / busy,
    }


def bench_serial(
    robot: str = "nermo_lite",
    duration: float = 2000.0,
    real_time: float = 10.0,
    seed: int = 0,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Everything: see the module. duration: of each row in virtual time [s]; real_time: of the exchange [s]."""
    rows = []
    for number, scenario in enumerate(SCENARIOS):
        if progress is not None:
            progress("tracking in virtual time", number / len(SCENARIOS))
        rows.append(track(scenario, duration, seed))
    real = exchange_in_real_time(robot, real_time, progress)
    first = rows[0]
    keys = ("cycles", "rate_hz", "missed_points", "filled_buffer_steps", "clock_mismatch_ppm")
    return {
        **{key: first[key] for key in keys},
        "rtt_ms": real["rtt_ms"],
        "jitter_scale_ms": JITTER * 1e3,
        "rows": rows,
        "real_time": real,
        **line_facts(),
    }
