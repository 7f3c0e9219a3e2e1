"""The simulation node in a real graph of its own."""

from __future__ import annotations

import itertools
import math
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from geometry_msgs.msg import Vector3
from graph import Graph
from nav_msgs.msg import Odometry
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import BatteryState, Imu, JointState
from std_srvs.srv import SetBool

from nermo_description.feet import readings_by_cell
from nermo_interfaces.msg import FootForces, ServoStates, Tactile
from nermo_interfaces.srv import PushRobot, ResetSimulation, StepSimulation

PERIOD = 5_000_000


@pytest.fixture
def graph() -> Iterator[Graph]:
    graph = Graph()
    yield graph
    graph.close()


def nanoseconds(message: object) -> int:
    stamp = message.clock if isinstance(message, Clock) else message.header.stamp  # type: ignore[attr-defined]
    return stamp.sec * 1_000_000_000 + stamp.nanosec


def test_publishes_all_sensors_at_their_rates_and_ends_cleanly(graph: Graph) -> None:
    topics = {
        "/clock": (Clock, PERIOD),
        "servo_states": (ServoStates, PERIOD),
        "truth/odom": (Odometry, PERIOD),
        "imu/data_raw": (Imu, PERIOD),
        "joint_states": (JointState, 4 * PERIOD),
        "tactile": (Tactile, PERIOD),
        "truth/foot_forces": (FootForces, 4 * PERIOD),
        "battery": (BatteryState, 100 * PERIOD),
    }
    heard = {topic: graph.hear(kind, topic) for topic, (kind, _) in topics.items()}
    process = graph.start(real_time_factor=0.5, battery_rate=2.0, frame_prefix="mouse/")
    graph.until(lambda: all(len(messages) >= 2 for messages in heard.values()), "all topics have spoken")
    for topic, (_, period) in topics.items():
        stamps = [nanoseconds(message) for message in heard[topic]]
        assert {late - early for early, late in itertools.pairwise(stamps)} == {period}, topic
    assert heard["imu/data_raw"][0].header.frame_id == "mouse/imu_link"
    assert heard["truth/odom"][0].child_frame_id == "mouse/base_link"
    for covariance in ("orientation", "angular_velocity", "linear_acceleration"):
        assert not any(getattr(heard["imu/data_raw"][0], f"{covariance}_covariance"))  # Imu.msg: unknown, but measured
    servos, joints = heard["servo_states"][-1], heard["joint_states"][-1]
    assert len(servos.name) == len(servos.position) == len(servos.velocity) == len(servos.torque) == len(servos.current)
    assert "front_left_knee_joint" in joints.name
    assert "root" not in joints.name
    assert all(heard["truth/foot_forces"][-1].contact)
    felt = readings_by_cell(heard["tactile"][-1].name, heard["tactile"][-1].voltage)
    assert min(felt["piezoresistive"]) > 1.04
    graph.until(lambda: graph.status().get("message") == "waiting for the first command", "diagnostics say so")
    status, output = graph.stop(process, signal.SIGTERM)
    assert status == 0, output
    assert "Traceback" not in output


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"name": ["wing"] * 11}, "unknown servo wing"),
        ({"position": [0.0] * 3}, "11 names but 3 values of position"),
        ({"position": [math.nan] * 11}, "allowed -10 to 10 rad"),
        ({"position": [1e308] * 11}, "allowed -10 to 10 rad"),
    ],
)
def test_unusable_servo_command_is_refused_and_said(graph: Graph, changes: dict, reason: str) -> None:
    states = graph.hear(ServoStates, "servo_states")
    process = graph.start(real_time_factor=0.2)
    graph.until(lambda: states and graph.hears(), "the simulation runs and hears commands")
    before = states[-1]
    graph.command(before)
    graph.until(lambda: states[-1] is not before, "the simulation goes on")
    graph.command(states[-1], **changes)
    graph.until(lambda: graph.status().get("commands_refused") == "1", "the refusal is counted")
    graph.until(lambda: nanoseconds(states[-1]) > nanoseconds(before) + 50 * PERIOD, "the simulation goes on")
    assert reason in graph.status()["last_refusal"]
    assert states[-1].position == pytest.approx(before.position, abs=0.1)
    _, output = graph.stop(process, signal.SIGTERM)
    assert reason in output


