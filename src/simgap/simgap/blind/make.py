"""Makes a blind check: recordings, maps and models on one side, sealed answers on the other."""

from __future__ import annotations

import hashlib
import json
import platform
import secrets
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import yaml

from simgap.blind.cases import SMALL, Case, Injected, draw, robot_of
from simgap.blind.recordings import realise

SCHEMA = "nermo_gap/blind/1"
Progress = Callable[[int, int], None]


class BlindError(Exception):
    """A blind check cannot be made, run or scored; the message says why."""


def make(
    folder: Path,
    answers: Path,
    count: int,
    seed: int,
    robots: Sequence[str] = SMALL,
    seconds: float = 15.0,
    workers: int = 1,
    salt: str | None = None,
    progress: Progress | None = None,
    only: Sequence[str] = (),
) -> dict[str, Any]:
    """Write ``folder``/data/ID/{recording.npz, map.yaml, model.xml} and ``answers``/ID.json; returns the manifest.

    ``only``: names of effects, of which each case has one; else kinds and effects are mixed (see `cases.draw`).

    The manifest, which is published, holds a SHA-256 of every answer (salted by a random number inside it), so that no
    answer can be changed later; it holds neither seed nor kinds. The same seed gives the same recordings. What was made
    before a call was interrupted is kept, and the same call goes on there.

    Raises:
        BlindError: a folder that already holds a check, or the begin of another one, answers inside of the data, or
            values out of range.
    """
    folder, answers = apart(folder, answers, count)
    if not 6.0 <= seconds <= 120.0:
        raise BlindError(f"seconds = {seconds:g}: must lie between 6 and 120")
    try:
        cases = draw(count, seed, robots, seconds, only)
    except ValueError as error:
        raise BlindError(str(error)) from error
    asked = {"seed": seed, "cases": count, "robots": list(robots), "seconds": seconds}
    _begin(answers, asked | ({"faults": list(only)} if only else {}))
    entries = {case.id: entry for case in cases if (entry := _made_before(case, folder, answers)) is not None}
    left = [case for case in cases if case.id not in entries]
    for case in _simulated(left, workers, robots):
        entries[case.id] = _publish(case, folder, answers, salt)
        if progress:
            progress(len(entries), count)
    return write_manifest(
        folder, answers, [entries[case.id] for case in cases], seed, robots, [case.answer() for case in cases]
    )


def _begin(answers: Path, asked: dict[str, Any]) -> None:
    """Note what is made, or see that it is what was begun here. Raises BlindError where that is another check."""
    file, text = answers / "asked.json", json.dumps(asked) + "\n"
    if not any(answers.iterdir()):
        file.write_text(text, encoding="utf-8")
    elif not file.exists() or file.read_text(encoding="utf-8") != text:
        raise BlindError(f"{answers} holds the begin of another check: choose another folder, or remove this one")


def _made_before(case: Case, folder: Path, answers: Path) -> dict[str, Any] | None:
    """The manifest's entry of a case that lies there whole, which is filled in; None where it is still to be made."""
    answer, recording = answers / f"{case.id}.json", folder / "data" / case.id / "recording.npz"
    try:
        text = answer.read_text(encoding="utf-8")
        sealed = json.loads(text)
        recorded = recording.read_bytes()
    except (OSError, ValueError):
        return None
    case.robot, case.healthy_shift = sealed["robot"], sealed["effect_on_recording"]
    listed = ("members", "places")
    case.faults = [Injected(**{**fault, **{n: tuple(fault[n]) for n in listed}}) for fault in sealed["faults"]]
    return _entry(case, text, recorded)


def apart(folder: Path, answers: Path, count: int) -> tuple[Path, Path]:
    """Where a new check and its answers go, absolute; the answers' folder is there then, for its owner alone.

    Raises:
        BlindError: a folder that already holds a check, answers inside of the data, or too many cases.
    """
    folder, answers = folder.resolve(), answers.resolve()
    if answers == folder or folder in answers.parents or answers in folder.parents:
        raise BlindError(f"answers = {answers}: must lie outside of {folder}, and not around it")
    for place in (folder / "manifest.json", answers / "answers.json"):
        if place.exists():
            raise BlindError(f"{place} already exists: choose another folder")
    if not 1 <= count <= 10_000:
        raise BlindError(f"cases = {count}: must lie between 1 and 10000")
    answers.mkdir(parents=True, exist_ok=True)
    answers.chmod(0o700)
    return folder, answers


