"""Quality of service as the recorder needs it: what publishers offer, and what a subscription to them all must ask."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

FOREVER_NS = 2**63 - 1
MINIMUM_DEPTH = 500
"""Samples kept between two drains of a subscription: 2.5 s of a topic at 200 Hz."""


@dataclass(frozen=True, slots=True)
class Offer:
    """Quality of service that one publisher offers; enumerations by rosbag2's lower-case names, durations in ns."""

    reliability: str = "reliable"
    durability: str = "volatile"
    history: str = "unknown"
    depth: int = 0
    deadline_ns: int = FOREVER_NS
    lifespan_ns: int = FOREVER_NS
    liveliness: str = "automatic"
    lease_ns: int = FOREVER_NS

    def as_metadata(self) -> dict[str, object]:
        """The entry of `offered_qos_profiles` that rosbag2 (metadata version 9) writes."""
        return {
            "history": self.history,
            "depth": self.depth,
            "reliability": self.reliability,
            "durability": self.durability,
            "deadline": _duration(self.deadline_ns),
            "lifespan": _duration(self.lifespan_ns),
            "liveliness": self.liveliness,
            "liveliness_lease_duration": _duration(self.lease_ns),
            "avoid_ros_namespace_conventions": False,
        }


@dataclass(frozen=True, slots=True)
class Request:
    """Quality of service of one recording subscription."""

    reliable: bool
    transient_local: bool
    depth: int


def request_for(offers: Sequence[Offer]) -> Request:
    """The strongest request that every publisher can fulfil.

    One best-effort publisher makes the subscription best effort, or it would not be heard; likewise for volatile ones.
    """
    return Request(
        reliable=all(offer.reliability == "reliable" for offer in offers),
        transient_local=all(offer.durability == "transient_local" for offer in offers),
        depth=max([MINIMUM_DEPTH, *(offer.depth for offer in offers)]),
    )


def _duration(nanoseconds: int) -> dict[str, int]:
    return {"sec": nanoseconds // 10**9, "nsec": nanoseconds % 10**9}
