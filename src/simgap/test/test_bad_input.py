"""Bad input, typed as a user would: each is one sentence with file, field and remedy on stderr, and status 2."""

from __future__ import annotations

import copy
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from numpy.typing import NDArray
from robots import MAPS, MODELS, simulate
from typer.testing import CliRunner

from simgap.cli import app

Array = NDArray[np.float64]

SECONDS = 8.0
DIAGNOSE = ("diagnose", "{log}", "--model", "{model}", "--map", "{map}")


@dataclass
class Files:
    """A log of the arm, its model and its map, still to be spoiled; and how the command is typed."""

    folder: Path
    table: dict[str, Array]
    mapping: dict[str, Any]
    model: str = MODELS["arm"]
    log: str = "log.csv"
    words: list[str] = field(default_factory=lambda: ["check", "{log}", "--model", "{model}", "--map", "{map}"])
    map_text: str | None = None
    content: bytes | None = None
    """Of the log, in place of the table."""

    def run(self) -> Any:
        paths = {name: self.folder / file for name, file in (("model", "arm.xml"), ("map", "map.yaml"))}
        paths |= {"log": self.folder / self.log, "folder": self.folder}
        paths["model"].write_text(self.model)
        paths["map"].write_text(self.map_text or yaml.safe_dump(self.mapping))
        if self.content is not None:
            paths["log"].write_bytes(self.content)
        elif paths["log"].suffix == ".npz":
            np.savez(paths["log"], **self.table)  # type: ignore[arg-type]
        elif paths["log"].suffix == ".csv":
            rows = zip(*(map(repr, map(float, column)) for column in self.table.values()), strict=True)
            paths["log"].write_text("\n".join([",".join(self.table), *map(",".join, rows)]))
        return CliRunner().invoke(app, [word.format(**paths) for word in self.words])


@pytest.fixture(scope="module")
def healthy() -> dict[str, Array]:
    return simulate("arm", SECONDS)


@pytest.fixture
def files(healthy: dict[str, Array], tmp_path: Path) -> Files:
    return Files(tmp_path, {k: v.copy() for k, v in healthy.items()}, copy.deepcopy(dict(MAPS["arm"])))


def test_the_files_are_good_before_they_are_spoiled(files: Files) -> None:
    answer = files.run()
    assert answer.exit_code == 0, answer.output


def _set(what: str, **values: Any) -> Callable[[Files], None]:
    def spoil(files: Files) -> None:
        getattr(files, what).update(values)

    return spoil


def _row(group: str, index: int, **values: Any) -> Callable[[Files], None]:
    """Change keys of a row of the map; None takes one out."""

    def spoil(files: Files) -> None:
        row = files.mapping[group][index]
        row |= values
        for key in [key for key, value in values.items() if value is None]:
            del row[key]

    return spoil


def _column(name: str, change: Callable[[Array], Array]) -> Callable[[Files], None]:
    def spoil(files: Files) -> None:
        files.table[name] = change(files.table[name])

    return spoil


def _file(**values: Any) -> Callable[[Files], None]:
    def spoil(files: Files) -> None:
        for name, value in values.items():
            setattr(files, name, value)

    return spoil


def _swap(files: Files) -> None:
    files.table["q0"], files.table["q1"] = files.table["q1"], files.table["q0"]


def _pickled(files: Files) -> None:
    files.log = "log.npz"
    files.table["u0"] = np.array([{"a": 1}], dtype=object)


def _lengths(files: Files) -> None:
    files.log = "log.npz"
    files.table["u0"] = files.table["u0"][:-5]


def _mesh(files: Files) -> None:
    files.model = '<mujoco><asset><mesh name="m" file="gone.stl"/></asset><worldbody/></mujoco>'


def _still(files: Files) -> None:
    for name in ("q0", "q1"):
        files.table[name][:] = 0.3


def _enabled(files: Files) -> None:
    files.mapping["enabled"] = {"column": "on"}
    files.table["on"] = np.full(len(files.table["t"]), 100.0)


def _held_out(files: Files) -> None:
    files.mapping["segments"] = {"column": "run", "held_out": [7]}
    files.table["run"] = np.zeros(len(files.table["t"]))


def _words(*words: str) -> Callable[[Files], None]:
    return _file(words=list(words))


