"""A blind check of mice: many hidden ones, recorded by the protocol, whose answers are sealed elsewhere."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nermo_description.robots import load_robot
from nermo_gap.blind.mice.faults import KNOWN, UNKNOWN, Fault
from nermo_gap.blind.mice.mouse import with_faults
from nermo_gap.blind.mice.places import part, sites_of
from nermo_gap.protocol.record import record
from nermo_gap.protocol.standard import protocol_of
from simgap.blind.cases import shares_of
from simgap.blind.make import Progress, apart, seal, sha256, write_manifest
from simgap.execution.batch import run_batch
from simgap.execution.executors import PROCESSES

WORKER = "nermo_gap.blind.worker"
"""Module that diagnoses a case."""
Maker = Callable[[np.random.Generator], Fault]


@dataclass(frozen=True)
class Case:
    """One mouse of a check, as far as it is drawn; faults are made from the seeds where it is recorded."""

    id: str
    robot: str
    kind: str
    faults: tuple[str, ...]
    seed: tuple[int, int]

    def made(self) -> list[Fault]:
        """What is wrong with it; of a pair the second sits in other parts than the first, where that can be."""
        found: list[Fault] = []
        every = KNOWN | UNKNOWN
        for place, name in enumerate(self.faults):
            for attempt in range(10):
                fault = every[name](np.random.default_rng([*self.seed, place, attempt]))
                if not {part(p) for p in fault.parts} & {part(p) for f in found for p in f.parts}:
                    break
            found.append(fault)
        return found

    def answer(self) -> dict[str, Any]:
        """What is sealed, in the terms of `simgap.blind.score`."""
        return {
            "id": self.id,
            "robot": self.robot,
            "kind": self.kind,
            "seed": list(self.seed),
            "faults": [_told(fault, self.robot) for fault in self.made()],
        }


def _told(fault: Fault, robot: str) -> dict[str, Any]:
    return {
        "name": fault.says or fault.kind,
        "kind": fault.kind,
        "site": fault.site or "-",
        "members": list(fault.parts),
        "level": "medium",
        "size": fault.value,
        "known": bool(fault.says),
        "places": list(sites_of(robot, fault.parts)),
        "parameters": {fault.parameter: fault.value} if fault.parameter else {},
    }


def draw_cases(count: int, seed: int, robots: Sequence[str]) -> list[Case]:
    """``count`` mice in random order, in the shares of `simgap.blind.cases.KINDS`, robots in turn.

    Every fault comes before one comes twice. The same count, seed and robots give the same cases.
    """
    random = np.random.default_rng([seed, 0x6D69])
    kinds = [kind for kind, n in shares_of(count).items() for _ in range(n)]
    known, unknown = _deck(KNOWN, random), _deck(UNKNOWN, random)
    cases = []
    for number, place in enumerate(random.permutation(count)):
        faults: tuple[str, ...] = ()
        if kinds[place] == "single":
            known = known or _deck(KNOWN, random)
            faults = (known.pop(),)
        elif kinds[place] == "unknown":
            unknown = unknown or _deck(UNKNOWN, random)
            faults = (unknown.pop(),)
        elif kinds[place] == "pair":
            faults = tuple(str(f) for f in random.choice(sorted(KNOWN), 2, replace=False))
        cases.append(Case(f"{number:03d}", robots[number % len(robots)], kinds[place], faults, (seed, number)))
    return cases


def _deck(faults: dict[str, Maker], random: np.random.Generator) -> list[str]:
    names = sorted(faults)
    return [names[i] for i in random.permutation(len(names))]


def make(
    folder: Path,
    answers: Path,
    count: int,
    seed: int,
    robots: Sequence[str] = ("nermo_lite",),
    protocol: str = "standard",
    markers: bool = False,
    workers: int = 1,
    salt: str | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Write ``folder``/data/ID/recordings, a protocol of each mouse, and ``answers``/ID.json; returns the manifest.

    The manifest holds a SHA-256 of every answer, but neither seed nor kinds.

    Raises:
        BlindError: a folder that already holds a check, answers inside of the data, or too many cases.
        GapInputError: there is no such protocol.
        ParameterError: a robot cannot be read.
    """
    for robot in robots:
        protocol_of(protocol, load_robot(robot), markers)
    folder, answers = apart(folder, answers, count)
    cases = draw_cases(count, seed, robots)
    jobs = (_Job(case, folder / "data" / case.id, protocol, markers) for case in cases)
    recorded = {}
    for done, (job, digest) in enumerate(run_batch(_record, jobs, max(workers, 1), PROCESSES), 1):
        recorded[job.case.id] = digest
        if progress:
            progress(done, count)
    entries = [
        {
            "id": case.id,
            "robot": case.robot,
            "protocol": protocol,
            "answer_sha256": sha256(seal(case.answer(), answers, salt)),
            "recording_sha256": recorded[case.id],
        }
        for case in cases
    ]
    return write_manifest(folder, answers, entries, seed, robots, [case.answer() for case in cases])


@dataclass(frozen=True)
class _Job:
    case: Case
    place: Path
    protocol: str
    markers: bool


def _record(job: _Job) -> str:
    """Record a mouse; the SHA-256 of all of its tables, one after the other."""
    case = job.case
    robot = load_robot(case.robot)
    off, noise, glue = np.random.default_rng([*case.seed, 0x6F66]).integers(2**31, size=3)
    body = with_faults(robot, int(glue), case.made(), int(off), job.markers)
    record(protocol_of(job.protocol, robot, job.markers), body, job.place / "recordings", int(noise))
    digest = hashlib.sha256()
    for table in sorted(job.place.rglob("*.npz")):
        digest.update(table.read_bytes())
    return digest.hexdigest()
