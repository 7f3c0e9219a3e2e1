"""What the mouse did, judged by the recording of the demo alone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from nermo_bringup.demo.plan import Plan, Scene
from nermo_bringup.recording.errors import RecordingError
from nermo_control.lift import LIFT_DURATION, SHIFT_DURATION
from nermo_control.types import Posture
from nermo_description.parameters import LEGS
from nermo_node.recording_reader import Recording, TopicData

Array = NDArray[np.float64]

FALLEN_TILT_RAD = math.radians(45.0)
FALLEN_HEIGHT = 0.6
"""Share of the standing height below which the mouse lies on its belly."""

LEAST_SPEED = 0.4
"""A walk passes from this share of the gait's no-slip speed on."""
LARGEST_DRIFT = 0.15
"""... and up to this lateral drift, as share of the distance."""
LARGEST_HEADING_ERROR_DEG = 20.0
LEAST_TURN_DEG = 15.0
LEAST_BEND_RAD = 0.15
"""A turn with the spine bends its servo by at least so much; full lock takes 0.7 rad."""
LOADED_N = 0.03
"""Force from which the lifted foot counts as standing: 1 % of the weight."""
LARGEST_LOADED_SHARE = 0.05
"""Of the time that the leg is lifted."""
LARGEST_TILT_DEG = 20.0
"""... beyond which the mouse has tipped over."""
LEAST_SITTING_PITCH_DEG = 3.0
"""Sitting lifts the nose by at least so much."""

STANDS_BELOW = 0.005
"""[m/s] over STANDS_OVER: slower is standing."""
STANDS_OVER = 0.2
"""[s]; a step takes longer, so that its two ends do not count."""

_SETTLED_S = 0.3
"""The mouse stands still for at least so long before each scene."""


@dataclass(frozen=True)
class Track:
    """Pose of base_link over time, from the ground truth."""

    time: Array
    """(n,) [s] of ROS time since the demo's first command."""
    position: Array
    """(n, 3) [m]"""
    roll_pitch_yaw: Array
    """(n, 3) [rad]; positive pitch is nose down (REP-103), yaw is unwrapped."""

    def between(self, begin: float, end: float) -> Track:
        """The part from begin to end [s]."""
        rows = (self.time >= begin) & (self.time <= end)
        if not rows.any():
            raise RecordingError(f"the recording has no ground truth between {begin:.1f} s and {end:.1f} s")
        return Track(self.time[rows], self.position[rows], self.roll_pitch_yaw[rows])

    @property
    def tilt(self) -> Array:
        """(n,) [rad], angle between the body's z axis and the vertical."""
        roll, pitch = self.roll_pitch_yaw[:, 0], self.roll_pitch_yaw[:, 1]
        return np.arccos(np.cos(roll) * np.cos(pitch))


@dataclass(frozen=True, slots=True)
class Walk:
    """One straight walk; the line is the one on which the mouse stood when it began."""

    gait: str
    frequency_hz: float
    spine: bool
    duration_s: float
    distance_m: float
    speed_m_s: float
    lateral_drift_m: float
    heading_error_deg: float
    fell: bool
    stood_s: float
    """Longest time in which the mouse did not move, though it was told to walk."""


@dataclass(frozen=True, slots=True)
class Turn:
    """One turn; positive is to the left."""

    direction: str
    duration_s: float
    turned_deg: float
    radius_m: float
    fell: bool


@dataclass(frozen=True, slots=True)
class SpineTurn:
    """One turn to the left in which the spine helps."""

    strategy: str
    duration_s: float
    turned_deg: float
    radius_m: float
    spine_rad: float
    """Mean position of the servo spine_lateral in the second half, positive left."""
    fell: bool


@dataclass(frozen=True, slots=True)
class Balance:
    """One leg lifted by a mouse that stands, as in N table 6.5."""

    leg: str
    compensation: bool
    passed: bool
    """The lifted foot carried nothing and the mouse did not tip over."""
    foot_forces_n: tuple[float, ...]
    """While the leg was up: front left, front right, rear left, rear right."""
    loaded_share: float
    """Share of that time in which the lifted foot carried something."""
    pitch_deg: float
    """Change of pitch by lifting, positive nose down."""
    tilt_peak_deg: float


@dataclass(frozen=True, slots=True)
class GraphHealth:
    """How the graph kept up."""

    command_age_ms: dict[str, float]
    """p50, p99 and max, from the publishing of a tick to the arrival of the servo command that answers it, as the
    simulation measures it since its start: what happened while the other nodes came up is in it."""
    ticks_missed: int
    """Ticks since the first control command for which the simulation had no servo command."""
    real_time_factor: float
    """Simulated time over wall time since the first control command."""