CASES: dict[str, tuple[Callable[[Files], None], str, str, str]] = {
    # name: (how it is spoiled, file, field, remedy)
    "unit of another quantity": (_row("outputs", 1, unit="m"), "map.yaml", r"outputs\[1\] \(q1\)", r"angle \[rad\]"),
    "unit that does not exist": (_row("outputs", 1, unit="furlongish"), "map.yaml", r"outputs\[1\]", "is not a unit"),
    "unit missing": (_row("inputs", 0, unit=None), "map.yaml", r"inputs\[0\] \(u0\)", "must be one of angle"),
    "degrees for radians": (_column("q1", np.degrees), "log.csv", "'q1'", "unit.* in the map.*degrees for radians"),
    "milliseconds for seconds": (_column("t", lambda t: 1e3 * t), "log.csv", r"time \(t\)", "unit of time right"),
    "opposite sign": (_column("q0", np.negative), "log.csv", "'q0'", "set sign: -1"),
    "columns swapped": (_swap, "log.csv", "'q0' and 'q1'", "exchange the two in the map"),
    "joint of another robot": (
        _row("outputs", 0, sensor=None, joint="sholder", quantity="position"),
        "map.yaml",
        r"outputs\[0\]",
        "did you mean shoulder",
    ),
    "actuator of another robot": (_row("inputs", 0, actuator="elbow"), "map.yaml", r"inputs\[0\]", "elbow_servo"),
    "sensor of another robot": (_row("outputs", 0, sensor="imu"), "map.yaml", r"outputs\[0\]", "valid sensors"),
    "torque told to a servo": (
        _row("inputs", 0, kind="torque", unit="N m"),
        "map.yaml",
        r"inputs\[0\]",
        "with measured: true",
    ),
    "quantity that a joint lacks": (
        _row("outputs", 0, sensor=None, joint="elbow", quantity="orientation"),
        "map.yaml",
        r"outputs\[0\]",
        "it has position, velocity",
    ),
    "key misspelt": (_row("inputs", 0, knid="position"), "map.yaml", r"inputs\[0\].knid", "did you mean kind"),
    "kind unknown": (_row("inputs", 0, kind="speed"), "map.yaml", r"inputs\[0\].kind", "must be one of 'position'"),
    "column used twice": (_row("outputs", 1, column="q0"), "map.yaml", r"outputs\[1\]", r"used by outputs\[0\]"),
    "no inputs": (_set("mapping", inputs=[]), "map.yaml", "inputs", "neither commanded nor measured"),
    "no outputs": (_set("mapping", outputs=[]), "map.yaml", "outputs", "nothing measured is given"),
    "no time": (lambda f: f.mapping.pop("time"), "map.yaml", "time", "needs a column and a unit"),
    "gains of a servo": (
        _set("mapping", gains={"elbow_servo": {"kp": 1.0}}),
        "map.yaml",
        "gains.elbow_servo",
        "for plain motors",
    ),
    "negative gain": (
        _set("mapping", gains={"elbow_servo": {"kp": -1}}),
        "map.yaml",
        "gains.elbow_servo.kp",
        "at least 0",
    ),
    "map that is no YAML": (_file(map_text="inputs: ["), "map.yaml", "cannot be read as a map", "line 1"),
    "map that is a list": (_file(map_text="- time"), "map.yaml", "needs the keys", "time, inputs and outputs"),
    "rows of a bag for a table": (
        _row("outputs", 0, column=None, topic="/q", field="data"),
        "map.yaml",
        "some rows name a column",
        "for tables or for bags",
    ),
    "held-out run that is not there": (_held_out, "log.csv", "segments.held_out", "has no run 7"),
    "column missing": (lambda f: f.table.pop("q0"), "log.csv", r"outputs\[0\].*'q0'", "did you mean"),
    "NaN all along": (_column("q0", lambda q: np.nan * q), "log.csv", r"outputs\[0\].*'q0'", "holds no finite number"),
    "nothing moves": (_still, "log.csv", "outputs", "move each joint"),
    "clock that stands": (_column("t", lambda t: 0.0 * t), "log.csv", r"time \(t\)", "the column that counts up"),
    "clock that jumps all the time": (
        _column("t", lambda t: t + 5.0 * (np.arange(len(t)) // 15)),
        "log.csv",
        "usable data",
        "record longer",
    ),
    "two seconds": (
        lambda f: f.table.update({k: v[:400] for k, v in f.table.items()}),
        "log.csv",
        "2.00 s|1.99 s",
        "at least 4 s",
    ),
    "servos never on": (_enabled, "log.csv", "enabled.*'on'", "true or false, or 1 or 0"),
    "row cut off": (_file(content=b"t,u0,u1,q0,q1\n0,0,0,0,0\n0.1,0,"), "log.csv", "row 3", "cut off while"),
    "cell of words": (
        _file(content=b"t,u0,u1,q0,q1\n0,0,0,0,0\n0.1,0,0,ERR,0\n.2,0,0,0,0\n"),
        "log.csv",
        "'q0': row 3",
        "leave the cell empty",
    ),
    "names not in UTF-8": (_file(content=b"t,u\xfc\n0,0\n"), "log.csv", "a byte .0xfc", "save the table in UTF-8"),
    "header twice": (_file(content=b"t,q0,q0\n0,0,0\n"), "log.csv", "'q0' twice", "header"),
    "empty file": (_file(content=b""), "log.csv", "holds no numbers", "needs rows"),
    "header alone": (_file(content=b"t,u0,u1,q0,q1\n"), "log.csv", "holds no numbers", "needs rows"),
    "pickled array": (_pickled, "log.npz", "pickle", "numpy.savez"),
    "columns of unequal length": (_lengths, "log.npz", "columns differ in length", "rows"),
    "archive that is none": (
        _file(log="log.npz", content=b"PK\x03\x04 no"),
        "log.npz",
        "cannot read the table",
        "whole",
    ),
    "Parquet that is none": (
        _file(log="log.parquet", content=b"PAR1"),
        "log.parquet",
        "cannot read the table",
        "whole",
    ),
    "another kind of file": (_file(log="log.txt", content=b"1 2"), "log.txt", r"\.txt", r"a table \(\.csv"),
    "bag for a map of columns": (
        _file(log="log.mcap", content=b""),
        "log.mcap|map.yaml",
        "is a bag",
        "topic and field",
    ),
    "log that is not there": (
        _words("check", "none.csv", "--model", "{model}", "--map", "{map}"),
        "none.csv",
        "recording",
        "no such",
    ),
    "map that is not there": (
        _words("check", "{log}", "--model", "{model}", "--map", "none.yaml"),
        "none.yaml",
        "map",
        "No such",
    ),
    "model that is not there": (
        _words("check", "{log}", "--model", "none.xml", "--map", "{map}"),
        "none.xml",
        "model",
        "no such",
    ),
    "model that is no MJCF": (_file(model="<robot>"), "arm.xml", "MuJoCo cannot read the model", "MJCF or URDF"),
    "mesh that is not there": (_mesh, "arm.xml", "gone.stl", "from the folder of the model"),
    "diagnosis that is none": (
        _words("apply", "{map}", "--model", "{model}", "--out", "out.xml"),
        "map.yaml",
        "diagnosis",
        ".",
    ),
    "diagnosis that was edited": (
        _file(
            map_text='{"schema": "simgap/diagnosis/1", "correction": {"model": [3]}}',
            words=["apply", "{map}", "--model", "{model}", "--out", "{folder}/out.xml"],
        ),
        "map.yaml",
        "correction",
        "run it again",
    ),
    "model overwritten": (
        _words("apply", "{map}", "--model", "{model}", "--out", "{model}"),
        "arm.xml",
        "--out",
        "choose another name",
    ),
    "corrected model that is no MJCF": (
        _words("apply", "{map}", "--model", "{model}", "--out", "corrected.txt"),
        "corrected.txt",
        "--out",
        r"must end in \.xml",
    ),
    "folder for results that is a file": (_words(*DIAGNOSE, "--out", "{log}"), "log.csv", "--out", "choose another"),
    "results below a file": (_words(*DIAGNOSE, "--out", "{log}/today"), "log.csv", "--out", "choose another"),
    "file for results that is a folder": (
        _words(*DIAGNOSE, "--json", "{folder}"),
        "test_bad_input",
        "--json",
        "a file in it",
    ),
    "model without joints": (
        _file(model="<mujoco><worldbody/></mujoco>", words=["map", "{log}", "--model", "{model}", "--yes"]),
        "log.csv",
        "joints .it has none",
        "Write the map by hand",
    ),
    "effect misspelt": (_words("effects", "servo_dely"), "", "'servo_dely'", "did you mean servo_delay"),
    "log that nobody could watch": (
        _file(log="log.npz", words=["monitor", "{log}", "--model", "{model}", "--map", "{map}"]),
        "log.npz",
        "only .csv and .mcap",
        "while they are written",
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_bad_input_is_told_with_file_field_and_remedy(name: str, files: Files) -> None:
    spoil, file, place, remedy = CASES[name]
    spoil(files)
    answer = files.run()
    assert answer.exit_code == 2, answer.output
    assert answer.exception is None or isinstance(answer.exception, SystemExit)
    told = answer.stderr.strip().splitlines()
    assert len(told) == 1, "one sentence, and nothing else"
    for what, wanted in (("file", file), ("field", place), ("remedy", remedy)):
        assert re.search(wanted, told[0]), f"no {what} ({wanted}) in: {told[0]}"


@pytest.mark.parametrize(
    "words",
    [
        (*DIAGNOSE, "--budget", "0"),
        (*DIAGNOSE, "--budget", "nan"),
        (*DIAGNOSE, "--seed", "-1"),
        ("example", "--seed", "-1"),
    ],
    ids=" ".join,
)
def test_a_number_that_cannot_be_is_refused_before_the_work(words: tuple[str, ...], files: Files) -> None:
    files.words = list(words)
    answer = files.run()
    assert answer.exit_code == 2
    assert f"'{words[-2]}'" in answer.stderr and "greater than or equal to" in answer.stderr
