"""One case of a blind check, diagnosed in a process that sees this case alone: ``python -m simgap.blind.worker``.

The process first gives up the right to read anything but its case, its Python and the system (see jail.py), and only
then looks at the recording.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from simgap.analysis.diagnose import Diagnosis
    from simgap.analysis.options import Options

Diagnose = Callable[[Path, "Options"], "Diagnosis"]
"""Diagnoses the case in a folder."""


def of_tables(case: Path, options: Options) -> Diagnosis:
    """A case of recording*.npz, model.xml and map.yaml."""
    from simgap.analysis.diagnose import diagnose
    from simgap.data.mapping import load_map
    from simgap.data.plant import build_plant, load_spec
    from simgap.data.recording import load_table, recording_from_table

    plant = build_plant(load_spec(case / "model.xml"), load_map(case / "map.yaml"))
    recordings = [recording_from_table(load_table(p), plant, p.stem) for p in sorted(case.glob("recording*.npz"))]
    return diagnose(recordings, plant, options)


def main(
    case: Path, out: Path, options: dict[str, Any], diagnosed: Diagnose = of_tables, readable: Sequence[Path] = ()
) -> None:
    """Diagnose ``case`` into ``out``/ID.json; ``options``: threads, baselines, seed, only, answers (a path to try).

    Whoever hands in ``diagnosed`` has imported what that needs, and names as ``readable`` what else it has to read.
    """
    # Imported before the jail closes, since some libraries look around the file system when they are imported.
    import simgap.analysis.diagnose
    import simgap.data.mapping
    import simgap.data.recording
    import simgap.inference.baselines  # noqa: F401
    from simgap.analysis.diagnose import write_experiment
    from simgap.analysis.options import Options
    from simgap.blind.jail import can_read, confine

    out.mkdir(parents=True, exist_ok=True)
    os.environ["TMPDIR"] = str(out)
    sealed = confine([case, *readable], [out])
    leaks = [str(p) for p in (case.parent, *map(Path, options.get("answers", ()))) if can_read(p)]
    isolation = {"landlock": sealed, "readable_beyond_the_case": leaks}
    if sealed and leaks:
        raise SystemExit(f"{case}: the jail leaks: {', '.join(leaks)} can be read")
    started = time.monotonic()
    chosen = Options(
        seed=int(options.get("seed", 0)),
        threads=options.get("threads"),
        baselines=bool(options.get("baselines", True)),
        only=tuple(options.get("only", ())),
    )
    found = diagnosed(case, chosen)
    write_experiment(found, out)
    report = found.report
    report |= {"id": case.name, "isolation": isolation, "time_to_verdict_s": time.monotonic() - started}
    partial = out / f".{case.name}.partial"
    partial.write_text(json.dumps(report) + "\n", encoding="utf-8")
    partial.replace(out / f"{case.name}.json")


def run(arguments: list[str], diagnosed: Diagnose = of_tables, readable: Sequence[Path] = ()) -> None:
    """`main` by what the command line says: case, folder for the result, options as JSON."""
    case, out, options = arguments
    main(Path(case).resolve(), Path(out).resolve(), json.loads(options), diagnosed, readable)


if __name__ == "__main__":
    run(sys.argv[1:])
