"""A hidden mouse from its first step to its opened seal: what `nermo demo --gap` shows."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from nermo_description.robots import ParameterError, load_robot
from nermo_gap.blind.mice.faults import KINDS
from nermo_gap.blind.mice.mouse import draw
from nermo_gap.blind.mice.seal import Answer, judge, open_seal, seal
from nermo_gap.protocol.record import record
from nermo_gap.protocol.standard import protocol_of
from nermo_gap.robots.checks import what_to_do
from nermo_gap.robots.diagnosis import diagnose_recordings
from simgap.analysis.options import Options
from simgap.console import print_diagnosis, progress, silence, write_diagnosis
from simgap.data.errors import GapInputError

BUDGET, SLOW = 150.0, 10.0
"""[s] that a shown diagnosis may take, and how many times what its recording took in process: the same work, mostly."""


@dataclass(frozen=True)
class Shown:
    """How it went: the truth, what the diagnosis made of it, and the page to read."""

    answer: Answer
    report: dict[str, Any]
    judged: str
    page: Path | None


def show(
    robot: str,
    number: int,
    out: Path,
    console: Console,
    protocol: str = "standard",
    budget: float | None = None,
    fault: str | None = None,
    only: tuple[str, ...] = (),
    markers: bool = False,
    hasty: bool = False,
) -> Shown:
    """Draw a mouse, record it, diagnose it, open the seal, and say honestly how it went.

    ``budget`` [s] is what the diagnosis may take; without one as long as it takes, or if ``hasty`` what is `affordable`
    on this machine. ``fault`` asks for one instead of drawing it; ``only`` names the
    effects that are considered, all where empty. ``markers``: the tracker sees feet and rear torso too.

    Raises:
        GapInputError: ``out`` holds something already, or there is no such protocol or fault.
        ParameterError: the robot cannot be read.
    """
    parameters = load_robot(robot)
    body, wrong = draw(parameters, number, fault, markers)
    chosen, recordings, folder = protocol_of(protocol, parameters, markers), out / "recordings", out / "diagnosis"
    console.print(
        f"Mouse {number}, a {parameters.name}: every number of it is 3 to 8 % off, and it has one of {len(KINDS) - 1} "
        "faults, or none.",
        highlight=False,
    )
    started = time.monotonic()
    with progress("record") as say:
        record(chosen, body, recordings, number, say)
    digest = seal(Answer.of(robot, number, wrong), recordings)
    took = time.monotonic() - started
    console.print(
        f"Recorded: {chosen.seconds:.0f} s of the protocol {protocol!r}, in {took:.0f} s. "
        f"The answer lies sealed beside it ({digest}).",
        highlight=False,
    )
    if budget is None and hasty:
        budget = affordable(took)
        if budget > BUDGET:
            console.print(f"The diagnosis may take {budget / 60.0:.0f} minutes on this machine.", highlight=False)
    with silence() as terminal, progress("align", terminal) as say:
        options = Options(baselines=False, only=only, progress=say, budget=budget)
        found = diagnose_recordings([recordings], robot, options)
        found.report["command"] = f"nermo gap diagnose {recordings}"
        found.report["what_to_do"] = what_to_do(found.report, str(folder), [str(recordings)])
        page = write_diagnosis(found, folder, None)
    print_diagnosis(found)
    answer = open_seal(recordings)
    judged = judge(answer, found.report)
    console.print(_table(answer, found.report, judged))
    console.print("The report:")
    print(page)
    return Shown(answer, found.report, judged, page)


def affordable(recorded: float) -> float:
    """What a diagnosis may take [s] where the recording took ``recorded`` [s]: a slow machine finds as much."""
    return max(BUDGET, SLOW * recorded)


def demonstrate(robot: str, number: int, out: Path, fault: str | None, budget: float | None) -> int:
    """`show` as a command, hasty without a budget; returns its exit status, 0 whatever the diagnosis says."""
    try:
        show(robot, number, out, Console(markup=False), budget=budget, fault=fault, hasty=True)
    except (GapInputError, ParameterError) as error:
        print(error, file=sys.stderr)
        return 2
    return 0


def _table(answer: Answer, report: dict[str, Any], judged: str) -> Table:
    """Truth and diagnosis, side by side."""
    found = [f"{e['name']} at {e['site']} ({_values(e)})" for e in report["effects"]]
    table = Table("", "", title=f"the seal is opened: {judged}", show_header=False)
    table.add_row("truth", answer.sentence())
    table.add_row("diagnosis", f"{report['verdict']}: {'; '.join(found) or 'nothing'}")
    for group in report["equivalent"]:
        table.add_row("not told apart", ", ".join(group))
    return table


def _values(effect: dict[str, Any]) -> str:
    return ", ".join(f"{n} {p['value']:.3g} {p['unit']}".removesuffix(" 1") for n, p in effect["parameters"].items())