def read_track(recording: Recording, plan: Plan) -> tuple[Track, int]:
    """The ground truth of a demo, and the ROS time [ns] at which its plan began.

    Raises:
        RecordingError: the recording lacks ground truth, or a command to walk.
    """
    odometry_topic, command_topic = recording.topic_ending("truth/odom"), recording.topic_ending("control_command")
    data = recording.read([odometry_topic, command_topic])
    start = plan_start(data[command_topic].stamp, data[command_topic]["posture"], plan)
    return _track(data[odometry_topic], start), start


def plan_start(stamp: NDArray[np.int64], posture: NDArray[np.int64], plan: Plan) -> int:
    """When the plan began [ns], from the times (n,) [ns] and postures (n,) of the commands that were recorded.

    The first walk tells it, not the first command: what is played in the first moment may be lost, as a player and a
    recorder that have just come up do not know each other yet.

    Raises:
        RecordingError: no command to walk is recorded.
    """
    walking = stamp[posture == Posture.WALK]
    if len(walking) == 0:
        raise RecordingError("no command to walk is recorded")
    return int(walking.min()) - round(next(scene.begin for scene in plan.scenes if scene.kind == "walk") * 1e9)


def _track(odometry: TopicData, start: int) -> Track:
    pose = "pose.pose"
    position = np.column_stack([odometry[f"{pose}.position.{axis}"] for axis in "xyz"])
    quaternion = np.column_stack([odometry[f"{pose}.orientation.{axis}"] for axis in "xyzw"])
    roll_pitch_yaw = Rotation.from_quat(quaternion).as_euler("ZYX")[:, ::-1].copy()
    roll_pitch_yaw[:, 2] = np.unwrap(roll_pitch_yaw[:, 2])
    return Track(np.asarray((odometry.stamp - start) * 1e-9, dtype=np.float64), position, roll_pitch_yaw)


def judge_walk(track: Track, scene: Scene, gait_frequency: float, spine: bool = False) -> Walk:
    """Distance along the line, drift beside it and heading error at the end, averaged over the last gait cycle."""
    before, during = track.between(scene.begin - _SETTLED_S, scene.begin), track.between(scene.begin, scene.end)
    last_cycle = track.between(scene.end - 1.0 / gait_frequency, scene.end)
    heading = float(before.roll_pitch_yaw[:, 2].mean())
    forward, left = np.array([math.cos(heading), math.sin(heading)]), np.array([-math.sin(heading), math.cos(heading)])
    origin = before.position[:, :2].mean(axis=0)
    distance = float((during.position[-1, :2] - origin) @ forward)
    return Walk(
        gait=scene.gait,
        frequency_hz=gait_frequency,
        spine=spine,
        duration_s=scene.duration,
        distance_m=distance,
        speed_m_s=distance / scene.duration,
        lateral_drift_m=float(((last_cycle.position[:, :2] - origin) @ left).mean()),
        heading_error_deg=math.degrees(float(last_cycle.roll_pitch_yaw[:, 2].mean()) - heading),
        fell=fell(before, during),
        stood_s=longest_stand(during),
    )


def longest_stand(track: Track) -> float:
    """Longest time [s] without a move, 0 where the mouse moves all the time."""
    ahead = np.minimum(np.searchsorted(track.time, track.time + STANDS_OVER), len(track.time) - 1)
    took = np.maximum(track.time[ahead] - track.time, 1e-9)
    stands = np.linalg.norm(track.position[ahead, :2] - track.position[:, :2], axis=1) < STANDS_BELOW * took
    stands &= took > 0.5 * STANDS_OVER
    edges = np.flatnonzero(np.diff(np.concatenate([[0], stands.astype(int), [0]])))
    runs = [float(track.time[ahead[last - 1]] - track.time[first]) for first, last in edges.reshape(-1, 2)]
    return max(runs, default=0.0)


