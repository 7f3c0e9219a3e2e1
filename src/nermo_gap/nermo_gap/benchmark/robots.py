"""The robots of the development benchmark (and of the tests): small, and nothing like a mouse."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

PENDULUM = """<mujoco model="pendulum"><option timestep="0.0025" integrator="implicitfast"/>
<worldbody><body name="link"><joint name="hinge" axis="0 1 0" damping="0.02" armature="0.002"/>
<geom name="rod" type="capsule" fromto="0 0 0 0 0 -.3" size=".02" mass="0.8"/></body></worldbody>
<actuator><position name="servo" joint="hinge" kp="12" kv="0.3" forcerange="-8 8" ctrlrange="-2 2"/></actuator>
<sensor><jointpos name="angle" joint="hinge"/></sensor></mujoco>"""

CART_POLE = """<mujoco model="cart_pole"><option timestep="0.0025" integrator="implicitfast"/>
<worldbody><body name="cart"><joint name="slide" type="slide" axis="1 0 0" damping="0.5"/>
<geom type="box" size=".1 .05 .05" mass="1"/>
<body name="pole" pos="0 0 0"><joint name="swing" axis="0 1 0" damping="0.005"/>
<geom type="capsule" fromto="0 0 0 0 0 -.5" size=".015" mass="0.2"/></body></body></worldbody>
<actuator><motor name="push" joint="slide" gear="10" ctrlrange="-1 1"/></actuator></mujoco>"""

ARM = """<mujoco model="arm"><option timestep="0.0025" integrator="implicitfast"/>
<worldbody><body name="upper"><joint name="shoulder" axis="0 1 0" damping="0.05" armature="0.01"/>
<geom type="capsule" fromto="0 0 0 0 0 -.3" size=".025" mass="1"/>
<body name="fore" pos="0 0 -.3"><joint name="elbow" axis="0 1 0" damping="0.03" armature="0.005"/>
<geom type="capsule" fromto="0 0 0 0 0 -.25" size=".02" mass="0.6"/></body></body></worldbody>
<actuator><position name="shoulder_servo" joint="shoulder" kp="30" kv="1" forcerange="-15 15"/>
<position name="elbow_servo" joint="elbow" kp="15" kv="0.5" forcerange="-8 8"/></actuator>
<sensor><jointpos name="shoulder_pos" joint="shoulder"/><jointpos name="elbow_pos" joint="elbow"/></sensor></mujoco>"""

LEG = """<mujoco model="leg"><option timestep="0.001" integrator="implicitfast" cone="elliptic"/>
<worldbody><geom name="floor" type="plane" size="2 2 .1" friction="0.8"/>
<body name="trunk" pos="0 0 0.32"><joint name="lift" type="slide" axis="0 0 1" damping="1"/>
<geom name="trunk" type="box" size=".06 .04 .03" mass="0.8" contype="0" conaffinity="0"/>
<body name="thigh"><joint name="hip" axis="0 1 0" damping="0.02" armature="0.002"/>
<geom type="capsule" fromto="0 0 0 0 0 -.16" size=".012" mass="0.12" contype="0" conaffinity="0"/>
<body name="shank" pos="0 0 -.16">
<joint name="knee" axis="0 1 0" stiffness="1.5" springref="0.3" damping="0.02" armature="0.001"/>
<geom type="capsule" fromto="0 0 0 0 0 -.15" size=".01" mass="0.08" contype="0" conaffinity="0"/>
<geom name="foot" type="sphere" pos="0 0 -.16" size=".015" mass="0.02" friction="0.8"/></body></body></body></worldbody>
<tendon><fixed name="knee_cable"><joint joint="knee" coef="0.02"/></fixed></tendon>
<actuator><position name="hip_servo" joint="hip" kp="25" kv="0.6" forcerange="-6 6"/>
<position name="cable_servo" tendon="knee_cable" kp="25000" kv="500" forcerange="-200 200"/></actuator>
<sensor><jointpos name="hip_pos" joint="hip"/><jointpos name="knee_pos" joint="knee"/></sensor></mujoco>"""

MAPS: dict[str, dict[str, object]] = {
    "pendulum": {
        "time": {"column": "t", "unit": "s"},
        "inputs": [{"column": "u", "unit": "rad", "actuator": "servo", "kind": "position"}],
        "outputs": [{"column": "q", "unit": "rad", "sensor": "angle"}],
    },
    "cart_pole": {
        "time": {"column": "t", "unit": "s"},
        "inputs": [{"column": "f", "unit": "N", "actuator": "push", "kind": "torque"}],
        "outputs": [
            {"column": "x", "unit": "m", "joint": "slide", "quantity": "position"},
            {"column": "phi", "unit": "rad", "joint": "swing", "quantity": "position"},
        ],
    },
    "arm": {
        "time": {"column": "t", "unit": "s"},
        "inputs": [
            {"column": "u0", "unit": "rad", "actuator": "shoulder_servo", "kind": "position"},
            {"column": "u1", "unit": "rad", "actuator": "elbow_servo", "kind": "position"},
        ],
        "outputs": [
            {"column": "q0", "unit": "rad", "sensor": "shoulder_pos"},
            {"column": "q1", "unit": "rad", "sensor": "elbow_pos"},
        ],
    },
    "leg": {
        "time": {"column": "t", "unit": "s"},
        "inputs": [
            {"column": "u0", "unit": "rad", "actuator": "hip_servo", "kind": "position"},
            {"column": "u1", "unit": "m", "actuator": "cable_servo", "kind": "position"},
        ],
        "outputs": [
            {"column": "q0", "unit": "rad", "sensor": "hip_pos"},
            {"column": "q1", "unit": "rad", "sensor": "knee_pos"},
            {"column": "z", "unit": "m", "body": "trunk", "quantity": "position", "component": "z"},
        ],
    },
}
MODELS = {"pendulum": PENDULUM, "cart_pole": CART_POLE, "arm": ARM, "leg": LEG}


def smooth_noise(rng: np.random.Generator, n: int, dt: float, low: float = 0.2, high: float = 1.5) -> Array:
    """A random sum of sines between two frequencies [Hz] with standard deviation 1."""
    t = dt * np.arange(n)
    frequencies, phases = rng.uniform(low, high, 12), rng.uniform(0, 2 * np.pi, 12)
    total: Array = np.sin(2 * np.pi * frequencies[:, None] * t + phases[:, None]).sum(0)
    return total / total.std()


def commands(name: str, seed: int, n: int, dt: float) -> dict[str, Array]:
    """An excitation that suits each robot."""
    rng = np.random.default_rng(seed)
    match name:
        case "pendulum":
            return {"u": 0.6 * smooth_noise(rng, n, dt)}
        case "cart_pole":
            return {"f": 3.0 * smooth_noise(rng, n, dt, 0.4, 2.0)}
        case "arm":
            return {"u0": 0.5 * smooth_noise(rng, n, dt), "u1": 0.6 * smooth_noise(rng, n, dt)}
        case _:
            bend = 0.15 * smooth_noise(rng, n, dt, 0.3, 1.0)
            return {"u0": -0.25 + 0.5 * bend, "u1": 0.02 * (0.55 - bend)}
