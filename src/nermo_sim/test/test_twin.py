"""The twin obeys, feels, times out, and says so when it breaks."""

from __future__ import annotations

import math
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from nermo_description.command_follower import Following
from nermo_description.parameters import LEGS, RobotParameters
from nermo_sim.divergence import STATE, SimulationDivergedError, load_dump
from nermo_sim.layout import ModelError
from nermo_sim.sensor_data import TYPICAL_NOISE, SensorNoise
from nermo_sim.twin import Twin

GRAVITY = 9.81
SHARED = settings(max_examples=8, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def held(twin: Twin) -> list[float]:
    """The command that changes nothing."""
    return twin.data.ctrl[twin.layout.actuators].tolist()


def run(twin: Twin, seconds: float, command: list[float] | None = None) -> None:
    for _ in range(round(seconds * 1e9 / twin.period_ns)):
        twin.step(command)


@pytest.mark.parametrize("keyframe", ["stand", "sit", "crouch"])
def test_stays_where_a_keyframe_puts_it(twin: Twin, keyframe: str) -> None:
    twin.reset(keyframe)
    before = twin.base_state()
    run(twin, 2.0, held(twin))
    after = twin.base_state()
    assert after.position == pytest.approx(before.position, abs=1e-3)
    assert max(map(abs, after.linear_velocity)) < 1e-3


def test_four_feet_carry_the_weight_in_the_stand(twin: Twin) -> None:
    run(twin, 1.0, held(twin))
    forces, touching = twin.foot_forces()
    weight = GRAVITY * float(twin.model.body_subtreemass[0])
    assert all(touching)
    assert forces.sum(axis=0) == pytest.approx([0.0, 0.0, weight], abs=0.01 * weight)
    assert twin.sensors().foot_forces == pytest.approx(forces[:, 2], rel=0.02)


def test_imu_feels_gravity_upwards(twin: Twin) -> None:
    run(twin, 1.0, held(twin))
    sensors = twin.sensors()
    assert np.linalg.norm(sensors.linear_acceleration) == pytest.approx(GRAVITY, rel=0.01)
    assert sensors.linear_acceleration[2] > 0.99 * GRAVITY
    assert np.linalg.norm(sensors.orientation) == pytest.approx(1.0)


def test_odometry_and_base_state_agree(twin: Twin) -> None:
    twin.displace(0.3, np.zeros(twin.joint_count))
    twin.push((0.5, 0.2, 0.0), 0.1)
    run(twin, 0.1, held(twin))
    odometry, state = twin.odometry(), twin.base_state()
    w, x, y, z = state.quaternion
    assert (odometry.x, odometry.y) == state.position[:2]
    assert odometry.yaw == pytest.approx(math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))
    assert odometry.forward_velocity == state.linear_velocity[0]
    assert odometry.turn_rate == state.angular_velocity[2]
    assert odometry.yaw == pytest.approx(0.3, abs=0.1)


def test_servos_go_where_they_are_told(twin: Twin) -> None:
    command = held(twin)
    index = twin.layout.servos.index("head_pan")
    command[index] += 0.4
    run(twin, 1.0, command)
    assert twin.sensors().servo_positions[index] == pytest.approx(command[index], abs=0.05)


def test_time_goes_on_over_a_reset(twin: Twin) -> None:
    run(twin, 0.1, held(twin))
    before = twin.time_ns
    sensors = twin.reset("crouch")
    assert sensors.stamp == twin.time_ns == before
    assert twin.step(None).stamp == before + twin.period_ns
    assert twin.data.time == pytest.approx(twin.time_ns * 1e-9)


def test_unknown_keyframe_is_refused_with_the_names(twin: Twin) -> None:
    with pytest.raises(ValueError, match="'fly' is unknown: choose one of stand"):
        twin.reset("fly")


def test_command_far_from_the_posture_after_a_reset_is_approached(twin: Twin) -> None:
    command = held(twin)
    command[0] += 0.5
    twin.step(command)
    start = held(twin)[0]
    positions = []
    for _ in range(200):
        twin.step(command)
        positions.append(held(twin)[0])
    assert start < command[0] - 0.4
    assert np.abs(np.diff(positions)).max() < 0.02
    assert positions[-1] == command[0]


