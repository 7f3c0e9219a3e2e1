"""What is held while a mouse moves that somebody watches."""

from __future__ import annotations

import pytest

from nermo_bringup.protocol.dead_man import REPEAT_HOLD_S, STEERS, HeldKey, hint, watching
from nermo_bringup.teleop.keyboard import HOLD_S
from nermo_description.robots import load_robot
from nermo_gap.protocol.standard import protocol_of
from nermo_gap.protocol.through_graph import Request

ROBOT = load_robot("nermo_lite")


def test_a_key_counts_until_its_repetition_must_have_come() -> None:
    key = HeldKey()
    assert not key.held(0.0)
    key.press(" ", 0.0)
    assert key.held(HOLD_S - 0.01), "the first repetition comes late"
    assert not key.held(HOLD_S)


def test_a_key_that_repeats_is_let_go_a_quarter_of_a_second_after_the_last_one() -> None:
    key = HeldKey()
    for number in range(10):
        key.press(" ", 0.5 + 0.04 * number)
    assert key.held(0.86 + REPEAT_HOLD_S - 0.01) and not key.held(0.86 + REPEAT_HOLD_S)


def test_any_other_key_lets_go_at_once() -> None:
    key = HeldKey()
    key.press(" ", 0.0)
    key.press("x", 0.1)
    assert not key.held(0.1)


@pytest.mark.parametrize(
    ("target", "port", "given", "held"),
    [
        ("sim", "twin", None, "none"),
        ("serial", "twin", None, "none"),
        ("serial", "/dev/ttyUSB0", None, "space"),
        ("link", "quic/nermo.local:7447?rel=0", None, "space"),
        ("serial", "/dev/ttyUSB0", "pad", "pad"),
        ("serial", "/dev/ttyUSB0", "none", "none"),
        ("sim", "twin", "space", "space"),
    ],
)
def test_a_real_mouse_is_watched_unless_somebody_says_otherwise(target, port, given, held, tmp_path) -> None:
    protocol = protocol_of("walk", ROBOT)
    request = Request(protocol, ROBOT, "nermo_lite", tmp_path, target, port, dead_man=given)
    assert request.watched_by == held
    assert (hint(held) == "") == (held == "none")


def test_nobody_watches_the_twin() -> None:
    with watching("none", "xbox") as held:
        assert held() == 0.0, "it is held, and goes straight on"


def test_who_steers_holds_a_key_of_a_direction_instead() -> None:
    key = HeldKey(STEERS)
    assert key.turn(0.0) is None
    for at, pressed, turn in ((0.0, " ", 0.0), (0.1, "a", 1.0), (0.2, "d", -1.0), (0.3, "w", 0.0)):
        key.press(pressed, at)
        assert key.turn(at) == turn
    assert key.turn(0.3 + HOLD_S) is None
    key.press("a", 1.5)
    key.press("x", 1.6)
    assert key.turn(1.6) is None
    assert "turn left or right" in hint("space", steers=True) and "turn" not in hint("space")


def test_nobody_turns_who_only_holds() -> None:
    key = HeldKey()
    key.press(" ", 0.0)
    key.press("a", 0.1)
    assert key.turn(0.1) is None, "it is any other key"
