"""The clock of the graph, for a node that somebody starts by hand and does not tell which one it is."""

from __future__ import annotations

import time

from rclpy.node import Node
from rclpy.parameter import Parameter

USE_SIM_TIME = "use_sim_time"
DISCOVERY_S = 5.0
"""So long after its start a node may not have heard of a /clock that is there; up to 2.9 s were seen beside a graph."""


class GraphClock:
    """Gives stamps of the clock that the others go by: `/clock` where somebody publishes it, else the machine's.

    A node that was started with `use_sim_time`, true or false, keeps to that.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._told = USE_SIM_TIME in node._parameter_overrides
        self._started = time.monotonic()

    def stamp(self) -> int:
        """Now [ns]; 0 while it is not known, which receivers take for the time at which they hear it."""
        if not self._told:
            simulated = self._node.count_publishers("/clock") > 0
            if simulated != self._node.get_parameter(USE_SIM_TIME).value:
                self._node.set_parameters([Parameter(USE_SIM_TIME, value=simulated)])
            if not simulated and time.monotonic() - self._started < DISCOVERY_S:
                return 0
        return int(self._node.get_clock().now().nanoseconds)