def test_silence_holds_and_then_crouches(twin: Twin) -> None:
    command = held(twin)
    run(twin, 0.1, command)
    assert twin.command_state is Following.FOLLOWING
    run(twin, 0.19)
    assert twin.command_state is Following.FOLLOWING
    run(twin, 0.02)
    assert twin.command_state is Following.HOLDING
    assert held(twin) == command
    run(twin, 0.8)
    assert twin.command_state is Following.CROUCHING
    run(twin, 1.0)
    crouch = twin.model.key_ctrl[twin.layout.keyframes["crouch"]]
    assert twin.data.ctrl == pytest.approx(crouch)
    assert twin.tilt() < 0.1
    run(twin, 1.0, command)
    assert twin.command_state is Following.FOLLOWING
    assert held(twin) == command


def test_nobody_ever_commanding_is_no_silence(twin: Twin) -> None:
    run(twin, 2.0)
    assert twin.command_state is Following.WAITING


@pytest.mark.parametrize(
    ("command", "message"),
    [([0.0] * 3, "3 servo positions: there are 11"), ([math.nan] * 11, "finite"), ([math.inf] + [0.0] * 10, "finite")],
)
def test_unusable_command_is_refused_and_changes_nothing(twin: Twin, command: list[float], message: str) -> None:
    run(twin, 0.05, held(twin))
    before = held(twin)
    with pytest.raises(ValueError, match=message):
        twin.step(command)
    twin.step(None)
    assert held(twin) == before


