"""`nermo experiment NAME --target ... --film ...`: plays what is missing, measures what is seen, and says both."""

from __future__ import annotations

import contextlib
import functools
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from nermo_bringup.experiment.film import Filming, clock_deviation, films_of, track, tracked
from nermo_bringup.experiment.measure import LONGEST_GAP, Measured, measure, seen_in, summary
from nermo_bringup.experiment.plan import Plan, Run
from nermo_description.parameter_files import ParameterError
from nermo_description.results import CommandError, write_results
from nermo_gap.protocol.scene import SceneFile
from nermo_node.recording_reader import RecordingError
from nermo_sim.console import console, counting, print_rows, progress
from nermo_sim.experiments.on_robot import RobotRequest
from nermo_sim.experiments.registry import ON_ROBOT
from nermo_sim.experiments.runs import Result, run_cases
from nermo_track.errors import TrackError
from simgap.data.errors import GapInputError

Row = dict[str, Any]


def do(request: RobotRequest) -> None:
    """Does a request, and prints and writes what was found.

    Raises:
        CommandError: it was asked for wrongly, or nothing could be measured; what was recorded is kept.
    """
    with _told():
        plan = Plan.of(request, ON_ROBOT[request.name])
        if request.target is not None:
            from nermo_bringup.experiment.play import play

            play(plan, request, request.target)
        there = {run: scene for run in plan.runs if (scene := plan.recorded(run)) is not None}
        if request.film:
            _track(plan, there, Filming(request.film, request.camera, request.tags, request.fps))
        measured = _measure(plan, there)
        _report(plan, request, there, measured)


def _track(plan: Plan, there: dict[Run, SceneFile], filming: Filming) -> None:
    """Follows the mouse through all films; one that cannot be used is said, and the others are."""
    films, strange = films_of(filming.films, plan.runs)
    for file in strange:
        _warn(f"{file}: its name does not begin with the number of a run; it is left out")
    by_number = {run.number: run for run in there}
    for number in sorted(films.keys() - by_number.keys()):
        _warn(f"{films[number][0]}: run {number:02d} is not recorded; it is left out")
    with counting("films", len(films.keys() & by_number.keys())) as counter:
        for number in sorted(films.keys() & by_number.keys()):
            run = by_number[number]
            try:
                track(plan, run, films[number], filming, lambda stage, share: None)
            except (TrackError, RecordingError) as error:
                _warn(str(error))
            counter.advance()


def _measure(plan: Plan, there: dict[Run, SceneFile]) -> dict[Run, Measured]:
    """Of each run that somebody saw."""
    found = {}
    for run, scene in there.items():
        folder = tracked(plan, run) or plan.folder / run.name
        seconds = plan.segment(run).pieces[-1].seconds
        of_way: Callable[[Any], Result] = functools.partial(_of_way, plan, run)
        try:
            if (seen := seen_in(folder)) is None:
                continue
            found[run] = measure(seen, scene, seconds, of_way, clock_deviation(folder), run.number)
        except RecordingError as error:
            _warn(f"run {run.film}: {error}")
            continue
        if scene.slow_motion:
            _warn(f"run {run.film}: {scene.slow_motion}")
        if found[run].gap > LONGEST_GAP:
            _warn(f"run {run.film}: the mouse was not seen for {found[run].gap:.1f} s of its walk")
        if not found[run].result.get("reached", True):
            _warn(f"run {run.film}: its end was not reached, or not seen; it counts as far as it was")
    return found


def _of_way(plan: Plan, run: Run, way: Any) -> Result:
    return plan.on_robot.measure(run.case, way, plan.settings)


