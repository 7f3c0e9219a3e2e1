"""A robot of which one leg was recorded is diagnosed as that leg."""

from __future__ import annotations

import copy

import mujoco
import numpy as np
import pytest

from simgap.analysis.diagnose import diagnose
from simgap.analysis.options import Options
from simgap.data.mapping import parse_map
from simgap.data.plant import build_plant
from simgap.data.recording import recording_from_table

LEG = """
<body name="{0}_thigh" pos="{1} 0 0"><joint name="{0}_hip" axis="0 1 0" damping="0.05" armature="0.01"/>
<geom type="capsule" fromto="0 0 0 0 0 -.2" size=".02" mass="0.5"/><site name="{0}_mid" pos="0 0 -.1"/>
<body name="{0}_shank" pos="0 0 -.2"><joint name="{0}_knee" axis="0 1 0" damping="0.03" armature="0.005"/>
<geom name="{0}_foot" type="capsule" fromto="0 0 0 0 0 -.2" size=".015" mass="0.2"/></body></body>"""
SERVOS = """
<position name="{0}_hip_servo" joint="{0}_hip" kp="20" kv="0.6"/>
<position name="{0}_knee_servo" joint="{0}_knee" kp="10" kv="0.3"/>"""


def model(more: str = "", servos: tuple[str, ...] = ("left", "right")) -> str:
    """Two legs at a trunk that is fixed; ``more`` goes behind the bodies."""
    legs = "".join(LEG.format(name, 0.3 * i) for i, name in enumerate(("left", "right")))
    driven = "".join(SERVOS.format(name) for name in servos)
    sensors = '<sensor><framepos name="where" objtype="site" objname="right_mid"/></sensor>'
    return (
        '<mujoco><option timestep="0.0025" integrator="implicitfast"/><worldbody><geom type="box" size=".1 .1 .02" '
        f'pos="0 0 .1"/>{legs}</worldbody>{more}<actuator>{driven}</actuator>{sensors}<keyframe><key name="home" '
        f'qpos="0.1 0.2 0.3 0.4" ctrl="{" ".join("0" for _ in range(2 * len(servos)))}"/></keyframe></mujoco>'
    )


MAP = {
    "time": {"column": "t", "unit": "s"},
    "inputs": [
        {"column": f"u_{j}", "unit": "rad", "actuator": f"left_{j}_servo", "kind": "position"} for j in ("hip", "knee")
    ],
    "outputs": [
        {"column": f"q_{j}", "unit": "rad", "joint": f"left_{j}", "quantity": "position"} for j in ("hip", "knee")
    ],
}


def test_a_leg_that_nobody_recorded_is_left_out() -> None:
    plant = build_plant(mujoco.MjSpec.from_string(model()), parse_map(MAP))
    assert plant.names(mujoco.mjtObj.mjOBJ_JOINT) == ["left_hip", "left_knee"]
    assert plant.names(mujoco.mjtObj.mjOBJ_ACTUATOR) == ["left_hip_servo", "left_knee_servo"]
    np.testing.assert_array_equal(plant.model.key_qpos, [[0.1, 0.2]])
    (said,) = plant.warnings
    assert "right_thigh" in said and "left out" in said


def _with(key: str, *rows: dict[str, object]) -> dict[str, object]:
    changed = copy.deepcopy(MAP)
    changed[key] = [*changed.get(key, []), *rows]  # type: ignore[misc]
    return changed


@pytest.mark.parametrize(
    "mapping",
    [
        _with("outputs", {"column": "z", "unit": "rad", "joint": "right_knee", "quantity": "position"}),
        _with("outputs", {"column": "z", "unit": "m", "sensor": "where", "component": "z"}),
        _with("inputs", {"column": "v", "unit": "rad", "actuator": "right_hip_servo", "kind": "position"}),
        _with("auxiliary", {"column": "hot", "unit": "degC", "actuator": "right_hip_servo"}),
        {**MAP, "signals": [{"where": "joint", "name": "right_hip", "quantity": "load_friction", "value": 0.1}]},
    ],
    ids=["a joint", "a sensor", "a command", "a temperature", "a friction"],
)
def test_what_the_map_names_stays(mapping: dict[str, object]) -> None:
    plant = build_plant(mujoco.MjSpec.from_string(model()), parse_map(mapping))
    assert plant.model.njnt == 4 and not any("left out" in w for w in plant.warnings)


@pytest.mark.parametrize(
    "xml",
    [
        model(servos=("left",)),
        model('<equality><joint joint1="left_hip" joint2="right_hip"/></equality>'),
        model(
            '<tendon><fixed name="rope"><joint joint="left_hip" coef="1"/><joint joint="right_hip" coef="1"/></fixed>'
            "</tendon>"
        ),
        model('<equality><connect body1="left_shank" body2="right_shank" anchor="0 0 0"/></equality>'),
        model('<equality><connect site1="left_mid" site2="right_mid"/></equality>'),
        model(
            '<tendon><spatial name="rope"><site site="left_mid"/><geom geom="right_foot"/><site site="left_mid"/>'
            "</spatial></tendon>"
        ).replace('name="right_foot" type="capsule"', 'name="right_foot" type="cylinder"'),
        model()
        .replace("</actuator>", '<motor name="jet" site="right_mid" gear="0 0 1 0 0 0"/></actuator>')
        .replace('ctrl="0 0 0 0"', 'ctrl="0 0 0 0 0"'),
    ],
    ids=["passive", "equal joints", "a cable", "a bar", "a ball joint", "a cable round it", "a jet"],
)
def test_what_moves_the_recorded_leg_stays(xml: str) -> None:
    plant = build_plant(mujoco.MjSpec.from_string(xml), parse_map(MAP))
    assert plant.model.njnt == 4 and not any("left out" in w for w in plant.warnings)


def test_a_leg_is_diagnosed_as_if_it_were_alone() -> None:
    """The other leg changes nothing: not the windows, not the candidates, not what is found."""
    whole = build_plant(mujoco.MjSpec.from_string(model()), parse_map(MAP))
    alone = mujoco.MjSpec.from_string(model())
    alone.delete(alone.body("right_thigh"))
    part = build_plant(alone, parse_map(MAP))
    table = _walked(part.model)
    options = Options(baselines=False, threads=1, only=("coulomb_friction", "servo_gain"))
    told = [diagnose([recording_from_table(table, p)], p, options).report for p in (whole, part)]
    assert told[0]["verdict"] == told[1]["verdict"] == "effect"
    assert told[0]["effects"] == told[1]["effects"]
    assert told[0]["effects"][0]["name"] == "coulomb_friction" and told[0]["effects"][0]["site"] == "left_knee"


def _walked(nominal: mujoco.MjModel) -> dict[str, np.ndarray]:
    """Twelve seconds of a leg whose knee rubs with 0.3 N m."""
    made = copy.copy(nominal)
    made.dof_frictionloss[1] = 0.3
    data, rng = mujoco.MjData(made), np.random.default_rng(7)
    mujoco.mj_resetData(made, data)
    n, rows = 2400, []
    t = 0.005 * np.arange(n)
    told = np.stack([0.4 * np.sin(5.0 * t), 0.5 * np.sin(7.0 * t + 1.0)], 1)
    for u in told:
        rows.append(data.qpos[:2].copy())
        data.ctrl[:] = u
        mujoco.mj_step(made, data, nstep=2)
    q = np.array(rows) + rng.normal(0.0, 2e-4, (n, 2))
    return {"t": t, "u_hip": told[:, 0], "u_knee": told[:, 1], "q_hip": q[:, 0], "q_knee": q[:, 1]}
