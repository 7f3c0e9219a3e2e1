"""Whatever comes in whatever order: the firmware is in the state that the rules say, its pulses are none or right."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule, run_state_machine_as_test
from pwm_host import LOWER, UPPER, PwmHost, need_sanitizers, pulse

from nermo_description.silence import HOLD, WATCHDOG
from nermo_hw.sbcp.boards import ACKNOWLEDGE, POINT
from nermo_hw.sbcp.pwm_board import CHANNELS, FLAGS, POWER, PULSE, STAGGER, State

EMPTY_AFTER_MS, EMPTY_V = 500, 6.0
NARROWEST, WIDEST = pulse(LOWER) - PULSE, pulse(UPPER) + PULSE


@dataclass
class Rules:
    """The board as the data sheet has it, a millisecond at a time, without its trajectories."""

    session: int
    now: int = 0
    last: int | None = None
    latched: set[str] = field(default_factory=lambda: {"restarted"})
    powered: bool = False
    first_point: int | None = None
    point: int = 0
    accepted: int = 0
    empty: bool = False
    not_empty: int = 0

    def wait(self, milliseconds: int) -> None:
        for _ in range(milliseconds):
            self.now += 1
            if self.powered and self.now - self.accepted >= WATCHDOG.after * 1e3:
                self.latch("watchdog")
            if not self.empty:
                self.not_empty = self.now
            if self.now - self.not_empty >= EMPTY_AFTER_MS:
                self.latch("empty")

    def exchange(self, session: int, sequence: int, flags: int, possible: bool) -> None:
        newer = self.last is None or 0 < (sequence - self.last) % 0x10000 < 0x8000
        if session != self.session or not newer or flags & ~FLAGS or (flags & POINT and not possible):
            return
        self.last, self.accepted = sequence, self.now
        if flags & ACKNOWLEDGE:
            self.latched.clear()
        if self.now - self.not_empty >= EMPTY_AFTER_MS:
            self.latch("empty")
        if self.latched or not flags & POWER:
            self.limp()
            return
        self.powered = True
        if flags & POINT:
            self.first_point = self.now if self.first_point is None else self.first_point
            self.point = self.now

    def latch(self, cause: str) -> None:
        if cause not in self.latched:
            self.latched.add(cause)
            self.session = (self.session + 1) % 0x10000
            self.last = None
            self.limp()

    def limp(self) -> None:
        self.powered, self.first_point = False, None

    @property
    def state(self) -> State:
        if self.latched:
            return State.FAULT
        if self.first_point is None:
            return State.LIMP
        return State.DRIVING if self.now - self.point < HOLD.after * 1e3 else State.HOLDING

    def has_pulse(self, channel: int) -> bool:
        begun = not self.latched and self.first_point is not None
        return begun and self.now - self.first_point >= channel * STAGGER * 1e3


class Board(RuleBasedStateMachine):
    """A host that does everything wrong that one can."""

    host: PwmHost

    def __init__(self) -> None:
        super().__init__()
        self.host.wait(1)
        self._start(7)
        self.sent: list[tuple[bytes, int, int, int, bool]] = []

    def _start(self, session: int) -> None:
        self.host.power_up(session)
        self.rules = Rules(session, now=self.host.now // 1000)
        self.rules.not_empty = self.rules.now

    @rule(milliseconds=st.sampled_from((1, 4, 5, 50, 150, 199, 200, 201, 250, 299, 300, 499, 500, 501)))
    def wait(self, milliseconds: int) -> None:
        self.host.wait(milliseconds)
        self.rules.wait(milliseconds)

    @rule(
        flags=st.sampled_from((0, POWER, POINT, POWER | POINT, POWER | ACKNOWLEDGE, FLAGS, ACKNOWLEDGE, 0x80 | FLAGS)),
        off=st.sampled_from((0, 0, 0, 0, 0, 1, -1)),
        ahead=st.sampled_from((1, 1, 1, 1, 2, 0, -1, 0x7FFF, 0x8000)),
        time=st.sampled_from((0.005, 0.005, 0.2, 0.0, 0.3)),
        angle=st.sampled_from((0.0, 0.4, -0.4, 3.2, -3.2, float("nan"))),
    )
    def exchange(self, flags: int, off: int, ahead: int, time: float, angle: float) -> None:
        session = (self.rules.session + off) % 0x10000
        sequence = ((self.rules.last or 0) + ahead) % 0x10000
        targets = np.full(CHANNELS, angle)
        raw = self.host.frame(targets, flags & ~POINT, time, session=session, sequence=sequence)
        if not flags & POINT:
            raw = self.host.frame(None, flags, time, session=session, sequence=sequence)
        possible = 0.0 < time <= HOLD.after and bool(np.isfinite(angle))
        self.sent.append((raw, session, sequence, flags, possible))
        self._send(self.sent[-1])

    def _send(self, sent: tuple[bytes, int, int, int, bool]) -> None:
        raw, *meant = sent
        self.host.send(raw)
        self.rules.exchange(*meant)

    @precondition(lambda self: not self.rules.latched)
    @rule(cycles=st.integers(1, 60))
    def walk(self, cycles: int) -> None:
        for _ in range(cycles):
            self.exchange(POWER | POINT, 0, 1, 0.005, 0.3)
            self.wait(5)

    @precondition(lambda self: self.sent)
    @rule(data=st.data())
    def comes_again(self, data: st.DataObject) -> None:
        self._send(data.draw(st.sampled_from(self.sent)))

    @precondition(lambda self: self.sent)
    @rule(data=st.data(), place=st.integers(0, 36), change=st.integers(1, 255))
    def comes_damaged(self, data: st.DataObject, place: int, change: int) -> None:
        raw = bytearray(data.draw(st.sampled_from(self.sent))[0])
        raw[place] ^= change
        self._noise(bytes(raw))

    @precondition(lambda self: self.sent)
    @rule(data=st.data(), cut=st.integers(1, 36))
    def comes_in_half(self, data: st.DataObject, cut: int) -> None:
        self._noise(data.draw(st.sampled_from(self.sent))[0][:cut])

    @rule(noise=st.binary(max_size=80))
    def noise(self, noise: bytes) -> None:
        self._noise(noise)

    def _noise(self, raw: bytes) -> None:
        """And then a pause, in which the parser gives up what it waits for."""
        self.host.send(raw)
        self.host.wait(3)
        self.host.send(b"\0")
        self.rules.wait(3)

    @rule(voltage=st.sampled_from((8.0, 8.0, 6.4, 5.9)))
    def supply(self, voltage: float) -> None:
        self.host.last = self.host.firmware.supply(voltage, self.host.now)
        self.rules.empty = voltage < EMPTY_V

    @rule(session=st.integers(0, 0xFFFF))
    def brown_out(self, session: int) -> None:
        self._start(session)

    @invariant()
    def is_as_the_rules_say(self) -> None:
        last = self.host.last
        assert (last.state, last.session) == (self.rules.state, self.rules.session)
        for channel, width in enumerate(last.pulses.tolist()):
            assert bool(width) == self.rules.has_pulse(channel), channel
            assert width == 0.0 or NARROWEST[channel] <= width <= WIDEST[channel]


@pytest.fixture(scope="module")
def host():
    need_sanitizers()
    made = PwmHost()
    yield made
    made.close()


def test_any_sequence_of_frames_silences_and_faults_leads_where_the_rules_say(host):
    machine = type("BoardOfThisHost", (Board,), {"host": host})
    run_state_machine_as_test(
        machine,
        settings=settings(
            max_examples=150, stateful_step_count=40, deadline=None, suppress_health_check=list(HealthCheck)
        ),
    )
