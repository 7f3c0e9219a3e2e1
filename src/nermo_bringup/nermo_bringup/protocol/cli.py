"""`nermo gap`: the commands of nermo_gap, whose protocol can be played through the graph here."""

from __future__ import annotations

from pathlib import Path

from nermo_bringup.network import use_network
from nermo_gap import cli
from nermo_gap.protocol.cli import hand_in
from nermo_gap.protocol.through_graph import Request

gap_app = cli.gap_app


def _record(request: Request) -> list[Path]:
    from nermo_bringup.protocol.session import record_through_graph

    use_network(None)
    return record_through_graph(request)


hand_in(_record)
