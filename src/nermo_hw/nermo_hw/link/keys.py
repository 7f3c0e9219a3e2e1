"""A certificate authority of one's own, and a certificate for each end of the link."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from nermo_hw.link.revocation import common_name, revoke, revoked_names

CA_DAYS = 3650
"""The authority's own certificate; whatever it signs ends before it."""
DAYS = 365
"""Validity of an end's certificate, unless somebody says otherwise."""
SOON_DAYS = 30
"""A certificate that ends within this is worth a word."""
CA = "ca"


class KeysError(ValueError):
    """Keys cannot be made; the text says which and why."""


def make_keys(folder: Path, names: Sequence[str], *, days: int = DAYS, renew: bool = False) -> list[Path]:
    """Makes `ca.pem` and `ca.key` where there are none, and `<name>.pem` and `<name>.key` for each name that has none.

    The robot gets `ca.pem` and its own two files; `ca.key` stays where it is safe. Returns the certificates made.

    Args:
        folder: Where they go.
        names: Ends and observers.
        days: How long their certificates are valid.
        renew: Make new ones, with new keys, also for names that have some. The old ones stay valid until their end.

    Raises KeysError for a name that cannot be one, or a folder that cannot be written.
    """
    for name in names:
        if not re.fullmatch(r"[A-Za-z0-9][\w.-]*", name) or name == CA:
            raise KeysError(f"name {name!r}: letters, digits, '.', '-' and '_' only, and not {CA!r}")
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        made = []
        revoked = revoked_names(folder)
        if not (folder / f"{CA}.key").is_file():
            _write(folder, CA, *_authority())
            made.append(folder / f"{CA}.pem")
        authority = x509.load_pem_x509_certificate((folder / f"{CA}.pem").read_bytes())
        key = serialization.load_pem_private_key((folder / f"{CA}.key").read_bytes(), password=None)
        assert isinstance(key, ec.EllipticCurvePrivateKey)
        for name in names:
            if renew or not (folder / f"{name}.pem").is_file():
                _write(folder, name, *_certificate(common_name(name, revoked), authority, key, days))
                made.append(folder / f"{name}.pem")
    except (OSError, ValueError) as error:
        raise KeysError(f"{folder}: keys cannot be made: {error}") from error
    return made


def revoke_keys(folder: Path, names: Sequence[str], *, days: int = DAYS) -> list[Path]:
    """Puts the certificates of `names` on the list of those that are refused, and makes new ones.

    Raises KeysError for a name that has no certificate here, or a folder that cannot be written.
    """
    for name in names:
        if not (folder / f"{name}.pem").is_file():
            raise KeysError(f"{folder / f'{name}.pem'} is missing: there is nothing to revoke")
    try:
        for name in names:
            revoke(folder, name, f"revoked on {datetime.now(UTC).date()}")
    except OSError as error:
        raise KeysError(f"{folder}: nothing can be revoked: {error}") from error
    return make_keys(folder, names, days=days, renew=True)


def valid_until(certificate: Path) -> datetime:
    """When a certificate ends. Raises KeysError where it cannot be read."""
    try:
        return x509.load_pem_x509_certificate(certificate.read_bytes()).not_valid_after_utc
    except (OSError, ValueError) as error:
        raise KeysError(f"{certificate} cannot be read: {error}") from error


def _builder(subject: str, issuer: str, end: datetime) -> x509.CertificateBuilder:
    now = datetime.now(UTC)
    return (
        x509.CertificateBuilder()
        .subject_name(_name(subject))
        .issuer_name(_name(issuer))
        .serial_number(x509.random_serial_number())
        # A robot's clock may be behind.
        .not_valid_before(now - timedelta(days=2))
        .not_valid_after(end)
    )


def _authority() -> tuple[x509.Certificate, ec.EllipticCurvePrivateKey]:
    key = ec.generate_private_key(ec.SECP256R1())
    name = f"Nermo {x509.random_serial_number() & 0xFFFFFFFF:08x}"
    certificate = (
        _builder(name, name, datetime.now(UTC) + timedelta(days=CA_DAYS))
        .public_key(key.public_key())
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .sign(key, hashes.SHA256())
    )
    return certificate, key


def _certificate(
    name: str, authority: x509.Certificate, authority_key: ec.EllipticCurvePrivateKey, days: int
) -> tuple[x509.Certificate, ec.EllipticCurvePrivateKey]:
    key = ec.generate_private_key(ec.SECP256R1())
    uses = [ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]
    issuer = authority.subject.get_attributes_for_oid(NameOID.COMMON_NAME)[0].value
    certificate = (
        _builder(name, str(issuer), min(datetime.now(UTC) + timedelta(days=days), authority.not_valid_after_utc))
        .public_key(key.public_key())
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(x509.SubjectAlternativeName([x509.DNSName(name)]), critical=False)
        .add_extension(x509.ExtendedKeyUsage(uses), critical=False)
        .sign(authority_key, hashes.SHA256())
    )
    return certificate, key


def _name(common_name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name)])


def _write(folder: Path, name: str, certificate: x509.Certificate, key: ec.EllipticCurvePrivateKey) -> None:
    """The key first, readable by its owner only: a certificate without its key would never be made again."""
    private = key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    handle = os.open(folder / f"{name}.key", os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
    with os.fdopen(handle, "wb") as file:
        file.write(private)
    (folder / f"{name}.pem").write_bytes(certificate.public_bytes(serialization.Encoding.PEM))
