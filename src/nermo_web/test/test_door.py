"""What browsers may send, and how everything else is refused."""

from __future__ import annotations

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from nermo_web import door


def test_what_the_page_sends_is_read() -> None:
    stick = door.read('{"kind": "stick", "sent": 12.5, "press": 1, "forward": 1, "turn": -0.5}')
    assert stick == door.Stick(kind="stick", sent=12.5, press=1, forward=1.0, turn=-0.5)
    assert door.read('{"kind": "settings", "spine": {"turning": true}}').spine == {"turning": True}
    assert door.read(b'{"kind": "stop"}') == door.Stop(kind="stop")
    for value in (True, 3, 0.5, "spine", [0.5, 0.0]):
        message = door.read(json.dumps({"kind": "parameter", "node": "n", "name": "p", "value": value}))
        assert message.value == value
        assert type(message.value) is type(value)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "JSON"),
        ("null", "message"),
        ("[]", "message"),
        ('{"kind": "fly"}', "fly"),
        ('{"kind": "stick", "sent": 1, "press": 1, "forward": NaN}', "forward"),
        ('{"kind": "stick", "sent": 1, "press": 1, "forward": 1e999}', "forward"),
        ('{"kind": "stick", "sent": 1, "press": 1, "forward": 1.0001}', "forward"),
        ('{"kind": "stick", "sent": 1, "press": 1, "forward": "1"}', "forward"),
        ('{"kind": "stick", "sent": 1, "press": 1, "turn": true}', "turn"),
        ('{"kind": "stick", "sent": 1, "press": 1.5}', "press"),
        ('{"kind": "stick", "sent": 1, "press": -1}', "press"),
        ('{"kind": "stick", "sent": Infinity, "press": 1}', "sent"),
        ('{"kind": "stick", "press": 1}', "sent"),
        ('{"kind": "stop", "really": false}', "really"),
        ('{"kind": "posture", "posture": "fly"}', "posture"),
        ('{"kind": "settings", "frequency": 1e9}', "frequency"),
        ('{"kind": "settings", "speed": 11}', "speed"),
        ('{"kind": "settings", "gait": "' + "g" * 65 + '"}', "gait"),
        ('{"kind": "parameter", "node": "n", "name": "p", "value": NaN}', "value"),
        ('{"kind": "parameter", "node": "n", "name": "p", "value": null}', "value"),
        ('{"kind": "parameter", "node": "n", "name": "p", "value": [1, [2]]}', "value"),
        ('{"kind": "stop"}' + " " * door.LONGEST_TEXT, "bytes"),
        ("[" * 2000, "JSON"),
        (b"\xff\xfe", "JSON"),
    ],
)
def test_the_rest_is_refused_in_words(text: str | bytes, why: str) -> None:
    with pytest.raises(ValueError, match=why) as refusal:
        door.read(text)
    assert str(refusal.value).startswith("message refused: ")
    assert len(str(refusal.value)) < 300


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=10), inner, max_size=4),
    max_leaves=8,
)


@given(
    st.binary(max_size=200)
    | st.text(max_size=200)
    | JSON.map(json.dumps)
    | st.fixed_dictionaries(
        {"kind": st.sampled_from(["stick", "settings", "parameter", "posture"])},
        optional=dict.fromkeys(("sent", "press", "forward", "spine", "value", "node", "name", "posture"), JSON),
    ).map(json.dumps)
)
def test_nothing_gets_through_but_a_message_or_a_refusal(text: str | bytes) -> None:
    try:
        message = door.read(text)
    except ValueError:
        return
    assert isinstance(message, door.Message)
    if isinstance(message, door.Stick):
        assert -1.0 <= message.forward <= 1.0
