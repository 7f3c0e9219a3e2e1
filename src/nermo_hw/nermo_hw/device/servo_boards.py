"""All boards behind their bus controller, with battery and plant, as a function of time: no thread, no own clock."""

from __future__ import annotations

import heapq
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from nermo_description.parameters import LEGS, RobotParameters
from nermo_hw.device.board import Board, BodyBoard, ServoBoard
from nermo_hw.device.device import STEP_NS, WATCH_EVERY, Array, Device, DeviceSettings, Point
from nermo_hw.device.fault_injection import FaultError, names_only
from nermo_hw.device.plant import Plant, PlantSensors
from nermo_hw.sbcp import boards
from nermo_hw.sbcp.boards import BODY_BOARD, BUS_CONTROLLER, SERVO_BOARDS, board_name
from nermo_hw.sbcp.packet import OVERHEAD, DeviceClass, Instruction, Packet, Status
from nermo_hw.sbcp.parser import Parser
from nermo_hw.sbcp.plausible import plausible_request
from nermo_hw.sbcp.registers import Value
from nermo_hw.serial.calibration import Calibration, Mountings


class ServoBoards(Device):
    """Nermo's electronics, as `Device` says.

    mounting: how encoders sit too. stored: non-volatile registers by board name.
    """

    what = "a bus of servo boards"

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
        super().__init__(robot, plant, settings, mounting=mounting, seed=seed, now=now)
        self._encoders = Mountings(LEGS, mounting.knee_encoders if mounting else {})
        self._sensed: tuple[int, PlantSensors] | None = None
        self._bus_parser = Parser(plausible_request)
        self._baud = self.settings.baud or boards.BUS_BAUD
        self._silent_boards: set[str] = set()
        self._held, self._held_at = np.zeros(len(self._names), dtype=bool), np.zeros(len(self._names))
        """Servos that do not answer stay where they are."""

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

    # Time

    def _step(self) -> None:
        targets = np.zeros(len(self._names))
        for board in self.servo_boards:
            board.advance(self.time)
            for channel, servo in enumerate(board.servos):
                if servo is not None:
                    targets[servo] = board.set_points[channel]
        self.plant.step(np.where(self._held, self._held_at, self._servos.angles(targets)), self.energised)
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
        for board in self.boards.values():
            board.restart(self.time, round(self.settings.boot_time * 1e9))

    def set_silent_servos(self, names: Sequence[str]) -> None:
        names_only("servo", names, self._names)
        sensors = self.plant.sensors()
        self._held[:] = [name in names for name in self._names]
        self._held_at[:] = sensors.positions
        for board in self.servo_boards:
            board.set_silent(self._channels(board, names))

    def set_frozen(self, names: Sequence[str]) -> None:
        names_only("sensor", names, ("imu", "battery", *self._names))
        self.body.frozen = frozenset(names)
        for board in self.servo_boards:
            board.set_stuck(self._channels(board, names))

    def set_unreadable(self, names: Sequence[str]) -> None:
        names_only("sensor", names, ("imu", "battery", *self._names))
        self.body.unreadable = frozenset(names)
        for board in self.servo_boards:
            board.set_unreadable(self._channels(board, names))

    def set_angle_error(self, servo: str, angle: float) -> None:
        if not -3.0 <= angle <= 3.0:
            raise FaultError(f"angle error = {angle!r} rad: must be within -3 and 3")
        board, channel = self._channel(servo)
        board.angle_error[channel] = angle

    def set_silent_boards(self, names: Sequence[str]) -> None:
        names_only("board", names, [board_name(address) for address in self.boards])
        self._silent_boards = set(names)

    def set_extra_current(self, servo: str, current: float) -> None:
        if not 0.0 <= current <= 10.0:
            raise FaultError(f"extra current = {current!r} A: must be within 0 and 10")
        board, channel = self._channel(servo)
        board.extra_current[channel] = current

    def move_by_hand(self, servo: str, position: float) -> None:
        super().move_by_hand(servo, position)
        self._sensed = None

    @property
    def energised(self) -> NDArray[np.bool_]:
        result = np.zeros(len(self._names), dtype=bool)
        for board in self.servo_boards:
            for channel, place in enumerate(board.servos):
                if place is not None:
                    result[place] = board.energised >> channel & 1
        return result

    def state(self) -> dict[str, object]:
        return {
            **super().state(),
            "faults": {board_name(address): int(board.faults) for address, board in self.boards.items()},
            "dropped_points": [board.interpolator.dropped_points for board in self.servo_boards],
            **self.facts(),
        }

    def facts(self) -> dict[str, object]:
        return {
            "missed_points": [board.interpolator.missed_points for board in self.servo_boards],
            "filled_buffer_steps": [board.interpolator.filled_buffer_steps for board in self.servo_boards],
        }

    def stored(self) -> dict[str, dict[str, Value]]:
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
        byte_ns = boards.BITS_PER_BYTE * 1e9 / self._baud
        targets = np.full(len(self._names), np.nan)
        while self._inbox and self._inbox[0][0] <= now:
            raw = heapq.heappop(self._inbox)[2]
            if not self.controller.hears(self._board_time(now)):
                continue
            # A packet comes whole or never: what does not parse at once is damaged.
            for packet in [*self._bus_parser.feed(raw), *self._bus_parser.flush()]:
                on_bus += round((OVERHEAD + len(packet.payload)) * byte_ns)
                answer = self._answer(packet, self._board_time(on_bus), targets)
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
            self._send(answer_bytes, on_bus)

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
