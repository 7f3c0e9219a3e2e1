"""Tables, maps and the door: what cannot be used is refused in one sentence that names the entry."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pyarrow
import pyarrow.parquet
import pytest
from robots import ARM, MAPS, aligned_of, plant_of, simulate

from simgap.analysis.input_checks import check_map, check_replay
from simgap.data.align import align
from simgap.data.errors import GapInputError
from simgap.data.mapping import load_map, parse_map
from simgap.data.noise_floor import noise_floor
from simgap.data.plant import build_plant, euler_angles
from simgap.data.recording import load_table, recording_from_table
from simgap.data.units import factor
from simgap.simulation.state import measured_state
from simgap.simulation.windows import cut


@pytest.mark.parametrize(
    ("unit", "quantities", "value"),
    [
        ("deg", ("angle",), np.pi / 180),
        ("rpm", ("angular_velocity",), np.pi / 30),
        ("mm", ("length",), 1e-3),
        ("Nm", ("torque",), 1.0),
        ("mN m", ("torque",), 1e-3),
        ("g", ("acceleration",), 9.80665),
        ("ms", ("time",), 1e-3),
        ("rad", ("length", "angle"), 1.0),
    ],
)
def test_units_convert(unit: str, quantities: tuple[str, ...], value: float) -> None:
    assert factor(unit, quantities, "row")[0] == pytest.approx(value)


@pytest.mark.parametrize("unit", [None, "", "m", "1", "Hz", "furlongish", "N"])
def test_unit_that_does_not_fit_names_the_row(unit: str | None) -> None:
    with pytest.raises(GapInputError, match=r"outputs\[3\]"):
        factor(unit, ("angle",), "map: outputs[3]")


@pytest.mark.parametrize("suffix", [".csv", ".npz", ".parquet"])
def test_tables_read_alike(tmp_path: Path, suffix: str) -> None:
    columns = {"t": np.arange(5) * 0.1, "q": np.array([1.0, 2.5, np.nan, -1e-3, 4.0])}
    path = tmp_path / f"log{suffix}"
    match suffix:
        case ".csv":
            lines = [
                "t,q",
                *(
                    f"{float(t)!r},{'' if np.isnan(q) else repr(float(q))}"
                    for t, q in zip(*columns.values(), strict=False)
                ),
            ]
            path.write_text("\n".join(lines) + "\n")
        case ".npz":
            np.savez(path, **columns)
        case _:
            pyarrow.parquet.write_table(pyarrow.table(columns), path)
    table = load_table(path)
    for name, values in columns.items():
        np.testing.assert_array_equal(table[name], values)


def _arm_map(**changes: object) -> dict[str, object]:
    return {**MAPS["arm"], **changes}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"inputs": []}, "neither commanded nor measured inputs"),
        ({"outputs": []}, "nothing measured"),
        (
            {"inputs": [{"column": "u", "unit": "rad", "actuator": "sholder_servo", "kind": "position"}]},
            "shoulder_servo",
        ),
        ({"outputs": [{"column": "q", "unit": "rad", "joint": "knee", "quantity": "position"}]}, "shoulder, elbow"),
        ({"outputs": [{"column": "q", "unit": "m", "sensor": "elbow_pos"}]}, r"outputs\[0\] \(q\).*'m' does not fit"),
        ({"outputs": [{"column": "q", "sensor": "elbow_pos"}]}, "unit is missing"),
        ({"outputs": [{"column": "q", "unit": "rad", "sensor": "elbow_pos", "colour": 1}]}, r"outputs\[0\].colour"),
        ({"inputs": [{"column": "u", "unit": "N m", "actuator": "elbow_servo", "kind": "torque"}]}, "takes no torque"),
        ({"gains": {"elbow_servo": {"kp": -1}}}, "gains.elbow_servo.kp"),
    ],
)
def test_wrong_maps_are_refused(changes: dict[str, object], message: str) -> None:
    with pytest.raises(GapInputError, match=message):
        build_plant(mujoco.MjSpec.from_string(ARM), parse_map(_arm_map(**changes)))


def test_map_file_errors_name_the_file(tmp_path: Path) -> None:
    bad = tmp_path / "bad.yaml"
    bad.write_text("inputs: [")
    for path in (bad, tmp_path / "missing.yaml"):
        with pytest.raises(GapInputError, match=path.name):
            load_map(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b"[" * 20_000, "nested more than 20 deep in line 1"),
        (b"a: &a [x, x]\nb: &b [*a, *a]\nc: [*b, *b]\n", r"the alias \*a in line 2: a map is written without"),
        (b"a: [" + b"1, " * 30_000 + b"]", "longer than 50000 bytes"),
        (b"time: 2026-99-99\n", "month must be in 1..12"),
        (b"\xff\xfe\xfd", "can't decode"),
        (b"- time\n", "needs the keys time, inputs and outputs"),
        (b"gains:\n  knee: {kp: 3}\n  hip: {kp: 1}\n  knee: {kp: 30}\n", "'knee' stands twice, again in line 4"),
        (b"inputs: []\noutputs: []\ninputs: [1]\n", "'inputs' stands twice, again in line 3"),
    ],
)
def test_a_map_beyond_all_measure_is_refused_in_one_sentence(tmp_path: Path, text: bytes, message: str) -> None:
    path = tmp_path / "map.yaml"
    path.write_bytes(text)
    with pytest.raises(GapInputError, match=f"map.yaml: .*{message}"):
        load_map(path)


def test_missing_column_suggests_the_nearest() -> None:
    table = simulate("arm", 5.0)
    table["q_0"] = table.pop("q0")
    with pytest.raises(GapInputError, match="q_0"):
        recording_from_table(table, plant_of("arm"))


def test_gains_put_a_controller_in_front_of_a_motor() -> None:
    xml = ARM.replace('<position name="elbow_servo" joint="elbow" kp="15" kv="0.5" forcerange="-8 8"/>',
                      '<motor name="elbow_servo" joint="elbow" gear="4" ctrlrange="-2 2"/>')  # fmt: skip
    plant = build_plant(
        mujoco.MjSpec.from_string(xml), parse_map(_arm_map(gains={"elbow_servo": {"kp": 15, "kd": 0.5}}))
    )
    data = mujoco.MjData(plant.model)
    data.qpos[:], data.qvel[:], data.ctrl[:] = [0.1, 0.2], [0.3, -0.4], [0.0, 0.5]
    mujoco.mj_forward(plant.model, data)
    assert data.qfrc_actuator[1] == pytest.approx(15 * (0.5 - 0.2) - 0.5 * -0.4)
    data.ctrl[1] = 5.0
    mujoco.mj_forward(plant.model, data)
    assert data.qfrc_actuator[1] == pytest.approx(4 * 2.0)


def test_what_is_said_of_a_channel_has_its_unit() -> None:
    """The zero of a rate is a rate."""
    row = {"column": "dq0", "joint": "shoulder", "quantity": "velocity", "unit": "deg/s"}
    plant = build_plant(mujoco.MjSpec.from_string(ARM), parse_map(MAPS["arm"] | {"outputs": [row]}))
    assert [(channel.unit, channel.quantity) for channel in plant.outputs] == [("rad/s", "angular_velocity")]


def test_euler_angles_of_single_turns() -> None:
    for axis in range(3):
        quaternion = np.zeros(4)
        quaternion[0], quaternion[1 + axis] = np.cos(0.2), np.sin(0.2)
        expected = np.zeros(3)
        expected[axis] = 0.4
        np.testing.assert_allclose(euler_angles(quaternion), expected, atol=1e-12)


def _align(name: str, table: dict[str, np.ndarray]):  # type: ignore[no-untyped-def,type-arg]
    plant = plant_of(name)
    return plant, align(recording_from_table(table, plant), plant)


def test_time_jump_splits_the_recording_and_no_window_crosses_it() -> None:
    table = simulate("arm", 14.0)
    table["t"] = np.where(table["t"] > 6.0, table["t"] + 3.0, table["t"])
    table["t"] = np.where(table["t"] > 13.0, table["t"] - 11.0, table["t"])
    _, aligned = _align("arm", table)
    assert len(aligned.runs) == 3
    assert "jumps 2 times" in " ".join(aligned.warnings)
    windows = cut(aligned, horizon=0.4)
    for start in windows.start:
        run = next(r for r in aligned.runs if r.start <= start < r.stop)
        assert run.start <= start - windows.warm_up and start + windows.length <= run.stop


def test_two_seconds_are_too_short() -> None:
    with pytest.raises(GapInputError, match="at least 4 s"):
        _align("arm", simulate("arm", 2.0))


def test_slow_time_is_taken_for_a_wrong_unit() -> None:
    table = simulate("arm", 12.0)
    table["t"] *= 1000.0
    with pytest.raises(GapInputError, match="unit of time"):
        _align("arm", table)


def test_dead_channel_is_named_and_left_out() -> None:
    table = simulate("arm", 8.0)
    table["q1"][:] = 0.31
    _, aligned = _align("arm", table)
    assert aligned.live.tolist() == [True, False]
    assert any("q1" in w and "dead" in w for w in aligned.warnings)
    table["q0"][300:] = table["q0"][300]
    with pytest.raises(GapInputError, match="no output"):
        _align("arm", table)


def test_dropped_samples_are_not_scored() -> None:
    table = simulate("arm", 8.0)
    table["q0"][500:540] = np.nan
    _, aligned = _align("arm", table)
    assert not aligned.valid[505:535, 0].any() and aligned.valid[505:535, 1].all()
    assert aligned.valid[:, 0].mean() > 0.97


def test_a_slower_channel_lacks_nothing_and_one_with_holes_does() -> None:
    table = simulate("arm", 8.0)
    slow = np.arange(len(table["q0"])) % 4 == 0
    table["q0"] = np.where(slow, table["q0"], np.nan)
    assert not any("missing" in w for w in _align("arm", table)[1].warnings)
    lost = np.random.default_rng(0).random(len(slow)) < 0.1
    table["q0"][lost] = np.nan
    (warning,) = [w for w in _align("arm", table)[1].warnings if "missing" in w]
    assert "q0" in warning and 8.0 < float(warning.split(":")[1].split("%")[0]) < 12.0


@pytest.mark.parametrize("noise", [1e-4, 1e-3])
def test_noise_floor_finds_white_noise(noise: float) -> None:
    _, _, floor = aligned_of("arm", simulate("arm", 10.0, noise=noise))
    np.testing.assert_allclose(floor, noise, rtol=0.25)


def test_noise_floor_of_a_robot_that_rests_most_of_the_time_is_that_of_its_motion() -> None:
    """In its friction it repeats the same value, which says nothing of how well a motion repeats."""
    plant, table = plant_of("pendulum"), simulate("pendulum", 12.0, noise=2e-4)
    column = plant.outputs[0].column
    rests = (table["t"] % 2.0) > 0.5
    held = np.maximum.accumulate(np.where(rests, 0, np.arange(len(rests))))
    table[column] = table[column][held]
    floor = noise_floor(align(recording_from_table(table, plant), plant))
    assert floor[0] == pytest.approx(2e-4, rel=0.3)


def test_noise_floor_sees_quantisation_and_repeats() -> None:
    table = simulate("pendulum", 10.0, noise=0.0)
    step = 2 * np.pi / 4096
    table["q"] = np.round(table["q"] / step) * step
    _, _, floor = aligned_of("pendulum", table)
    assert floor[0] == pytest.approx(step / np.sqrt(12), rel=0.3)
    # The same commands twice, with an error that is too slow to look like noise.
    one, slow = simulate("pendulum", 6.0, noise=1e-4), 0.01
    two = {k: v.copy() for k, v in one.items()}
    two["q"] = two["q"] + slow * np.sin(2 * two["t"]) * np.sqrt(2)
    joined = {k: np.concatenate([one[k], two[k] + (10.0 if k == "t" else 0.0)]) for k in one}
    _, _, floor = aligned_of("pendulum", joined)
    assert floor[0] == pytest.approx(slow / np.sqrt(2), rel=0.3)


def test_runs_that_began_elsewhere_or_of_another_robot_are_no_repeats() -> None:
    """A robot that was set down elsewhere, and one with a payload, differ by no noise."""
    noise = 1e-4
    rng, still = np.random.default_rng(0), simulate("pendulum", 6.0, noise=0.0)
    one, two = ({**still, "q": still["q"] + rng.normal(0.0, noise, len(still["q"]))} for _ in range(2))
    joined = {k: np.concatenate([one[k], two[k] + {"t": 10.0, "q": 0.2}.get(k, 0.0)]) for k in one}
    _, aligned, floor = aligned_of("pendulum", joined)
    assert len(aligned.runs) == 2 and floor[0] == pytest.approx(noise, rel=0.25)
    length = len(one["t"])
    joined["q"][length:] += 0.05 * np.sin(joined["t"][length:])
    plant = plant_of("pendulum")
    recording = recording_from_table(joined, plant)
    assert noise_floor(align(recording, plant))[0] > 100.0 * noise
    recording.setup = np.repeat([0.0, 1.0], length)
    assert noise_floor(align(recording, plant))[0] == pytest.approx(noise, rel=0.25)


def test_an_encoder_s_count_is_found_though_stamps_are_irregular_and_digits_few() -> None:
    table = simulate("pendulum", 10.0, noise=0.0)
    step = 2 * np.pi / 4096
    rng = np.random.default_rng(0)
    table["t"] = table["t"] + rng.uniform(0.0, 0.1 * np.diff(table["t"]).min(), len(table["t"]))
    table["q"] = np.round(np.round(table["q"] / step) * step, 5)
    _, aligned, floor = aligned_of("pendulum", table)
    assert aligned.lattice[0] == pytest.approx(step, rel=0.02)
    assert floor[0] >= 0.98 * step / np.sqrt(12)


def test_a_map_may_say_what_a_sensor_resolves() -> None:
    def resolving(value: float):  # type: ignore[no-untyped-def]
        return lambda data: data["outputs"][0].update(resolution=value)

    plant = plant_of("pendulum", resolving(0.01))
    floor = noise_floor(align(recording_from_table(simulate("pendulum", 6.0, noise=0.0), plant), plant))
    assert floor[0] >= 0.01 / np.sqrt(12)
    with pytest.raises(GapInputError, match=r"outputs\[0\].resolution"):
        plant_of("pendulum", resolving(-1.0))


def _check(name: str, table: dict[str, np.ndarray], edit=None) -> list[str]:  # type: ignore[no-untyped-def,type-arg]
    plant = plant_of(name, edit)
    aligned = align(recording_from_table(table, plant), plant)
    return check_map(plant, aligned, measured_state(plant, aligned, noise_floor(aligned)))


def test_right_map_passes() -> None:
    for name in ("pendulum", "cart_pole", "arm", "leg"):
        assert _check(name, simulate(name, 8.0)) == []


def test_wrong_units_are_noticed() -> None:
    table = simulate("arm", 8.0)
    table["q1"] = np.degrees(table["q1"])
    with pytest.raises(GapInputError, match="'q1'.*degrees for radians"):
        _check("arm", table)
    table = simulate("cart_pole", 8.0)
    table["f"] = table["f"] * 1000.0
    with pytest.raises(GapInputError, match="'f'.*thousand"):
        _check("cart_pole", table)
    table = simulate("leg", 8.0)
    table["z"] = table["z"] * 1000.0
    with pytest.raises(GapInputError, match="'z'.*height"):
        _check("leg", table)


def test_a_joint_that_a_stop_holds_is_not_taken_for_a_wrong_unit() -> None:
    table = simulate("pendulum", 8.0)
    low, high = np.quantile(table["q"], [0.0, 0.25])
    stopped = {**table, "q": np.clip(table["q"], low, high)}
    assert np.ptp(stopped["q"]) < np.ptp(table["q"]) / 3
    (warning,) = _check("pendulum", stopped)
    assert "'q'" in warning and "falls short" in warning
    with pytest.raises(GapInputError, match="'q'.*turns for radians"):
        _check("pendulum", {**table, "q": table["q"] / (2 * np.pi)})


def test_wrong_units_show_in_the_replay() -> None:
    """An inertial sensor has nothing but the model to be compared with."""
    plant, rng = plant_of("leg"), np.random.default_rng(0)
    moved = rng.normal(0, 0.1, (6, 30, len(plant.outputs)))
    replayed = moved + rng.normal(0, 0.03, moved.shape)
    check_replay(plant, 1.4 * moved, replayed)
    for wrong in (180 / np.pi, 1000.0):
        with pytest.raises(GapInputError, match="'z'.*unit"):
            check_replay(plant, wrong * moved, replayed)


def test_swapped_columns_and_signs_are_noticed() -> None:
    table = simulate("arm", 8.0)
    swapped = {**table, "q0": table["q1"], "q1": table["q0"]}
    with pytest.raises(GapInputError, match="'q0' and 'q1' look swapped"):
        _check("arm", swapped)
    with pytest.raises(GapInputError, match="opposite sign"):
        _check("arm", {**table, "q0": -table["q0"]})
    assert _check("arm", {**table, "q0": -table["q0"]}, lambda m: m["outputs"][0].update(sign=-1)) == []


_RAIL = """<mujoco><worldbody><body name="carriage" pos="0.1 0 0.3" quat="0.7071068 0 0.7071068 0">
<joint name="lift" type="slide" axis="-0.8 0 0.6"/><geom size=".1"/><site name="marker" pos="0 0 .02"/>
<body name="arm"><joint name="swing" axis="0 1 0"/><geom size=".05"/></body></body></worldbody>
<actuator><motor name="m" joint="swing"/></actuator></mujoco>"""


@pytest.mark.parametrize("frame", [{"body": "carriage"}, {"site": "marker"}])
def test_a_body_on_a_rail_shows_how_far_it_slid(frame: dict[str, str]) -> None:
    """Along the axes that it slides along; across them, and from a body that also turns, nobody can tell."""
    outputs = [{"column": c, "unit": "m", **frame, "quantity": "position", "component": c} for c in ("x", "y", "z")] + [
        {"column": "a", "unit": "m", "body": "arm", "quantity": "position", "component": "z"}
    ]
    rows = {"inputs": [{"column": "u", "unit": "Nm", "actuator": "m", "kind": "torque"}], "outputs": outputs}
    spec = mujoco.MjSpec.from_string(_RAIL)
    plant = build_plant(spec, parse_map({"time": {"column": "t", "unit": "s"}, **rows}))
    data = mujoco.MjData(plant.model)
    data.qpos[:] = (0.07, 0.4)
    mujoco.mj_forward(plant.model, data)
    seen = plant.read(data.sensordata)
    x, y, z, arm = plant.outputs
    assert (x.qpos, y.qpos, z.qpos, arm.qpos) == (0, -1, 0, -1)
    for i, channel in ((0, x), (2, z)):
        assert channel.coordinate(np.array([seen[i]])) == pytest.approx([0.07])
