"""For tests: everywhere that emergency stops are obeyed, behind one face, and what the documentation says of all."""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

import numpy as np
from standing import BEGIN, NEUTRAL, ROBOT, SAMPLE

from nermo_description.emergency_stops import EmergencyStops
from nermo_hw.link.config import DEFAULT, Side, load_link
from nermo_hw.link.end import LinkEnd
from nermo_hw.link.loopback import Loopback
from nermo_hw.link.transport import LinkError
from nermo_hw.robot_end import RobotEnd
from nermo_hw.safety.supervisor import SafetySupervisor
from nermo_hw.types import SensorSample, ServoTargets

SOURCES = ("pad", "keyboard")
GIVEN_UP = 6.0
"""[s] Longer than an end of the link may be silent."""


class Place(Protocol):
    """Where stops are obeyed. A source is a publisher of `emergency_stop`."""

    def say(self, source: str, stop: bool) -> None: ...
    def leave(self, source: str) -> None: ...
    def signal(self) -> None: ...
    def release(self) -> str: ...
    def limp(self) -> bool: ...


class Twin:
    """What the twin's node does with `EmergencyStops`. Released at the start, as it is."""

    def __init__(self) -> None:
        self.stops = EmergencyStops()
        self._present = set(SOURCES)

    def say(self, source: str, stop: bool) -> None:
        self.stops.say(source, stop)

    def leave(self, source: str) -> None:
        self.stops.keep([other for other in SOURCES if other != source])

    def signal(self) -> None:
        self.stops.press("SIGUSR1")

    def release(self) -> str:
        return self.stops.release()

    def limp(self) -> bool:
        return self.stops.active


class Cable(Twin):
    """The supervisor, as its node uses it."""

    def __init__(self) -> None:
        super().__init__()
        self._now = BEGIN
        self._supervisor = SafetySupervisor(ROBOT, now=self._now)
        self.stops = self._supervisor.stops
        self.limp()
        assert self.release() == ""

    def release(self) -> str:
        return self._supervisor.release(self._now)

    def limp(self) -> bool:
        self._now += 5_000_000
        self._supervisor.take_sensors(SAMPLE, self._now)
        return not self._supervisor.step(self._now).targets.energised


class Servos:
    """A line to servos that are at once where they are told to be."""

    def __init__(self) -> None:
        self.energised = False
        self._positions = NEUTRAL
        self._count = 0

    def open(self) -> None: ...
    def close(self) -> None: ...
    def release(self) -> None: ...

    def exchange(self, targets: ServoTargets | None = None) -> SensorSample:
        assert targets is not None
        self.energised, self._positions = targets.energised, targets.positions
        self._count += 1
        noise = np.array([1e-3 * (self._count % 7), 0.0, 0.0])
        return replace(SAMPLE, servo_positions=self._positions, angular_velocity=noise)


class Link:
    """Both ends of a link on a loopback wire, in a time of their own; any of them may be cut off or start anew."""

    def __init__(self) -> None:
        self.seconds = 0.0
        self.config = load_link(DEFAULT, [("keys", None), ("robot.endpoints", []), ("workstation.endpoints", [])])
        self.wire = Loopback()
        self._saying: set[str] = set()
        self.workstation: LinkEnd | None = None
        self.robot: RobotEnd | None = None
        self.start_robot()
        self.start_workstation()
        self.other = self._end("nermo hw release")
        assert self.release() == ""

    # What the wire and the processes do

    def start_robot(self) -> None:
        if self.robot is not None:
            self.robot.link.close()
        self.servos = Servos()
        wire = self.wire.end(Side.ROBOT)
        self.robot = RobotEnd(ROBOT, self.config, self.servos, None, self._clock, transport=wire, monotonic=self._now)
        self.robot.link.open(beating=False)
        self.pass_time(0.1)

    def start_workstation(self) -> None:
        """Its node hears what each publisher has said last."""
        self.kill_workstation()
        self.workstation = self._end("/nermo/zenoh_link")
        for source in self._saying:
            self.workstation.stops.say(source, True)
        self.pass_time(0.1)

    def kill_workstation(self) -> None:
        if self.workstation is not None:
            self.workstation.close()
        self.workstation = None

    def pass_time(self, seconds: float) -> None:
        until = self.seconds + seconds
        while self.seconds < until:
            self.seconds += 0.05
            if self.workstation is not None:
                self.workstation.beat()
            if self.robot is not None:
                self.robot.link.beat()
                self.robot.tick()

    def other_release(self) -> str | None:
        """Somebody else with a certificate asks; None where no answer comes."""
        return self._ask(self.other)

    # As everywhere

    def say(self, source: str, stop: bool) -> None:
        self._saying = self._saying | {source} if stop else self._saying - {source}
        if self.workstation is not None:
            self.workstation.stops.say(source, stop)
            self.workstation.beat()

    def leave(self, source: str) -> None:
        self._saying -= {source}
        if self.workstation is not None:
            self.workstation.stops.keep([other for other in SOURCES if other != source])
            self.workstation.beat()

    def signal(self) -> None:
        """To the robot's end."""
        assert self.robot is not None
        self.robot.emergency_stop("SIGUSR1")

    def release(self) -> str | None:
        return None if self.workstation is None else self._ask(self.workstation)

    def limp(self) -> bool:
        self.pass_time(0.05)
        return not self.servos.energised

    # Inside

    def _ask(self, end: LinkEnd) -> str | None:
        try:
            return end.ask_release()
        except LinkError:
            return None

    def _end(self, name: str) -> LinkEnd:
        wire = self.wire.end(Side.WORKSTATION)
        end = LinkEnd(
            self.config, Side.WORKSTATION, lambda *_: None, self._clock, name=name, transport=wire, monotonic=self._now
        )
        end.open(beating=False)
        return end

    def _now(self) -> float:
        return self.seconds

    def _clock(self) -> int:
        return BEGIN + round(self.seconds * 1e9)


class Expected:
    """What the documentation says of stops, a second time and as plainly as possible."""

    def __init__(self) -> None:
        self.saying: set[str] = set()
        self.stopped = False

    def event(self, event: str) -> bool | None:
        """Takes an event; of a release, whether it is granted."""
        match event.split():
            case ["press", source]:
                self.saying.add(source)
                self.stopped = True
            case ["end" | "leave", source]:
                self.saying.discard(source)
            case ["signal"]:
                self.stopped = True
            case ["release"]:
                self.stopped = self.stopped and bool(self.saying)
                return not self.saying
        return None


EVENTS = ("press pad", "end pad", "leave pad", "press keyboard", "end keyboard", "signal", "release")


def do(place: Place, event: str) -> bool | None:
    """Has an event happen; of a release, whether it was granted."""
    match event.split():
        case ["press", source]:
            place.say(source, True)
        case ["end", source]:
            place.say(source, False)
        case ["leave", source]:
            place.leave(source)
        case ["signal"]:
            place.signal()
        case ["release"]:
            return place.release() == ""
    return None
