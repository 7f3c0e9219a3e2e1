"""The gait knowledge-base: N's numbers, files and their mistakes, named sets."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from pydantic import ValidationError

from nermo_control.gait.knowledge_base import (
    GaitKnowledgeBase,
    GaitParameters,
    frequency_error,
    gait_speed,
    read_gait_parameters,
    stride_length,
    write_gait_parameters,
)
from nermo_description.parameter_files import ParameterError

OURS = ["optimized_roll", "optimized_speed", "thesis"]
"""Sets that come with the package."""


@pytest.mark.parametrize(("gait", "factor"), [("trot", 2.00), ("walking_trot", 1.67), ("lateral_walk", 1.47)])
def test_gait_factors_are_those_of_table_a2(gait: str, factor: float) -> None:
    assert GaitParameters().gaits[gait].gait_factor == pytest.approx(factor, abs=0.005)


def test_theoretical_trot_speeds_are_those_of_section_6_2_1() -> None:
    trot = GaitParameters().gaits["trot"]
    assert gait_speed(0.8, 0.06, trot.gait_factor) == pytest.approx(0.096)
    assert gait_speed(0.8, 0.06 + 0.015, trot.gait_factor) == pytest.approx(0.12)


def test_stride_length_undoes_gait_speed() -> None:
    gait = GaitParameters().gaits["lateral_walk"]
    assert stride_length(gait_speed(0.5, 0.04, gait.gait_factor), 0.5, gait.duty_factor) == pytest.approx(0.04)


@pytest.mark.parametrize("frequency", [0.0, 50.0, float("nan"), float("inf"), -0.8])
def test_impossible_frequencies_are_refused_in_words(frequency: float) -> None:
    assert "allowed 0.1 to 3.0 Hz" in (frequency_error(frequency) or "")


def test_the_file_gives_back_what_was_written(tmp_path: Path) -> None:
    parameters = GaitParameters(default_gait="lateral_walk", settle_duration=0.1)
    write_gait_parameters(parameters, tmp_path / "gaits.yaml")
    assert read_gait_parameters(tmp_path / "gaits.yaml") == parameters
    assert [file.name for file in tmp_path.iterdir()] == ["gaits.yaml"]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"front": {"swing_amplitude": 0.5}}, ["front.swing_amplitude", "0.5", "0.0 to 0.03 m"]),
        ({"rear": {"swing_amplitud": 0.01}}, ["rear.swing_amplitud", "did you mean 'swing_amplitude'"]),
        ({"defalt_gait": "trot"}, ["defalt_gait", "did you mean 'default_gait'"]),
        ({"default_gait": "gallop"}, ["default_gait", "gallop", "trot"]),
        ({"default_gait_frequency": 50.0}, ["default_gait_frequency", "50.0", "0.1 to 3.0 Hz"]),
        ({"settle_duration": float("nan")}, ["settle_duration", "nan"]),
        ({"gaits": {"trot": {"phase_offsets": [0.0, 0.0, 0.0, 0.0]}}}, ["gaits.trot.duty_factor", "missing"]),
        ({"gaits": {"trot": {"duty_factor": 0.5, "phase_offsets": [0.0, 1.5, 0.0, 0.0]}}}, ["phase_offsets", "1.5"]),
        ({"gaits": {"trot": {"duty_factor": 2.0, "phase_offsets": [0.0] * 4}}}, ["duty_factor", "0.2 to 0.95"]),
    ],
)
def test_a_mistake_in_a_file_is_named(tmp_path: Path, change: dict[str, object], words: list[str]) -> None:
    data = GaitParameters().model_dump(mode="json")
    for key, value in change.items():
        data[key] = {**data[key], **value} if isinstance(value, dict) and key in ("front", "rear") else value
    file = tmp_path / "gaits.yaml"
    file.write_text(yaml.safe_dump(data))
    with pytest.raises(ParameterError) as caught:
        read_gait_parameters(file)
    for word in [str(file), *words]:
        assert word in str(caught.value)


@pytest.mark.parametrize("text", ["[1, 2]", "front: [", "\x00"])
def test_a_file_that_is_no_mapping_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "gaits.yaml").write_text(text)
    with pytest.raises(ParameterError, match=r"gaits\.yaml"):
        read_gait_parameters(tmp_path / "gaits.yaml")


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match="nowhere.yaml"):
        read_gait_parameters(tmp_path / "nowhere.yaml")


def test_parameters_are_immutable() -> None:
    with pytest.raises(ValidationError):
        GaitParameters().default_gait = "walking_trot"  # type: ignore[misc]


def test_every_number_has_a_range_and_a_unit() -> None:
    parameters = GaitParameters()
    for model in (parameters, parameters.front, parameters.gaits["trot"]):
        for name, field in type(model).model_fields.items():
            assert field.description, name
            if field.annotation is float:
                assert {"ge", "le"} <= {key for rule in field.metadata for key in ("ge", "le") if hasattr(rule, key)}, (
                    name
                )
                assert field.json_schema_extra["unit"], name  # type: ignore[index,call-overload]


def test_sets_are_saved_listed_and_loaded(tmp_path: Path) -> None:
    base = GaitKnowledgeBase(tmp_path / "sets")
    assert base.names() == OURS
    base.save("first")
    changed = GaitParameters(default_gait_frequency=0.5)
    base.change(changed)
    base.save("second")
    assert base.names() == sorted(["first", "second", *OURS])
    assert base.load("first") == GaitParameters()
    assert base.load("second") == changed


def test_what_comes_with_the_package_is_loaded_unless_something_else_has_its_name(tmp_path: Path) -> None:
    base = GaitKnowledgeBase(tmp_path)
    assert base.load("thesis") == GaitParameters(), "N's as printed"
    found = base.load("optimized_roll")
    assert found.rear.stance_amplitude < 1e-4 and found != base.load("optimized_speed")
    base.change(GaitParameters(default_gait_frequency=0.5))
    base.save("optimized_roll")
    assert base.load("optimized_roll").default_gait_frequency == 0.5


def test_a_set_is_overwritten_only_on_demand(tmp_path: Path) -> None:
    base = GaitKnowledgeBase(tmp_path)
    base.save("mine")
    base.change(GaitParameters(default_gait_frequency=0.5))
    with pytest.raises(ParameterError, match="overwrite"):
        base.save("mine")
    assert base.load("mine") == GaitParameters()
    base.save("mine", overwrite=True)
    assert base.load("mine").default_gait_frequency == 0.5


@pytest.mark.parametrize("name", ["", "../evil", "a/b", "with space"])
def test_bad_set_names_are_refused(tmp_path: Path, name: str) -> None:
    base = GaitKnowledgeBase(tmp_path)
    for action in (base.save, base.load):
        with pytest.raises(ParameterError, match="letters, digits"):
            action(name)


def test_an_unknown_set_names_the_nearest(tmp_path: Path) -> None:
    base = GaitKnowledgeBase(tmp_path)
    base.save("maze")
    with pytest.raises(ParameterError, match="did you mean maze"):
        base.load("maxe")


def test_the_revision_counts_changes(tmp_path: Path) -> None:
    base = GaitKnowledgeBase(tmp_path)
    base.change(GaitParameters())
    assert base.revision == 0
    base.change(GaitParameters(default_gait_frequency=0.5))
    base.change(GaitParameters())
    assert base.revision == 2
