"""Node `web`: the page in the browser. Topics in; `control_command` and `emergency_stop` out, when somebody drives."""

from __future__ import annotations

import secrets
import sys
import time
from typing import Any

from pydantic import ConfigDict, Field
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from std_srvs.srv import SetBool

from nermo_control.driver import FREQUENCY_RANGE_HZ, SPEED_STEPS, Driver, Limits
from nermo_control.nodes.operator import Operator
from nermo_control.spine.functions import SPINE_FUNCTIONS
from nermo_description.robots import load_any_robot
from nermo_node.complaints import Complaints
from nermo_node.diagnostics import OK, Diagnostics, Status
from nermo_node.parameters import blame, declare
from nermo_node.run import run
from nermo_web import door
from nermo_web.nodes.cameras import Cameras
from nermo_web.nodes.live_parameters import LiveParameters
from nermo_web.nodes.shown_topics import ShownTopics, as_text
from nermo_web.page_server import LOOPBACK, Event, PageServer
from nermo_web.who_drives import WhoDrives

LISTEN_PERIOD_S = 0.02
"""Between two looks at what browsers did: what a command may be late by."""
COMMAND_PERIOD_S = 0.05
FRAME_PERIOD_S = 0.04
TELL_PERIOD_S = 0.1
STOP_PERIOD_S = 0.5
"""Between two repeats of what this source says of the emergency stop."""


