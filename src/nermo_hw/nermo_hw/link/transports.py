"""Every word that an endpoint may begin with: what carries the link then, and whether it encrypts.

Nothing of a transport is imported before an end of the link is made with it.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import cast

from nermo_hw.link.transport import Transport

_ZENOH = "nermo_hw.link.zenoh_transport:ZenohTransport"


@dataclass(frozen=True, slots=True)
class Carrier:
    """What carries the link at endpoints that begin with a word."""

    encrypts: bool
    """A link with keys may only be at such endpoints, one without keys only at others."""
    transport: str
    """`module:Class` of its `Transport`."""
    ending: str = ""
    """Of the endpoint, so that a lost packet holds nothing up."""


TRANSPORTS = {
    "quic": Carrier(True, _ZENOH, "?rel=0"),
    "tls": Carrier(True, _ZENOH),
    "udp": Carrier(False, _ZENOH),
    "tcp": Carrier(False, _ZENOH),
}


def words(encrypts: bool) -> list[str]:
    """The words of a link with keys, or of one without."""
    return [word for word, carrier in TRANSPORTS.items() if carrier.encrypts is encrypts]


def transport_at(endpoint: str) -> Callable[..., Transport]:
    """The class of the transport at an endpoint whose word is known; made with the link's config and the side."""
    module, _, name = TRANSPORTS[endpoint.partition("/")[0]].transport.partition(":")
    return cast("Callable[..., Transport]", getattr(importlib.import_module(module), name))