def test_a_spine_command_beyond_the_range_is_held_and_said(graph: Graph) -> None:
    states = graph.hear(ServoStates, "servo_states")
    process = graph.start(real_time_factor=0.2)
    graph.until(lambda: states and graph.hears(), "the simulation runs and hears commands")
    spine = list(states[-1].name).index("spine_lateral")
    before = states[-1]
    positions = list(before.position)
    positions[spine] = -1.0004
    graph.command(before, position=positions)
    graph.until(lambda: nanoseconds(states[-1]) > nanoseconds(before) + 20 * PERIOD, "the simulation goes on")
    later = states[-1]
    positions[spine] = 2.0
    graph.command(later, position=positions)
    graph.until(lambda: nanoseconds(states[-1]) > nanoseconds(later) + 20 * PERIOD, "the simulation goes on")
    assert max(state.position[spine] for state in states) < 1.05
    _, output = graph.stop(process, signal.SIGTERM)
    assert "spine_lateral = 2.000 rad is held to its range, -1 to 1 rad" in output
    assert output.count("is held to its range") == 1, "what the words do not show is not said"


def test_repeated_and_stale_commands_are_refused(graph: Graph) -> None:
    states = graph.hear(ServoStates, "servo_states")
    graph.start(real_time_factor=0.05)
    # A stamp of 0 counts as now, so the first tick of all is no use here.
    graph.until(lambda: states and nanoseconds(states[-1]) > 0 and graph.hears(), "the simulation runs")
    first = states[-1]
    graph.command(first)
    graph.until(lambda: graph.status().get("commands") == "1", "the command has come")
    graph.command(first)
    graph.until(lambda: "repeated" in graph.status().get("last_refusal", ""), "the repetition is refused")
    graph.until(lambda: nanoseconds(states[-1]) > nanoseconds(first) + 60 * PERIOD, "the first tick is old")
    graph.command(first)
    graph.until(lambda: "stale" in graph.status()["last_refusal"], "the stale one is refused")


def test_waits_for_a_graph_that_is_slower_than_real_time(graph: Graph) -> None:
    states = graph.hear(ServoStates, "servo_states")
    graph.start(patience=1.0)
    graph.until(lambda: states and graph.hears(), "the simulation runs and hears commands")
    # Answers that take two periods. It waits for them once the ticks are over that it gave a graph not yet there.
    in_a_row = 0
    deadline = time.monotonic() + 60.0
    while in_a_row < 40:
        assert time.monotonic() < deadline, "it does not wait for late answers"
        answered = len(states)
        graph.command(states[-1])
        late = time.monotonic() + 2e-9 * PERIOD
        graph.until(lambda late=late: time.monotonic() > late, "two periods are over")
        graph.until(lambda answered=answered: len(states) > answered, "the next tick has come")
        in_a_row = in_a_row + 1 if len(states) == answered + 1 else 0


def test_silence_makes_it_crouch(graph: Graph) -> None:
    states, odometry = graph.hear(ServoStates, "servo_states"), graph.hear(Odometry, "truth/odom")
    graph.start()
    graph.until(lambda: states and odometry and graph.hears(), "the simulation runs and hears commands")
    standing = odometry[-1].pose.pose.position.z

    def obeyed() -> bool:
        graph.command(states[-1])
        return int(graph.status().get("commands", "0")) > 0

    graph.until(obeyed, "a command has come")
    graph.until(lambda: graph.status().get("message") == "crouching", "it crouches")
    graph.until(lambda: odometry[-1].pose.pose.position.z < 0.8 * standing, "it is low")


