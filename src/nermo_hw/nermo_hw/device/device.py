"""All boards behind their bus controller, with battery and plant, as a function of time: no thread, no own clock.

Whoever runs it says what time it is, so a minute can be gone through in a second, or the same second twice.
"""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from nermo_description.battery_model import Battery
from nermo_description.parameters import LEGS, RobotParameters
from nermo_hw.device.board import Board, BodyBoard, ServoBoard
from nermo_hw.device.fault_injection import FaultError, FaultyLine, LineFaults, names_only
from nermo_hw.device.plant import Plant, PlantSensors
from nermo_hw.sbcp import boards
from nermo_hw.sbcp.boards import BODY_BOARD, BUS_CONTROLLER, SERVO_BOARDS, board_name
from nermo_hw.sbcp.packet import OVERHEAD, DeviceClass, Instruction, Packet, Status
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
"""Time that is caught up; more is skipped, so that on a machine that is too slow answers still come in time."""


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
        boards.BUS_BAUD, ge=9600, le=100_000_000, description="Of the bus", json_schema_extra={"unit": "bit/s"}
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


class Device:
    """The robot's electronics.

    plant: what the servos move. mounting: how its servos and encoders sit, which the host finds out by calibrating.
    stored: non-volatile registers by board name. seed: of clocks, jitter and faults. now: true time of the start [ns].
    """

    def __init__(
        self,
        robot: RobotParameters,
        plant: Plant,
        settings: DeviceSettings | None = None,
        *,
        mounting: Calibration | None = None,
        stored: Mapping[str, Mapping[str, Value]] | None = None,
        seed: int = 0,
        now: int = 0,
    ) -> None:
        self.robot, self.plant, self.settings = robot, plant, settings or DeviceSettings()
        self._names = tuple(robot.servos)
        self._servos = Mountings(self._names, mounting.servos if mounting else {})
        self._encoders = Mountings(LEGS, mounting.knee_encoders if mounting else {})
        self._random = np.random.default_rng(seed)
        self.battery = Battery()
        self.battery.charge = self.settings.charge
        self.line_faults = LineFaults()
        self._line = FaultyLine(self.line_faults, seed)
        self.time = now
        self._heard = now
        self._steps = 0
        self._sensed: tuple[int, PlantSensors] | None = None
        self._order = itertools.count()
        self._inbox: list[tuple[int, int, bytes]] = []
        self._outbox: list[tuple[int, int, bytes]] = []
        self._host_parser, self._bus_parser = Parser(plausible_request), Parser(plausible_request)
        self._silent_boards: set[str] = set()
        self._held, self._held_at = np.zeros(len(self._names), dtype=bool), np.zeros(len(self._names))
        """Servos that do not answer stay where they are."""
        self.points: list[Point] = []
        """Taken since this list was last emptied, if `trace` is on."""
        self.trace = False
        self.skipped = 0
        """Time that was not caught up [ns]."""

        kept = stored or {}
        self.controller = Board(BUS_CONTROLLER, 1000, 0.0, kept.get(board_name(BUS_CONTROLLER), {}))
        self.servo_boards = [
            ServoBoard(
                (int(DeviceClass.SERVO_BOARD), number),
                [self._names.index(name) if name in self._names else None for name in names],
                leg,
                self._sense,
                current_per_torque=self.settings.stall_current / robot.servos[self._names[0]].max_torque,
                serial_number=2000 + number,
                ppm=self._ppm(),
                stored=kept.get(f"servo board {number}", {}),
            )
            for leg, (number, names) in enumerate(SERVO_BOARDS.items())
        ]
        self.body = BodyBoard(
            BODY_BOARD,
            self._sense,
            lambda: (self.battery.voltage, self.battery.current),
            serial_number=3000 + seed,
            ppm=self._ppm(),
            stored={"robot": robot.name[:16], **kept.get(board_name(BODY_BOARD), {})},
            seed=seed,
        )
        # By the address that each had when it was built in; it may have been given another since.
        built_in = (self.controller, *self.servo_boards, self.body)
        self.boards: dict[tuple[int, int], Board] = {board.address: board for board in built_in}
        for board in self.boards.values():
            board.restart(now, 0)

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

    # Time

    def advance(self, now: int) -> None:
        """Brings plant, boards and battery to a true time [ns]."""
        behind = now - self.time
        if behind > LARGEST_DEBT_NS:
            skip = (behind - LARGEST_DEBT_NS) // STEP_NS * STEP_NS
            self.skipped += skip
            self.time += skip
        while self.time + STEP_NS <= now:
            self.time += STEP_NS
            self._step()

    def _step(self) -> None:
        targets, energised = np.zeros(len(self._names)), np.zeros(len(self._names), dtype=bool)
        for board in self.servo_boards:
            board.advance(self.time)
            for channel, servo in enumerate(board.servos):
                if servo is not None:
                    targets[servo] = board.set_points[channel]
                    energised[servo] = board.energised >> channel & 1
        self.plant.step(np.where(self._held, self._held_at, self._servos.angles(targets)), energised)
        self._steps += 1
        if self._steps % WATCH_EVERY == 0:
            sensors = self._sense()
            power = float(np.abs(sensors.torques * sensors.velocities).sum())
            self.battery.draw(power, WATCH_EVERY * STEP_NS * 1e-9)
            for board in self.servo_boards:
                board.watch_currents(self.time)
            if self.battery.voltage < self.settings.brown_out_voltage:
                self.brown_out()

    # Faults, at run time

    def brown_out(self) -> None:
        """The supply breaks down for a moment: all boards start anew."""
        for board in self.boards.values():
            board.restart(self.time, round(self.settings.boot_time * 1e9))

    def set_silent_servos(self, names: Sequence[str]) -> None:
        """Exactly these servos do not answer their boards. Raises FaultError."""
        names_only("servo", names, self._names)
        sensors = self.plant.sensors()
        self._held[:] = [name in names for name in self._names]
        self._held_at[:] = sensors.positions
        for board in self.servo_boards:
            board.set_silent(self._channels(board, names))

    def set_frozen(self, names: Sequence[str]) -> None:
        """Exactly these sensors go on saying what they said last: "imu", "battery", and servos. Raises FaultError."""
        names_only("sensor", names, ("imu", "battery", *self._names))
        self.body.frozen = frozenset(names)
        for board in self.servo_boards:
            board.set_stuck(self._channels(board, names))

    def set_unreadable(self, names: Sequence[str]) -> None:
        """Exactly these sensors say that they have no reading: "imu", "battery", and servos. Raises FaultError."""
        names_only("sensor", names, ("imu", "battery", *self._names))
        self.body.unreadable = frozenset(names)
        for board in self.servo_boards:
            board.set_unreadable(self._channels(board, names))

    def set_angle_error(self, servo: str, angle: float) -> None:
        """How far a servo's reading is from where it is [rad], as after its horn has slipped. Raises FaultError."""
        if not -3.0 <= angle <= 3.0:
            raise FaultError(f"angle error = {angle!r} rad: must be within -3 and 3")
        board, channel = self._channel(servo)
        board.angle_error[channel] = angle

    def set_silent_boards(self, names: Sequence[str]) -> None:
        """Exactly these boards do not answer, as in "servo board 3". Raises FaultError."""
        names_only("board", names, [board_name(address) for address in self.boards])
        self._silent_boards = set(names)

    def set_extra_current(self, servo: str, current: float) -> None:
        """A servo that draws more than it should [A]. Raises FaultError."""
        if not 0.0 <= current <= 10.0:
            raise FaultError(f"extra current = {current!r} A: must be within 0 and 10")
        board, channel = self._channel(servo)
        board.extra_current[channel] = current

    def set_charge(self, charge: float) -> None:
        """Charge of the battery [0, 1]. Raises FaultError."""
        if not 0.0 <= charge <= 1.0:
            raise FaultError(f"charge = {charge!r}: must be within 0 and 1")
        self.battery.charge = charge

    def move_by_hand(self, servo: str, position: float) -> None:
        """Somebody turns a limp servo to a joint angle [rad]. Raises FaultError, also where the servo has power."""
        board, channel = self._channel(servo)
        if board.energised >> channel & 1:
            raise FaultError(f"servo {servo} has power: it cannot be turned by hand")
        self.plant.move_by_hand(self._names.index(servo), position)
        self._sensed = None

    def state(self) -> dict[str, object]:
        """What a test wants to know."""
        return {
            "time_ns": self.time,
            "energised": [
                self._names[place]
                for board in self.servo_boards
                for channel, place in enumerate(board.servos)
                if place is not None and board.energised >> channel & 1
            ],
            "faults": {board_name(address): int(board.faults) for address, board in self.boards.items()},
            "positions": dict(zip(self._names, self.plant.sensors().positions.tolist(), strict=True)),
            "voltage": self.battery.voltage,
            "missed_points": [board.interpolator.missed_points for board in self.servo_boards],
            "filled_buffer_steps": [board.interpolator.filled_buffer_steps for board in self.servo_boards],
            "dropped_points": [board.interpolator.dropped_points for board in self.servo_boards],
            "line_faults": dict(self._line.count),
            "skipped_s": self.skipped * 1e-9,
        }

    def stored(self) -> dict[str, dict[str, Value]]:
        """Non-volatile registers by board."""
        return {board_name(address): board.registers.stored for address, board in self.boards.items()}

    # Inside

    def _channel(self, servo: str) -> tuple[ServoBoard, int]:
        """Where a servo is plugged in. Raises FaultError where there is none of that name."""
        names_only("servo", [servo], self._names)
        place = self._names.index(servo)
        return next((board, board.servos.index(place)) for board in self.servo_boards if place in board.servos)

    def _channels(self, board: ServoBoard, names: Sequence[str]) -> int:
        """The channels of a board that these servos hang on, as bits."""
        places = [None if place is None else self._names[place] for place in board.servos]
        return sum(1 << channel for channel, name in enumerate(places) if name in names)

    def _ppm(self) -> float:
        return self.settings.clock_ppm + self.settings.clock_spread_ppm * float(self._random.standard_normal())

    def _sense(self) -> PlantSensors:
        """The plant's sensors of this step, angles as servos and encoders report them."""
        if self._sensed is None or self._sensed[0] != self._steps:
            sensors = self.plant.sensors()
            sensors.positions = self._servos.reported(sensors.positions)
            sensors.velocities = self._servos.direction * sensors.velocities
            sensors.knee_angles = self._encoders.reported(sensors.knee_angles)
            self._sensed = (self._steps, sensors)
        return self._sensed[1]

    def _serve(self, now: int) -> None:
        """Hands the packets that have come to the boards, one after another, as the bus controller does (C 5.3.2)."""
        on_bus = now
        answers: list[bytes] = []
        byte_ns = boards.BITS_PER_BYTE * 1e9 / self.settings.baud
        targets = np.full(len(self._names), np.nan)
        while self._inbox and self._inbox[0][0] <= now:
            raw = heapq.heappop(self._inbox)[2]
            if not self.controller.hears(now):
                continue
            # A packet comes whole or never: what does not parse at once is damaged.
            for packet in [*self._bus_parser.feed(raw), *self._bus_parser.flush()]:
                on_bus += round((OVERHEAD + len(packet.payload)) * byte_ns)
                answer = self._answer(packet, on_bus, targets)
                if packet.address != BUS_CONTROLLER:
                    wait = boards.SLAVE_TIMEOUT if answer.code == Status.NO_ANSWER else boards.REPLY_DELAY
                    on_bus += round(wait * 1e9)
                    if answer.code != Status.NO_ANSWER:
                        on_bus += round((OVERHEAD + len(answer.payload)) * byte_ns)
                answers.append(answer.encode())
        self.controller.registers["bad_packets"] = self._host_parser.corrupt + self._bus_parser.corrupt
        if self.trace and np.isfinite(targets).any():
            self.points.append(Point(now, targets))
        if self.settings.reply_jitter > 0.0 and answers:
            on_bus += round(abs(self._random.standard_normal()) * self.settings.reply_jitter * 1e9)
        for answer_bytes in answers:
            for raw, delay in self._line.pass_on(answer_bytes, answer=True):
                heapq.heappush(self._outbox, (on_bus + round(delay * 1e9), next(self._order), raw))

    def _answer(self, packet: Packet, now: int, targets: Array) -> Packet:
        if packet.address == BUS_CONTROLLER:
            return self.controller.handle(packet, now)
        table = self.controller.registers
        table["forwarded"] = (table.number("forwarded") + 1) & 0xFFFFFFFF
        there = [
            board
            for place, board in self.boards.items()
            if board.address == packet.address and board.hears(now) and board_name(place) not in self._silent_boards
        ]
        if not there:
            table["unanswered"] = (table.number("unanswered") + 1) & 0xFFFFFFFF
            return Packet(*packet.address, Status.NO_ANSWER)
        if len(there) > 1:  # both speak at once (C 5.3.1.3)
            return Packet(*packet.address, Status.DAMAGED_ANSWER)
        (board,) = there
        answer = board.handle(packet, now)
        if self.trace and isinstance(board, ServoBoard) and answer.code == Status.OK:
            self._note(packet, board, targets)
        return answer

    def _note(self, packet: Packet, board: ServoBoard, targets: Array) -> None:
        if packet.code != Instruction.EXCHANGE or not packet.payload[1] & boards.POINT or not board.energised:
            return
        request = boards.ServoRequest.decode(packet.payload)
        for channel, place in enumerate(board.servos):
            if place is not None:
                targets[place] = self._servos.direction[place] * (request.targets[channel] - self._servos.zero[place])
