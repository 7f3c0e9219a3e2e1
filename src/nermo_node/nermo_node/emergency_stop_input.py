"""The topic `emergency_stop` and the service `release` of whatever gives the servos their power."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from nermo_description.emergency_stops import EmergencyStops
from nermo_node import qos
from nermo_node.command_input import UNNAMED, WithInfo, sender_of

TOPIC = "emergency_stop"
_UNKNOWN = "_NODE_NAME_UNKNOWN_"
SIGNAL_PERIOD_S = 0.02
"""Between two looks whether a signal has come."""


class EmergencyStopInput:
    """Tells `stops` what each publisher says, and releases when somebody asks, at `release` and at `~/release`.

    The signal SIGUSR1 to the process is a stop too, for a script or a key of the window manager.

    A publisher is a source of its own until it is gone, whatever its node is called. A ROS that does not hand over who
    published a message (Jazzy) knows one source for all.

    Args:
        node: Whose topic and services these are.
        stops: What the publishers say goes here.
        changed: Called after each message.
        release: Releases; what is left, in words, empty where nothing is.
        group: Callback group of the services, for a release that takes its time.
    """

    def __init__(
        self,
        node: Node,
        stops: EmergencyStops,
        changed: Callable[[], None],
        release: Callable[[], str],
        group: CallbackGroup | None = None,
    ) -> None:
        self._node, self._stops, self._changed, self._release = node, stops, changed, release
        self._signalled = False
        node.create_subscription(Bool, TOPIC, WithInfo(self._receive), qos.STATE)
        for name in ("release", "~/release"):
            node.create_service(Trigger, name, self._on_release, callback_group=group)
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGUSR1, self._on_signal)
            node.create_timer(SIGNAL_PERIOD_S, self._look, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def forget_the_gone(self) -> None:
        """Publishers that are not there any more say nothing; of the others the name may be known by now."""
        publishers = self._publishers()
        self._stops.keep(list(publishers))
        self._stops.rename(publishers)

    def _receive(self, message: Bool, info: dict[str, Any]) -> None:
        sender = sender_of(info)
        if not message.data and not self._stops.says(sender):
            return  # nothing new: a flood of it costs no look at who is there
        self._stops.say(sender, bool(message.data), self._publishers().get(sender, f"a publisher of {TOPIC}"))
        self._changed()

    def _on_signal(self, *_: object) -> None:
        self._stops.press("SIGUSR1")
        self._signalled = True

    def _look(self) -> None:
        """Handlers of signals run between any two instructions: what follows from one is done here."""
        if self._signalled:
            self._signalled = False
            self._changed()

    def _publishers(self) -> dict[bytes, str]:
        found = {
            bytes(each.endpoint_gid): _name(each.node_namespace, each.node_name)
            for each in self._node.get_publishers_info_by_topic(TOPIC)
        }
        return {**found, UNNAMED: f"topic {TOPIC}"} if found else {}

    def _on_release(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self.forget_the_gone()
        response.message = self._release()
        response.success = not response.message
        return response


def _name(namespace: str, node: str) -> str:
    """Full name of a node; ROS may hear of a publisher before it hears whose it is."""
    return f"a publisher of {TOPIC}" if node == _UNKNOWN else f"{namespace.rstrip('/')}/{node}"
