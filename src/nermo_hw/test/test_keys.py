"""Certificates with an end, renewed and revoked, with real zenoh sessions between the two ends."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from emulated import until
from link_door import Door, Intruder, config, free_port
from typer.testing import CliRunner

from nermo_hw.cli import hw_app
from nermo_hw.link.clock import SteadyClock
from nermo_hw.link.config import Side
from nermo_hw.link.end import LinkEnd
from nermo_hw.link.keys import KeysError, make_keys, revoke_keys, valid_until
from nermo_hw.link.revocation import common_name, revoke, revoked_names
from nermo_hw.link.session import LinkError, access_list

ENDS = ["robot", "workstation"]


def tls_of(folder: Path, name: str) -> dict[str, object]:
    """As `Intruder` needs it, of the certificate of `name`."""
    return {
        "root_ca_certificate": str(folder / "ca.pem"),
        "verify_name_on_connect": False,
        "enable_mtls": True,
        "connect_certificate": str(folder / f"{name}.pem"),
        "connect_private_key": str(folder / f"{name}.key"),
    }


def copied(folder: Path, name: str, to: Path) -> Path:
    """What a thief has: the certificate and key of an end."""
    to.mkdir()
    for file in ("ca.pem", f"{name}.pem", f"{name}.key"):
        (to / file).write_bytes((folder / file).read_bytes())
    return to


def test_an_end_is_valid_for_a_year_and_never_longer_than_its_authority(tmp_path: Path) -> None:
    make_keys(tmp_path, ["robot"])
    make_keys(tmp_path, ["workstation"], days=3650)
    now, day = datetime.now(UTC), timedelta(days=1)
    assert now + 364 * day < valid_until(tmp_path / "robot.pem") <= now + 365 * day
    assert valid_until(tmp_path / "workstation.pem") <= valid_until(tmp_path / "ca.pem") <= now + 3650 * day


def test_a_renewed_certificate_replaces_the_old_one_and_the_other_end_need_not_know(tmp_path: Path) -> None:
    make_keys(tmp_path, ENDS, days=2)
    before = (tmp_path / "workstation.pem").read_bytes()
    assert make_keys(tmp_path, ["workstation"]) == []
    assert make_keys(tmp_path, ["workstation"], renew=True) == [tmp_path / "workstation.pem"]
    assert (tmp_path / "workstation.pem").read_bytes() != before
    settings = config(tmp_path, f"quic/127.0.0.1:{free_port()}?rel=0")
    with (
        LinkEnd(settings, Side.ROBOT, lambda *_: None, SteadyClock()) as robot,
        LinkEnd(settings, Side.WORKSTATION, lambda *_: None, SteadyClock()) as workstation,
    ):
        until(lambda: workstation.connected and robot.connected, "they found each other")


def test_an_ended_certificate_is_said_at_its_own_end_and_turned_away_at_the_other(tmp_path: Path) -> None:
    keys = tmp_path / "keys"
    make_keys(keys, ["robot"])
    make_keys(keys, ["workstation"], days=-1)
    settings = config(keys, f"quic/127.0.0.1:{free_port()}?rel=0")
    with pytest.raises(LinkError, match=r"workstation.pem ended on .*: `nermo hw keys --renew` makes a new one"):
        LinkEnd(settings, Side.WORKSTATION, lambda *_: None, SteadyClock()).open()
    ended = copied(keys, "workstation", tmp_path / "ended")
    make_keys(keys, ["workstation"], renew=True)
    door = Door(settings)
    intruder = Intruder(settings, tls_of(ended, "workstation"))
    try:
        assert door.until("away:") == "away: a peer whose certificate has ended was turned away"
    finally:
        intruder.close()
        door.close()
    assert not [line for line in door.lines if line.startswith("got:")]


@pytest.mark.parametrize("protocol", ["quic/127.0.0.1:{}?rel=0", "tls/127.0.0.1:{}"])
def test_a_revoked_certificate_commands_no_more_and_its_successor_does(tmp_path: Path, protocol: str) -> None:
    keys = tmp_path / "keys"
    make_keys(keys, ENDS)
    stolen = copied(keys, "workstation", tmp_path / "stolen")
    assert revoke_keys(keys, ["workstation"]) == [keys / "workstation.pem"]
    settings = config(keys, protocol.format(free_port()))
    door = Door(settings)
    thief = Intruder(settings, tls_of(stolen, "workstation"))
    try:
        assert door.until("away:") == "away: workstation may not put nermo/servo_command"
        assert not [line for line in door.lines if line.startswith("got:")]
        owner = Intruder(settings, tls_of(keys, "workstation"))
        try:
            assert door.until("got:") == "got: servo_command"
        finally:
            owner.close()
    finally:
        thief.close()
        door.close()


def test_a_revoked_observer_hears_nothing_more(tmp_path: Path) -> None:
    make_keys(tmp_path, [*ENDS, "listener"])
    settings = config(tmp_path, "quic/127.0.0.1:1?rel=0", observers=["listener"])
    assert _names(access_list(settings, Side.ROBOT)) == {"workstation", "listener"}
    revoke(tmp_path, "listener", "lost")
    assert _names(access_list(settings, Side.ROBOT)) == {"workstation", "listener-2"}
    revoke(tmp_path, "robot", "lost")
    assert _names(access_list(settings, Side.WORKSTATION)) == {"robot-2"}


def _names(rules: dict[str, list[dict[str, list[str]]]]) -> set[str]:
    return {name for subject in rules["subjects"] for name in subject.get("cert_common_names", [])}


def test_the_list_is_read_with_remarks_and_counts_up(tmp_path: Path) -> None:
    assert revoked_names(tmp_path) == frozenset()
    (tmp_path / "revoked").write_text("# lost in the train\nworkstation  # on Monday\n\n  robot\n")
    assert revoked_names(tmp_path) == {"workstation", "robot"}
    assert revoke(tmp_path, "workstation", "again") == "workstation-2"
    assert common_name("workstation", revoked_names(tmp_path)) == "workstation-3"
    assert common_name("listener", revoked_names(tmp_path)) == "listener"


def test_what_has_no_certificate_cannot_be_revoked(tmp_path: Path) -> None:
    make_keys(tmp_path, ENDS)
    with pytest.raises(KeysError, match=r"listener.pem is missing: there is nothing to revoke"):
        revoke_keys(tmp_path, ["workstation", "listener"])
    assert revoked_names(tmp_path) == frozenset()


def test_the_command_says_until_when_and_what_to_do(tmp_path: Path) -> None:
    runner, folder = CliRunner(), str(tmp_path)
    made = runner.invoke(hw_app, ["keys", "--folder", folder, "--days", "90"])
    day = (datetime.now(UTC) + timedelta(days=90)).date()
    assert f"robot.pem, until {day}" in made.stdout
    assert "has them all" in runner.invoke(hw_app, ["keys", "--folder", folder]).stdout
    make_keys(tmp_path, ["robot"], days=3, renew=True)
    assert (
        "robot.pem ends in 2 days: --renew makes a new one"
        in runner.invoke(hw_app, ["keys", "--folder", folder]).stdout
    )
    assert f"until {day}" in runner.invoke(hw_app, ["keys", "--folder", folder, "--renew", "--days", "90"]).stdout
    revoked = runner.invoke(hw_app, ["keys", "workstation", "--folder", folder, "--revoke"])
    assert f"copy {tmp_path / 'revoked'} to the folder of the keys at the other end" in revoked.stdout.replace("\n", "")
    assert runner.invoke(hw_app, ["keys", "--folder", folder, "--revoke"]).exit_code != 0
