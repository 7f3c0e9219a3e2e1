"""What every emulated device has: a line with bytes under way, a plant, a battery, and a time that it is told.

Whoever runs it says what time it is, so a minute can be gone through in a second, or the same second twice.
"""

from __future__ import annotations

import heapq
import itertools
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from nermo_description.battery_model import Battery
from nermo_description.parameters import RobotParameters
from nermo_hw.device.fault_injection import FaultError, FaultyLine, LineFaults, names_only
from nermo_hw.device.plant import Plant
from nermo_hw.sbcp.parser import Parser
from nermo_hw.sbcp.plausible import plausible_request
from nermo_hw.sbcp.registers import Value
from nermo_hw.serial.calibration import Calibration, Mountings

Array = NDArray[np.float64]

STEP_NS = 1_000_000
"""Of the plant."""
WATCH_EVERY = 10
"""Steps between two looks at currents and battery."""
LARGEST_PAUSE_NS = 2_000_000
"""Within a packet."""
LARGEST_DEBT_NS = 50_000_000
"""Time that is caught up; more is skipped."""


class DeviceSettings(BaseModel):
    """How this device differs from a perfect one. Registers are set over the line."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    clock_ppm: float = Field(
        0.0, ge=-1e5, le=1e5, description="How much too fast the boards' clocks run", json_schema_extra={"unit": "ppm"}
    )
    clock_spread_ppm: float = Field(
        0.0,
        ge=0.0,
        le=1e5,
        description="Standard deviation of that from board to board",
        json_schema_extra={"unit": "ppm"},
    )
    reply_jitter: float = Field(
        0.0, ge=0.0, le=1.0, description="Standard deviation of answers coming late", json_schema_extra={"unit": "s"}
    )
    baud: int = Field(
        0, ge=0, le=100_000_000, description="Of its bus; 0: as it is", json_schema_extra={"unit": "bit/s"}
    )
    boot_time: float = Field(
        0.3, ge=0.0, le=60.0, description="After a brown-out, until boards answer", json_schema_extra={"unit": "s"}
    )
    stall_current: float = Field(
        0.9,
        gt=0.0,
        le=20.0,
        description="Of a servo at its stall torque; as micro servos of this size have",
        json_schema_extra={"unit": "A"},
    )
    charge: float = Field(1.0, ge=0.0, le=1.0, description="Of the battery at the start")
    brown_out_voltage: float = Field(
        5.0, ge=0.0, le=9.0, description="Below it the boards start anew", json_schema_extra={"unit": "V"}
    )


@dataclass(frozen=True, slots=True)
class Point:
    """Targets that the boards took."""

    time: int
    """True time [ns]."""
    targets: Array
    """[rad], in the robot's order; NaN for servos of boards that got none in this transfer."""


