"""A diagnosis from files to files: of recordings together, or of each by itself, several at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, count
from pathlib import Path
from typing import TYPE_CHECKING, Any

from simgap.data.errors import GapInputError
from simgap.execution.batch import run_batch
from simgap.execution.executors import PROCESSES, processors
from simgap.inference.budget import Hurry

if TYPE_CHECKING:
    from simgap.analysis.diagnose import Diagnosis
    from simgap.analysis.stages import Staged

Say = Callable[[str, float], None]


@dataclass(frozen=True)
class Wanted:
    """What a diagnosis is made of; all of it can be pickled. Fields are as the options of ``simgap diagnose``."""

    recordings: tuple[Path, ...]
    model: Path
    map: Path
    effects: tuple[Path, ...] = ()
    only: tuple[str, ...] = ()
    seed: int = 0
    baselines: bool = True
    budget: float | None = None
    reference: tuple[Path, ...] = ()
    threads: int | None = None
    out: Path | None = None
    command: str = ""


def diagnose_files(
    wanted: Wanted,
    say: Say | None = None,
    staged: Callable[[Staged], None] | None = None,
    hurry: Hurry | None = None,
) -> Diagnosis:
    """Read, check and diagnose recordings as one.

    ``staged`` is told what is known so far; ``hurry``, wanted, ends it with the best answer so far.

    Raises:
        GapInputError: a file cannot be used.
    """
    from simgap.analysis.diagnose import diagnose
    from simgap.analysis.options import Options
    from simgap.data.corrected import original
    from simgap.data.mapping import load_map
    from simgap.data.plant import build_plant, load_spec
    from simgap.data.recording import load_recording
    from simgap.effects.library import chosen_effects, load_effects
    from simgap.preparation.check import check

    extra = tuple(c for path in wanted.effects for c in load_effects(path))
    # A wrong name is told before anything is read.
    chosen_effects(extra, wanted.only)
    plant = build_plant(load_spec(wanted.model), load_map(wanted.map))
    read = [load_recording(r, plant) for r in wanted.recordings]
    seen = check(read, plant)
    options = Options(
        wanted.seed,
        wanted.threads,
        extra,
        {},
        wanted.baselines,
        wanted.only,
        say,
        budget=wanted.budget,
        corrects=original(plant.map),
        reference=[load_recording(r, plant) for r in wanted.reference],
        staged=staged,
        hurry=hurry or Hurry(),
    )
    found = diagnose(read, plant, options)
    found.report |= {"command": wanted.command, "data": seen.report()}
    return found


def diagnose_each(
    wanted: Wanted, out: Path, workers: int | None = None, place: str = PROCESSES
) -> Iterator[dict[str, Any]]:
    """Diagnose each recording by itself into a folder of ``out`` that has its name; yields a row each as it comes.

    A row: ``recording``, ``folder``, and ``verdict``, ``effects``, ``gap`` of its diagnosis, or ``error`` where it
    cannot be used. workers, place: as `open_pool` takes them; elsewhere than here, all paths must lead to the same
    files there.

    Raises:
        GapInputError: the place cannot be used.
    """
    at_once = min(workers or processors(), len(wanted.recordings))
    threads = 1 if place != PROCESSES else max(processors() // at_once, 1)
    here = replace(
        wanted,
        model=wanted.model.resolve(),
        map=wanted.map.resolve(),
        effects=_full(wanted.effects),
        reference=_full(wanted.reference),
        threads=threads,
    )
    jobs = [
        replace(here, recordings=(path,), out=out.resolve() / name)
        for path, name in zip(_full(wanted.recordings), _names(wanted.recordings), strict=True)
    ]
    for _, row in run_batch(_diagnose_one, jobs, at_once, place):
        yield row


def _full(paths: Sequence[Path]) -> tuple[Path, ...]:
    return tuple(path.resolve() for path in paths)


def _names(recordings: Sequence[Path]) -> list[str]:
    """A folder's name for each recording, all different."""
    found: list[str] = []
    for path in recordings:
        stem = path.resolve().name.partition(".")[0] or "recording"
        found.append(next(n for n in chain([stem], (f"{stem}-{i}" for i in count(2))) if n not in found))
    return found


def _diagnose_one(wanted: Wanted) -> dict[str, Any]:
    from simgap.console import silence, write_diagnosis

    (recording,), out = wanted.recordings, wanted.out
    row: dict[str, Any] = {"recording": str(recording), "folder": str(out)}
    try:
        with silence():
            found = diagnose_files(wanted)
            write_diagnosis(found, out, None)
    except GapInputError as error:
        return row | {"error": str(error)}
    report = found.report
    effects = [{k: e[k] for k in ("name", "site", "parameters")} for e in report["effects"]]
    return row | {"verdict": report["verdict"], "effects": effects, "gap": report["gap"], "wall_s": report["wall_s"]}
