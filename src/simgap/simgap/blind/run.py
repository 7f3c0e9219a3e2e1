"""Runs the diagnosis over the cases of a blind check: one confined process a case, resumable, several at a time."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from simgap.blind.make import BlindError, read_manifest
from simgap.execution.batch import run_batch
from simgap.execution.executors import PROCESSES

Progress = Callable[[dict[str, Any], int, int], None]

RESULTS = "results.jsonl"
_KEPT = (
    "verdict",
    "reasons",
    "gap",
    "effects",
    "equivalent",
    "baselines",
    "warnings",
    "isolation",
    "robot",
    "probabilities",
)


def results_file(out: Path) -> Path:
    """The lines of results, from a folder or the file itself."""
    return out if out.suffix == ".jsonl" else out / RESULTS


def experiment_file(out: Path, case: str) -> Path:
    """Where the command file of the experiment that a case's diagnosis proposes is kept."""
    return out / f"{case}.next.csv"


def read_results(out: Path) -> dict[str, dict[str, Any]]:
    """Results by case; a line that was cut off is left out, the last line of a case counts."""
    path, found = results_file(out), {}
    if path.exists():
        for line in path.read_text(encoding="utf-8").splitlines():
            try:
                row = json.loads(line)
                found[row["id"]] = row
            except (ValueError, KeyError, TypeError):
                continue
    return found


def results_of(manifest: dict[str, Any], out: Path) -> dict[str, dict[str, Any]]:
    """`read_results` of this check.

    Raises:
        BlindError: they are another check's, by the digests of the recordings.
    """
    found, digests = read_results(out), recording_digests(manifest)
    for case, row in found.items():
        if row.get("recording_sha256", digests.get(case)) != digests.get(case):
            raise BlindError(f"{results_file(out)}: case {case} is of another check: choose another folder")
    return found


def recording_digests(manifest: dict[str, Any]) -> dict[str, str]:
    """What was recorded last of each case."""
    return {c["id"]: c.get("next_sha256", c["recording_sha256"]) for c in manifest["cases"]}


@dataclass(frozen=True)
class Plan:
    """Which cases are diagnosed, how, and by how many processes.

    Attributes:
        cases: taken in this order; all where none is named.
        threads: of each case; None takes all processors.
        baselines: whether the alternatives (fit everything at once) are run too.
        only: names of the effects that are looked for; all where none is named.
        answers: places that must not be readable; each process tries.
        keep: whether each full diagnosis.json is kept.
        timeout: of one case [s].
        budget: no case is begun later than this [s], and those under way are stopped then, to be resumed another time.
        workers: cases at a time.
        worker: module that diagnoses a case, by `simgap.blind.worker.run`.
        place: as `open_pool` takes it: where the processes are started; elsewhere than here, both folders must be what
            is found under the same paths there.
    """

    cases: Sequence[str] = ()
    threads: int | None = None
    baselines: bool = True
    only: Sequence[str] = ()
    answers: Sequence[Path] = ()
    keep: bool = False
    timeout: float = 1800.0
    budget: float | None = None
    workers: int = 1
    worker: str = "simgap.blind.worker"
    place: str = PROCESSES

    @property
    def options(self) -> dict[str, Any]:
        """What the process of a case is told."""
        answers = [str(a) for a in self.answers]
        return {"threads": self.threads, "baselines": self.baselines, "only": list(self.only), "answers": answers}


def run(folder: Path, out: Path, plan: Plan, progress: Progress | None = None) -> dict[str, dict[str, Any]]:
    """Diagnose what has no result yet; a line of JSON a case is appended to ``out``/results.jsonl as it comes.

    Raises:
        BlindError: no check, answers within reach, unknown cases, or results of another check in ``out``.
        GapInputError: the place cannot be used.
    """
    folder, out = folder.resolve(), out.resolve()
    manifest = read_manifest(folder)
    ids = [c["id"] for c in manifest["cases"]]
    unknown = sorted(set(plan.cases) - set(ids))
    if unknown:
        raise BlindError(f"case {unknown[0]!r} is not one of {ids[0]} to {ids[-1]}")
    _refuse_reachable(folder, plan.answers)
    out.mkdir(parents=True, exist_ok=True)
    done, digests = results_of(manifest, out), recording_digests(manifest)
    todo = [i for i in (plan.cases or ids) if done.get(i, {}).get("status") not in ("done", "refused")]
    if not plan.cases:
        # The slow ones first, so that no worker is left alone with them at the end.
        todo.sort(key=lambda i: -sum(f.stat().st_size for f in (folder / "data" / i).glob("recording.*")))
    begun = time.monotonic()

    def jobs() -> Iterator[_Job]:
        for case in todo:
            left = float("inf") if plan.budget is None else plan.budget - (time.monotonic() - begun)
            if left < 1.0:
                return
            yield _Job(folder / "data" / case, out, plan, min(plan.timeout, left), left < plan.timeout)

    finished = 0
    for job, row in run_batch(_diagnose, jobs(), max(plan.workers, 1), plan.place, light=True):
        finished += 1
        if job.last and row["status"] == "timeout":
            continue  # The budget stopped it, and it waits for the next call.
        with results_file(out).open("a", encoding="utf-8") as file:
            file.write(json.dumps(row | {"recording_sha256": digests[row["id"]]}) + "\n")
        if progress:
            progress(row, finished, len(todo))
    return read_results(out)


@dataclass(frozen=True)
class _Job:
    """One case to diagnose; ``last``: the budget ends before its own time does."""

    case: Path
    out: Path
    plan: Plan
    timeout: float
    last: bool


def _refuse_reachable(folder: Path, answers: Sequence[Path]) -> None:
    for place in (*answers, folder):
        if place == folder:
            inside = [*folder.rglob("answers*"), *folder.rglob("*answer*.json")]
            if inside:
                raise BlindError(f"{inside[0]}: answers lie inside of the data; move them away")
        elif folder.resolve() in place.resolve().parents:
            raise BlindError(f"{place}: answers lie inside of the data; move them away")


def _diagnose(job: _Job) -> dict[str, Any]:
    case, out = job.case, job.out
    started = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="blind-") as scratch:
        command = [sys.executable, "-P", "-m", job.plan.worker, str(case), scratch, json.dumps(job.plan.options)]
        environment = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
        row: dict[str, Any] = {"id": case.name, "status": "failed"}
        try:
            ended = subprocess.run(
                command, cwd=scratch, env=environment, capture_output=True, text=True, timeout=job.timeout, check=False
            )
        except subprocess.TimeoutExpired:
            return row | {"status": "timeout", "wall_s": time.monotonic() - started}
        result = Path(scratch) / f"{case.name}.json"
        if ended.returncode or not result.exists():
            last = (ended.stderr.strip().splitlines() or ["no output"])[-1]
            refused = "GapInputError" in last
            row |= {"status": "refused" if refused else "failed", "error": last[:500]}
            return row | {"wall_s": time.monotonic() - started}
        report = json.loads(result.read_text(encoding="utf-8"))
        proposed = (report.get("next_experiment") or {}).get("file")
        if proposed:
            shutil.copy(Path(scratch) / proposed, experiment_file(out, case.name))
        if job.plan.keep:
            (out / f"{case.name}.json").write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    return row | {
        "status": "done",
        **{k: report[k] for k in _KEPT if k in report},
        "where": report["where"][:6],
        "ranking": report.get("ranking", [])[:5],
        "next_experiment": (report.get("next_experiment") or {}).get("description"),
        "wall_s": report["time_to_verdict_s"],
        "process_s": time.monotonic() - started,
    }
