"""The monitor: a model watched beside its robot, in the recording's own time, and files that grow."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from robots import MAPS, MODELS, plant_of, simulate
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from typer.testing import CliRunner

from simgap.cli import app
from simgap.data.bag import read_bag
from simgap.data.errors import GapInputError
from simgap.data.growing import GrowingCsv, GrowingMcap, follow
from simgap.data.mapping import parse_map
from simgap.data.plant import Plant, build_plant
from simgap.data.recording import recording_from_table
from simgap.monitoring.drift import LEARNED, Drift
from simgap.monitoring.monitor import KEPT, Change, Monitor
from simgap.monitoring.watch import line, watch

Array = NDArray[np.float64]
Table = dict[str, Array]

RUBBING = MODELS["arm"].replace('damping="0.05"', 'damping="0.05" frictionloss="0.1"').replace(
    'damping="0.03"', 'damping="0.03" frictionloss="0.05"'
)  # fmt: skip
"""The arm with dry friction in its model."""
ELBOW = 1
NOISE, PERIOD = 3e-4, 0.005


def _plant(xml: str = RUBBING) -> Plant:
    return build_plant(mujoco.MjSpec.from_string(xml), parse_map(dict(MAPS["arm"])))


@cache
def _log(seconds: float, seed: int = 0, worse_at: float = np.inf, heavier: float = 1.0) -> Table:
    """What the arm would log. Its elbow's friction triples at a time [s]; all along it may be heavier than modelled."""
    from simgap.blind.robots import commands

    plant = _plant()
    model, n = plant.model, round(seconds / PERIOD)
    model.body_mass[:] *= heavier
    mujoco.mj_setConst(model, mujoco.MjData(model))
    told, data = commands("arm", seed, n, PERIOD), mujoco.MjData(model)
    rows, steps = np.empty((n, len(plant.outputs))), round(PERIOD / model.opt.timestep)
    for k in range(n):
        if k == round(min(worse_at, 2.0 * seconds) / PERIOD):
            model.dof_frictionloss[ELBOW] *= 3.0
        for channel in plant.inputs:
            data.ctrl[channel.actuator] = told[channel.column][k]
        mujoco.mj_forward(model, data)
        rows[k] = plant.read(data.sensordata)
        mujoco.mj_step(model, data, steps)
    rows += NOISE * np.random.default_rng(seed).standard_normal(rows.shape)
    return {"t": PERIOD * np.arange(n), **told, **{c.column: rows[:, i] for i, c in enumerate(plant.outputs)}}


def _pieces(table: Table, seconds: float) -> Iterator[Table]:
    """A log as it comes: what is new, and what was before it."""
    for end in np.arange(seconds, table["t"][-1] + seconds, seconds):
        rows = (table["t"] < end) & (table["t"] >= end - seconds - KEPT)
        if rows.any():
            yield {name: values[rows] for name, values in table.items()}


def _monitor(*reference: Table) -> Monitor:
    plant = _plant()
    return Monitor(plant, [recording_from_table(table, plant) for table in reference], threads=1)


def _watched(monitor: Monitor, table: Table, seconds: float = 0.5) -> list[tuple[float, Change]]:
    """(time at which it was said, change)."""
    return [(float(piece["t"][-1]), c) for piece in _pieces(table, seconds) for c in monitor.update(piece)]


def test_tripled_friction_is_flagged_within_two_seconds() -> None:
    for seed in (0, 1, 2):
        worse_at = 20.0
        ((said, change),) = _watched(_monitor(), _log(26.0, seed, worse_at))[:1]
        assert worse_at < said <= worse_at + 2.0
        assert change.stale and change.part == "elbow" and change.gap > 1.5 * change.usual
        assert change.sentence.startswith("elbow: the model goes stale at 2")


def test_ten_minutes_of_healthy_motion_give_no_alarm() -> None:
    """Of a robot that is 5 % heavier than its model, as robots are."""
    monitor = _monitor()
    assert _watched(monitor, _log(600.0, 7, heavier=1.05), 10.0) == []
    assert monitor.time > 599.0 and monitor.learned == 1.0
    assert set(monitor.gap) == {"shoulder", "elbow"}


def test_a_reference_teaches_what_is_usual_and_then_a_fault_shows_from_the_start() -> None:
    monitor = _monitor(_log(20.0, 3))
    assert monitor.learned == 1.0
    changes = _watched(monitor, _log(8.0, 4, worse_at=0.0))
    assert changes[0][1].part == "elbow" and "elbow" in monitor.stale
    healthy = _monitor(_log(20.0, 3))
    assert _watched(healthy, _log(8.0, 4)) == []


def test_it_says_when_the_model_fits_again() -> None:
    monitor = _monitor(_log(20.0, 3))
    bad, good = _log(8.0, 4, worse_at=0.0), _log(12.0, 5)
    joined = {k: np.concatenate([bad[k], good[k] + (30.0 if k == "t" else 0.0)]) for k in bad}
    changes = [c for _, c in _watched(monitor, joined)]
    assert [c.stale for c in changes if c.part == "elbow"] == [True, False]
    assert "fits again" in changes[-1].sentence and monitor.stale == []


