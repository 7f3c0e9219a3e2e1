"""All transports, by the word that an endpoint begins with."""

from __future__ import annotations

from collections.abc import Callable

from nermo_hw.link.config import LinkConfig, Side
from nermo_hw.link.transport import Transport
from nermo_hw.link.zenoh_transport import ZenohTransport

TRANSPORTS: dict[str, Callable[[LinkConfig, Side], Transport]] = {
    "quic": ZenohTransport,
    "tls": ZenohTransport,
    "udp": ZenohTransport,
    "tcp": ZenohTransport,
}
"""Which of them encrypt says `config.py`."""


def make_transport(config: LinkConfig, side: Side) -> Transport:
    """The transport of an end, as its first endpoint says; QUIC where none is named."""
    endpoint = next(iter((*config.peer(side).endpoints, *config.peer(side.other).endpoints)), "quic/")
    return TRANSPORTS[endpoint.partition("/")[0]](config, side)
