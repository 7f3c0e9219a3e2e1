"""The runs of an experiment on the real mouse, and the folder in which they are kept."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from nermo_description.parameter_files import read_yaml, validate, write_yaml
from nermo_description.results import CommandError
from nermo_gap.protocol.scene import BAG_FOLDER, SceneFile, scene_of
from nermo_gap.protocol.standard import clock
from nermo_gap.protocol.types import REST, Piece, Rows, Segment
from nermo_sim.experiments.experiment import QUICK_DISTANCE
from nermo_sim.experiments.on_robot import LONGEST, SHORTEST, OnRobot, Posed, RobotRequest, Said
from nermo_sim.experiments.runs import Case, Settings

PLAN_FILE = "experiment.yaml"
ROBOT_FOLDER, FILMED_FOLDER, ASIDE_FOLDER = "robot", "filmed", "set_aside"
WALK = "walk"
"""The piece that is measured."""


class PlanFile(BaseModel):
    """What `experiment.yaml` holds: what the runs of this folder have in common."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    experiment: str
    robot: str
    """Name, or parameter file."""
    distance: float | None = Field(default=None, ge=SHORTEST, le=LONGEST, json_schema_extra={"unit": "m"})
    """[m] of a run; None where that is not one for all of them."""
    repeats: int = Field(ge=1, le=100)
    quick: bool = False
    seed: int = Field(default=0, ge=0)
    """Of the twin beside it."""


@dataclass(frozen=True)
class Run:
    """One run of one case. ``number`` counts from 1 through all of them."""

    number: int
    case: Case
    repeat: int
    name: str
    """Of its folder."""

    @property
    def film(self) -> str:
        """How the name of its film begins."""
        return self.name.partition("_")[0]


@dataclass(frozen=True)
class Plan:
    """An experiment's runs in N's order: a case is repeated before the next one (N 6.1.3)."""

    about: PlanFile
    on_robot: OnRobot[Any]
    folder: Path

    @classmethod
    def of(cls, request: RobotRequest, on_robot: OnRobot[Any]) -> Plan:
        """The plan that is written in the folder, or else a new one of what is asked.

        Raises:
            CommandError: something else is asked than is written (status 2), or there is nothing where nothing shall
                be played.
            ParameterError: the plan cannot be read.
        """
        folder = request.folder / ROBOT_FOLDER
        file = folder / PLAN_FILE
        if not file.exists():
            if request.target is None:
                raise CommandError(
                    f"{file} does not exist: nothing was recorded there; record with --target, or say where (--out)",
                    status=2,
                )
            return cls(_asked(request, on_robot), on_robot, folder)
        about = validate(read_yaml(file), file, PlanFile)
        said = {"robot": _found(request.robot), "distance": request.distance, "repeats": request.repeats}
        said |= {"quick": request.quick or None, "seed": request.seed or None}
        for name, value in said.items():
            if value is not None and value != getattr(about, name):
                raise CommandError(
                    f"{file}: {name} is {getattr(about, name)}, asked for is {value}: what was recorded there goes on "
                    "as it began; for anything else give another --out",
                    status=2,
                )
        return cls(about, on_robot, folder)

    @property
    def settings(self) -> Settings:
        """As the twin's runs have them."""
        about = self.about
        settings = self.on_robot.experiment.settings(about.robot, about.seed, about.quick, about.repeats)
        settings = replace(settings, tail=self.on_robot.experiment.tail)
        return settings if about.distance is None else replace(settings, distance=about.distance)

    @property
    def cases(self) -> list[Case]:
        """N's on the robot."""
        return list(self.on_robot.cases(self.about.quick))

    @property
    def runs(self) -> list[Run]:
        """All of them."""
        pairs = [(case, repeat) for case in self.cases for repeat in range(self.about.repeats)]
        return [
            Run(number, case, repeat, f"{number:02d}_{self.on_robot.name(case)}_{repeat + 1}")
            for number, (case, repeat) in enumerate(pairs, 1)
        ]

    def save(self) -> None:
        """Write the plan. Raises ParameterError, CommandError."""
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise CommandError(f"{self.folder} cannot be made: {error.strerror}", status=2) from error
        write_yaml(self.about.model_dump(mode="json"), self.folder / PLAN_FILE)

    def segment(self, run: Run) -> Segment:
        """What is played in a run: what tells a film's clock, and what is measured."""
        settings, on_robot = self.settings, self.on_robot
        tell = f"{run.case.key}, run {run.repeat + 1}"
        piece = _piece(tell, on_robot.played(run.case, settings), on_robot.seconds(run.case, settings))
        return Segment(run.name, "floor", on_robot.place(run.case, settings), (clock(), piece))

    def recorded(self, run: Run) -> SceneFile | None:
        """The scene of a run that is whole; None of one that is not there, or was broken off.

        Raises:
            GapInputError: its scene cannot be read.
        """
        folder = self.folder / run.name
        scene = scene_of(folder)
        if scene is None or scene.begun is None or not (folder / BAG_FOLDER).is_dir():
            return None
        return scene if scene.pieces[-1].name == WALK else None

    def set_aside(self, run: Run) -> None:
        """Moves what is recorded of a run to where it is kept and not counted. Raises OSError."""
        folder = self.folder / run.name
        if not folder.exists():
            return
        aside = self.folder / ASIDE_FOLDER
        aside.mkdir(exist_ok=True)
        folder.rename(next(path for path in _numbered(aside / run.name) if not path.exists()))


def _piece(tell: str, played: Said | Posed, seconds: float) -> Piece:
    """What is measured of a run: it moves for so long [s], between two rests in the stand."""
    seconds, looks = seconds + 2.0 * REST, (0.35,)
    if isinstance(played, Said):
        said = ((0.0, played.command),)
        return Piece(WALK, tell, seconds, commands=said, looks=looks, steering=played.steering)
    stand: tuple[Mapping[str, float], ...] = ({},) * round(REST / played.period)
    return Rows(WALK, tell, seconds, looks=looks, period=played.period, rows=stand + played.rows)


def _asked(request: RobotRequest, on_robot: OnRobot[Any]) -> PlanFile:
    """What a new folder's runs have in common. Raises CommandError for a distance that this experiment has not."""
    usual = on_robot.distance
    if not on_robot.other_distances and request.distance not in (None, usual):
        way = "has no distance" if usual is None else f"is over {usual:.3f} m always"
        raise CommandError(f"--distance: is {request.distance:g}; {request.name} {way}", status=2)
    if request.quick and on_robot.other_distances:
        usual = QUICK_DISTANCE
    repeats = on_robot.repeats.quick if request.quick else on_robot.repeats.usual
    return PlanFile(
        experiment=request.name,
        robot=_found(request.robot) or on_robot.experiment.robot,
        distance=request.distance or usual,
        repeats=request.repeats or repeats,
        quick=request.quick,
        seed=request.seed,
    )


def _found(robot: str | None) -> str | None:
    """A robot's name, or its file wherever one is called from."""
    return str(Path(robot).absolute()) if robot is not None and Path(robot).is_file() else robot


def _numbered(path: Path) -> Iterator[Path]:
    number = 0
    while True:
        number += 1
        yield path.with_name(f"{path.name}_{number}")