def test_how_the_log_is_cut_into_pieces_changes_little() -> None:
    found = []
    for seconds in (0.5, 7.0):
        monitor = _monitor()
        _watched(monitor, _log(26.0, 0), seconds)
        found.append((monitor.usual, monitor.stale))
    assert found[0][1] == found[1][1] == []
    for part in ("shoulder", "elbow"):
        assert found[0][0][part] == pytest.approx(found[1][0][part], rel=0.3)


def test_a_robot_that_rests_is_not_judged() -> None:
    table = {k: v.copy() for k, v in _log(12.0).items()}
    resting = {name: np.full(2400, 0.2 if name != "t" else 0.0) for name in table}
    resting["t"] = PERIOD * np.arange(2400)
    monitor = _monitor()
    assert _watched(monitor, resting) == []
    assert monitor.learned == 0.0 and "not moved" in line(monitor)


def test_a_wrong_map_is_refused_and_a_missing_column_named() -> None:
    table = dict(_log(12.0))
    with pytest.raises(GapInputError, match="opposite sign"):
        _watched(_monitor(), {**table, "q0": -table["q0"]})
    del table["q1"]
    with pytest.raises(GapInputError, match="q1"):
        _watched(_monitor(), table)
    with pytest.raises(GapInputError, match="too little motion"):
        _monitor(_log(5.0))


@given(st.integers(0, 2**32 - 1), st.floats(-3.0, 3.0), st.floats(0.1, 2.0))
@settings(max_examples=30, deadline=None)
def test_drift_hears_a_rise_and_no_noise(seed: int, usual: float, spread: float) -> None:
    rng, drift = np.random.default_rng(seed), Drift()
    for level in usual + spread * rng.standard_normal(LEARNED + 500):
        drift.add(float(level))
    assert not drift.risen and drift.learned == 1.0
    # One window that is far off is no drift; what stays is.
    assert not drift.add(usual + 100.0 * spread) and not drift.risen
    for _ in range(4):
        drift.add(usual + 12.0 * max(spread, 0.3))
    assert drift.risen
    for _ in range(20):
        drift.add(usual)
    assert not drift.risen


# --- files that grow


def _text(table: Table, rows: slice) -> str:
    return "".join(
        ",".join(repr(float(v)) for v in row) + "\n" for row in zip(*(c[rows] for c in table.values()), strict=True)
    )


