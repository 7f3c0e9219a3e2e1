"""The proposed experiment as a protocol, and the button that plays it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from nermo_control.types import ControlCommand
from nermo_description.results import CommandError
from nermo_description.robots import load_robot
from nermo_gap.cli import gap_app
from nermo_gap.protocol.looks import LENGTH
from nermo_gap.protocol.next_experiment import Beside, HeldPlayer, protocol_of
from nermo_gap.protocol.play import Body
from nermo_gap.protocol.record import record
from nermo_gap.protocol.recorded import Recorded, read
from nermo_gap.protocol.scene import scene_of, segments
from nermo_gap.protocol.through_graph import Request
from nermo_gap.protocol.types import Piece, Protocol, Segment
from nermo_gap.robots.channels import TRACKER, command
from nermo_gap.robots.diagnosis import robot_plant
from simgap.analysis.experiment import Experiment
from simgap.live.player import Hand

ROBOT = load_robot("nermo_lite")
PLANT = robot_plant(ROBOT, [*map(command, ROBOT.servos), *TRACKER])
PERIOD = 0.005


def sway() -> Experiment:
    t = np.arange(0.0, 6.0, PERIOD)
    inputs = np.tile([ROBOT.servos[c.name].neutral for c in PLANT.inputs], (len(t), 1))
    for i, channel in enumerate(PLANT.inputs):
        if channel.name.endswith("_hip"):
            inputs[:, i] += 0.15 * np.sin(np.maximum(t - 1.0, 0.0))
    return Experiment("sway slowly", "sway", PERIOD, inputs)


def protocol(name: str, looks: tuple[float, ...]) -> Protocol:
    walk = ((0.0, ControlCommand(0, forward_velocity=0.06, gait="trot")),)
    return Protocol(name, (Segment("walk", "floor", "walk", (Piece("walk", "walk", 3.0, (), walk, looks),)),))


def read_back(*folders: Path) -> Recorded:
    found = [folder for each in folders for folder in segments(each)]
    return read(found, [scene_of(folder) for folder in found], ROBOT)


def test_it_is_played_as_it_was_proposed_and_is_looked_at_where_the_others_are(tmp_path: Path) -> None:
    experiment = sway()
    (segment,) = protocol_of(experiment, PLANT).segments
    (piece,) = segment.pieces
    assert (segment.name, segment.scene, segment.seconds) == ("sway_slowly", "floor", 6.0)
    assert all(b - a >= LENGTH for a, b in zip(piece.looks, piece.looks[1:], strict=False))
    assert piece.looks[0] < experiment.settle and piece.looks[-1] + LENGTH < piece.seconds

    body, now = Body.twin(ROBOT), tmp_path / "now"
    record(protocol_of(experiment, PLANT), body, now, 0)
    (table,) = read_back(now).tables
    for channel, wanted in zip(PLANT.inputs, experiment.inputs.T, strict=True):
        np.testing.assert_allclose(table[channel.column], wanted[: len(table["t"])], atol=1e-6)
    for name, looks in (("looked", (0.35,)), ("walk", ())):
        record(protocol(name, looks), body, tmp_path / name, 0)
    assert read_back(tmp_path / "looked", now).looks == {0.0: (0.35,), 1.0: piece.looks}
    assert read_back(tmp_path / "walk", now).looks == {}, "a walk does not say where"


def test_a_servo_is_never_told_more_than_it_can() -> None:
    experiment = sway()
    experiment.inputs[:] = 9.0
    (piece,) = protocol_of(experiment, PLANT).segments[0].pieces
    assert piece.targets(2.0, ROBOT) == {name: servo.upper for name, servo in ROBOT.servos.items()}


NOON = 43200.0
"""[s] A clock that stands still: no machine is too slow for it."""


def playing(tmp_path: Path, what: Callable[[Request], list[Path]], named: bool = False) -> HeldPlayer:
    player = HeldPlayer(what, "serial", "/dev/ttyUSB0", patience=-1.0, clock=lambda: NOON)
    player.beside = Beside("nermo_lite", [tmp_path / "a b"], tmp_path, named)
    return player


def test_the_page_is_told_where_it_is_and_what_diagnoses_both(tmp_path: Path) -> None:
    asked: list[Request] = []

    def through_graph(request: Request) -> list[Path]:
        assert request.watcher is not None and not request.watcher.gone(), "it waits while the graph comes up"
        request.watcher.tell("it moves")
        assert request.watcher.gone(), "from then on for as long as its patience lasts"
        asked.append(request)
        request.out.mkdir()
        return [request.out]

    told: list[str] = []
    player = playing(tmp_path, through_graph)
    assert player.robot == "the robot" and "floor" in player.prepare
    first, second = (player.play(sway(), PLANT, told.append) for _ in range(2))
    assert [request.out.name for request in asked] == ["next_experiment_1", "next_experiment_2"]
    assert (asked[0].target, asked[0].port, asked[0].on_twin) == ("serial", "/dev/ttyUSB0", False)
    assert first.folder == str(tmp_path / "next_experiment_1") and told.count("it moves") == 2
    assert second.command == f"nermo gap diagnose '{tmp_path}/a b' {tmp_path}/next_experiment_2"
    named = playing(tmp_path, through_graph, named=True).play(sway(), PLANT, told.append)
    assert named.command.endswith("next_experiment_3 --robot nermo_lite")


def test_what_fails_is_told_and_a_hand_that_still_presses_begins_nothing(tmp_path: Path) -> None:
    seen: list[bool] = []

    def presses(number: int) -> str:
        return player.hold(Hand(viewer=1, press=number, sent=1e3 * NOON))

    def through_graph(request: Request) -> list[Path]:
        assert request.watcher is player and presses(1) == ""
        seen.extend([player.held(), player.gone()])
        raise CommandError("emergency stop")

    player = playing(tmp_path, through_graph)
    assert "load it again" in presses(1)
    player.join(1)
    ended = player.play(sway(), PLANT, lambda sentence: None)
    assert seen == [True, False] and ended.folder == ended.command == "" and "emergency stop" in ended.sentence
    presses(1)
    assert not player.held()
    presses(2)
    assert player.held()
    player.leave(1)
    assert not player.held()


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["a", "--target", "sim"], "--web"),
        (["a.csv", "--model", "m.xml", "--map", "m.yaml", "--web", "--target", "sim"], "no other robot"),
        (["a", "--web", "--target", "serial", "--calibration", "nowhere.yaml"], "nowhere.yaml"),
        (["a", "--web", "--target", "submarine"], "submarine"),
    ],
)
def test_what_cannot_be_played_is_refused_before_anything_is_diagnosed(
    words: list[str], why: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("a").mkdir()
    answer = CliRunner().invoke(gap_app, ["diagnose", *words], env={"COLUMNS": "200"})
    assert answer.exit_code == 2 and why in answer.output