def test_push_moves_the_mouse_in_its_direction_and_ends(twin: Twin) -> None:
    run(twin, 0.2, held(twin))
    before = twin.base_state().position
    twin.push((0.0, 1.5, 0.0), 0.05)
    run(twin, 0.05, held(twin))
    assert twin.base_state().linear_velocity[1] > 0.01
    run(twin, 0.01, held(twin))
    assert not twin.data.xfrc_applied.any()
    assert twin.base_state().position[1] > before[1]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (((1.0, 0.0, 0.0), 0.1, "ghost"), "body 'ghost' is unknown"),
        (((math.nan, 0.0, 0.0), 0.1), "finite"),
        (((1.0, 0.0, 0.0), 0.0), "duration"),
        (((1.0, 0.0, 0.0), math.nan), "duration"),
    ],
)
def test_unusable_push_is_refused(twin: Twin, arguments: tuple, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        twin.push(*arguments)


@SHARED
@given(st.integers(min_value=0, max_value=2**32 - 1), st.sampled_from([1, 10, 40]))
def test_no_command_within_range_breaks_the_simulation(
    twin: Twin, robot: RobotParameters, seed: int, hold: int
) -> None:
    random = np.random.default_rng(seed)
    lower = [servo.lower for servo in robot.servos.values()]
    upper = [servo.upper for servo in robot.servos.values()]
    twin.reset()
    for _ in range(200 // hold):
        command = random.uniform(lower, upper).tolist()
        for _ in range(hold):
            sensors = twin.step(command)
    assert np.isfinite(sensors.values).all()
    assert abs(twin.base_state().position[2]) < 1.0


@pytest.mark.parametrize("joint", ["rear_right_ankle_joint", "spine_lateral_2_joint", "front_left_hip_joint"])
def test_divergence_stops_names_the_joint_and_leaves_a_dump(twin: Twin, tmp_path: Path, joint: str) -> None:
    run(twin, 0.5, held(twin))
    number = twin.model.joint(joint).id
    stiffness = float(twin.model.jnt_stiffness[number])
    twin.model.jnt_stiffness[number] = 1e6  # far too stiff for the time step
    with pytest.raises(SimulationDivergedError, match=joint) as caught:
        run(twin, 1.0, held(twin))
    twin.model.jnt_stiffness[number] = stiffness
    assert caught.value.joint == joint
    with pytest.raises(SimulationDivergedError):
        twin.step(None)

    dump = load_dump(caught.value.folder)
    assert caught.value.folder == tmp_path / "dump"
    assert dump.joint == joint
    assert 100 < len(dump.states) == len(dump.controls) <= 201
    assert np.isfinite(dump.states[:-1]).all()
    assert not np.isfinite(dump.states[-1]).all() or np.abs(dump.states[-1]).max() > 1e10
    data = mujoco.MjData(dump.model)
    mujoco.mj_setState(dump.model, data, dump.states[-2], STATE)
    mujoco.mj_forward(dump.model, data)
    assert np.isfinite(data.sensordata).all()

    twin.reset()
    run(twin, 0.1, held(twin))
    assert np.isfinite(twin.sensors().values).all()


def test_dump_holds_no_more_than_the_last_second(twin: Twin) -> None:
    run(twin, 1.5, held(twin))
    twin.data.qvel[:] = math.nan
    with pytest.raises(SimulationDivergedError) as caught:
        twin.step(held(twin))
    dump = load_dump(caught.value.folder)
    assert len(dump.states) == 200  # one second of ticks
    assert np.diff(dump.states[:, 0]) == pytest.approx(0.005)


def test_same_seed_same_bytes_and_other_seed_other_noise(robot: RobotParameters, compiled: mujoco.MjModel) -> None:
    noise = SensorNoise(servo_position=0.01, angular_velocity=0.1)

    def values(seed: int) -> bytes:
        twin = Twin(robot, model=compiled, noise=noise, seed=seed)
        for _ in range(20):
            sensors = twin.step(held(twin))
        return sensors.values.tobytes()

    assert values(3) == values(3)
    assert values(3) != values(4)


def test_noise_has_the_stated_deviation_and_only_where_stated(robot: RobotParameters, compiled: mujoco.MjModel) -> None:
    noisy = Twin(robot, model=compiled, noise=SensorNoise(angular_velocity=0.2))
    clean = Twin(robot, model=compiled)
    errors = []
    for _ in range(400):
        measured, true = noisy.step(held(noisy)), clean.step(held(clean))
        errors.append(np.subtract(measured.angular_velocity, true.angular_velocity))
        assert measured.servo_positions == true.servo_positions
    assert np.std(errors) == pytest.approx(0.2, rel=0.1)


def test_typical_noise_is_on_every_reading_that_the_robot_has(robot: RobotParameters, compiled: mujoco.MjModel) -> None:
    once, thrice = Twin(robot, model=compiled, noise=TYPICAL_NOISE), TYPICAL_NOISE.times(3.0)
    layout, size = once.layout, compiled.nsensordata
    deviations = TYPICAL_NOISE.deviations(layout, size)
    assert thrice.deviations(layout, size) == pytest.approx(3.0 * deviations)
    readings = ("servo_positions", "servo_velocities", "servo_torques", "orientation", "angular_velocity")
    clean = Twin(robot, model=compiled)
    noisy, true = once.step(held(once)), clean.step(held(clean))
    for name in (*readings, "linear_acceleration", "foot_forces", "knee_encoders"):
        assert np.all(np.not_equal(getattr(noisy, name), getattr(true, name))), name


def test_interpolation_reaches_the_same_target_without_a_step(robot: RobotParameters, compiled: mujoco.MjModel) -> None:
    twin = Twin(robot, model=compiled, interpolate=True)
    command = held(twin)
    command[-1] += 0.05
    twin.step(command)
    assert held(twin) == pytest.approx(command)
    run(twin, 0.1, command)
    assert held(twin) == pytest.approx(command)


def test_period_must_fit_the_physics(robot: RobotParameters, compiled: mujoco.MjModel) -> None:
    with pytest.raises(ValueError, match="multiple of 0.001"):
        Twin(robot, model=compiled, period_ns=3_300_000)


def test_model_without_the_agreed_names_is_refused(robot: RobotParameters) -> None:
    with pytest.raises(ModelError, match="no actuator named 'front_left_hip'"):
        Twin(robot, model=mujoco.MjModel.from_xml_string("<mujoco/>"))


def test_without_power_its_springs_have_it_until_power_and_a_command_come_back(
    twin: Twin, robot: RobotParameters
) -> None:
    command = held(twin)
    run(twin, 0.5, command)
    standing = twin.base_state().position[2]
    twin.power(False)
    run(twin, 2.0, command)
    assert twin.command_state is Following.LIMP
    for leg, knee in zip(LEGS, twin.sensors().knee_encoders, strict=True):
        dynamics = robot.front_leg_dynamics if leg.startswith("front") else robot.rear_leg_dynamics
        assert knee == pytest.approx(dynamics.knee.rest, abs=0.1), "its spring has stretched it"
    assert twin.sensors().servo_torques == pytest.approx([0.0] * len(command))
    twin.power(True)
    lying = held(twin)
    run(twin, 1.5)
    assert twin.command_state is Following.WAITING
    assert held(twin) == lying
    run(twin, 1.5, command)
    assert twin.base_state().position[2] == pytest.approx(standing, rel=0.1)


def test_a_reset_gives_no_power(twin: Twin) -> None:
    twin.power(False)
    twin.reset()
    assert twin.command_state is Following.LIMP
