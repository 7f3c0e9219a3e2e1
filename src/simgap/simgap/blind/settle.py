"""Does the proposed experiment settle it? Second recordings of the cases that a diagnosis left ambiguous."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from simgap.blind.cases import Case, Injected
from simgap.blind.make import BlindError, read_manifest, write_recording
from simgap.blind.recordings import simulate_again
from simgap.blind.run import experiment_file, results_of
from simgap.blind.score import read_answers

Progress = Callable[[int, int], None]


def settle(folder: Path, answers: Path, results: Path, out: Path, progress: Progress | None = None) -> list[str]:
    """Write ``out``, a check of the ambiguous cases of ``results``, each with the experiment that it asked for.

    The robots are those of the sealed answers, told what the command files say; the first recordings are copied beside.
    The new check is diagnosed and scored with the same answers. Returns the cases.

    Raises:
        BlindError: a folder in use, no ambiguous case with a proposal, or answers that are not those that were sealed.
    """
    if (out / "manifest.json").exists():
        raise BlindError(f"{out / 'manifest.json'} already exists: choose another folder")
    manifest = read_manifest(folder)
    truth, found = read_answers(manifest, answers), results_of(manifest, results)
    asked = [
        c
        for c in manifest["cases"]
        if found.get(c["id"], {}).get("verdict") == "ambiguous" and experiment_file(results, c["id"]).exists()
    ]
    if not asked:
        raise BlindError(f"{results}: no ambiguous case proposes an experiment")
    entries = []
    for done, entry in enumerate(asked, 1):
        case = _case(truth[entry["id"]])
        commands = np.genfromtxt(experiment_file(results, case.id), delimiter=",", names=True)
        table = {name: np.asarray(commands[name]) for name in commands.dtype.names or () if name != "t"}
        try:
            columns = simulate_again(case, table)
        except ValueError as error:
            raise BlindError(f"case {case.id}: the experiment breaks its robot: {error}") from error
        place = out / "data" / case.id
        shutil.copytree(folder / "data" / case.id, place)
        write_recording(columns, place / "recording_next.npz")
        entries.append(entry | {"next_sha256": hashlib.sha256((place / "recording_next.npz").read_bytes()).hexdigest()})
        if progress:
            progress(done, len(asked))
    (out / "manifest.json").write_text(json.dumps(manifest | {"cases": entries}, indent=1) + "\n", encoding="utf-8")
    return [e["id"] for e in entries]


def _case(answer: dict[str, Any]) -> Case:
    faults = [Injected(**fault) for fault in answer["faults"]]
    first, second = answer["seed"]
    return Case(answer["id"], answer["robot"], answer["kind"], (first, second), answer["seconds"], faults)
