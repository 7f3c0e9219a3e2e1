"""Pictures and a video of a recording: where the mouse went, how it stepped, how it swayed, what it looked like."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from nermo_bringup.demo.evaluation import Track, read_foot_forces
from nermo_bringup.demo.plan import LIFTED, Plan, Scene
from nermo_description.parameters import LEGS, RobotParameters
from nermo_node.recording_reader import Recording

FRAME_RATE = 12.5
GAIT_WINDOW_S = 3.0
"""Shown of each walk in the gait diagram: its last seconds."""


def draw_track(track: Track, plan: Plan, path: Path) -> None:
    """Where base_link went, seen from above; each walk and turn in a colour of its own."""
    figure = Figure(figsize=(8.0, 6.0), layout="constrained")
    axes = figure.subplots()
    axes.plot(track.position[:, 0], track.position[:, 1], color="0.8", linewidth=1.0)
    for scene in _moving(plan):
        part = track.between(scene.begin, scene.end)
        axes.plot(part.position[:, 0], part.position[:, 1], label=_name(scene))
    axes.set(xlabel="x [m]", ylabel="y [m]", title="Track of base_link")
    axes.set_aspect("equal", adjustable="datalim")
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig(path, dpi=120)


def draw_orientation(track: Track, plan: Plan, path: Path) -> None:
    """Roll, pitch and yaw over the whole demo."""
    figure = Figure(figsize=(10.0, 6.0), layout="constrained")
    rows = figure.subplots(3, 1, sharex=True)
    for axes, name, angle in zip(rows, ("roll", "pitch", "yaw"), np.degrees(track.roll_pitch_yaw).T, strict=True):
        axes.plot(track.time, angle, linewidth=0.8)
        axes.set(ylabel=f"{name} [deg]")
        axes.grid(alpha=0.3)
        for scene in _moving(plan):
            axes.axvspan(scene.begin, scene.end, color="C1", alpha=0.1)
    rows[0].set_title("Orientation of base_link; shaded: walking and turning")
    rows[-1].set_xlabel("time [s]")
    figure.savefig(path, dpi=120)


def draw_balance(forces: tuple[Any, Any], plan: Plan, path: Path) -> None:
    """The load on each foot while a leg is lifted; times [s] since the demo's start, vertical forces (n, 4) [N]."""
    (scene,) = (scene for scene in plan.scenes if scene.kind == "balance")
    time, force = forces
    rows = (time >= scene.begin - 1.0) & (time <= scene.end + 1.0)
    figure = Figure(figsize=(8.0, 4.0), layout="constrained")
    axes = figure.subplots()
    for leg, name in enumerate(LEGS):
        label = f"{name.replace('_', ' ')}{' (lifted)' if name == LIFTED else ''}"
        axes.plot(time[rows], force[rows, leg], label=label, linewidth=2.0 if name == LIFTED else 1.0)
    axes.axvspan(scene.begin, scene.end, color="C1", alpha=0.1)
    axes.set(xlabel="time [s]", ylabel="force [N]", title="Balance test: the spine bends, then a leg is lifted")
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig(path, dpi=120)


def draw_gaits(recording: Recording, start: int, plan: Plan, path: Path) -> None:
    """Which foot carries how much and when, for the end of each walk; `start` [ns] is when the plan began."""
    from nermo_sim.plots import GAIT_KEY, draw_gait

    topic = recording.topic_ending("leg_states")
    legs = recording.read([topic])[topic]
    time, load = read_foot_forces(recording, start)
    newest = np.searchsorted(legs.stamp, np.round(time * 1e9) + start, side="right") - 1
    planned = (legs["phases"] == 0)[np.maximum(newest, 0)]
    walks = [scene for scene in plan.scenes if scene.kind == "walk"]
    figure = Figure(figsize=(9.0, 2.2 * len(walks)), layout="constrained")
    for axes, scene in zip(np.atleast_1d(figure.subplots(len(walks), 1)), walks, strict=True):
        begin = max(scene.begin, scene.end - GAIT_WINDOW_S)
        rows = (time >= begin) & (time <= scene.end)
        draw_gait(axes, time[rows], planned[rows], load[rows])
        axes.set(title=_name(scene), xlim=(begin, scene.end))
    figure.suptitle(f"Gaits: {GAIT_KEY}")
    figure.savefig(path, dpi=120)


def render_video(
    recording: Recording, robot: RobotParameters, path: Path, progress: Callable[[float, float], None]
) -> None:
    """The mouse as it was recorded: base_link from the ground truth, joints from their states.

    Raises:
        nermo_sim.render.RenderingUnavailableError: there is no OpenGL.
    """
    import imageio.v2 as imageio
    import mujoco

    from nermo_description.model import build_model
    from nermo_sim.render import Renderer

    model = build_model(robot)
    # Without a graphics card, smooth edges take twice as long as all the rest.
    model.vis.quality.offsamples = 0
    data = mujoco.MjData(model)
    times, states = _states(recording, model)
    frames = np.arange(times[0], times[-1], 1e9 / FRAME_RATE)
    rows = np.minimum(np.searchsorted(times, frames), len(times) - 1)
    with (
        Renderer(model, 640, 480) as renderer,
        imageio.get_writer(path, fps=FRAME_RATE, codec="libx264", macro_block_size=8) as video,
    ):
        for number, row in enumerate(rows):
            data.qpos[:] = states[row]
            mujoco.mj_forward(model, data)
            video.append_data(renderer.picture(data, "side"))  # type: ignore[attr-defined]
            progress(number + 1, len(rows))


def _states(recording: Recording, model: Any) -> tuple[Any, Any]:
    """Times [ns], and the model's generalized positions at each of them."""
    import mujoco

    joints_topic, odometry_topic = recording.topic_ending("joint_states"), recording.topic_ending("truth/odom")
    data = recording.read([joints_topic, odometry_topic])
    joints, odometry = data[joints_topic], data[odometry_topic]
    base = model.site("base_link").id
    # base_link is fixed in the torso, which is what the model's free joint moves.
    torso_in_base_position, torso_in_base_turn = np.zeros(3), np.zeros(4)
    mujoco.mju_negPose(torso_in_base_position, torso_in_base_turn, model.site_pos[base], model.site_quat[base])
    root = model.joint("root").qposadr[0]
    names = [model.joint(number).name for number in range(model.njnt) if model.joint(number).name != "root"]
    states = np.tile(model.qpos0, (len(joints), 1))
    states[:, [model.joint(name).qposadr[0] for name in names]] = joints.by_name("position", names)
    nearest = np.minimum(np.searchsorted(odometry.stamp, joints.stamp), len(odometry) - 1)
    position = np.column_stack([odometry[f"pose.pose.position.{axis}"] for axis in "xyz"])[nearest]
    turn = np.column_stack([odometry[f"pose.pose.orientation.{axis}"] for axis in "wxyz"])[nearest]
    for row in range(len(joints)):
        mujoco.mju_mulPose(
            states[row, root : root + 3],
            states[row, root + 3 : root + 7],
            position[row],
            turn[row],
            torso_in_base_position,
            torso_in_base_turn,
        )
    return joints.stamp, states


def _moving(plan: Plan) -> Sequence[Scene]:
    return [scene for scene in plan.scenes if scene.kind in ("walk", "turn_left", "turn_right", "turn_spine")]


def _name(scene: Scene) -> str:
    return (scene.gait if scene.kind == "walk" else scene.kind).replace("_", " ")
