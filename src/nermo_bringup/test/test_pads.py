"""The pads that come with the package, and what is said about wrong ones."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from nermo_bringup.teleop.pads import AXES, BUTTONS, Controls, load_pad
from nermo_description.parameter_files import ParameterError

PADS = Path(__file__).parents[1] / "config" / "pads"


@pytest.mark.parametrize("name", ["xbox", "playstation", "switch_pro", "generic"])
def test_the_pads_that_come_along_can_drive(name: str) -> None:
    pad = load_pad(name, PADS)
    axes, buttons = [0.0] * pad.axis_count, [0] * pad.button_count
    axes[pad.axes[pad.controls.forward]] = 0.7
    buttons[pad.buttons[pad.controls.dead_man]] = 1
    assert pad.read("forward", axes, buttons) == 0.7
    assert pad.read("turn", axes, buttons) == 0.0
    assert [control for control in BUTTONS if pad.read(control, axes, buttons)] == ["dead_man"]


@pytest.mark.parametrize("name", ["xbox", "playstation", "switch_pro"])
def test_mapped_pads_know_everything(name: str) -> None:
    pad = load_pad(name, PADS)
    assert all(getattr(pad.controls, control) for control in Controls.model_fields if control != "crouch")


def test_each_button_does_one_thing() -> None:
    pad = load_pad("generic", PADS)
    for control in BUTTONS:
        name = getattr(pad.controls, control)
        if name is None:
            continue
        axes, buttons = [0.0] * pad.axis_count, [0] * pad.button_count
        if name in pad.buttons:
            buttons[pad.buttons[name]] = 1
        else:
            axes[pad.axes[name[:-1]]] = 1.0 if name[-1] == "+" else -1.0
        assert [other for other in BUTTONS if pad.read(other, axes, buttons)] == [control]


def test_the_axes_are_no_buttons() -> None:
    assert not set(AXES) & set(BUTTONS)


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (
            {"controls": {"dead_man": "left_bumber"}},
            "controls.dead_man: there is no button 'left_bumber'; did you mean left_bumper",
        ),
        ({"controls": {"forward": "left_z"}}, "controls.forward: there is no axis 'left_z'; did you mean left_y"),
        ({"controls": {"dead_men": "a"}}, "controls.dead_men: no such field; did you mean 'dead_man'?"),
        ({"controls": {"stand": "b"}}, "'b' already does emergency_stop"),
        ({"axes": {"left_y": -1}}, "axes.left_y: is -1; input should be greater than or equal to 0"),
        ({"axes": {"left_y": "up"}}, "axes.left_y: is 'up'; input should be a valid integer"),
        ({"colour": "red"}, "colour: no such field"),
        ({"controls": {"dead_man": None}}, "controls.dead_man: is None; input should be a valid string"),
    ],
)
def test_a_wrong_pad_names_file_field_and_value(tmp_path: Path, change: dict, complaint: str) -> None:
    content = yaml.safe_load((PADS / "xbox.yaml").read_text())
    for key, value in change.items():
        content[key] = {**content[key], **value} if isinstance(value, dict) else value
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(content))
    with pytest.raises(ParameterError) as error:
        load_pad(str(path))
    assert str(path) in str(error.value)
    assert complaint in str(error.value)


def test_a_pad_without_a_dead_man_button_is_refused(tmp_path: Path) -> None:
    content = yaml.safe_load((PADS / "xbox.yaml").read_text())
    del content["controls"]["dead_man"]
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(content))
    with pytest.raises(ParameterError, match="controls.dead_man: is missing"):
        load_pad(str(path))


def test_an_unknown_pad_names_the_nearest() -> None:
    with pytest.raises(ParameterError, match="no pad 'xbux'.*did you mean xbox"):
        load_pad("xbux", PADS)


@pytest.mark.parametrize("text", ["[1, 2]", "a: [", "\x00"])
def test_what_is_no_pad_file_is_said(tmp_path: Path, text: str) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    with pytest.raises(ParameterError, match="mine.yaml"):
        load_pad(str(path))
