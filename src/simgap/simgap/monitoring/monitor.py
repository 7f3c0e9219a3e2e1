"""A nominal model watched beside its robot: the gap of the last seconds by part, and when the model goes stale."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from simgap.analysis.input_checks import check_map
from simgap.data.align import Aligned, align
from simgap.data.errors import GapInputError
from simgap.data.excitation import excited
from simgap.data.noise_floor import noise_floor
from simgap.data.plant import Plant
from simgap.data.recording import Recording, recording_from_table
from simgap.monitoring.drift import Drift
from simgap.monitoring.level import HORIZON, Levels, levels, parts
from simgap.simulation.state import measured_state

Array = NDArray[np.float64]

SPAN = 2.0
"""[s] over which the gap is told."""
KEPT = 6.0
"""[s] of the recording that are needed beside what is new: what nobody measures settles in them."""
TOGETHER = 0.5
"""[s] for which an alarm waits for others: a fault of one part moves its neighbours, and the worst is named first."""
_FIRST = 4.0
"""[s] from which the noise of the sensors is taken, where there is no reference."""


@dataclass(frozen=True)
class Change:
    """A part whose model goes stale, or fits again.

    Attributes:
        time: [s] of the recording.
        gap, usual: over the last SPAN seconds, and while all was well, in noise floors.
    """

    part: str
    time: float
    stale: bool
    gap: float
    usual: float

    @property
    def sentence(self) -> str:
        """For a terminal."""
        if not self.stale:
            return f"{self.part}: fits again at {self.time:.1f} s"
        return (
            f"{self.part}: the model goes stale at {self.time:.1f} s: {self.gap:.1f} noise floors over the last "
            f"{SPAN:g} s where {self.usual:.1f} are usual"
        )


@dataclass
class _Part:
    drift: Drift
    recent: deque[tuple[float, float]] = field(default_factory=deque)
    """(time, level) of the last SPAN seconds."""


class Monitor:
    """Compares a robot with its nominal model while it moves.

    The last seconds are cut into short windows; the model starts each where the robot is and is told the same. Each
    part learns what is usual from its first ten seconds of motion, or from ``reference``, recordings of the robot when
    it was well. A part whose gap stays above that is stale (`Drift`). A part that rests tells nothing.

    Raises:
        GapInputError: the references cannot be used, contradict the map, or hold no motion.
    """

    def __init__(self, plant: Plant, reference: Sequence[Recording] = (), threads: int | None = None) -> None:
        self.plant, self._threads = plant, threads
        self._floor: Array | None = None
        self._until = self._newest = -np.inf
        self.time = 0.0
        """[s] of the recording up to which it has looked."""
        self.waits = "nothing was recorded yet"
        """Why nothing is compared just now; empty where something is."""
        self._risen: list[str] = []
        self._told_at = np.inf
        known: list[Levels] = []
        for recording in reference:
            aligned = align(recording, plant)
            self._begin(aligned)
            assert self._floor is not None, "the references have begun it"
            found = levels(plant, aligned, self._floor, -np.inf, threads)
            known += [found] if found is not None else []
        self._parts = {name: _Part(Drift(_of(known, i))) for i, name in enumerate(parts(plant))}
        if reference and not self.learned:
            raise GapInputError("the reference holds too little motion: ten seconds of each part are needed")

    @property
    def learned(self) -> float:
        """Share of what the part that is furthest has to see before it can tell, 0 to 1."""
        return max(part.drift.learned for part in self._parts.values())

    @property
    def stale(self) -> list[str]:
        """Parts whose model does not fit any more."""
        return [name for name, part in self._parts.items() if part.drift.risen]

    @property
    def gap(self) -> dict[str, float]:
        """Root mean square gap [noise floors] of the last SPAN seconds by part, of those that moved."""
        return {name: _root(part.recent) for name, part in self._parts.items() if part.recent}

    @property
    def usual(self) -> dict[str, float]:
        """The same while all was well, of the parts that have learned it."""
        return {
            name: float(np.exp(0.5 * part.drift.usual))
            for name, part in self._parts.items()
            if part.drift.usual is not None
        }

    def update(self, columns: Mapping[str, Array]) -> list[Change]:
        """What has come since the last call, and KEPT seconds before it, as columns of the map.

        Raises:
            GapInputError: a column is missing, or the first seconds contradict the map.
        """
        recording = recording_from_table(dict(columns), self.plant)
        newest = float(np.nanmax(recording.time))
        if newest < self._newest - KEPT:
            # A log that begins anew.
            self._until, self._told_at = -np.inf, -np.inf if self._risen else np.inf
        self._newest = newest
        try:
            aligned = align(recording, self.plant, 2.0 * HORIZON if self._floor is not None else _FIRST, moving=False)
        except GapInputError as error:
            self.waits = str(error)
            return []
        if self._floor is None and not self._begin(aligned):
            self.waits = "the robot has not moved yet"
            return []
        assert self._floor is not None, "it has begun"
        found = levels(self.plant, aligned, self._floor, self._until, self._threads)
        return [] if found is None else self._take(found)

    def _begin(self, aligned: Aligned) -> bool:
        """Take the sensors' noise from the first recording in which something moves, and look at its map."""
        floor = noise_floor(aligned)
        if not excited(self.plant, aligned, floor):
            return False
        check_map(self.plant, aligned, measured_state(self.plant, aligned, floor))
        self._floor = floor if self._floor is None else np.maximum(self._floor, floor)
        return True

    def _take(self, found: Levels) -> list[Change]:
        changes = []
        for k in np.argsort(found.end, kind="stable"):
            self.time = self._until = float(found.end[k])
            for i, (name, part) in enumerate(self._parts.items()):
                while part.recent and part.recent[0][0] <= self.time - SPAN:
                    part.recent.popleft()
                if not found.active[k, i]:
                    continue
                part.recent.append((self.time, float(found.level[k, i])))
                if not part.drift.add(float(found.level[k, i])):
                    continue
                if part.drift.risen:
                    self._told_at = min(self._told_at, self.time + TOGETHER)
                    self._risen.append(name)
                elif name in self._risen:
                    self._risen.remove(name)
                else:
                    changes.append(self._change(name))
            if self.time >= self._told_at:
                together = [self._change(name) for name in self._risen]
                changes += sorted(together, key=lambda change: -change.gap / change.usual)
                self._risen, self._told_at = [], np.inf
        self.waits = "" if self.gap else "nothing moves"
        return changes

    def _change(self, name: str) -> Change:
        part = self._parts[name]
        gap = _root(part.recent) if part.recent else 0.0
        return Change(name, self.time, part.drift.risen, gap, self.usual[name])


def _of(known: Sequence[Levels], part: int) -> list[float]:
    return [float(v) for found in known for v in found.level[found.active[:, part], part]]


def _root(recent: Sequence[tuple[float, float]]) -> float:
    return float(np.sqrt(np.mean(np.exp([level for _, level in recent]))))
