"""The runs of an experiment played on the mouse, one after the other, with whoever stands beside it."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from nermo_bringup.experiment.plan import Plan, Run
from nermo_bringup.protocol.session import SPOILED, LeftError, Session, session
from nermo_description.results import CommandError
from nermo_description.robots import load_robot
from nermo_gap.protocol.through_graph import Request
from nermo_gap.protocol.types import Protocol
from nermo_sim.experiments.on_robot import RobotRequest, Target


def play(plan: Plan, asked: RobotRequest, target: Target) -> None:
    """Play and record what is missing of a plan, until all of it is there or somebody leaves.

    Nobody is asked anything with --yes, or where there is no terminal: a run is then begun at once, and kept.

    Raises:
        CommandError: a run was broken off and nobody is asked, the graph broke down, or nobody watches a real mouse;
            what was recorded until then is kept.
        ParameterError: the robot's parameters cannot be read.
        GapInputError: what is recorded cannot be read.
    """
    missing = [run for run in plan.runs if plan.recorded(run) is None]
    if not missing:
        return
    segments = tuple(plan.segment(run) for run in missing)
    request = Request(
        Protocol(plan.about.experiment, segments),
        load_robot(plan.about.robot),
        plan.about.robot,
        plan.folder,
        target,
        asked.port,
        asked.calibration,
        asked.dead_man,
        asked.pad,
        plan.about.seed,
    )
    with session(request) as opened:
        plan.save()
        try:
            _Beside(plan, opened, asks=not asked.yes and sys.stdin.isatty(), filmed=not request.on_twin).all(missing)
        except LeftError:
            opened.announce(f"left; what is recorded stays in {plan.folder}, and the same command goes on there")


class _Beside:
    """What is said to whoever stands beside the mouse, and what they answer."""

    def __init__(self, plan: Plan, opened: Session, asks: bool, filmed: bool) -> None:
        self._plan, self._session, self._asks, self._filmed = plan, opened, asks, filmed
        self._broken = 0
        """How often in a row."""

    def all(self, missing: Sequence[Run]) -> None:
        """Every run that is missing. Raises LeftError, CommandError."""
        first = missing[0]
        if self._filmed:
            self._session.announce(
                "the camera stands still and sees the floor's tags, the start line and the end line; one film a run, "
                f"named {first.film}.mp4 and so on, or with several cameras {first.film}_left.mp4 for left.yaml"
            )
        for run in missing:
            self._one(run)

    def _one(self, run: Run) -> None:
        """One run, as often as it is asked for."""
        while self._wanted(run):
            try:
                self._plan.set_aside(run)
                folder = self._plan.folder / run.name
                folder.mkdir(parents=True)
            except OSError as error:
                raise CommandError(f"{self._plan.folder} cannot be written: {error.strerror}") from error
            ready = f"start film {run.film} now" if self._filmed else ""
            broken = self._session.record(self._plan.segment(run), folder, again=False, ready=ready)
            if self._filmed:
                self._session.tell(f"stop film {run.film}")
            if not (self._again(broken) if not self._asks else self._repeats(broken)):
                return

    def _wanted(self, run: Run) -> bool:
        """Whether this run is to be done now."""
        count, case = len(self._plan.runs), f"{run.case.key}, run {run.repeat + 1}"
        place = self._plan.on_robot.place(run.case, self._plan.settings)
        self._session.announce(f"run {run.film} of {count}: {case}: {place}")
        if not self._asks:
            return True
        return self._answer("press Enter when it is so; s skips this run, q leaves") != "s"

    def _repeats(self, broken: str) -> bool:
        """Whether a run is to be done again, says whoever stands there."""
        if broken:
            self._session.tell(broken)
            return self._answer("press Enter to do it again; s skips this run, q leaves") != "s"
        return self._answer("press Enter to keep it; r does it again, q keeps it and leaves") == "r"

    def _again(self, broken: str) -> bool:
        """The same where nobody is asked: each graph has its twin on the start line, a mouse has to be put there."""
        self._broken = self._broken + 1 if broken else 0
        if broken and (self._filmed or self._broken >= SPOILED):
            raise CommandError(f"{broken}; what was recorded before stays in {self._plan.folder}")
        if broken:
            self._session.tell(f"{broken}; once more")
        return bool(broken)

    def _answer(self, question: str) -> str:
        """The first letter of what is answered."""
        answer = self._session.ask(question).lower()[:1]
        if answer == "q":
            raise LeftError
        return answer