class WebParameters(Limits):
    """Parameters of the page."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    robot: str = Field("nermo_lite", description="name of a robot, or path of its parameter file")
    scene: str = Field("flat", description="scene that it is in, as the twin's: a name, or an MJCF file")
    host: str = Field("127.0.0.1", description="where to listen; 0.0.0.0: for everybody who has the token")
    port: int = Field(8080, ge=0, le=65535, description="where to listen; 0: any that is free")
    recording: str = Field("", description="recording that is shown; then nothing drives here")


class Web(Node):
    """One page for all who look, and one source of commands for the graph."""

    def __init__(self) -> None:
        super().__init__("web")
        parameters = declare(self, WebParameters)
        with blame("robot"):
            robot = load_any_robot(parameters.robot)
        self._refused = Complaints(self, "refused")
        self._recording = parameters.recording
        self._driver = Driver(parameters)
        self._who_drives = WhoDrives(self._driver)
        self._operator = Operator(self, self._driver, self._refused.add_one)
        self._live = LiveParameters(self, self._on_parameters)
        self._cameras = Cameras(self, self._refused.add_one)
        self._recorder = self.create_client(SetBool, "recorder/record")
        with blame("scene"):
            self._shown = ShownTopics(self, robot, parameters.scene, self._refused.add_one)
        token = "" if parameters.host in LOOPBACK else secrets.token_urlsafe(16)
        with blame("host or port"):
            self._page = PageServer(parameters.host, parameters.port, token, self._shown.scene.port)
        self._commanded_at = self._said_stop_at = 0.0
        self._news = True
        Diagnostics(self, robot.name, {"page": self._status, "messages": self._refused.status})
        for address in self._page.addresses:
            self.get_logger().info(f"the mouse in the browser: {address}")
        # Hands and eyes work in real time, whatever the simulation's clock does.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(LISTEN_PERIOD_S, self._listen, clock=steady)
        self.create_timer(FRAME_PERIOD_S, self._shown.draw, clock=steady)
        self.create_timer(TELL_PERIOD_S, self._tell, clock=steady)

    def destroy_node(self) -> None:
        """Let all browsers go."""
        if hasattr(self, "_page"):
            self._page.close()
            self._shown.scene.close()
        super().destroy_node()

    # What browsers do

    def _listen(self) -> None:
        while not self._page.events.empty():
            self._on_event(self._page.events.get())
        if self._recording:
            return
        now = time.monotonic()
        if self._operator.stop_is_news or self._who_drives.ends or now - self._commanded_at >= COMMAND_PERIOD_S:
            self._commanded_at = now
            self._operator.send(self._who_drives.command(now, self._operator.stamp()))
        if now - self._said_stop_at >= STOP_PERIOD_S:
            self._said_stop_at = now
            self._operator.repeat_stop()

    def _on_event(self, event: Event) -> None:
        viewer, at = event.viewer, event.at
        if event.text is not None:
            try:
                self._say(viewer, self._obey(viewer, at, door.read(event.text)))
            except ValueError as error:
                self._refused.add_one(f"viewer {viewer}: {error}")
                self._say(viewer, str(error))
        elif event.here:
            self._who_drives.join(viewer)
            self._page.say(as_text("hello", you=viewer, **self._choices()), viewer)
            self._page.say(as_text("parameters", nodes=self._live.table()), viewer)
        else:
            self._who_drives.leave(viewer, at)

    def _obey(self, viewer: int, at: float, message: door.Message) -> str:
        """Does what a viewer wants; why not, in words."""
        who_drives = self._who_drives
        if self._recording and not isinstance(message, door.Beat):
            return "this is a recording: nothing drives here"
        match message:
            case door.Stick():
                return who_drives.stick(viewer, message, at)
            case door.Beat():
                who_drives.beat(viewer, message.sent * 1e-3, at)
            case door.Stop():
                who_drives.stop(at)
                self.get_logger().warning(f"viewer {viewer}: EMERGENCY STOP")
            case door.Release():
                who_drives.release(at)
                self.get_logger().info(f"viewer {viewer}: emergency stop released")
            case door.Take():
                return who_drives.take(viewer, message, at)
            case door.Settings():
                return who_drives.change(viewer, message, at)
            case door.Record():
                if refusal := who_drives.refusal(viewer, at):
                    return refusal
                return self._record(message.on, self._answer_to(viewer))
            case door.SetParameter():
                if refusal := who_drives.refusal(viewer, at):
                    return refusal
                self._live.set(message.node, message.name, message.value, self._answer_to(viewer))
        return ""

    def _record(self, on: bool, answer: Any) -> str:
        """Asks the recorder to begin or to end; why nobody can, in words."""
        if not self._recorder.service_is_ready():
            return "nothing records in this graph"

        def done(future: Any) -> None:
            if (said := future.result()) is not None:
                answer(said.success, said.message)

        self._recorder.call_async(SetBool.Request(data=on)).add_done_callback(done)
        return ""

    def _answer_to(self, viewer: int) -> Any:
        def answer(taken: bool, words: str) -> None:
            self._say(viewer, words, good=taken)
            self._news = True  # also where it was refused: the slider goes back

        return answer

    # What browsers are told

    def _say(self, viewer: int, words: str, good: bool = False) -> None:
        if words:
            self._page.say(as_text("said", text=words, good=good), viewer)

    def _on_parameters(self) -> None:
        self._news = True

    def _choices(self) -> dict[str, Any]:
        return {
            "recording": self._recording,
            "spine": list(SPINE_FUNCTIONS),
            "frequency_hz": list(FREQUENCY_RANGE_HZ),
            "speed_steps": SPEED_STEPS,
            "max_forward_m_s": self._driver.limits.max_forward_velocity,
            "max_turn_rad_s": self._driver.limits.max_turn_rate,
        }

    def _tell(self) -> None:
        told = self._shown.told()
        pictures = self._cameras.pictures(watched=self._who_drives.viewers > 0)
        self._page.pictures = list(pictures.values())
        if self._who_drives.viewers == 0:
            return
        driver = self._driver
        settings = {
            "gaits": list(driver.gaits),
            "gait": driver.gait or driver.default_gait,
            "frequency_hz": driver.gait_frequency or driver.default_frequency,
            "speed": driver.speed,
            "spine": {name: getattr(driver.spine_modes, name) for name in SPINE_FUNCTIONS},
            "straight_line": driver.straight_line,
        }
        self._page.say(
            as_text(
                "state",
                **told,
                stopped=driver.stopped,
                drives=self._who_drives.holder(time.monotonic()),
                posture=driver.posture.name.lower(),
                viewers=self._who_drives.viewers,
                cameras=list(pictures),
                settings=settings,
            )
        )
        if self._news:
            self._news = False
            self._page.say(as_text("parameters", nodes=self._live.table()))

    def _status(self) -> Status:
        drives, viewers = self._who_drives.holder(time.monotonic()), self._who_drives.viewers
        sentence = f"{viewers} look, {f'viewer {drives} drives' if drives else 'nobody drives'}"
        return OK, sentence, {"viewers": viewers, "drives": drives or ""}


def main() -> int:
    """Runs the page."""
    return run(Web)


if __name__ == "__main__":
    sys.exit(main())