def judge_turn(track: Track, scene: Scene) -> Turn:
    """By how much the mouse turned, and on which radius: the way of base_link over the angle."""
    before, during = track.between(scene.begin - _SETTLED_S, scene.begin), track.between(scene.begin, scene.end)
    turned = float(during.roll_pitch_yaw[-1, 2] - before.roll_pitch_yaw[:, 2].mean())
    # The body sways with each step; averaged over a cycle the way is that of the middle.
    window = max(1, len(during.time) // 10)
    smooth = np.column_stack(
        [np.convolve(during.position[:, axis], np.full(window, 1.0 / window), mode="valid") for axis in (0, 1)]
    )
    way = float(np.linalg.norm(np.diff(smooth, axis=0), axis=1).sum()) * len(during.time) / max(len(smooth), 1)
    return Turn(
        direction=scene.kind.removeprefix("turn_"),
        duration_s=scene.duration,
        turned_deg=math.degrees(turned),
        radius_m=way / abs(turned) if turned else math.inf,
        fell=fell(before, during),
    )


def judge_spine_turn(track: Track, scene: Scene, spine: tuple[Array, Array]) -> SpineTurn:
    """As `judge_turn`; `spine` is times (n,) [s] since the demo's start and positions (n,) [rad] of spine_lateral."""
    turn = judge_turn(track, scene)
    time, position = spine
    rows = (time >= 0.5 * (scene.begin + scene.end)) & (time <= scene.end)
    bend = float(position[rows].mean()) if rows.any() else 0.0
    return SpineTurn("mix", turn.duration_s, turn.turned_deg, turn.radius_m, bend, turn.fell)


def begun(scene: Scene, time: Array, posture: NDArray[np.int64], wanted: Posture) -> Scene:
    """The scene from the command for it on, not from when it was planned: on a busy machine the player is late.

    time: (n,) [s] since the demo's start, posture: (n,), of the commands that were recorded.

    Raises:
        RecordingError: there is no such command before the scene was to end.
    """
    said = time[(posture == wanted) & (time < scene.end)]
    if len(said) == 0:
        raise RecordingError(f"no command to {wanted.name.lower()} is recorded before {scene.end:.1f} s")
    return replace(scene, begin=max(scene.begin, float(said.min())))


def judge_balance(track: Track, scene: Scene, forces: tuple[Array, Array], leg: str) -> Balance:
    """From shortly after the lift on. `forces`: times (n,) [s] and vertical forces (n, 4) [N] on the feet."""
    up = scene.begin + SHIFT_DURATION + LIFT_DURATION + 0.1
    before, during = track.between(scene.begin - _SETTLED_S, scene.begin), track.between(up, scene.end)
    time, force = forces
    rows = (time >= up) & (time <= scene.end)
    if not rows.any():
        raise RecordingError(f"the recording has no foot forces between {up:.1f} s and {scene.end:.1f} s")
    share = float((force[rows, LEGS.index(leg)] > LOADED_N).mean())
    tilt = math.degrees(float(during.tilt.max()))
    return Balance(
        leg=leg,
        compensation=True,
        passed=share <= LARGEST_LOADED_SHARE and tilt < LARGEST_TILT_DEG,
        foot_forces_n=tuple(float(value) for value in force[rows].mean(axis=0)),
        loaded_share=share,
        pitch_deg=math.degrees(float(during.roll_pitch_yaw[:, 1].mean() - before.roll_pitch_yaw[:, 1].mean())),
        tilt_peak_deg=tilt,
    )


def read_spine(recording: Recording, start: int) -> tuple[Array, Array]:
    """Times [s] since the demo's start and measured positions [rad] of the servo spine_lateral."""
    topic = recording.topic_ending("servo_states")
    data = recording.read([topic])[topic]
    return np.asarray((data.stamp - start) * 1e-9, dtype=np.float64), data.by_name("position", ["spine_lateral"])[:, 0]


def read_postures(recording: Recording, start: int) -> tuple[Array, NDArray[np.int64]]:
    """Times (n,) [s] since the demo's start and postures (n,) of the commands."""
    topic = recording.topic_ending("control_command")
    data = recording.read([topic])[topic]
    return np.asarray((data.stamp - start) * 1e-9, dtype=np.float64), np.asarray(data["posture"], dtype=np.int64)


def read_foot_forces(recording: Recording, start: int) -> tuple[Array, Array]:
    """Times (n,) [s] since the demo's start and vertical forces (n, 4) [N] on the feet, from the ground truth."""
    topic = recording.topic_ending("truth/foot_forces")
    data = recording.read([topic])[topic]
    return np.asarray((data.stamp - start) * 1e-9, dtype=np.float64), np.asarray(data["force.z"], dtype=np.float64)


def sitting_pitch(track: Track, scene: Scene) -> float:
    """By how much sitting lifts the nose [rad]."""
    before, seated = track.between(scene.begin - _SETTLED_S, scene.begin), track.between(scene.end - 0.5, scene.end)
    return float(before.roll_pitch_yaw[:, 1].mean() - seated.roll_pitch_yaw[:, 1].mean())


def fell(standing: Track, during: Track) -> bool:
    """Whether the mouse tipped over or dropped on its belly."""
    height = float(standing.position[:, 2].mean())
    return bool((during.tilt > FALLEN_TILT_RAD).any() or (during.position[:, 2] < FALLEN_HEIGHT * height).any())


def read_health(recording: Recording) -> GraphHealth:
    """What the simulation reports of the commands that reached it.

    Raises:
        RecordingError: it reported nothing, or no command is recorded.
    """
    topic = recording.topic_ending("control_command")
    begin = recording.read([topic])[topic].log_time[0]
    reports = _simulation_reports(recording)
    if not reports:
        raise RecordingError("the simulation reported nothing on /diagnostics")
    missed_before = [int(report["ticks_missed"]) for arrived, report in reports if arrived < begin]
    factors = [float(report["real_time_factor"]) for arrived, report in reports if arrived >= begin]
    _, last = reports[-1]
    return GraphHealth(
        command_age_ms={name: float(last[f"command_age_{name}_ms"]) for name in ("p50", "p99", "max")},
        ticks_missed=int(last["ticks_missed"]) - (missed_before[-1] if missed_before else 0),
        real_time_factor=sum(factors) / len(factors) if factors else 0.0,  # reports come evenly in wall time
    )


def _simulation_reports(recording: Recording) -> list[tuple[int, dict[str, str]]]:
    """Arrival [ns] and values of each of the simulation's diagnostics."""
    reports = []
    for raw, message in recording.decoded([recording.topic_ending("diagnostics")]):
        for status in message.status:
            values = {pair.key: pair.value for pair in status.values}
            if "command_age_p99_ms" in values:
                reports.append((raw.log_time, values))
    return reports


def complaints(
    walks: Sequence[Walk],
    turns: Sequence[Turn],
    spine_turn: SpineTurn,
    balance: Balance,
    nose_lift: float,
    plan: Plan,
    no_slip_speed: dict[str, float],
) -> list[str]:
    """Why the demo did not pass, in words; empty when it did.

    Args:
        nose_lift: [rad] by sitting.
        no_slip_speed: [m/s] of each gait (N (5.22)).
    """
    found = []
    for walk in walks:
        name = f"{walk.gait.replace('_', ' ')}:"
        least = LEAST_SPEED * no_slip_speed[walk.gait]
        if walk.fell:
            found.append(f"{name} the mouse fell")
        if walk.speed_m_s < least:
            found.append(f"{name} {walk.speed_m_s:.3f} m/s, at least {least:.3f} wanted")
        if abs(walk.lateral_drift_m) > LARGEST_DRIFT * abs(walk.distance_m):
            found.append(f"{name} {walk.lateral_drift_m:+.3f} m beside its line, at most {LARGEST_DRIFT:.0%} wanted")
        if abs(walk.heading_error_deg) > LARGEST_HEADING_ERROR_DEG:
            found.append(f"{name} heading off by {walk.heading_error_deg:+.0f} deg")
    for turn in turns:
        toward = turn.turned_deg if turn.direction == "left" else -turn.turned_deg
        if turn.fell:
            found.append(f"turn {turn.direction}: the mouse fell")
        if toward < LEAST_TURN_DEG:
            found.append(f"turn {turn.direction}: {toward:.0f} deg, at least {LEAST_TURN_DEG:.0f} wanted")
    if spine_turn.fell:
        found.append("turn with the spine: the mouse fell")
    if spine_turn.turned_deg < LEAST_TURN_DEG or spine_turn.spine_rad < LEAST_BEND_RAD:
        found.append(
            f"turn with the spine: {spine_turn.turned_deg:.0f} deg, spine servo at {spine_turn.spine_rad:.2f} rad, "
            f"at least {LEAST_TURN_DEG:.0f} deg and {LEAST_BEND_RAD} rad wanted"
        )
    if not balance.passed:
        found.append(
            f"balance, {balance.leg.replace('_', ' ')} lifted: its foot carried something for "
            f"{balance.loaded_share:.0%} of the time, the mouse tilted by {balance.tilt_peak_deg:.0f} deg"
        )
    if math.degrees(nose_lift) < LEAST_SITTING_PITCH_DEG:
        found.append(f"sit: the nose rose by {math.degrees(nose_lift):.1f} deg, {LEAST_SITTING_PITCH_DEG:.0f} wanted")
    if {walk.gait for walk in walks} != {scene.gait for scene in plan.scenes if scene.kind == "walk"}:
        found.append("not every gait was walked")
    return found
