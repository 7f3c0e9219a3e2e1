"""The command player as a process in a real graph."""

from __future__ import annotations

from pathlib import Path

import pytest
from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock
from terminal import PATIENCE_S

from nermo_interfaces.msg import ControlCommand, ServoCommand

PLAYER = "nermo_bringup.nodes.command_player"
WALK = (
    "{duration: 0.3, commands: [{at: 0, posture: stand}, {at: 0.1, posture: walk, forward_velocity: 0.05, gait: trot}]}"
)


@pytest.fixture
def file(tmp_path: Path) -> str:
    path = tmp_path / "walk.yaml"
    path.write_text(WALK)
    return str(path)


def test_a_file_is_played_at_its_pace_and_ends_with_a_stop(graph, tmp_path: Path) -> None:
    # Each part is long enough that a bench which hears the player late, for it is just discovered, hears each.
    path = tmp_path / "walk.yaml"
    path.write_text(
        "{duration: 2, commands: [{at: 0, posture: stand}, {at: 1, posture: walk, forward_velocity: 0.05, gait: trot}]}"
    )
    heard: list[ControlCommand] = []
    graph.node.create_subscription(ControlCommand, "control_command", heard.append, 50)
    player = graph.start(PLAYER, *graph.parameters(file=str(path)))
    graph.until(lambda: len(heard) > 1 and heard[-1].forward_velocity == 0.0 and heard[-1].posture == 0, "the end")
    assert player.wait(timeout=PATIENCE_S) == 0
    assert heard[0].posture == ControlCommand.POSTURE_STAND
    stamps = [message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec for message in heard]
    assert stamps == sorted(stamps)
    walking = [message for message in heard if message.forward_velocity == 0.05]
    assert walking
    assert {message.gait for message in walking} == {"trot"}


class LongWalk:
    """A minute of walking that is played, what is heard of it, and a simulation's clock that a test moves."""

    def __init__(self, graph, folder: Path) -> None:
        path = folder / "walk.yaml"
        path.write_text("{duration: 60, commands: [{at: 0, posture: walk, forward_velocity: 0.05}]}")
        self._graph, self._now = graph, 0
        self.heard: list[int] = []
        """Seconds of the commands' stamps."""
        graph.node.create_subscription(
            ControlCommand, "control_command", lambda message: self.heard.append(message.header.stamp.sec), 50
        )
        self.player = graph.start(PLAYER, *graph.parameters(file=str(path)))

    def by_simulation(self) -> Publisher:
        """Lets a simulation's clock go until the walk is played by that."""
        clock = self._graph.node.create_publisher(Clock, "/clock", 10)

        def advance() -> bool:
            self._now += 20_000_000
            message = Clock()
            message.clock.sec, message.clock.nanosec = divmod(self._now, 1_000_000_000)
            clock.publish(message)
            return sum(stamp < 1_000_000_000 for stamp in self.heard) > 5

        self._graph.until(advance, "it is played by the simulation's clock")
        return clock


def test_what_began_by_the_wall_clock_is_played_whole_by_a_clock_that_is_found_later(graph, tmp_path: Path) -> None:
    walk = LongWalk(graph, tmp_path)
    graph.until(lambda: len(walk.heard) > 2, "it plays by the machine's clock")
    assert min(walk.heard) > 1_000_000_000
    walk.by_simulation()


def test_a_twin_that_ends_ends_the_player_with_an_error(graph, tmp_path: Path) -> None:
    walk = LongWalk(graph, tmp_path)
    graph.node.destroy_publisher(walk.by_simulation())
    output, _ = walk.player.communicate(timeout=PATIENCE_S)
    assert walk.player.returncode == 1
    assert "has the twin ended?" in output and "of 60 s were played" in output
    assert "Traceback" not in output


def test_in_lockstep_each_tick_gets_its_own_command(graph, file: str) -> None:
    heard: list[ControlCommand] = []
    graph.node.create_subscription(ControlCommand, "control_command", heard.append, 50)
    clock = graph.node.create_publisher(Clock, "/clock", 10)
    graph.start(PLAYER, *graph.parameters(file=file, lockstep=True))
    graph.until(lambda: clock.get_subscription_count() > 0, "the player hears the clock")
    graph.until(lambda: graph.node.count_publishers("control_command") > 0, "the player is heard")
    tick = 0

    def stamp(message: ControlCommand) -> int:
        return round((message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec) * 1000)

    def advance() -> bool:
        # As a stepped simulation does: the next tick comes when this one was answered, and not before.
        nonlocal tick
        if not heard or stamp(heard[-1]) == tick:
            tick += 5 if heard else 0
            message = Clock()
            message.clock.nanosec = tick * 1_000_000
            clock.publish(message)
        return tick > 250

    graph.until(advance, "a quarter of a second of simulation has passed")
    first = stamp(heard[0])
    by_tick = {stamp(message) - first: message.forward_velocity for message in heard}
    assert by_tick == {tick: (0.05 if tick >= 100 else 0.0) for tick in range(0, max(by_tick) + 1, 5)}


def test_a_wrong_file_ends_the_player_with_one_sentence(graph, tmp_path: Path) -> None:
    path = tmp_path / "walk.yaml"
    path.write_text("commands: [{at: 0, gait_frequency: 50}]")
    player = graph.start(PLAYER, *graph.parameters(file=str(path)))
    output, _ = player.communicate(timeout=PATIENCE_S)
    assert player.returncode == 2
    assert f"{path}: commands.0.gait_frequency: is 50" in output
    assert "Traceback" not in output


def test_servo_positions_go_to_who_owns_the_servos_and_at_the_end_the_mouse_is_to_stand(graph, tmp_path: Path) -> None:
    path = tmp_path / "squat.yaml"
    path.write_text(
        "{duration: 3, commands: [{at: 0, posture: sit}, {at: 1, servos: {tail: 0.1, head_pan: 0.3}}, "
        "{at: 2, servos: {tail: 0.2}}]}"
    )
    targets: list[ServoCommand] = []
    said: list[ControlCommand] = []
    graph.node.create_subscription(ServoCommand, "servo_targets", targets.append, 500)
    graph.node.create_subscription(ControlCommand, "control_command", said.append, 500)
    player = graph.start(PLAYER, *graph.parameters(file=str(path)))
    # What it says last is heard after it has said it, and maybe after it has ended.
    graph.until(
        lambda: bool(said) and said[-1].posture == ControlCommand.POSTURE_STAND and 0.2 in targets[-1].position,
        "the end is heard",
    )
    output, _ = player.communicate(timeout=PATIENCE_S)
    assert player.returncode == 0, output
    postures = [command.posture for command in said]
    assert [a for a, b in zip(postures, [None, *postures], strict=False) if a != b] == [
        ControlCommand.POSTURE_SIT,
        ControlCommand.POSTURE_DIRECT,
        ControlCommand.POSTURE_STAND,
    ]
    assert dict(zip(targets[0].name, targets[0].position, strict=True)) == {"tail": 0.1, "head_pan": 0.3}
    assert dict(zip(targets[-1].name, targets[-1].position, strict=True)) == {"tail": 0.2, "head_pan": 0.3}
    assert graph.node.count_publishers("servo_command") == 0