class Device(ABC):
    """The robot's electronics, whichever they are: `ServoBoards` or a `PwmBoard`.

    plant: what the servos move. mounting: how its servos sit, which the host finds out by calibrating. seed: of clocks,
    jitter and faults. now: true time of the start [ns].
    """

    what: ClassVar[str]
    """It, in words."""

    def __init__(
        self,
        robot: RobotParameters,
        plant: Plant,
        settings: DeviceSettings | None = None,
        *,
        mounting: Calibration | None = None,
        seed: int = 0,
        now: int = 0,
    ) -> None:
        self.robot, self.plant, self.settings = robot, plant, settings or DeviceSettings()
        self._names = tuple(robot.servos)
        self._servos = Mountings(self._names, mounting.servos if mounting else {})
        self._random = np.random.default_rng(seed)
        self.battery = Battery()
        self.battery.charge = self.settings.charge
        self.line_faults = LineFaults()
        self._line = FaultyLine(self.line_faults, seed)
        self.time = now
        self._heard = now
        self._steps = 0
        self._order = itertools.count()
        self._inbox: list[tuple[int, int, bytes]] = []
        self._outbox: list[tuple[int, int, bytes]] = []
        self._host_parser = Parser(plausible_request)
        self.points: list[Point] = []
        """Taken since this list was last emptied, if `trace` is on."""
        self.trace = False
        self.largest_catch_up: int | None = None
        """The most that one call of `advance` catches up [ns]; None: all. Who serves in real time sets it, so that
        requests are heard in between, by boards whose time is behind, and answered in time by a slow machine too."""
        self._behind = 0
        self.skipped = 0
        """Time that was not caught up [ns]."""

    def close(self) -> None:  # noqa: B027 - most have nothing to give back
        """Gives back what it holds."""

    # The line

    def receive(self, data: bytes, now: int) -> None:
        """Bytes from the host, at a true time [ns] that does not run backwards."""
        self.advance(now)
        clean = True
        # A pause within a packet ends it: what was cut off does not swallow what comes next.
        cut_off = self._host_parser.flush() if now - self._heard > LARGEST_PAUSE_NS else []
        self._heard = now
        for packet in [*cut_off, *self._host_parser.feed(data)]:
            for raw, delay in self._line.pass_on(packet.encode()):
                if delay > 0.0:
                    heapq.heappush(self._inbox, (now + round(delay * 1e9), next(self._order), raw))
                    clean = False
                else:
                    self._inbox.append((now, next(self._order), raw))
        if not clean:
            heapq.heapify(self._inbox)
        self._serve(now)

    def collect(self, now: int) -> bytes:
        """What the host gets by now; nothing comes earlier than a real line would bring it."""
        self.advance(now)
        self._serve(now)
        out = b""
        while self._outbox and self._outbox[0][0] <= now:
            out += heapq.heappop(self._outbox)[2]
        return out

    def next_output(self) -> int | None:
        """When `collect` will have something [ns], or None."""
        times = [queue[0][0] for queue in (self._outbox, self._inbox) if queue]
        return min(times, default=None)

    @abstractmethod
    def _serve(self, now: int) -> None:
        """Takes what is in the inbox by now and puts answers into the outbox."""

    def _send(self, packet: bytes, at: int) -> None:
        """An answer on its way to the host."""
        for raw, delay in self._line.pass_on(packet, answer=True):
            heapq.heappush(self._outbox, (at + round(delay * 1e9), next(self._order), raw))

    # Time

    def advance(self, now: int) -> None:
        """Brings plant, boards and battery to a true time [ns], or `largest_catch_up` towards it."""
        behind = now - self.time
        if behind > LARGEST_DEBT_NS:
            skip = (behind - LARGEST_DEBT_NS) // STEP_NS * STEP_NS
            self.skipped += skip
            self.time += skip
        until = now if self.largest_catch_up is None else min(now, self.time + self.largest_catch_up)
        while self.time + STEP_NS <= until:
            self.time += STEP_NS
            self._step()
        self._behind = (now - self.time) // STEP_NS * STEP_NS

    def _board_time(self, now: int) -> int:
        """A true time as the boards have it, who are behind while there is time to catch up [ns]."""
        return now - self._behind

    def _ppm(self) -> float:
        """How much too fast a board's clock runs."""
        return self.settings.clock_ppm + self.settings.clock_spread_ppm * float(self._random.standard_normal())

    @abstractmethod
    def _step(self) -> None:
        """A millisecond passes."""

    # Faults, at run time

    @abstractmethod
    def brown_out(self) -> None:
        """The supply breaks down for a moment: all boards start anew."""

    def set_charge(self, charge: float) -> None:
        """Charge of the battery [0, 1]. Raises FaultError."""
        if not 0.0 <= charge <= 1.0:
            raise FaultError(f"charge = {charge!r}: must be within 0 and 1")
        self.battery.charge = charge

    def move_by_hand(self, servo: str, position: float) -> None:
        """Somebody turns a limp servo to a joint angle [rad]. Raises FaultError, also where the servo has power."""
        names_only("servo", [servo], self._names)
        place = self._names.index(servo)
        if self.energised[place]:
            raise FaultError(f"servo {servo} has power: it cannot be turned by hand")
        self.plant.move_by_hand(place, position)

    def set_silent_servos(self, names: Sequence[str]) -> None:
        """Exactly these servos do not answer their boards. Raises FaultError, also where none answers anyway."""
        raise self._senseless("silent_servos")

    def set_silent_boards(self, names: Sequence[str]) -> None:
        """Exactly these boards do not answer, as in "servo board 3". Raises FaultError."""
        raise self._senseless("silent_boards")

    def set_frozen(self, names: Sequence[str]) -> None:
        """Exactly these sensors go on saying what they said last: "imu", "battery", and servos. Raises FaultError."""
        raise self._senseless("frozen")

    def set_unreadable(self, names: Sequence[str]) -> None:
        """Exactly these sensors say that they have no reading: "imu", "battery", and servos. Raises FaultError."""
        raise self._senseless("unreadable")

    def set_angle_error(self, servo: str, angle: float) -> None:
        """How far a servo's reading is from where it is [rad], as after its horn has slipped. Raises FaultError."""
        raise self._senseless("angle_error")

    def set_extra_current(self, servo: str, current: float) -> None:
        """A servo that draws more than it should [A]. Raises FaultError."""
        raise self._senseless("extra_current")

    def _senseless(self, word: str) -> FaultError:
        return FaultError(f"{word}: {self.what} has nothing that could be so")

    # What there is to know

    @property
    @abstractmethod
    def energised(self) -> NDArray[np.bool_]:
        """Which servos have power, in the robot's order."""

    def state(self) -> dict[str, object]:
        """What a test wants to know."""
        return {
            "time_ns": self.time,
            "energised": [name for name, on in zip(self._names, self.energised.tolist(), strict=True) if on],
            "positions": dict(zip(self._names, self.plant.sensors().positions.tolist(), strict=True)),
            "voltage": self.battery.voltage,
            "line_faults": dict(self._line.count),
            "skipped_s": self.skipped * 1e-9,
        }

    def facts(self) -> dict[str, object]:
        """What the diagnostics say."""
        return {}

    def stored(self) -> dict[str, dict[str, Value]]:
        """Non-volatile registers by board."""
        return {}
