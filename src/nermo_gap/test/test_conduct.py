"""A segment played in real time: pieces one after the other, and again where they were broken off."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from nermo_control.driver import Steering
from nermo_control.path import Path
from nermo_control.types import ControlCommand, Posture
from nermo_description.robots import load_robot
from nermo_description.stand import Stand
from nermo_gap.protocol.conduct import BROKEN_AFTER, LEAD, Conductor, asked
from nermo_gap.protocol.play import script_of
from nermo_gap.protocol.scene import PieceRow, SceneFile
from nermo_gap.protocol.types import REST, Piece, Protocol, Segment, Wave

ROBOT = load_robot("nermo_lite")
SQUAT = Piece("squat", "squat", 2.0, (Wave("front_left_knee", -0.3, 1.0, one_way=True),), looks=(0.6,))
GO = ControlCommand(0, forward_velocity=0.06, gait="trot")
TROT = Piece("trot", "trot", 3.0, commands=((0.0, GO),))
SEGMENT = Segment("standing", "floor", "set it down", (SQUAT, TROT))
TICK = 5_000_000
BEGUN = 7_000_000_000


class Beside:
    """A conductor, its clock, and what it says to whoever stands beside the mouse."""

    def __init__(self, again: bool = True) -> None:
        self.told: list[str] = []
        self.conductor = Conductor(SEGMENT, ROBOT, self.told.append, again)
        self.now = BEGUN - TICK

    def play(self, seconds: float, held: bool = True) -> list[Posture]:
        """Postures that were commanded meanwhile."""
        said = []
        for _ in range(round(seconds * 1e9 / TICK)):
            self.now += TICK
            command, targets = self.conductor.step(self.now, held)
            assert command.stamp == self.now
            assert (targets is None) == (command.posture is not Posture.DIRECT)
            said.append(command.posture)
        return said


def test_pieces_follow_one_another_out_of_the_stand_without_a_break() -> None:
    beside = Beside()
    assert set(beside.play(LEAD)) == {Posture.STAND}
    assert set(beside.play(SQUAT.seconds)) == {Posture.DIRECT}
    assert [p for p in beside.play(TROT.seconds) if p is Posture.WALK]
    beside.play(0.1)
    assert beside.conductor.over and beside.conductor.piece is None
    first, second = beside.conductor.played
    assert (first.begin, first.end) == (BEGUN + LEAD * 1e9, BEGUN + (LEAD + SQUAT.seconds) * 1e9)
    assert (second.begin, second.end - second.begin) == (first.end, TROT.seconds * 1e9)
    assert beside.told == ["1 of 2: squat (2 s)", "2 of 2: trot (3 s)"]
    assert set(beside.play(1.0)) == {Posture.STAND}


def test_who_lets_go_stops_the_mouse_at_once_and_the_piece_is_played_again() -> None:
    beside = Beside()
    beside.play(LEAD + SQUAT.seconds + 1.0)
    assert set(beside.play(5.0, held=False)) == {Posture.STAND}
    assert beside.told[-1] == "let go: 'trot' is broken off and will be played again"
    assert [played.piece.name for played in beside.conductor.played] == ["squat"]
    again = beside.now + TICK
    assert set(beside.play(LEAD)) == {Posture.STAND}, "it comes to rest first"
    beside.play(TROT.seconds + 0.1)
    assert beside.conductor.over and beside.conductor.played[1].begin == again + LEAD * 1e9


@pytest.mark.parametrize("jump", [BROKEN_AFTER + 0.1, -1.0])
def test_a_piece_in_which_nobody_commanded_for_a_while_is_played_again(jump: float) -> None:
    beside = Beside()
    beside.play(LEAD + 1.0)
    beside.now += round(jump * 1e9)
    assert beside.play(0.005) == [Posture.STAND]
    assert beside.told[-1].startswith("late: 'squat'")


def test_a_piece_in_which_the_servos_are_not_commanded_is_played_again_from_when_they_are() -> None:
    beside = Beside()
    beside.play(LEAD + 1.0)
    conductor, silent = beside.conductor, beside.now
    for _ in range(round(2.0 * BROKEN_AFTER * 1e9 / TICK)):
        beside.now += TICK
        conductor.step(beside.now, True, silent)
    assert conductor.piece is None and conductor.spoiled == 1
    assert beside.told[-1] == "the servos are commanded no more: 'squat' is broken off and will be played again"
    beside.play(LEAD + SQUAT.seconds + 0.1)
    assert [played.piece.name for played in conductor.played] == ["squat"] and conductor.spoiled == 0


def test_where_the_last_piece_is_not_played_again_who_lets_go_ends_it() -> None:
    beside = Beside(again=False)
    beside.play(LEAD + SQUAT.seconds + 1.0)
    assert set(beside.play(0.1, held=False)) == {Posture.STAND}
    conductor = beside.conductor
    assert conductor.over and not conductor.broken
    walked = conductor.played[-1]
    assert walked.piece is TROT and (walked.end - walked.begin) * 1e-9 == pytest.approx(1.0, abs=0.01)
    assert beside.told[-1] == "let go: 'trot' ended after 1.0 s"


def test_a_last_piece_that_is_not_played_again_is_broken_off_by_whatever_else() -> None:
    beside = Beside(again=False)
    beside.play(LEAD + SQUAT.seconds + 1.0)
    beside.now += 10**9
    assert set(beside.play(0.1)) == {Posture.STAND}
    assert beside.conductor.broken == "late: 'trot' was broken off" and not beside.conductor.over
    assert [played.piece.name for played in beside.conductor.played] == ["squat"]


def test_pieces_before_the_last_one_are_played_again_in_any_case() -> None:
    beside = Beside(again=False)
    beside.play(LEAD + 1.0)
    beside.play(0.1, held=False)
    assert beside.told[-1] == "let go: 'squat' is broken off and will be played again"
    beside.play(LEAD + SQUAT.seconds + TROT.seconds + 0.1)
    assert beside.conductor.over and not beside.conductor.broken


def test_it_asks_for_what_a_recording_in_process_asks_for() -> None:
    script = script_of(TROT)
    for t in np.arange(0.0025, TROT.seconds, 0.005):
        command, targets = asked(TROT, float(t), ROBOT)
        wanted = script(round(float(t) * 1e9))
        assert wanted is not None and targets is None
        assert (command.posture, command.forward_velocity) == (wanted.posture, wanted.forward_velocity), t
    assert asked(SQUAT, 1.0, ROBOT)[1] == SQUAT.targets(1.0, ROBOT)


def test_the_scene_says_when_each_piece_was_played() -> None:
    beside = Beside()
    beside.play(LEAD + SQUAT.seconds + 1.0)
    beside.play(0.1, held=False)
    beside.play(LEAD + TROT.seconds + 0.1)
    protocol, played = Protocol("short", (SEGMENT,)), beside.conductor.played
    scene = SceneFile.of(protocol, SEGMENT, "nermo_lite", Stand(), np.zeros(7), played)
    assert scene.begun == played[0].begin
    squat, trot = scene.pieces
    assert (squat.begin, squat.end, squat.looks) == (0.0, SQUAT.seconds, SQUAT.looks)
    assert trot.begin == pytest.approx(SQUAT.seconds + 1.1 + LEAD, abs=0.011)
    at = scene.pieces_at(np.array([-1.0, REST, squat.end + 0.5, trot.begin + 0.1, trot.end]))
    np.testing.assert_array_equal(at, [np.nan, 0.0, np.nan, 1.0, np.nan])


@pytest.mark.parametrize(("skipped", "said"), [(0.0, ""), (0.01, ""), (1.2, "which left out 1.2 of 9.0 s")])
def test_an_emulated_mouse_in_slow_motion_is_said(skipped: float, said: str) -> None:
    pieces = (PieceRow(name="trot", begin=0.0, end=9.0),)
    whole = {"protocol": "short", "segment": "walk", "robot": "nermo_lite", "scene": "floor", "pieces": pieces}
    told = SceneFile.model_validate({**whole, "skipped": skipped}).slow_motion
    assert said in told and bool(said) is bool(told)
    assert SceneFile.model_validate(whole).slow_motion == "", "recordings from before say nothing of it"


def test_who_steers_turns_a_piece_that_is_steered_and_no_other() -> None:
    steered = replace(TROT, steering=Steering(Path.line((0.0, 0.0, 0.0), 1.0), 0.4))
    assert asked(steered, 1.0, ROBOT, 0.5)[0] == replace(GO, turn_rate=0.2)
    assert asked(steered, 1.0, ROBOT)[0] == GO
    assert asked(steered, 0.5 * REST, ROBOT, 0.5)[0].posture is Posture.STAND
    assert asked(TROT, 1.0, ROBOT, 0.5)[0] == GO, "nobody steers it"
    assert Segment("way", "floor", "", (SQUAT, steered)).steered and not SEGMENT.steered