def seal(answer: dict[str, Any], answers: Path, salt: str | None = None) -> str:
    """Write ``answers``/ID.json, salted; returns its text, whose SHA-256 is published."""
    text = json.dumps(answer | {"salt": salt or secrets.token_hex(16)}, indent=1, sort_keys=True) + "\n"
    (answers / f"{answer['id']}.json").write_text(text, encoding="utf-8")
    return text


def sha256(text: str) -> str:
    """Of a text, as hexadecimal digits."""
    return hashlib.sha256(text.encode()).hexdigest()


def write_manifest(
    folder: Path,
    answers: Path,
    entries: Sequence[dict[str, Any]],
    seed: int,
    robots: Sequence[str],
    cases: Sequence[dict[str, Any]],
) -> dict[str, Any]:
    """Publish the cases' entries as ``folder``/manifest.json, and seal seed and ``cases`` in ``answers``."""
    manifest = {
        "schema": SCHEMA,
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": {"mujoco": mujoco.__version__, "python": platform.python_version()},
        "cases": list(entries),
    }
    (folder / "manifest.json").write_text(json.dumps(manifest, indent=1) + "\n", encoding="utf-8")
    sealed = {"schema": SCHEMA, "seed": seed, "robots": list(robots), "cases": list(cases)}
    (answers / "answers.json").write_text(json.dumps(sealed, indent=1) + "\n", encoding="utf-8")
    return manifest


def _simulated(cases: Sequence[Case], workers: int, robots: Sequence[str]) -> Any:
    if workers <= 1:
        for i, case in enumerate(cases):
            yield _update(cases, i, realise(case, robots))
        return
    with get_context("spawn").Pool(workers) as pool:
        for i, case in enumerate(pool.imap(partial(realise, robots=robots), cases)):
            yield _update(cases, i, case)


def _update(cases: Sequence[Case], i: int, case: Case) -> Case:
    """What a worker found out goes back into the list; the columns stay with the one that is returned."""
    cases[i].robot, cases[i].faults, cases[i].healthy_shift = case.robot, case.faults, case.healthy_shift
    return case


def _publish(case: Case, folder: Path, answers: Path, salt: str | None) -> dict[str, Any]:
    robot, place = robot_of(case.robot), folder / "data" / case.id
    place.mkdir(parents=True, exist_ok=True)
    write_recording(case.columns, place / "recording.npz")
    (place / "map.yaml").write_text(yaml.safe_dump(robot.mapping, sort_keys=False), encoding="utf-8")
    (place / "model.xml").write_text(robot.xml, encoding="utf-8")
    # The answer comes last: where it lies, the case is whole.
    return _entry(case, seal(case.answer(), answers, salt), (place / "recording.npz").read_bytes())


def _entry(case: Case, sealed: str, recorded: bytes) -> dict[str, Any]:
    """What the manifest says of a case."""
    return {
        "id": case.id,
        "robot": case.robot,
        "seconds": case.seconds,
        "answer_sha256": sha256(sealed),
        "recording_sha256": hashlib.sha256(recorded).hexdigest(),
    }


def write_recording(columns: dict[str, Any], path: Path) -> None:
    """Write columns with the seven digits that a logger gives; more would only make the files larger."""
    np.savez_compressed(path, **{n: v if n == "t" else np.round(v, 7) for n, v in columns.items()})


def read_manifest(folder: Path) -> dict[str, Any]:
    """The published manifest. Raises BlindError where it is missing or broken."""
    path = folder / "manifest.json"
    try:
        manifest: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise BlindError(f"{path} cannot be read: {error}") from error
    if manifest.get("schema") != SCHEMA:
        raise BlindError(f"{path}: schema = {manifest.get('schema')!r}: must be {SCHEMA!r}")
    return manifest
