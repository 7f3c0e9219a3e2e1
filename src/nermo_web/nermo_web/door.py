"""The door for what browsers send: JSON text becomes one of a few records, or is refused in words."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from nermo_control.driver import FREQUENCY_RANGE_HZ, SPEED_STEPS
from nermo_description.ranges import LONGEST_NAME

LONGEST_TEXT = 4096
"""Bytes of a message; the longest real one is a parameter that is a list."""
MOST_MESSAGES = 200
"""Messages of one browser in a second; a pressed stick sends 20."""
_LARGEST_INTEGER = 2**53
"""Beyond, JavaScript's numbers are no integers."""

Share = Annotated[float, Field(ge=-1.0, le=1.0)]
Name = Annotated[str, Field(max_length=LONGEST_NAME)]


class _Message(BaseModel):
    model_config = ConfigDict(strict=True, frozen=True, extra="forbid", allow_inf_nan=False)


class Stick(_Message):
    """Where the stick is. Sent 20 times a second while it is pressed, and once when it is let go."""

    kind: Literal["stick"]
    sent: float = Field(ge=0.0, le=1e12)
    """[ms] of the browser's own clock, which only runs forward."""
    press: int = Field(ge=0, le=_LARGEST_INTEGER)
    """Counts the times that it was pressed; 0: it is not."""
    forward: Share = 0.0
    turn: Share = 0.0
    """Positive left."""


class Beat(_Message):
    """A sign of life while the stick is at rest: it tells how the browser's clock stands to ours."""

    kind: Literal["beat"]
    sent: float = Field(ge=0.0, le=1e12)


class Stop(_Message):
    """Emergency stop."""

    kind: Literal["stop"]


class Release(_Message):
    """The end of the emergency stop: the servos shall have power again."""

    kind: Literal["release"]


class Take(_Message):
    """Take a posture."""

    kind: Literal["posture"]
    posture: Literal["stand", "sit", "crouch"]


class Settings(_Message):
    """What commands say beside the stick; what is not named stays as it is."""

    kind: Literal["settings"]
    gait: Name | None = None
    frequency: float | None = Field(None, ge=FREQUENCY_RANGE_HZ[0], le=FREQUENCY_RANGE_HZ[1])
    """[Hz]"""
    speed: int | None = Field(None, ge=1, le=SPEED_STEPS)
    spine: dict[Name, bool] = Field(default_factory=dict, max_length=16)
    straight_line: bool | None = None


class Record(_Message):
    """Begin a recording, or end it."""

    kind: Literal["record"]
    on: bool


class SetParameter(_Message):
    """A parameter of a node of the graph."""

    kind: Literal["parameter"]
    node: Name
    name: Annotated[str, Field(max_length=4 * LONGEST_NAME)]
    value: bool | int | float | Annotated[str, Field(max_length=1024)] | Annotated[list[float], Field(max_length=64)]


Message = Stick | Beat | Stop | Release | Take | Settings | Record | SetParameter
_ANY: TypeAdapter[Any] = TypeAdapter(Annotated[Message, Field(discriminator="kind")])


def read(text: str | bytes) -> Message:
    """The message that a browser sent.

    Raises:
        ValueError: It is none; says which field of which kind is wrong, and how.
    """
    if len(text) > LONGEST_TEXT:
        raise ValueError(f"message refused: {len(text)} bytes, allowed are {LONGEST_TEXT}")
    try:
        message: Message = _ANY.validate_json(text)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(str(part) for part in first["loc"]) or "message"
        raise ValueError(f"message refused: {place}: {first['msg']}") from None
    return message
