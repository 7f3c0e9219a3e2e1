"""What the robot's end says about itself: once a second on the diagnostics, at a change on stderr and in its log."""

from __future__ import annotations

import json
import sys
import time
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path

from nermo_hw.link.intake import CommandIntake
from nermo_hw.link.messages import encode_diagnostics
from nermo_hw.safety.rules import Cause, State
from nermo_hw.safety.supervisor import Output, SafetySupervisor

OK, WARN, ERROR = 0, 1, 2
"""Levels of diagnostic_msgs/DiagnosticStatus."""
PERIOD = 1.0
"""Of the diagnostics [s]."""

_Part = tuple[str, int, str, Mapping[str, object]]
"""Name, level, sentence, values."""


class Report:
    """Made anew in every tick, said when it is time or when the state has changed.

    log: file that gets every change of state or causes as a JSON line. monotonic: seconds that never jump.
    """

    def __init__(
        self,
        robot: str,
        supervisor: SafetySupervisor,
        commands: CommandIntake,
        log: Path | None,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        self._monotonic = monotonic
        self._robot, self._supervisor, self._commands, self._log = robot, supervisor, commands, log
        self._away: Counter[str] = Counter()
        self._told_away: Counter[str] = Counter()
        self._told_refused = self._told_waiting = 0
        self._told_state: tuple[State, tuple[Cause, ...]] | None = None
        self._told_at = -PERIOD
        self._ticks = 0

    def turned_away(self, sentence: str) -> None:
        """Somebody was refused at the door of the link."""
        self._away[sentence] += 1

    def of(
        self, output: Output, line: str, overruns: int, now: int, link: Callable[[], Mapping[str, object]]
    ) -> bytes | None:
        """The diagnostics, where some are due.

        line: what is wrong with it, empty where nothing is. now: their stamp [ns]. link: tells how it is doing.
        """
        self._ticks += 1
        state = (output.state, output.causes)
        changed = state != self._told_state
        if not changed and self._monotonic() - self._told_at < PERIOD:
            return None
        self._told_at, self._told_state = self._monotonic(), state
        if changed:
            self._write(output, now)
        values = link()
        parts = [
            self._safety(output),
            *self._commands_refused(),
            self._owner(),
            *self._door(),
            ("line", ERROR if line else OK, line or "open", {"ticks": self._ticks, "overruns": overruns}),
            ("link", *((OK, "connected") if values["connected"] else (WARN, "nobody is heard")), values),
        ]
        for name, level, sentence, _ in parts:
            if level != OK and (changed or name in ("door", "commands", "owner")):
                sys.stderr.write(f"robot_end: {name}: {sentence}\n")
        told = [(f"robot_end: {name}", level, sentence, dict(facts)) for name, level, sentence, facts in parts]
        return encode_diagnostics(now, self._robot, told)

    def _safety(self, output: Output) -> _Part:
        supervisor = self._supervisor
        values: dict[str, object] = {
            "state": output.state,
            "causes": ", ".join(str(cause) for cause in output.causes),
            "commands_received": self._commands.received,
            "commands_accepted": supervisor.accepted,
            "commands_refused": supervisor.refused,
            "last_refusal": supervisor.last_refusal,
        }
        level = {State.FOLLOW: OK, State.HOLD: WARN}.get(output.state, ERROR)
        return "safety", level, supervisor.sentence(output), values

    def _commands_refused(self) -> list[_Part]:
        if self._supervisor.refused == self._told_refused:
            return []
        self._told_refused = self._supervisor.refused
        return [("commands", WARN, f"refused: {self._supervisor.last_refusal}", {})]

    def _owner(self) -> _Part:
        commands = self._commands
        owner = commands.owner()
        values = {"owner": owner, "turned_away": commands.turned_away}
        if commands.turned_away > self._told_waiting:
            self._told_waiting = commands.turned_away
            return "owner", WARN, f"refused: {commands.last_turned_away}", values
        return "owner", OK, f"{owner} commands" if owner else "nobody commands", values

    def _door(self) -> list[_Part]:
        parts: list[_Part] = []
        for sentence, count in list(self._away.items()):
            if count > self._told_away[sentence]:
                self._told_away[sentence] = count
                parts.append(("door", WARN, sentence, {"count": count}))
        return parts

    def _write(self, output: Output, now: int) -> None:
        if self._log is None:
            return
        stamped = self._supervisor.command_stamp
        entry = {
            "monotonic_ns": time.monotonic_ns(),
            "state": str(output.state),
            "causes": [str(cause) for cause in output.causes],
            "command_age_ms": None if stamped is None else (now - stamped) * 1e-6,
            "commands_received": self._commands.received,
        }
        try:
            with self._log.open("a", encoding="utf-8") as file:
                file.write(json.dumps(entry) + "\n")
        except OSError as error:  # a full card is no reason to let go of the robot
            sys.stderr.write(f"robot_end: {self._log} cannot be written: {error}\n")
            self._log = None
