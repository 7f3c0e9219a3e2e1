"""Which geoms could touch, and that simulations in which none can are those of MuJoCo all the same."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from robots import MODELS, aligned_of, plant_of, simulate

from simgap.simulation.contacts import may_touch
from simgap.simulation.replay import Replayer
from simgap.simulation.variant import Variant
from simgap.simulation.windows import cut

mask = st.integers(0, 3)


@given(
    parents=st.lists(st.integers(0, 3), min_size=1, max_size=4),
    jointed=st.lists(st.booleans(), min_size=4, max_size=4),
    masks=st.lists(st.tuples(mask, mask), min_size=5, max_size=5),
    filtered=st.booleans(),
)
def test_what_may_touch_does_where_everything_overlaps(
    parents: list[int], jointed: list[bool], masks: list[tuple[int, int]], filtered: bool
) -> None:
    """MuJoCo itself is asked: each body has a ball of the same place and size, so that all pairs that pass collide."""
    spec = mujoco.MjSpec()
    if not filtered:
        spec.option.disableflags = int(mujoco.mjtDisableBit.mjDSBL_FILTERPARENT)
    bodies = [spec.worldbody]
    for i, parent in enumerate(parents):
        bodies.append(bodies[min(parent, i)].add_body())
        if jointed[i]:
            bodies[-1].add_joint(type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 1, 0])
    for body, (kind, answers) in zip(bodies, masks, strict=False):
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[1, 0, 0], contype=kind, conaffinity=answers)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert may_touch(model) == (data.ncon > 0)


@pytest.mark.parametrize("name", MODELS)
def test_a_model_that_is_said_not_to_touch_never_does(name: str) -> None:
    model = plant_of(name).model
    data, random = mujoco.MjData(model), np.random.default_rng(3)
    touched = False
    for _ in range(500):
        data.qpos[:] = model.qpos0 + random.normal(0.0, 1.5, model.nq)
        mujoco.mj_forward(model, data)
        touched |= data.ncon > 0
    assert may_touch(model) or not touched
    assert may_touch(model) == (name in ("leg", "quad")), name


def test_a_variant_may_let_touch_what_cannot_in_the_model() -> None:
    """A leg on ground that it cannot feel, with its ground given back, lands as the leg does."""
    plant, aligned, floor = aligned_of("leg", simulate("leg", 6.0))
    whole = Replayer(plant, aligned, cut(aligned), floor, 1)
    nominal = Variant.nominal(plant)
    fields = ("geom_contype", "geom_conaffinity", "body_contype", "body_conaffinity")
    masks = {field: getattr(plant.model, field).copy() for field in fields}
    ghost = plant_of("leg")
    for field in fields:
        getattr(ghost.model, field)[:] = 0
    assert may_touch(plant.model) and not may_touch(ghost.model)
    through = Replayer(ghost, aligned, cut(aligned), floor, 1)
    landed = Variant.nominal(ghost)
    fallen = landed.copy()
    for field, values in masks.items():
        getattr(landed.model, field)[:] = values
    expected = whole.run([nominal])
    np.testing.assert_array_equal(through.run([landed]), expected)
    assert np.abs(through.run([fallen]) - expected).max() > 0.01
    np.testing.assert_array_equal(through.run([fallen, landed])[1], expected[0])
