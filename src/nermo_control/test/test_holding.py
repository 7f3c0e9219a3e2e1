"""Who holds a page's button, and until when."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from nermo_control.holding import Lateness, WhoHolds
from nermo_description.silence import OWNER, STICK

ANNA, BERT = 1, 2
SIGNS = st.tuples(
    st.sampled_from([ANNA, BERT]),
    st.sampled_from(["press", "hold", "let go", "leave"]),
    st.floats(0.0, 0.6),
    st.floats(0.0, 0.5),
)
"""Whose, what, [s] since the last sign, and [s] on its way."""


@given(st.lists(SIGNS, max_size=60))
def test_one_holds_it_and_only_while_fresh_signs_of_that_press_come(signs: list[tuple[str, str, float, float]]) -> None:
    hands, now = WhoHolds(), 100.0
    for viewer in (ANNA, BERT):
        hands.join(viewer)
        hands.beat(viewer, now - 10.0 * viewer, now)
    press = {ANNA: 0, BERT: 0}
    pressing, over = dict.fromkeys(press, False), set[tuple[int, int]]()
    counted: tuple[int, float] | None = None
    for viewer, what, pause, late in signs:
        now += pause
        if counted and now - counted[1] > STICK.after:
            assert not hands.holds(now)
        if what == "leave":
            hands.leave(viewer, now)
            hands.join(viewer)
            hands.beat(viewer, now - 10.0 * viewer, now)
            pressing[viewer] = False
            if counted and counted[0] == viewer:
                assert not hands.holds(now) and hands.holder(now) is None
            continue
        press[viewer] += what == "press"
        pressing[viewer] = what != "let go" and press[viewer] > 0
        number = press[viewer] if pressing[viewer] else 0
        before = hands.holder(now)
        said = hands.press(viewer, number, now - late - 10.0 * viewer, now)
        if said is None:
            assert number and late <= STICK.after + 1e-3 and before in (None, viewer)
            assert (viewer, number) not in over, "a press that was let go counts no more"
            assert hands.holds(now) and hands.holder(now) == viewer
            counted = viewer, now
        elif said:
            assert before not in (None, viewer)
            over.add((viewer, number))
        if not number and before == viewer:
            assert not hands.holds(now)


def test_whoever_held_it_keeps_it_for_a_moment_and_what_is_spent_stays_so() -> None:
    hands = WhoHolds()
    hands.join(ANNA)
    hands.join(BERT)
    assert hands.press(ANNA, 1, 0.0, 0.0) is None
    assert "viewer 1 drives" in (hands.press(BERT, 1, 0.1, 0.1) or "")
    hands.let_go(0.2)
    assert not hands.holds(0.2) and hands.holder(0.2) == ANNA
    assert hands.press(ANNA, 1, 0.3, 0.3) == "", "it has to be pressed again"
    assert hands.holder(0.2 + OWNER.after + 0.01) is None
    assert hands.press(BERT, 1, 0.9, 0.9) == "", "that press has met another"
    assert hands.press(BERT, 2, 1.0, 1.0) is None
    assert hands.press(ANNA, 2, 2.0, 2.0, "stopped") == "stopped" and not hands.holds(2.0)
    assert hands.press(ANNA, 2, 2.1, 2.1) == ""


def test_lateness_needs_no_common_clock_and_forgets_slowly() -> None:
    lateness = Lateness()
    assert lateness.of(sent=5.0, arrived=105.3) == 0.0
    assert lateness.of(sent=6.0, arrived=106.1) == 0.0, "a shorter way is known now"
    assert lateness.of(sent=7.0, arrived=107.6) == pytest.approx(0.5, abs=1e-3)
    # Clocks that drift apart by 50 ppm, over a day, a message a second.
    assert max(lateness.of(sent=8.0 + t, arrived=108.1 + t * 1.00005) for t in range(86_400)) < 0.01
