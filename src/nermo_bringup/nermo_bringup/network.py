"""The option `--network` of the words that start nodes."""

from __future__ import annotations

import os
import sys
from typing import Annotated, Literal

import typer

NetworkOption = Annotated[
    Literal["localhost", "subnet"] | None,
    typer.Option(
        help="Who may take part in the graph: processes of this machine, or every machine in its network. "
        "Default: localhost, or what ROS_AUTOMATIC_DISCOVERY_RANGE says.",
        show_default=False,
    ),
]

WARNING = (
    "the graph is open to every machine in this network (ROS_DOMAIN_ID={domain}): whoever reaches it can read it all "
    "and move the robot, without a password; --network localhost keeps it on this machine."
)


def use_network(network: Literal["localhost", "subnet"] | None) -> None:
    """Lets this process and those that it starts take part in a graph that reaches so far; warns of an open one."""
    from nermo_node.network import chosen_network, reaching

    wanted = network or chosen_network(os.environ)
    environment = reaching(os.environ, wanted)
    for name in os.environ.keys() - environment.keys():
        del os.environ[name]
    os.environ.update(environment)
    if wanted == "subnet":
        print(f"nermo: {WARNING.format(domain=os.environ.get('ROS_DOMAIN_ID', 0))}", file=sys.stderr, flush=True)
