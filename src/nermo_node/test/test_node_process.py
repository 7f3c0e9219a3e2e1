"""Parameters, running and diagnostics of a node, in processes of its own and over the middleware."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from graph_bench import PATIENCE_S, GraphBench
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import DescribeParameters, SetParameters

SUBJECT = Path(__file__).with_name("subject_node.py")


@pytest.fixture
def bench() -> Iterator[GraphBench]:
    made = GraphBench()
    yield made
    made.close()


@pytest.fixture
def start() -> Iterator[Callable[..., subprocess.Popen[str]]]:
    processes = []

    def begin(*arguments: str) -> subprocess.Popen[str]:
        command = [sys.executable, str(SUBJECT), "--ros-args", *arguments]
        environment = {**os.environ, "RCUTILS_LOGGING_BUFFERED_STREAM": "0"}
        process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=environment
        )
        processes.append(process)
        return process

    yield begin
    for process in processes:
        process.terminate()
        process.communicate(timeout=PATIENCE_S)


def test_a_change_is_checked_by_the_model_and_handed_over(bench: GraphBench, start: Callable) -> None:
    start("-p", "gain:=0.5", "-r", "__ns:=/here")
    statuses: list[DiagnosticStatus] = []
    bench.node.create_subscription(DiagnosticArray, "/diagnostics", lambda message: statuses.extend(message.status), 10)
    bench.until(lambda: bool(statuses), "diagnostics come")
    assert (statuses[0].name, statuses[0].message) == ("here/subject: gain", "gain 0.5")
    assert statuses[0].hardware_id == "bench"

    def set_gain(value: float) -> object:
        parameter = Parameter(
            name="gain", value=ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=value)
        )
        request = SetParameters.Request(parameters=[parameter])
        return bench.call(SetParameters, "/here/subject/set_parameters", request).results[0]

    for bad in (7.0, float("nan"), 1.5):
        refused = set_gain(bad)
        assert not refused.successful
        assert "gain" in refused.reason
    assert set_gain(0.75).successful
    bench.until(lambda: statuses[-1].message == "gain 0.75", "diagnostics tell the change")

    description = bench.call(
        DescribeParameters, "/here/subject/describe_parameters", DescribeParameters.Request(names=["gain"])
    ).descriptors[0]
    assert description.description == "A gain [m]"
    assert (description.floating_point_range[0].from_value, description.floating_point_range[0].to_value) == (0.0, 2.0)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_cleanly(bench: GraphBench, start: Callable, number: signal.Signals) -> None:
    said: list[DiagnosticArray] = []
    bench.node.create_subscription(DiagnosticArray, "/diagnostics", said.append, 10)
    process = start()
    bench.until(lambda: bool(said), "the node is there, and runs")
    process.send_signal(number)
    output, _ = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, "destroyed" in output, "Traceback" in output) == (0, True, False), output


@pytest.mark.parametrize("fails", ["signal", "interrupt"])
def test_what_a_signal_interrupts_is_no_fault(start: Callable, fails: str) -> None:
    """Neither a callback, nor what ends an object, where nothing can be caught."""
    process = start("-p", f"fails:={fails}")
    output, _ = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, [line for line in output.splitlines() if "[rcl]" not in line]) == (0, ["destroyed"])


def test_what_hangs_is_interrupted_by_the_second_sigint(start: Callable) -> None:
    process = start("-p", "fails:=hang")
    assert process.stdout is not None
    assert process.stdout.readline() == "hangs\n"
    process.send_signal(signal.SIGINT)
    assert process.stdout.readline() == "still hangs\n"
    process.send_signal(signal.SIGINT)
    output, _ = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, "destroyed" in output, "Traceback" in output) == (0, True, False), output


@pytest.mark.parametrize(
    ("arguments", "status", "words"),
    [
        (
            ["-p", "gain:=7.0"],
            2,
            "parameter gain = 7.0: input should be less than or equal to 2 (allowed 0.0 to 2.0 m)",
        ),
        (["-p", "gain:=two"], 2, "parameter gain = 'two'"),
        (["-p", "gian:=1.0"], 2, "unknown parameter gian: did you mean gain?"),
        (["-p", "gain:=1.5"], 2, "gain = 1.5 is unlucky"),
        (["-p", "shape.size:=-1"], 2, "parameter shape.size = -1"),
        (["-p", "fails:=constructor"], 1, "the constructor failed"),
        (["-p", "fails:=value"], 2, "the value does not do"),
        (["-p", "fails:=callback"], 1, "the callback failed"),
        (["-p", "fails:=end"], 1, "the end failed"),
        (["-p", "nonsense"], 2, "bad arguments"),
    ],
)
def test_what_is_wrong_is_said_in_one_sentence(start: Callable, arguments: list[str], status: int, words: str) -> None:
    process = start(*arguments)
    output, _ = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == status, output
    sentences = [line for line in output.splitlines() if line != "destroyed" and "[rcl]" not in line]
    assert len(sentences) == 1, output
    assert words in sentences[0]