def test_stepped_mode_waits_for_the_answer_to_each_tick(graph: Graph) -> None:
    states = graph.hear(ServoStates, "servo_states")
    graph.start(stepped=True, real_time_factor=0.0)
    # An unanswered tick is repeated for who comes late, and nothing else comes.
    graph.until(lambda: len(states) >= 3, "the first tick is repeated")
    assert {nanoseconds(message) for message in states} == {0}
    for tick in range(1, 20):
        graph.command(states[-1])
        graph.until(lambda tick=tick: nanoseconds(states[-1]) == tick * PERIOD, f"tick {tick} has come")
    answered = states[-1]
    graph.command(states[0])
    count = len(states)
    graph.until(lambda: len(states) > count + 1, "the tick is repeated")
    assert nanoseconds(states[-1]) == nanoseconds(answered)


def test_stepped_mode_is_deterministic(graph: Graph) -> None:
    runs = []
    for _ in range(2):
        states = graph.hear(ServoStates, "servo_states")
        process = graph.start(stepped=True, real_time_factor=0.0, seed=5, sensor_noise=1.0)
        for tick in range(30):
            graph.until(
                lambda tick=tick, states=states: states and nanoseconds(states[-1]) == tick * PERIOD, f"tick {tick}"
            )
            graph.command(states[-1])
        runs.append({nanoseconds(message): serialize_message(message) for message in states})
        graph.stop(process, signal.SIGTERM)
        states.clear()
    assert runs[0].keys() & runs[1].keys() >= {tick * PERIOD for tick in range(30)}
    assert all(runs[0][tick * PERIOD] == runs[1][tick * PERIOD] for tick in range(30))


def test_pause_step_and_go_on(graph: Graph) -> None:
    clock, states = graph.hear(Clock, "/clock"), graph.hear(ServoStates, "servo_states")
    graph.start()
    graph.until(lambda: len(states) > 5, "the simulation runs")
    refused = graph.call(StepSimulation, "mujoco_sim/step", StepSimulation.Request(ticks=3))
    assert not refused.success
    assert "pause it first" in refused.message
    assert graph.call(SetBool, "mujoco_sim/pause", SetBool.Request(data=True)).message == "paused"
    graph.until(lambda: graph.status().get("message") == "paused", "it says so")

    def step(ticks: int) -> int:
        answer = graph.call(StepSimulation, "mujoco_sim/step", StepSimulation.Request(ticks=ticks))
        assert answer.success
        return int(answer.time.sec) * 1_000_000_000 + int(answer.time.nanosec)

    before = step(1)
    assert step(7) == before + 7 * PERIOD
    graph.until(lambda: clock and nanoseconds(clock[-1]) == before + 7 * PERIOD, "seven ticks have come")
    assert not graph.call(StepSimulation, "mujoco_sim/step", StepSimulation.Request(ticks=0)).success
    assert graph.call(SetBool, "mujoco_sim/pause", SetBool.Request(data=False)).message == "running"
    graph.until(lambda: nanoseconds(clock[-1]) > before + 20 * PERIOD, "it runs again")


def test_reset_and_push(graph: Graph) -> None:
    clock, odometry = graph.hear(Clock, "/clock"), graph.hear(Odometry, "truth/odom")
    graph.start()
    graph.until(lambda: odometry, "the simulation runs")
    standing = odometry[-1].pose.pose.position
    assert graph.call(PushRobot, "mujoco_sim/push", PushRobot.Request(force=Vector3(y=2.0), duration=0.2)).success
    graph.until(lambda: odometry[-1].pose.pose.position.y > standing.y + 0.005, "it is pushed aside")
    refused = graph.call(PushRobot, "mujoco_sim/push", PushRobot.Request(body="ghost", duration=0.1))
    assert not refused.success
    assert "ghost" in refused.message
    assert graph.call(ResetSimulation, "mujoco_sim/reset", ResetSimulation.Request(keyframe="crouch")).success
    graph.until(lambda: odometry[-1].pose.pose.position.z < 0.8 * standing.z, "it crouches")
    assert abs(odometry[-1].pose.pose.position.y - standing.y) < 0.002
    refused = graph.call(ResetSimulation, "mujoco_sim/reset", ResetSimulation.Request(keyframe="fly"))
    assert not refused.success
    assert "stand" in refused.message
    stamps = [nanoseconds(message) for message in clock]
    assert stamps == sorted(set(stamps))


