"""A zenoh session as the link needs it: told whom to meet, encrypted, and open to nobody else."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import zenoh

from nermo_hw.link.config import LinkConfig, Side
from nermo_hw.link.revocation import common_name, revoked_names
from nermo_hw.link.transport import KeysMissingError, LinkError

PRIORITIES = {
    "real_time": zenoh.Priority.REAL_TIME,
    "interactive_high": zenoh.Priority.INTERACTIVE_HIGH,
    "interactive_low": zenoh.Priority.INTERACTIVE_LOW,
    "data_high": zenoh.Priority.DATA_HIGH,
    "data": zenoh.Priority.DATA,
    "data_low": zenoh.Priority.DATA_LOW,
    "background": zenoh.Priority.BACKGROUND,
}


def open_session(config: LinkConfig, side: Side) -> zenoh.Session:
    """Opens the session of an end. Raises LinkError."""
    try:
        settings = zenoh.Config()
        for path, value in zenoh_settings(config, side).items():
            settings.insert_json5(path, json.dumps(value))
        return zenoh.open(settings)
    except zenoh.ZError as error:
        where = ", ".join(config.peer(side).endpoints)
        raise LinkError(f"link {where}: {str(error).split(' at /')[0]}") from error


def zenoh_settings(config: LinkConfig, side: Side) -> dict[str, Any]:
    """Zenoh's configuration by path.

    Raises LinkError where a key or a certificate is missing.
    """
    here = config.peer(side)
    listens = side is Side.ROBOT
    settings: dict[str, Any] = {
        "mode": "peer",
        # Nobody is looked for, and nobody is told of: peers are those that the file names.
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "listen/endpoints": list(here.endpoints) if listens else [],
        "connect/endpoints": [] if listens else list(here.endpoints),
        "connect/timeout_ms": -1,
        "connect/exit_on_failure": False,
        "connect/retry": {"period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 2},
        "open/return_conditions/connect_scouted": False,
        "transport/link/tx/lease": round(config.lease * 1e3),
        # A batch that waits holds the newest command up.
        "transport/link/tx/queue/batching/enabled": False,
        "transport/shared_memory/enabled": False,
        "transport/unicast/open_timeout": 3000,
        "transport/unicast/accept_timeout": 3000,
    }
    if config.keys is not None:
        settings["transport/link/tls"] = _tls(config, side)
        settings["access_control"] = access_list(config, side)
    return settings


def _tls(config: LinkConfig, side: Side) -> dict[str, Any]:
    assert config.keys is not None
    name = config.peer(side).name
    ca, certificate, key = config.keys / "ca.pem", config.keys / f"{name}.pem", config.keys / f"{name}.key"
    for file in (ca, certificate, key):
        if not file.is_file():
            raise KeysMissingError(f"{file} is missing: `nermo hw keys` makes it")
    _check_validity(certificate)
    return {
        "root_ca_certificate": str(ca),
        "listen_certificate": str(certificate),
        "listen_private_key": str(key),
        "connect_certificate": str(certificate),
        "connect_private_key": str(key),
        "enable_mtls": True,
        "close_link_on_expiration": True,
        # The access list goes by the name in the certificate, and a robot's address changes with the network.
        "verify_name_on_connect": False,
    }


def _check_validity(certificate: Path) -> None:
    """Zenoh would only try again and again. A robot's end without `cryptography` does without this sentence too."""
    try:
        from nermo_hw.link.keys import KeysError, valid_until
    except ImportError:
        return
    try:
        end = valid_until(certificate)
    except KeysError as error:
        raise LinkError(str(error)) from error
    if end <= datetime.now(UTC):
        raise LinkError(f"{certificate} ended on {end.date()}: `nermo hw keys --renew` makes a new one")


def access_list(config: LinkConfig, side: Side) -> dict[str, Any]:
    """Who may do what at an end, by the common name of the certificate; everything else is refused.

    Whoever has a certificate of ours may know which topics this end listens to: a peer that tries to use one without
    being on the list is then refused by name, and not ignored unseen. Names on the list of revoked certificates are
    on no other list.
    """
    revoked = frozenset[str]() if config.keys is None else revoked_names(config.keys)
    far_end = common_name(config.peer(side.other).name, revoked)
    observers = [common_name(name, revoked) for name in config.observers]
    incoming, outgoing = config.key_list(side), config.key_list(side.other)
    tokens = ["@/*/@ros2_lv/**"]
    services = [config.release_key]
    asks, answers = ("egress", "ingress") if side is Side.WORKSTATION else ("ingress", "egress")

    def rule(name: str, flow: str, messages: list[str], keys: list[str]) -> dict[str, Any]:
        return {"id": name, "permission": "allow", "flows": [flow], "messages": messages, "key_exprs": keys}

    rules = [
        rule("receive", "ingress", ["put"], incoming),
        rule("announce", "egress", ["declare_subscriber"], incoming),
        rule("send", "egress", ["put"], outgoing),
        rule("be_asked", "ingress", ["declare_subscriber"], outgoing),
        rule("ask", asks, ["query"], services),
        rule("answer", answers, ["reply", "declare_queryable"], services),
        rule("tell_tokens", "egress", ["liveliness_token"], tokens),
        rule(
            "hear_tokens", "ingress", ["liveliness_token", "declare_liveliness_subscriber", "liveliness_query"], tokens
        ),
    ]
    everything = [entry["id"] for entry in rules]
    subjects: list[dict[str, Any]] = [
        {"id": "anybody"},
        {"id": "far_end", "cert_common_names": [far_end]},
    ]
    policies = [
        {"rules": ["announce"], "subjects": ["anybody"]},
        {"rules": everything, "subjects": ["far_end"]},
    ]
    if observers and side is Side.ROBOT:
        subjects.append({"id": "observers", "cert_common_names": observers})
        policies.append({"rules": ["send", "be_asked", "tell_tokens"], "subjects": ["observers"]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }
