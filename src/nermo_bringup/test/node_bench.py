"""A bench in the graph for the nodes of this package."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence

from graph_bench import GraphBench


class Bench(GraphBench):
    """A test's own node in a ROS domain, and the nodes that it started there."""

    def __init__(self) -> None:
        super().__init__(start_parameter_services=False)

    def start(self, module: str, *arguments: str, terminal: int | None = None) -> subprocess.Popen[str]:
        """Run the `main` of a node module with ROS arguments, as its console script does."""
        return self.run(f"import sys; from {module} import main; sys.exit(main())", *arguments, terminal=terminal)

    def run(self, code: str, *arguments: str, terminal: int | None = None) -> subprocess.Popen[str]:
        """Run Python code that becomes a node; on a terminal if one is given."""
        command = [sys.executable, "-c", code, *(("--ros-args", *arguments) if arguments else ())]
        if terminal is None:
            return self.begin(command, stdin=subprocess.DEVNULL)
        return self.begin(command, stdin=terminal, stdout=terminal, stderr=terminal)

    @staticmethod
    def parameters(**values: object) -> Sequence[str]:
        """ROS arguments that set parameters."""
        return [argument for name, value in values.items() for argument in ("-p", f"{name}:={json.dumps(value)}")]
