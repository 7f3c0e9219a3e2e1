"""The node in a graph of its own: every tactile message is answered, faults are told, parameters act live."""

from __future__ import annotations

import math
import subprocess
import sys
from collections.abc import Iterator

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from graph_bench import PATIENCE_S, GraphBench
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter

from nermo_description.feet import named_readings
from nermo_interfaces.msg import LegLoads, Tactile
from nermo_node import qos
from nermo_node.time import to_message, to_nanoseconds
from nermo_sensors.models.foot import TactileFeet


class Feet(GraphBench):
    """Sends what four feet read and hears what the node makes of it."""

    def __init__(self) -> None:
        super().__init__("feet")
        self._feet = TactileFeet()
        self._stamp = 1_000_000_000
        self._publisher = self.node.create_publisher(Tactile, "tactile", qos.SENSOR)
        self.loads: list[LegLoads] = []
        self.diagnostics: list[DiagnosticArray] = []
        self._listening = self.node.create_subscription(LegLoads, "leg_loads", self.loads.append, 100)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self.diagnostics.append, 100)

    def press(self, loads: list[float], broken: bool = False) -> LegLoads:
        """One sample, and the node's answer to it; sent again until there is one."""
        readings = self._feet.read(loads, 0.005)
        if broken:
            readings["piezoresistive"][2] = math.nan
        heard = len(self.loads)

        def answered() -> bool:
            if len(self.loads) > heard:
                return True
            self._stamp += 5_000_000
            self._publish(readings)
            return False

        self.until(answered, "leg_loads came")
        return self.loads[-1]

    def listen(self, whether: bool) -> None:
        """Begins or ends to listen to the loads."""
        if whether:
            self._listening = self.node.create_subscription(LegLoads, "leg_loads", self.loads.append, 100)
        else:
            self.node.destroy_subscription(self._listening)

    def send(self, loads: list[float]) -> None:
        """One sample, whether or not it is answered."""
        readings = self._feet.read(loads, 0.005)
        self._stamp += 5_000_000
        self._publish(readings)

    def _publish(self, readings: dict[str, list[float]]) -> None:
        names, voltages = named_readings(readings)
        message = Tactile(name=names, voltage=voltages)
        message.header.stamp = to_message(self._stamp)
        self._publisher.publish(message)


@pytest.fixture
def feet() -> Iterator[Feet]:
    process = subprocess.Popen([sys.executable, "-m", "nermo_sensors.nodes.leg_load_estimator"])
    feet = Feet()
    yield feet
    feet.close()
    process.terminate()
    assert process.wait(PATIENCE_S) == 0


def test_loads_follow_and_faults_are_told(feet: Feet) -> None:
    for _ in range(60):
        answer = feet.press([0.7, 0.7, 0.7, 0.0])
    assert to_nanoseconds(answer.header.stamp) > 1_000_000_000
    assert answer.header.frame_id == "base_link"
    assert list(answer.load)[:3] == pytest.approx([0.7] * 3, abs=0.35)
    assert list(answer.contact)[:3] == [True] * 3
    assert all(variance > 0.0 for variance in answer.variance)
    for _ in range(40):
        answer = feet.press([0.7, 0.7, 0.7, 0.0], broken=True)
    assert math.isfinite(answer.load[2])

    def told() -> bool:
        texts = [status.message for message in feet.diagnostics for status in message.status]
        return any("rear_left: the piezoresistive cell no reading" in text for text in texts)

    feet.until(told, "the diagnostics name the foot")

    answers = []
    for value in (50.0, -1.0):
        request = SetParameters.Request(parameters=[Parameter("contact_force", value=value).to_parameter_msg()])
        answers.append(feet.call(SetParameters, "leg_load_estimator/set_parameters", request).results[0].successful)
    assert answers == [True, False]
    # What is heard next may be the answer to a sample from before.
    feet.until(lambda: not any(feet.press([0.7, 0.7, 0.7, 0.0]).contact), "none of them is on the ground any more")


def test_samples_are_passed_over_only_while_nobody_listens(feet: Feet) -> None:
    loads = [0.7, 0.7, 0.7, 0.0]
    feet.press(loads)

    def passed_over() -> int:
        told = [
            int(pair.value)
            for message in feet.diagnostics
            for status in message.status
            for pair in status.values
            if pair.key == "passed_over"
        ]
        return max(told, default=0)

    def passed_over_by_now() -> int:
        heard = len(feet.diagnostics)
        feet.until(lambda: len(feet.diagnostics) > heard + 1, "there are diagnostics of now")
        return passed_over()

    # Before it knew of whoever listens it may have passed over some.
    before = passed_over_by_now()
    for _ in range(20):
        feet.press(loads)
    assert passed_over_by_now() == before
    feet.listen(False)

    def some_were() -> bool:
        feet.send(loads)
        return passed_over() > before + 20

    feet.until(some_were, "samples are passed over")
    feet.listen(True)
    feet.press(loads)
    heard = len(feet.loads)
    answers = [feet.press(loads) for _ in range(10)]
    stamps = {to_nanoseconds(answer.header.stamp) for answer in answers}
    assert len(stamps) == 10
    assert len(feet.loads) >= heard + 10
    assert list(answers[-1].load)[:3] == pytest.approx([0.7] * 3, abs=0.35)


def test_wrong_feet_are_refused() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "nermo_sensors.nodes.leg_load_estimator", "--ros-args", "-p", "feet:=none.yaml"],
        capture_output=True,
        text=True,
        timeout=2.0 * PATIENCE_S,
        check=False,
    )
    assert done.returncode == 2
    assert "none.yaml" in done.stderr + done.stdout and "Traceback" not in done.stderr
