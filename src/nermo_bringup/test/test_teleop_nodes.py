"""Pad, keyboard and teleop as processes in a real graph."""

from __future__ import annotations

import contextlib
import os
import pty
import signal
import termios
from pathlib import Path

import pytest
from builtin_interfaces.msg import Time
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.task import Future
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Joy
from std_msgs.msg import Bool
from std_srvs.srv import Trigger
from terminal import PATIENCE_S

from nermo_control.driver import Driver, Limits
from nermo_control.nodes.operator import Operator
from nermo_control.types import Posture
from nermo_interfaces.msg import ControlCommand
from nermo_node import qos

PADS = Path(__file__).parents[1] / "config" / "pads"

VIRTUAL_PAD = """
import os, sys
os.environ["SDL_VIDEODRIVER"] = "dummy"
import sdl2
from nermo_bringup.nodes import joystick
# The pad is there before the node opens it, as on a robot that boots with its pad plugged in.
sdl2.SDL_Init(sdl2.SDL_INIT_GAMECONTROLLER)
index = sdl2.SDL_JoystickAttachVirtual(sdl2.SDL_JOYSTICK_TYPE_GAMECONTROLLER, 6, 15, 0)
pad = sdl2.SDL_JoystickOpen(index)
sdl2.SDL_JoystickSetVirtualAxis(pad, 1, -32768)
sdl2.SDL_JoystickSetVirtualButton(pad, 9, 1)
sys.exit(joystick.main())
"""


class Listener:
    """Collects what teleop sends."""

    def __init__(self, graph) -> None:
        self.commands: list[ControlCommand] = []
        self.stops: list[bool] = []
        graph.node.create_subscription(ControlCommand, "control_command", self.commands.append, 10)
        graph.node.create_subscription(
            Bool, "emergency_stop", lambda message: self.stops.append(message.data), qos.LATCHED
        )


@pytest.fixture
def heard(graph) -> Listener:
    return Listener(graph)


def joy(*buttons: int, forward: float = 0.0) -> Joy:
    message = Joy(axes=[0.0, forward, 0.0, 0.0, 0.0, 0.0], buttons=[0] * 15)
    for button in buttons:
        message.buttons[button] = 1
    return message


LEFT_BUMPER, B = 9, 1


def test_a_pad_drives_through_the_joy_topic(graph, heard) -> None:
    graph.start("nermo_bringup.nodes.teleop", *graph.parameters(pad=str(PADS / "xbox.yaml"), max_forward_velocity=0.1))
    graph.run(VIRTUAL_PAD)
    # A pad that a busy machine lets be silent for a moment stops the mouse in between.
    graph.until(
        lambda: bool(heard.commands) and heard.commands[-1].forward_velocity == pytest.approx(0.05, abs=1e-3),
        "the stick walks the mouse",
    )
    assert heard.commands[-1].header.frame_id == "base_link"
    graph.until(lambda: heard.commands[-1].header.stamp.sec > 0, "it knows that the graph has no /clock")


def test_commands_bear_the_time_of_the_clock_that_somebody_publishes(graph, heard) -> None:
    clock = graph.node.create_publisher(Clock, "/clock", 10)
    publisher = graph.node.create_publisher(Joy, "joy", 10)
    graph.start("nermo_bringup.nodes.teleop", *graph.parameters(pad=str(PADS / "xbox.yaml")))
    graph.until(lambda: publisher.get_subscription_count() > 0, "teleop listens")

    def driven_at(second: int) -> bool:
        clock.publish(Clock(clock=Time(sec=second)))
        publisher.publish(joy(LEFT_BUMPER, forward=1.0))
        return bool(heard.commands) and heard.commands[-1].header.stamp.sec == second

    graph.until(lambda: driven_at(7), "the stamp is the simulation's")
    assert {command.header.stamp.sec for command in heard.commands} <= {0, 7}
    graph.node.destroy_publisher(clock)
    graph.until(
        lambda: publisher.publish(joy(LEFT_BUMPER)) or heard.commands[-1].header.stamp.sec > 7, "the clock has gone"
    )


