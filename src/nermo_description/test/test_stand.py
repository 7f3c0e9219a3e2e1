"""The scene `hung`: the torso in a stand, from the first moment on."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from nermo_description.model import build_model, scene_names
from nermo_description.robots import load_any_robot, load_robot
from nermo_description.stand import Stand


@pytest.mark.parametrize("name", ["nermo", "nermo_lite"])
@pytest.mark.parametrize("posture", ["stand", "crouch"])
def test_a_mouse_in_the_scene_hung_begins_at_the_stands_height_and_stays_there(name: str, posture: str) -> None:
    model = build_model(load_robot(name), "hung")
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key(posture).id)
    assert data.joint("root").qpos == pytest.approx(Stand().pose())
    for _ in range(round(1.5 / model.opt.timestep)):
        mujoco.mj_step(model, data)
    assert data.joint("root").qpos[2] == pytest.approx(Stand().height, abs=5e-3)
    assert data.joint("root").qpos[3] > np.cos(0.05), "it hangs level"
    assert data.ncon == 0, "no foot touches anything"


@pytest.mark.parametrize("name", ["nermo", "nermo_lite"])
def test_a_mouse_that_is_fifty_grams_heavier_than_it_should_be_hangs_free_too(name: str) -> None:
    """A stand is what tells such a mouse: on the floor, where it once came to rest, it says nothing."""
    model = build_model(load_robot(name), "hung")
    model.body("torso").mass[0] += 0.05
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("stand").id)
    for _ in range(round(3.0 / model.opt.timestep)):
        mujoco.mj_step(model, data)
    assert data.ncon == 0 and data.joint("root").qpos[2] == pytest.approx(Stand().height - 0.05 * 9.81 / 2.0, abs=0.01)


def test_the_scene_is_known_and_only_for_a_mouse() -> None:
    assert "hung" in scene_names()
    with pytest.raises(ValueError, match="stand of a mouse, and cheetah_cub is a pantograph"):
        build_model(load_any_robot("cheetah_cub"), "hung")
