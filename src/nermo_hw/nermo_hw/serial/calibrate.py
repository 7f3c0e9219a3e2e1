"""Zero positions and directions, found by hands on a limp robot: whoever calibrates moves, nobody is asked anything."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from nermo_description.parameters import LEGS, RobotParameters
from nermo_hw.serial.calibration import Calibration, Mounting
from nermo_hw.serial.driver import Driver
from nermo_hw.types import SensorSample, ServoTargets, SilentLineError

Array = NDArray[np.float64]
Tell = Callable[[str], None]

PERIOD = 0.02
"""Between two looks at the servos [s]."""
STILL_FOR = 1.5
"""A posture counts when nothing has moved for so long [s]."""
STILL_WITHIN = 0.01
"""And by no more than this [rad]."""
MOVED_BY = 0.2
"""Movement that tells a direction [rad]."""
PATIENCE = 1.0
"""A board that has not answered, or a sensor that has not measured, for so long is named [s]: an answer may be late."""

POSITIVE = {
    "hip": "swing the foot back",
    "knee": "turn its pulley so that the tendon pays out and the knee can stretch",
    "spine_lateral": "bend the body to the left",
    "spine_vertical": "arch the back, which lowers the hip",
    "tail": "turn the tail to the left",
    "head_pan": "turn the head to the left",
    "head_tilt": "turn the head down",
}
"""What moves a servo in its positive direction; see docs/nermo_description.md."""


class CalibrationError(Exception):
    """It did not come to an end; the text says at what."""


class Calibrator:
    """Reads a limp robot without a calibration and makes one.

    driver: open, and made without a calibration. tell: shows what is to be done. timeout: for each step [s].
    """

    def __init__(self, driver: Driver, tell: Tell, timeout: float = 60.0, still_for: float = STILL_FOR) -> None:
        self._driver, self._tell, self._timeout, self._still_for = driver, tell, timeout, still_for
        self._limp = ServoTargets(np.zeros(len(driver.names)), energised=False)

    def directions(self) -> dict[str, int]:
        """Direction of every servo: each is moved by hand in its positive direction, one after another.

        Raises CalibrationError where one does not move in time, or another moves.
        """
        found: dict[str, int] = {}
        for number, name in enumerate(self._driver.names):
            self._tell(f"{name}: {POSITIVE[_kind(name)]}, by at least {np.degrees(MOVED_BY):.0f} degrees")
            found[name] = self._direction_of(number, name)
            self._tell(f"{name}: direction {found[name]:+d}")
        return found

    def zeros(self, posture: dict[str, float], directions: dict[str, int]) -> dict[str, float]:
        """What every servo reports where its angle is 0, from one posture that is held still.

        posture: the angle [rad] of every servo in it.
        """
        sample = self._still("the posture")
        names = self._driver.names
        reported = dict(zip(names, sample.servo_positions.tolist(), strict=True))
        return {name: _turn(reported[name] - directions[name] * posture[name]) for name in names}

    def encoders(self, angles: dict[str, float], before: dict[str, Mounting]) -> dict[str, Mounting]:
        """Knee encoders by leg, from knees that are held at known angles [rad]; directions are as before."""
        found = {}
        for leg, value in zip(LEGS, self._still("the knees").knee_angles.tolist(), strict=True):
            direction = before.get(leg, Mounting()).direction
            found[leg] = Mounting(zero=round(_turn(value - direction * angles[leg]), 4), direction=direction)
        return found

    def _direction_of(self, number: int, name: str) -> int:
        start: Array | None = None
        for sample in self._samples(f"{name} to move"):
            if start is None:
                start = sample.servo_positions
            moved = sample.servo_positions - start
            other = int(np.abs(moved).argmax())
            if abs(moved[other]) < MOVED_BY:
                continue
            if other != number:
                raise CalibrationError(f"{self._driver.names[other]} was moved while {name} was asked for; begin again")
            return 1 if moved[number] > 0.0 else -1
        raise AssertionError("samples end with an error")

    def _still(self, what: str) -> SensorSample:
        """The last sample of a while in which nothing has moved."""
        seen: deque[tuple[float, Array]] = deque()
        for sample in self._samples(f"{what} to be held still"):
            now, values = time.monotonic(), np.concatenate([sample.servo_positions, sample.knee_angles])
            if seen and np.abs(values - seen[0][1]).max() > STILL_WITHIN:
                seen.clear()
            seen.append((now, values))
            if now - seen[0][0] >= self._still_for:
                return sample
        raise AssertionError("samples end with an error")

    def _samples(self, what: str) -> Iterator[SensorSample]:
        """Complete samples of the limp robot, until the time is over."""
        complete = time.monotonic()
        deadline = complete + self._timeout
        while time.monotonic() < deadline:
            try:
                sample = self._driver.exchange(self._limp)
            except SilentLineError:
                continue
            if lacks := _lacks(sample, self._driver.names):
                if time.monotonic() - complete >= PATIENCE:
                    raise CalibrationError(lacks)
            else:
                yield sample
                complete = time.monotonic()
            time.sleep(PERIOD)
        raise CalibrationError(f"waited {self._timeout:g} s in vain for {what}")


def calibrate(
    driver: Driver,
    posture: str,
    before: Calibration | None,
    tell: Tell,
    *,
    directions: bool,
    knees: bool,
    timeout: float,
) -> Calibration:
    """A whole calibration, in the order zero, directions, knees.

    posture: name of the posture that the robot is held in. before: its directions and encoders stand where they are not
    found anew.

    Raises CalibrationError, and LineError where the line does not work.
    """
    robot = driver.robot
    calibrator = Calibrator(driver, tell, timeout)
    known = {name: before.servos[name].direction if before and name in before.servos else 1 for name in robot.servos}
    signs: dict[str, int] = calibrator.directions() if directions else dict(known)
    tell(f"hold the robot in the posture {posture!r} and do not move it")
    zeros = calibrator.zeros(robot.posture(posture), signs)
    encoders = dict(before.knee_encoders) if before else {}
    if knees:
        tell("press all four knees against their stops, as straight as they go, and do not move them")
        encoders = calibrator.encoders(knee_stops(robot), encoders)
    servos = {
        name: Mounting.model_validate({"zero": round(zeros[name], 4), "direction": signs[name]})
        for name in robot.servos
    }
    return Calibration(robot=robot.name, servos=servos, knee_encoders=encoders)


def knee_stops(robot: RobotParameters) -> dict[str, float]:
    """Knee angle at the form stop of each leg [rad]: the straightest."""
    front, rear = robot.front_leg_dynamics.knee.lower, robot.rear_leg_dynamics.knee.lower
    return {leg: front if leg.startswith("front") else rear for leg in LEGS}


def _lacks(sample: SensorSample, servos: Sequence[str]) -> str:
    """What a sample has not, in a sentence; empty where it is complete.

    Raises CalibrationError where the board never measures an angle.
    """
    if sample.missing:
        return f"{', '.join(sample.missing)} does not answer"
    if sample.blind:
        raise CalibrationError(
            "this board reads no angles, so there is nothing to find them by: write the calibration file by hand, as "
            "firmware/README.md shows"
        )
    unread = _unread(sample, servos)
    return f"{', '.join(unread)} has no reading" if unread else ""


def _unread(sample: SensorSample, servos: Sequence[str]) -> list[str]:
    """Servos and knee encoders that could not measure."""
    names = (*servos, *(f"knee encoder {leg}" for leg in LEGS))
    values = (*sample.servo_positions.tolist(), *sample.knee_angles.tolist())
    return [name for name, value in zip(names, values, strict=True) if math.isnan(value)]


def _kind(servo: str) -> str:
    return servo if servo in POSITIVE else servo.rsplit("_", 1)[1]


def _turn(angle: float) -> float:
    """The same angle within half a turn of 0."""
    return float((angle + np.pi) % (2.0 * np.pi) - np.pi)