def test_a_lost_pad_stops_the_mouse_and_a_button_stops_it_for_good(graph, heard) -> None:
    graph.start("nermo_bringup.nodes.teleop", *graph.parameters(pad=str(PADS / "xbox.yaml")))
    publisher = graph.node.create_publisher(Joy, "joy", 10)
    graph.until(lambda: publisher.get_subscription_count() > 0, "teleop listens")

    def walking() -> bool:
        publisher.publish(joy(LEFT_BUMPER, forward=1.0))
        return bool(heard.commands) and heard.commands[-1].forward_velocity > 0.0

    graph.until(walking, "the mouse is told to walk")
    graph.until(lambda: heard.commands[-1].forward_velocity == 0.0, "the lost pad stops the mouse")
    publisher.publish(joy(B))
    graph.until(lambda: heard.stops == [True], "the emergency stop is sent")
    graph.until(lambda: heard.commands[-1].posture == ControlCommand.POSTURE_STOP, "the posture is STOP")


def test_an_unknown_pad_ends_teleop_with_one_sentence(graph) -> None:
    teleop = graph.start("nermo_bringup.nodes.teleop", *graph.parameters(pad="/nowhere/pad.yaml"))
    output, _ = teleop.communicate(timeout=PATIENCE_S)
    assert teleop.returncode == 2
    assert "/nowhere/pad.yaml: cannot be read" in output
    assert "Traceback" not in output


@pytest.mark.parametrize("ending", ["escape", "terminate"])
def test_the_keyboard_drives_and_gives_the_terminal_back(graph, heard, ending: str) -> None:
    controller, terminal = pty.openpty()
    before = termios.tcgetattr(terminal)
    teleop = graph.start("nermo_bringup.nodes.keyboard_teleop", terminal=terminal)
    shown: list[bytes] = []

    def screen() -> bytes:
        os.set_blocking(controller, False)
        with contextlib.suppress(BlockingIOError):
            shown.append(os.read(controller, 65536))
        return b"".join(shown)

    graph.until(lambda: b"EMERGENCY STOP, limp; 1 takes it back" in screen(), "the help is shown")

    def held() -> bool:
        # Pressed until it is heard: what is said before the two have discovered each other is lost.
        os.write(controller, b"w")
        return bool(screen()) and bool(heard.commands) and heard.commands[-1].forward_velocity > 0.0

    graph.until(held, "the key is a command")
    graph.until(lambda: bool(screen()) and heard.commands[-1].forward_velocity == 0.0, "the released key stops")
    if ending == "escape":
        os.write(controller, b"\x1b")
    else:
        teleop.send_signal(signal.SIGTERM)
    while teleop.poll() is None:
        screen()
    assert teleop.returncode == 0
    assert termios.tcgetattr(terminal) == before
    os.close(controller)
    os.close(terminal)


def test_a_keyboard_teleop_without_a_terminal_says_so(graph) -> None:
    teleop = graph.start("nermo_bringup.nodes.keyboard_teleop")
    output, _ = teleop.communicate(timeout=PATIENCE_S)
    assert teleop.returncode == 1
    assert "needs a terminal" in output
    assert "Traceback" not in output


def test_a_release_whose_answer_is_lost_is_asked_for_again(graph) -> None:
    asked: list[Trigger.Request] = []
    refused: list[str] = []

    async def answer(request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        asked.append(request)
        if len(asked) == 1:
            await Future()
        response.success = True
        return response

    graph.node.create_service(Trigger, "release", answer, callback_group=ReentrantCallbackGroup())
    driver = Driver(Limits())
    operator = Operator(graph.node, driver, refused.append)
    driver.emergency_stop()
    operator.send(None)
    driver.take(Posture.STAND)

    def asked_twice() -> bool:
        operator.send(None)
        return len(asked) == 2

    graph.until(asked_twice, "the release is asked for again")
    assert refused == []
