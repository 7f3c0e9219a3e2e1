"""The robots of the blind check (and of the tests), beside the mouse: small, each with a map and an excitation."""

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

FINGER = """<mujoco model="finger"><option timestep="0.001" integrator="implicitfast"/>
<worldbody><body name="palm"><joint name="wrist" axis="0 1 0" damping="0.03" armature="0.004"/>
<geom type="capsule" fromto="0 0 0 0 0 -.12" size=".02" mass="0.35"/>
<body name="tip" pos="0 0 -.12">
<joint name="knuckle" axis="0 1 0" stiffness="0.8" springref="35" damping="0.015" armature="0.001"/>
<geom type="capsule" fromto="0 0 0 0 0 -.1" size=".015" mass="0.15"/></body></body></worldbody>
<tendon><fixed name="cable"><joint joint="knuckle" coef="0.015"/></fixed></tendon>
<actuator><position name="wrist_servo" joint="wrist" kp="12" kv="0.3" forcerange="-5 5"/>
<position name="cable_servo" tendon="cable" kp="20000" kv="300" forcerange="-150 0"/></actuator>
<sensor><jointpos name="wrist_pos" joint="wrist"/><jointpos name="knuckle_pos" joint="knuckle"/></sensor></mujoco>"""

CAMERA = """<mujoco model="camera"><option timestep="0.0025" integrator="implicitfast"/>
<worldbody><body name="column"><joint name="pan" axis="0 0 1" damping="0.03" armature="0.004"/>
<geom type="capsule" fromto="0 0 0 0 0 .1" size=".02" mass="0.4" contype="0" conaffinity="0"/>
<body name="fork" pos="0 0 .1"><joint name="tilt" axis="0 1 0" damping="0.02" armature="0.003"/>
<geom type="box" size=".02 .05 .03" mass="0.25" contype="0" conaffinity="0"/>
<body name="eye" pos=".04 0 .03"><joint name="roll" axis="1 0 0" damping="0.02" armature="0.002"/>
<geom type="box" size=".05 .03 .03" pos=".03 .01 .02" mass="0.3"
 contype="0" conaffinity="0"/><site name="gyro"/></body></body></body></worldbody>
<actuator><position name="pan_servo" joint="pan" kp="8" kv="0.25" forcerange="-4 4"/>
<position name="tilt_servo" joint="tilt" kp="8" kv="0.25" forcerange="-4 4"/>
<position name="roll_servo" joint="roll" kp="5" kv="0.15" forcerange="-3 3"/></actuator>
<sensor><jointpos name="pan_pos" joint="pan"/><jointpos name="tilt_pos" joint="tilt"/>
<jointpos name="roll_pos" joint="roll"/><gyro name="eye_gyro" site="gyro"/></sensor></mujoco>"""

_QUAD_LEG = """<body name="{leg}_thigh" pos="{x} {y} 0">
<joint name="{leg}_hip" axis="0 1 0" damping="0.02" armature="0.001"/>
<geom type="capsule" fromto="0 0 0 0 0 -.08" size=".01" mass="0.07" contype="0" conaffinity="0"/>
<body name="{leg}_shank" pos="0 0 -.08"><joint name="{leg}_knee" axis="0 1 0" damping="0.02" armature="0.001"/>
<geom type="capsule" fromto="0 0 0 0 0 -.08" size=".008" mass="0.04" contype="0" conaffinity="0"/>
<geom name="{leg}_foot" type="sphere" pos="0 0 -.08" size=".012" mass="0.01" friction="0.8"/></body></body>"""
_QUAD_SERVOS = """<position name="{leg}_hip_servo" joint="{leg}_hip" kp="12" kv="0.25" forcerange="-3 3"/>
<position name="{leg}_knee_servo" joint="{leg}_knee" kp="12" kv="0.25" forcerange="-3 3"/>"""
_QUAD_SENSORS = (
    """<jointpos name="{leg}_hip_pos" joint="{leg}_hip"/><jointpos name="{leg}_knee_pos" joint="{leg}_knee"/>"""
)
QUAD_LEGS = ("front_left", "front_right", "rear_left", "rear_right")


def _each_leg(text: str) -> str:
    places = {leg: (0.1 if "front" in leg else -0.1, 0.06 if "left" in leg else -0.06) for leg in QUAD_LEGS}
    return "".join(text.format(leg=leg, x=x, y=y) for leg, (x, y) in places.items())