def test_a_csv_is_read_as_it_is_written(tmp_path: Path) -> None:
    """In pieces that end within a row: nothing is lost, nothing is read twice, and what is old is forgotten."""
    table, path = _log(12.0), tmp_path / "log.csv"
    text = ",".join(table) + "\n" + _text(table, slice(None))
    path.write_text(text[:10])
    growing = GrowingCsv(path, _plant().map)
    assert growing.read(1e9) is None
    found: Table = {}
    at = 10
    for size in (7, 1, 3000, 17, 100_000, 10**7):
        with path.open("a") as file:
            file.write(text[at : at + size])
        at += size
        found = growing.read(1e9) or found
    assert growing.read(1e9) is None
    for name, values in table.items():
        np.testing.assert_array_equal(found[name], values)
    with path.open("a") as file:
        file.write(_text({**table, "t": table["t"] + 20.0}, slice(0, 100)))
    last = growing.read(9.0)
    assert last is not None and last["t"][0] == pytest.approx(table["t"][-1] - 9.0, abs=0.01) and len(last["t"]) > 1800


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("t,u0,u1,q0\n", r"log.csv: outputs\[1\]: no column 'q1'.*did you mean"),
        ("t,u0,u1,q0,q1\n1,2,3\n", "row 2 has 3 cells where the header has 5"),
        ("t,u0,u1,q0,q1\n0,0,0,0,0\n1,0,0,ERR,0\n2,0,0,0,0\n", "'q0': row 3 holds 'ERR'"),
        ("t,u0,u1,q0,q1\n0,0,0,ERR,0\n", "'q0': row 2 holds 'ERR'"),
    ],
)
def test_a_growing_csv_that_cannot_be_used_is_refused(text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text(text)
    with pytest.raises(GapInputError, match=message):
        GrowingCsv(tmp_path / "log.csv", _plant().map).read(1.0)


STORE = get_typestore(Stores.ROS2_JAZZY)
JOINTS = ("shoulder", "elbow")
BAG_MAP = {
    "inputs": [
        {
            "topic": "/command",
            "field": "position",
            "joint": j,
            "actuator": f"{j}_servo",
            "kind": "position",
            "unit": "rad",
        }
        for j in JOINTS
    ],
    "outputs": [
        {"topic": "/joint_states", "field": "position", "joint": j, "quantity": "position", "unit": "rad"}
        for j in JOINTS
    ],
}


def _bag(folder: Path, table: Table) -> Path:
    types = STORE.types
    kind = "sensor_msgs/msg/JointState"
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        topics = {name: writer.add_connection(name, kind, typestore=STORE) for name in ("/command", "/joint_states")}
        for k, t in enumerate(table["t"]):
            ns = 10**18 + round(t * 1e9)
            header = types["std_msgs/msg/Header"](
                stamp=types["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9), frame_id=""
            )
            for name, columns in (("/command", ("u0", "u1")), ("/joint_states", ("q0", "q1"))):
                message = types[kind](
                    header=header,
                    name=list(JOINTS),
                    position=np.array([table[c][k] for c in columns]),
                    velocity=np.zeros(0),
                    effort=np.zeros(0),
                )
                writer.write(topics[name], ns, STORE.serialize_cdr(message, kind))
    (path,) = folder.glob("*.mcap")
    return path


def test_an_mcap_is_read_as_it_is_written(tmp_path: Path) -> None:
    """Cut anywhere: the same numbers as from the whole bag."""
    table = {k: v[:900] for k, v in _log(12.0).items()}
    whole = _bag(tmp_path / "bag", table).read_bytes()
    mapping = parse_map(dict(BAG_MAP))
    path = tmp_path / "growing.mcap"
    path.write_bytes(b"")
    growing, found = GrowingMcap(path, mapping), None
    rng = np.random.default_rng(0)
    at = 0
    while at < len(whole):
        size = int(rng.integers(1, 40_000))
        with path.open("ab") as file:
            file.write(whole[at : at + size])
        at += size
        found = growing.read(1e9) or found
    expected, _ = read_bag(tmp_path / "bag", mapping)
    assert found is not None and set(found) == set(expected)
    for name, values in expected.items():
        np.testing.assert_allclose(found[name], values, atol=1e-12)


def test_what_cannot_grow_is_refused(tmp_path: Path) -> None:
    bag, table = parse_map(dict(BAG_MAP)), _plant().map
    (tmp_path / "a.csv").write_text("")
    (tmp_path / "b.mcap").write_bytes(b"no bag at all")
    (tmp_path / "c.db3").write_bytes(b"")
    (tmp_path / "empty").mkdir()
    cases: list[tuple[str, object, Callable[[], object]]] = [
        ("no such recording; start what writes it first", table, lambda: follow(tmp_path / "none.csv", table)),
        ("name topics of a bag", bag, lambda: follow(tmp_path / "a.csv", bag)),
        ("name topic and field instead of column", table, lambda: follow(tmp_path / "b.mcap", table)),
        ("b.mcap: is no MCAP", bag, lambda: follow(tmp_path / "b.mcap", bag).read(1.0)),
        ("not a bag that is no MCAP", bag, lambda: follow(tmp_path / "c.db3", bag)),
        ("holds no .mcap yet", bag, lambda: follow(tmp_path / "empty", bag)),
    ]
    for message, _, call in cases:
        with pytest.raises(GapInputError, match=message):
            call()


def test_the_command_watches_a_file_that_another_writes(tmp_path: Path) -> None:
    table = _log(26.0, 0, 20.0)
    (tmp_path / "arm.xml").write_text(RUBBING)
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(dict(MAPS["arm"])))
    log = tmp_path / "log.csv"
    log.write_text(",".join(table) + "\n")

    def write() -> None:
        for first in range(0, len(table["t"]), 400):
            with log.open("a") as file:
                file.write(_text(table, slice(first, first + 400)))

    words = ["monitor", str(log), "--model", str(tmp_path / "arm.xml"), "--map", str(tmp_path / "map.yaml")]
    writer = threading.Thread(target=write)
    writer.start()
    answer = CliRunner().invoke(app, [*words, "--idle", "3", "--json", str(tmp_path / "seen.json")])
    writer.join()
    assert answer.exit_code == 0, answer.output
    said = answer.stdout.splitlines()
    assert sum("elbow: the model goes stale" in one for one in said) == 1
    assert "stale at the end: " in said[-1] and "elbow" in said[-1]
    seen = json.loads((tmp_path / "seen.json").read_text())
    assert "elbow" in seen["stale"] and seen["changes"][0]["part"] == "elbow" and seen["learned"] == 1.0


def test_it_ends_when_nothing_is_written_any_more() -> None:
    class Quiet:
        def read(self, keep: float) -> None:
            return None

    now = [0.0]
    seen = list(watch(Quiet(), Monitor(plant_of("arm")), 2.0, lambda: now[0], lambda s: now.__setitem__(0, now[0] + s)))
    assert seen == [[]] * 8


def test_a_log_with_too_little_motion_is_said_so(tmp_path: Path) -> None:
    table = simulate("arm", 5.0)
    (tmp_path / "arm.xml").write_text(MODELS["arm"])
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(dict(MAPS["arm"])))
    (tmp_path / "log.csv").write_text(",".join(table) + "\n" + _text(table, slice(None)))
    words = ["monitor", str(tmp_path / "log.csv"), "--model", str(tmp_path / "arm.xml")]
    answer = CliRunner().invoke(app, [*words, "--map", str(tmp_path / "map.yaml"), "--idle", "0"])
    assert answer.exit_code == 1 and "too little motion" in answer.stderr.splitlines()[-1]
