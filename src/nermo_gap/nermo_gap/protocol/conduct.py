"""A segment of a protocol played in real time: what is to be commanded at each moment, and when each piece was done."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from nermo_control.types import ControlCommand, Posture
from nermo_description.parameters import RobotParameters
from nermo_description.silence import TARGETS
from nermo_gap.protocol.types import Piece, Segment

LEAD = 3.0
"""[s] of the stand before a piece that does not follow upon another: a crouched mouse stands up and comes to rest."""
BROKEN_AFTER = TARGETS.after
"""[s] Whoever conducts and is late by more has let the mouse come to a stand, and where the servos are not commanded
for so long the mouse did something else; the piece counts as broken off."""

Targets = Mapping[str, float]
"""[rad] by servo."""
STAND = ControlCommand(0, posture=Posture.STAND)
DIRECT = ControlCommand(0, posture=Posture.DIRECT)


@dataclass(frozen=True)
class Played:
    """A piece that was played to its end, and its first and last stamp [ns]."""

    piece: Piece
    begin: int
    end: int


def asked(piece: Piece, t: float, robot: RobotParameters, turn: float = 0.0) -> tuple[ControlCommand, Targets | None]:
    """What is commanded ``t`` [s] from a piece's beginning, and where its waves have the servos.

    ``turn``: in [-1, 1], left positive, by whoever steers a piece that is steered.
    """
    if piece.of_servos:
        return DIRECT, piece.targets(t, robot)
    return piece.said(t, turn) or STAND, None


class Conductor:
    """Plays the pieces one after the other. One that is broken off is begun anew, out of the stand.

    Args:
        segment: what to play.
        robot: of which servos.
        tell: gets a sentence for whoever stands beside the mouse.
        again: whether that is so of the last piece too. Otherwise the mouse would have to be brought back first: who
            lets go ends that piece there, as at an end line, and whatever else breaks it off breaks off the segment.
    """

    def __init__(
        self, segment: Segment, robot: RobotParameters, tell: Callable[[str], None], again: bool = True
    ) -> None:
        self._segment, self._robot, self._tell, self._again = segment, robot, tell, again
        self.broken = ""
        """Why the segment was broken off, where its last piece is not played again."""
        self.played: list[Played] = []
        self._standing_since: int | None = None
        self._begin: int | None = None
        """[ns] of the piece that is played now."""
        self._last: int | None = None
        self.spoiled = 0
        """How often the present piece was broken off though nobody let go."""

    @property
    def over(self) -> bool:
        """Whether all pieces have been played."""
        return len(self.played) == len(self._segment.pieces)

    @property
    def piece(self) -> Piece | None:
        """That is played now; None in the stand."""
        return None if self._begin is None or self.over else self._segment.pieces[len(self.played)]

    def seconds(self, now: int) -> float:
        """[s] of the segment that have been played at ``now`` [ns]."""
        done = sum(played.piece.seconds for played in self.played)
        return done if self.piece is None or self._begin is None else done + (now - self._begin) * 1e-9

    def step(
        self, now: int, held: bool = True, commanded: int | None = None, turn: float = 0.0
    ) -> tuple[ControlCommand, Targets | None]:
        """What to command at ``now`` [ns], stamped.

        ``held``: whether whoever watches the mouse lets it move. ``commanded``: stamp [ns] of what the servos were
        told last; None where nobody looks. ``turn``: as of `asked`.
        """
        why = "" if held else "let go"
        if self._last is not None and not 0 <= now - self._last <= BROKEN_AFTER * 1e9:
            why = why or "late"
        if commanded is not None and now - commanded > BROKEN_AFTER * 1e9:
            why = why or "the servos are commanded no more"
        self._last = now
        if why and self.piece is not None:
            self._break_off(now, why, held)
        if why:
            self._begin = self._standing_since = None
        if not why and self._begin is None and not self.over:
            self._rest(now)
        self._next_piece(now)
        piece = self.piece
        if piece is None or self._begin is None:
            return replace(STAND, stamp=now), None
        command, targets = asked(piece, (now - self._begin) * 1e-9, self._robot, turn)
        return replace(command, stamp=now), targets

    def _break_off(self, now: int, why: str, held: bool) -> None:
        piece = self.piece
        if piece is None or self._begin is None:
            return
        if self._again or len(self.played) + 1 < len(self._segment.pieces):
            self.spoiled += held
            self._tell(f"{why}: {piece.name!r} is broken off and will be played again")
        elif not held:
            self.played.append(Played(piece, self._begin, now))
            self._tell(f"{why}: {piece.name!r} ended after {(now - self._begin) * 1e-9:.1f} s")
        else:
            self.broken = f"{why}: {piece.name!r} was broken off"

    def _rest(self, now: int) -> None:
        """In the stand, until that has lasted."""
        if self._standing_since is None:
            self._standing_since = now
        elif now - self._standing_since >= LEAD * 1e9:
            self._start(now)

    def _next_piece(self, now: int) -> None:
        """The next one follows without a break."""
        while (piece := self.piece) is not None and self._begin is not None:
            end = self._begin + round(piece.seconds * 1e9)
            if now < end:
                return
            self.played.append(Played(piece, self._begin, end))
            self.spoiled = 0
            if self.over:
                return
            self._start(end)

    def _start(self, begin: int) -> None:
        self._begin = begin
        number, piece = len(self.played), self._segment.pieces[len(self.played)]
        self._tell(f"{number + 1} of {len(self._segment.pieces)}: {piece.tell} ({piece.seconds:.0f} s)")