QUAD = f"""<mujoco model="quad"><option timestep="0.001" integrator="implicitfast" cone="elliptic"/>
<worldbody><geom name="floor" type="plane" size="9 9 .1" friction="0.8"/>
<body name="trunk" pos="0 0 0.152"><freejoint name="root"/>
<geom type="box" size=".12 .05 .025" mass="1.1" contype="0" conaffinity="0"/><site name="imu"/>
{_each_leg(_QUAD_LEG)}</body></worldbody>
<actuator>{_each_leg(_QUAD_SERVOS)}</actuator>
<sensor>{_each_leg(_QUAD_SENSORS)}<gyro name="imu_gyro" site="imu"/></sensor></mujoco>"""


def _angles(columns: dict[str, str], what: str) -> list[dict[str, object]]:
    """Rows of a map for columns in rad: {column: name of the actuator or sensor}."""
    extra: dict[str, object] = {"kind": "position"} if what == "actuator" else {}
    return [{"column": c, "unit": "rad", what: name, **extra} for c, name in columns.items()]


def _vector(sensor: str, unit: str) -> list[dict[str, object]]:
    return [{"column": f"{sensor}_{a}", "unit": unit, "sensor": sensor, "component": a} for a in "xyz"]


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
    "finger": {
        "time": {"column": "t", "unit": "s"},
        "inputs": [
            {"column": "u0", "unit": "rad", "actuator": "wrist_servo", "kind": "position"},
            {"column": "u1", "unit": "mm", "actuator": "cable_servo", "kind": "position"},
        ],
        "outputs": _angles({"q0": "wrist_pos", "q1": "knuckle_pos"}, "sensor"),
    },
    "camera": {
        "time": {"column": "t", "unit": "s"},
        "inputs": _angles({"u0": "pan_servo", "u1": "tilt_servo", "u2": "roll_servo"}, "actuator"),
        "outputs": [
            *_angles({"q0": "pan_pos", "q1": "tilt_pos", "q2": "roll_pos"}, "sensor"),
            *_vector("eye_gyro", "rad/s"),
        ],
    },
    "quad": {
        "time": {"column": "t", "unit": "s"},
        "inputs": _angles(
            {f"{leg}_{j}_cmd": f"{leg}_{j}_servo" for leg in QUAD_LEGS for j in ("hip", "knee")}, "actuator"
        ),
        "outputs": [
            *_angles({f"{leg}_{j}": f"{leg}_{j}_pos" for leg in QUAD_LEGS for j in ("hip", "knee")}, "sensor"),
            *_vector("imu_gyro", "rad/s"),
            *[{"column": a, "unit": "m", "body": "trunk", "quantity": "position", "component": a} for a in "xyz"],
            *[
                {"column": f"q{a}", "unit": "1", "body": "trunk", "quantity": "orientation", "component": a}
                for a in "wxyz"
            ],
        ],
    },
}
MODELS = {
    "pendulum": PENDULUM,
    "cart_pole": CART_POLE,
    "arm": ARM,
    "leg": LEG,
    "finger": FINGER,
    "camera": CAMERA,
    "quad": QUAD,
}


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
        case "finger":
            return {"u0": 0.5 * smooth_noise(rng, n, dt), "u1": 15.0 * (-0.1 + 0.35 * smooth_noise(rng, n, dt))}
        case "camera":
            return {f"u{i}": 0.45 * smooth_noise(rng, n, dt, 0.3, 1.8) for i in range(3)}
        case "quad":
            return _trot(rng, n, dt)
        case _:
            # The foot stays below the hip, and slides a little.
            bend, swing = 0.2 * smooth_noise(rng, n, dt, 0.3, 1.5), 0.01 * smooth_noise(rng, n, dt, 0.3, 1.5)
            return {"u0": -0.25 + 0.5 * bend + swing, "u1": 0.02 * (0.55 - bend)}


def _trot(rng: np.random.Generator, n: int, dt: float) -> dict[str, Array]:
    """A trot on the spot and forward, its stride and height changing slowly."""
    t = dt * np.arange(n)
    frequency = rng.uniform(1.2, 1.8)
    stride, lift = (a * (1 + 0.35 * smooth_noise(rng, n, dt, 0.1, 0.4)) for a in (0.16, 0.3))
    ramp = np.clip(t / 0.8, 0.0, 1.0)
    found = {}
    for leg in QUAD_LEGS:
        phase = 2 * np.pi * frequency * t + (np.pi if leg in ("front_left", "rear_right") else 0.0)
        swing = np.clip(np.sin(phase), 0.0, None)
        found[f"{leg}_hip_cmd"] = 0.5 - ramp * (stride * np.cos(phase) - 0.5 * lift * swing)
        found[f"{leg}_knee_cmd"] = -1.0 - ramp * lift * swing
    return found


def start(name: str) -> dict[str, float]:
    """Joint angles [rad] at which a robot begins, where they are not zero."""
    if name == "quad":
        return {f"{leg}_{j}": a for leg in QUAD_LEGS for j, a in (("hip", 0.5), ("knee", -1.0))}
    return {}