def test_divergence_stops_it_until_a_reset(graph: Graph, tmp_path: Path) -> None:
    states = graph.hear(ServoStates, "servo_states")
    process = graph.start(dump_folder=tmp_path / "dump")
    graph.until(lambda: states, "the simulation runs")
    assert graph.call(PushRobot, "mujoco_sim/push", PushRobot.Request(force=Vector3(z=1e13), duration=1.0)).success
    graph.until(lambda: graph.status().get("level") == "2", "the error is diagnosed")
    assert "diverged" in graph.status()["message"]
    assert (tmp_path / "dump" / "states.npz").exists()
    stopped = nanoseconds(states[-1])
    assert graph.call(ResetSimulation, "mujoco_sim/reset", ResetSimulation.Request()).success
    graph.until(lambda: nanoseconds(states[-1]) > stopped + 20 * PERIOD, "it runs again")
    assert math.isfinite(sum(states[-1].position))
    status, output = graph.stop(process, signal.SIGTERM)
    assert status == 0, output
    assert "~/reset" in output


def test_two_in_one_graph_share_one_clock(graph: Graph) -> None:
    clock = graph.hear(Clock, "/clock")
    first, second = graph.hear(ServoStates, "a/servo_states"), graph.hear(ServoStates, "b/servo_states")
    graph.start("-r", "__ns:=/a", frame_prefix="a/")
    graph.start("-r", "__ns:=/b", frame_prefix="b/", publish_clock=False, use_sim_time=True)
    graph.until(lambda: clock and len(first) > 10 and len(second) > 40, "both run")
    assert graph.node.count_publishers("/clock") == 1
    start = nanoseconds(second[0])
    graph.until(lambda: nanoseconds(clock[-1]) > start + 200 * PERIOD, "a second has passed")
    graph.until(lambda: nanoseconds(second[-1]) > start + 190 * PERIOD, "the second keeps up")
    # Which of two messages is taken first says nothing; where the clock stands still, the second does too.
    assert graph.call(SetBool, "a/mujoco_sim/pause", SetBool.Request(data=True)).success
    stands = graph.call(StepSimulation, "a/mujoco_sim/step", StepSimulation.Request(ticks=1)).time
    told = len(graph.statuses("b/mujoco_sim"))
    graph.until(lambda: len(graph.statuses("b/mujoco_sim")) > told + 3, "time has passed, but not the clock's")
    assert nanoseconds(second[-1]) <= stands.sec * 1_000_000_000 + stands.nanosec + PERIOD


@pytest.mark.parametrize(
    ("parameters", "reason"),
    [
        ({"robot": "elephant"}, "elephant"),
        ({"scene": "moon"}, "moon"),
        ({"keyframe": "fly"}, "fly"),
        ({"real_time_factor": -1.0}, "real_time_factor"),
        ({"imu_rate": 70.0}, "imu_rate"),
        ({"control_rate": 400.0}, "period"),
        ({"robott": "nermo_lite"}, "robott"),
    ],
)
def test_bad_parameter_ends_it_in_one_sentence(graph: Graph, parameters: dict, reason: str) -> None:
    process = graph.start(**parameters)
    output, _ = process.communicate(timeout=60.0)
    assert process.returncode in (1, 2)
    assert reason in output
    assert "Traceback" not in output
