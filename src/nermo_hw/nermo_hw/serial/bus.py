"""What hangs on a line, as the driver sees it: which boards there are, what an exchange with them says, and back."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from nermo_hw.sbcp.packet import Packet
from nermo_hw.sbcp.registers import Value
from nermo_hw.types import Array, SensorSample

Address = tuple[int, int]


class Bus(Protocol):
    """One kind of electronics; `ServoBoardsBus` and `PwmBoardBus` are the two that there are."""

    name: str
    """As `bus` of a robot's file has it."""
    baud: int
    """[bit/s]"""
    door: Address
    """Who answers first; where it is silent, somebody else is there, or nobody."""
    boot_time: float
    """How long it may be silent when its port has been opened, because that has restarted it [s]."""
    boards: tuple[Address, ...]
    """All that `door` may lead to, itself among them."""
    servo_boards: tuple[Address, ...]
    """Of these, those that servos hang on, and that `settings` are for."""
    body: Address
    """The board that knows what robot this is."""
    settings: Mapping[str, Value]
    """Registers that servo boards get before they may have power."""
    learns: tuple[str, ...]
    """Registers of `body` that the bus wants to know when a line is opened."""

    def learn(self, values: Mapping[str, Value]) -> None:
        """Takes these registers: a new host begins, with boards that may remember another."""
        ...

    def packets(self, sequence: int, positions: Array | None, energised: bool, acknowledge: bool) -> list[Packet]:
        """One exchange. positions: joint angles [rad], shape (n,), finite; None: no trajectory point."""
        ...

    def take(self, packet: Packet) -> bool:
        """Whether a packet answers the present exchange; if so its content is kept. Status is OK."""
        ...

    def sample(self, stamp: int, elapsed: float, missing: tuple[str, ...]) -> SensorSample:
        """What the boards have said last. stamp, elapsed: as in `SensorSample`."""
        ...
