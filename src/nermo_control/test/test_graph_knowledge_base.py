"""The gait knowledge-base as a node: parameters with ranges, named sets, and who hears of a change."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from control_graph import ControlGraph
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import DescribeParameters, ListParameters, SetParameters

from nermo_control.gait.knowledge_base import GaitParameters, read_gait_parameters, write_gait_parameters
from nermo_control.nodes import conversions
from nermo_description.parameters import RobotParameters
from nermo_interfaces import msg
from nermo_interfaces.srv import ListParameterSets, LoadParameterSet, SaveParameterSet
from nermo_node import qos

NODE = "/mouse/gait_knowledge_base"


class KnowledgeBase:
    """The node under test, and what it said last."""

    def __init__(self, graph: ControlGraph, folder: Path) -> None:
        self.graph, self.folder = graph, folder
        self.last: msg.GaitParameters | None = None
        self.count = 0
        graph.node.create_subscription(msg.GaitParameters, "mouse/gait_parameters", self._listen, qos.LATCHED)
        self.start()

    def start(self) -> None:
        self.last = None
        kept = self.folder / "kept" / "changes.yaml"
        kept.parent.mkdir(exist_ok=True)
        self.graph.start("mouse", "gait_knowledge_base", sets_folder=self.folder, kept_changes=kept, use_sim_time=False)
        self.graph.until(lambda: self.last is not None, "gait parameters come")

    @property
    def parameters(self) -> GaitParameters:
        assert self.last is not None
        return conversions.gait_parameters_from_message(self.last)

    def set(self, name: str, value: float | list[float]) -> tuple[bool, str]:
        """What `ros2 param set` does."""
        kind = ParameterValue(type=ParameterType.PARAMETER_DOUBLE)
        if isinstance(value, list):
            kind = ParameterValue(type=ParameterType.PARAMETER_DOUBLE_ARRAY, double_array_value=value)
        else:
            kind.double_value = value
        request = SetParameters.Request(parameters=[Parameter(name=name, value=kind)])
        result = self.graph.call(SetParameters, f"{NODE}/set_parameters", request).results[0]
        return result.successful, result.reason

    def _listen(self, message: msg.GaitParameters) -> None:
        self.last = message
        self.count += 1


@pytest.fixture(scope="module")
def base(tmp_path_factory: pytest.TempPathFactory) -> Iterator[KnowledgeBase]:
    graph = ControlGraph()
    yield KnowledgeBase(graph, tmp_path_factory.mktemp("sets"))
    graph.close()


def test_every_value_is_a_parameter_with_range_and_unit(base: KnowledgeBase) -> None:
    names = base.graph.call(ListParameters, f"{NODE}/list_parameters", ListParameters.Request()).result.names
    numbers = [
        "default_gait_frequency",
        "front.neutral_stance_height",
        "rear.max_stride_length",
        "gaits.lateral_walk.duty_factor",
        "settle_duration",
    ]
    assert {*numbers, "default_gait", "gaits.trot.phase_offsets"} <= set(names)
    request = DescribeParameters.Request(names=numbers)
    for descriptor in base.graph.call(DescribeParameters, f"{NODE}/describe_parameters", request).descriptors:
        assert descriptor.floating_point_range, descriptor.name
        assert descriptor.description
    assert base.parameters == GaitParameters()


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("default_gait_frequency", 50.0),
        ("default_gait_frequency", 0.0),
        ("default_gait_frequency", float("nan")),
        ("front.max_stride_length", 1.0),
        ("gaits.trot.duty_factor", 1.0),
        ("gaits.trot.phase_offsets", [0.0, 0.5]),
        ("gaits.trot.phase_offsets", [0.0, 0.5, 0.5, 1.5]),
    ],
)
def test_a_value_out_of_range_is_refused_with_its_name(
    base: KnowledgeBase, name: str, value: float | list[float]
) -> None:
    before = base.parameters
    successful, reason = base.set(name, value)
    assert not successful
    assert name in reason
    count = base.count
    base.graph.until(lambda: base.count > count, "the next message")
    assert base.parameters == before


def test_a_change_is_told_and_sets_bring_it_back(base: KnowledgeBase) -> None:
    assert base.set("front.swing_amplitude", 0.02) == (True, "")
    base.graph.until(lambda: base.parameters.front.swing_amplitude == 0.02, "the change is told")
    assert base.last is not None and base.last.revision >= 1

    save = SaveParameterSet.Request(name="high_steps")
    saved = base.graph.call(SaveParameterSet, f"{NODE}/save_parameter_set", save)
    assert saved.success, saved.message
    assert read_gait_parameters(Path(saved.path)).front.swing_amplitude == 0.02
    again = base.graph.call(SaveParameterSet, f"{NODE}/save_parameter_set", save)
    assert (again.success, "exists" in again.message) == (False, True)

    assert base.set("front.swing_amplitude", 0.01) == (True, "")
    base.graph.until(lambda: base.parameters.front.swing_amplitude == 0.01, "the change is told")
    listed = base.graph.call(ListParameterSets, f"{NODE}/list_parameter_sets", ListParameterSets.Request())
    assert listed.names == ["high_steps", "optimized_roll", "optimized_speed", "thesis"]
    loaded = base.graph.call(
        LoadParameterSet, f"{NODE}/load_parameter_set", LoadParameterSet.Request(name="high_steps")
    )
    assert loaded.success, loaded.message
    base.graph.until(lambda: base.parameters.front.swing_amplitude == 0.02, "the set is told")


def test_a_set_with_other_gaits_becomes_parameters_too(base: KnowledgeBase) -> None:
    gaits = dict(GaitParameters().gaits)
    pace = gaits.pop("lateral_walk").model_copy(update={"phase_offsets": (0.0, 0.5, 0.0, 0.5)})
    other = GaitParameters(gaits={**gaits, "pace": pace}, default_gait="pace")
    write_gait_parameters(other, base.folder / "pacing.yaml")
    loaded = base.graph.call(LoadParameterSet, f"{NODE}/load_parameter_set", LoadParameterSet.Request(name="pacing"))
    assert loaded.success, loaded.message
    base.graph.until(lambda: base.parameters == other, "the new gait is told")
    assert base.set("gaits.pace.duty_factor", 0.6) == (True, "")
    assert not base.set("gaits.lateral_walk.duty_factor", 0.6)[0]
    base.graph.until(lambda: base.parameters.gaits["pace"].duty_factor == 0.6, "the change is told")


@pytest.mark.parametrize(("name", "words"), [("hihg_steps", "did you mean high_steps?"), ("../x", "letters, digits")])
def test_a_set_that_cannot_be_is_refused_in_words(base: KnowledgeBase, name: str, words: str) -> None:
    base.graph.call(SaveParameterSet, f"{NODE}/save_parameter_set", SaveParameterSet.Request(name="high_steps"))
    loaded = base.graph.call(LoadParameterSet, f"{NODE}/load_parameter_set", LoadParameterSet.Request(name=name))
    assert not loaded.success
    assert words in loaded.message


def test_a_late_listener_hears_of_robot_and_gaits(base: KnowledgeBase, robot: RobotParameters) -> None:
    heard: list[msg.RobotParameters] = []
    base.graph.node.create_subscription(msg.RobotParameters, "mouse/robot_parameters", heard.append, qos.LATCHED)
    base.graph.until(lambda: bool(heard), "the robot's parameters come")
    assert heard[0].robot == robot.name
    assert [servo.name for servo in heard[0].servos] == list(robot.servos)


def test_what_was_changed_live_is_still_there_after_a_restart(base: KnowledgeBase) -> None:
    assert base.set("rear.swing_amplitude", 0.017) == (True, "")
    base.graph.until(lambda: base.parameters.rear.swing_amplitude == 0.017, "the change is told")
    before = base.parameters
    base.graph.kill("mouse", "gait_knowledge_base")
    base.start()
    base.graph.until(lambda: base.parameters == before, "the change is told again")