def _report(plan: Plan, request: RobotRequest, there: dict[Run, SceneFile], measured: dict[Run, Measured]) -> None:
    """The twin beside it, the table, N's claims, the picture and the file."""
    total = len(plan.runs)
    console.print(f"{len(there)} of {total} runs are recorded in {plan.folder}, {len(measured)} are measured")
    if len(there) > len(measured):
        name, out = plan.about.experiment, request.folder.parent
        console.print(f"next: nermo experiment {name} --film DIR --camera FILE --out {out}", soft_wrap=True)
    if not measured and request.film:
        raise CommandError(f"no film tells how a run of {plan.about.experiment} went; see the warnings above")
    if not measured:
        return
    on_robot, settings, cases = plan.on_robot, plan.settings, plan.cases
    with progress("twin") as say:
        log = request.folder / "runs.jsonl"
        twin = run_cases(on_robot.experiment.run, cases, settings, on_robot.experiment.name, log, request.workers, say)
    by_case = [[found for run, found in measured.items() if run.case == case] for case in cases]
    rows = [row_of(plan, *each) for each in zip(cases, by_case, twin, strict=True)]
    about = plan.about
    distance = "" if about.distance is None else f"{about.distance:g} m, "
    title = f"{about.experiment} on the mouse, {distance}at most {about.repeats} x each, {about.robot}"
    print_rows(title, rows, _columns(plan, rows))
    topics = ", ".join(sorted({found.topic for found in measured.values()}))
    console.print(
        f"seen by {topics}; scatter: standard deviation between repeats; tracker: of a run, by what the tracker says "
        "of its own error",
        soft_wrap=True,
    )
    claims = on_robot.claims([row for row in rows if row["runs"]])
    if claims:
        print_rows("the thesis's robot beside it", claims, ("claim", "thesis", "ours", "ratio", "band", "within"))
    picture = plan.folder / f"{about.experiment}.png"
    on_robot.picture(rows, picture)
    console.print(f"picture: {picture}")
    if request.json is not None:
        each = [_of_run(run, there[run], found) for run, found in measured.items()]
        facts = {"about": about.model_dump(), "rows": rows, "runs": each, "claims": claims, "picture": picture}
        write_results(request.json, f"{about.experiment}-robot", facts, robot=about.robot, seed=about.seed)


def row_of(plan: Plan, case: Any, found: Sequence[Measured], twin: Sequence[Result]) -> Row:
    """A case: what the mouse did, what its twin does, and N's two."""
    names = plan.on_robot.measured
    row: Row = {**plan.on_robot.describe(case), "runs": len(found), **summary(list(found), names)}
    beside = summary([Measured(result, {}, "", 0.0) for result in twin], names)
    for name in names:
        row[f"twin_{name}"], row[f"twin_scatter_{name}"] = beside[name], beside[f"scatter_{name}"]
    for name in plan.on_robot.every:
        row[name] = all(run.result[name] for run in found) if found else None
        row[f"twin_{name}"] = all(result[name] for result in twin) if name in twin[0] else None
    first = names[0]
    row["robot_over_twin"], row["robot_over_twin_sd"] = _ratio(row, first, len(found), len(twin))
    return {**row, **plan.on_robot.thesis(case)}


def _ratio(row: Row, name: str, runs: int, twin_runs: int) -> tuple[float | None, float | None]:
    """The mouse's quantity over its twin's, and its standard deviation where both have a scatter."""
    own, twin = row[name], row[f"twin_{name}"]
    if own is None or not twin:
        return None, None
    scatter, twin_scatter = row[f"scatter_{name}"], row[f"twin_scatter_{name}"]
    if scatter is None or twin_scatter is None:
        return own / twin, None
    parts = (
        scatter / math.sqrt(runs) / own,
        (row[f"tracker_{name}"] or 0.0) / own,
        twin_scatter / math.sqrt(twin_runs) / twin,
    )
    return own / twin, own / twin * math.hypot(*parts)


def _columns(plan: Plan, rows: Sequence[Row]) -> list[str]:
    """Of the rows, those that the terminal shows."""
    first, *others = plan.on_robot.measured
    described = [name for name in plan.on_robot.describe(plan.cases[0]) if len({row[name] for row in rows}) > 1]
    described = described or list(plan.on_robot.describe(plan.cases[0]))[:1]
    lead = [first, f"scatter_{first}", f"tracker_{first}", f"twin_{first}", "robot_over_twin", "robot_over_twin_sd"]
    return [
        *described,
        "runs",
        *lead,
        *(name for name in rows[0] if name.startswith("thesis_")),
        *others,
        *plan.on_robot.every,
    ]


def _of_run(run: Run, scene: SceneFile, found: Measured) -> Row:
    tracker = {f"tracker_{name}": value for name, value in found.tracker.items()}
    seen = {"seen_by": found.topic, "longest_gap_s": found.gap, "skipped_s": scene.skipped or 0.0}
    return {"run": run.name, **seen, **found.result, **tracker}


def _warn(text: str) -> None:
    console.print(f"warning: {text}", style="yellow", highlight=False, soft_wrap=True)


@contextlib.contextmanager
def _told() -> Iterator[None]:
    """Input that cannot be used ends the command with its sentence and status 2."""
    try:
        yield
    except (ParameterError, GapInputError, RecordingError, TrackError) as error:
        raise CommandError(str(error), status=2) from error
