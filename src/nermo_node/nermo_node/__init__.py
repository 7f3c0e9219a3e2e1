"""What every node of the workspace shares: running it, its parameters, QoS, time, diagnostics and lockstep."""

from nermo_node.parameters import ParameterError
from nermo_node.run import run

__all__ = ["ParameterError", "run"]
