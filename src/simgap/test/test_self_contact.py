"""A model that touches itself where the robot was is said to."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from simgap.analysis.self_contact import self_contacts, warnings
from simgap.data.align import align
from simgap.data.mapping import parse_map
from simgap.data.noise_floor import noise_floor
from simgap.data.plant import build_plant
from simgap.data.recording import recording_from_table
from simgap.simulation.state import measured_state

LEG = """
<mujoco><worldbody><geom type="plane" size="1 1 0.1" pos="0 0 -0.32"/>
<body name="trunk" pos="0 0 0"><geom type="box" size="0.05 0.05 0.05" mass="1"/>
<body name="hip" pos="0 0 -0.06"><joint name="j" type="hinge" axis="0 1 0" damping="0.1"/>
<geom type="capsule" fromto="0 0 0 {0} 0 -0.2" size="0.02" mass="0.1"/></body></body></worldbody>
<actuator><position name="s" joint="j" kp="5"/></actuator></mujoco>"""
MAP = {
    "time": {"column": "t", "unit": "s"},
    "inputs": [{"column": "c", "unit": "rad", "actuator": "s", "kind": "position"}],
    "outputs": [{"column": "q", "unit": "rad", "joint": "j", "quantity": "position"}],
}


@pytest.mark.parametrize(("reach", "share"), [(0.0, 0.0), (0.05, 0.5)])
def test_overlaps_of_measured_poses_are_counted(reach: float, share: float) -> None:
    """A hip that swings up to its trunk does so in half of the poses; the ground below it is no part of the robot."""
    model = LEG.format(reach).replace('pos="0 0 -0.06"', 'pos="0 0 -0.06"' if reach else 'pos="0 0 -0.2"')
    plant = build_plant(mujoco.MjSpec.from_string(model), parse_map(MAP))
    # MuJoCo leaves out contacts of a body with its parent, unless that is welded to the world.
    t = 0.01 * np.arange(1000)
    q = np.where(np.sin(t) > 0, 2.4, 0.0)
    aligned = align(recording_from_table({"t": t, "c": q, "q": q + 1e-4 * np.sin(40 * t)}, plant), plant)
    state = measured_state(plant, aligned, noise_floor(aligned))
    found = self_contacts(plant, state)
    if share == 0.0:
        assert found == {} and warnings(plant, state) == []
    else:
        assert list(found) == [("hip", "trunk")]
        (said,) = warnings(plant, state)
        assert "hip and trunk overlap" in said and "exclude" in said
