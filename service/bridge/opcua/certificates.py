"""Certificates of OPC UA: the server's own, which it makes itself, and those of clients that are trusted.

OPC 10000-4, 6.1: the certificate names the application's URI; a client is trusted once an operator has put its
certificate into the folder `trusted`. One that was refused lies in `rejected`, from where it can be moved.
"""

import hashlib
import logging
import os
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from asyncua.crypto.cert_gen import generate_private_key, generate_self_signed_app_certificate
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric.rsa import RSAPrivateKey, RSAPublicKey
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    load_pem_private_key,
)
from cryptography.x509.oid import ExtendedKeyUsageOID

from drivers.files.bounded import read_bounded
from service.base.errors import ServiceError

log = logging.getLogger(__name__)

VALID_DAYS = 5 * 365
RENEWED = timedelta(days=30)
"""Time before its end at which the server's certificate is made anew, with the same key."""
MAX_REJECTED = 50
"""Certificates in `rejected`; then the oldest makes room."""
MAX_TRUSTED = 500
MAX_BYTES = 16_384
RSA_BITS = range(2048, 4097)
"""Keys that Basic256Sha256 allows."""


class CertificateFileError(ServiceError):
    """A file of a certificate or key cannot be used."""


@dataclass(frozen=True, slots=True)
class OwnCertificate:
    """The certificate of the server, and its private key."""

    certificate: x509.Certificate
    key: RSAPrivateKey

    @property
    def renewal_at(self) -> datetime:
        """When it is to be made anew."""
        return self.certificate.not_valid_after_utc - RENEWED


def thumbprint(der: bytes) -> str:
    """Return the thumbprint of a certificate: the SHA-1 of its DER (OPC 10000-6)."""
    return hashlib.sha1(der, usedforsecurity=False).hexdigest().upper()


def load_certificate(path: Path) -> x509.Certificate:
    """Read a certificate, DER or PEM; raise `CertificateFileError`."""
    try:
        return _parsed(read_bounded(path, MAX_BYTES))
    except OSError as err:
        raise CertificateFileError(f"{path}: {err.strerror}") from err
    except ValueError as err:
        raise CertificateFileError(f"{path} is no certificate: {err}") from err


def own_certificate(folder: Path, application_uri: str, host: str, now: datetime) -> OwnCertificate:
    """Return the server's certificate from its folder; make it, and the key, where it is missing or soon at its end.

    Raises `CertificateFileError` when a file is there that cannot be used: it is not replaced.
    """
    key_file, file = folder / "server.key.pem", folder / "server.der"
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        for name in ("trusted", "rejected"):
            (folder / name).mkdir(exist_ok=True, mode=0o700)
        if not key_file.exists():
            made = generate_private_key()
            _write(key_file, made.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
        key = load_pem_private_key(read_bounded(key_file, MAX_BYTES), None)
    except OSError as err:
        raise CertificateFileError(f"{err.filename}: {err.strerror}") from err
    except (ValueError, TypeError) as err:
        raise CertificateFileError(f"{key_file} is no private key: {err}") from err
    if not isinstance(key, RSAPrivateKey):
        raise CertificateFileError(f"{key_file} is no RSA key")
    if file.exists():
        own = OwnCertificate(load_certificate(file), key)
        if (
            own.certificate.public_key() == key.public_key()
            and application_uri in uris_of(own.certificate)
            and own.renewal_at > now
        ):
            return own
    names: list[x509.GeneralName] = [
        x509.UniformResourceIdentifier(application_uri),
        x509.DNSName(host),
    ]
    certificate = generate_self_signed_app_certificate(
        key, "stonefall", {}, names, [ExtendedKeyUsageOID.SERVER_AUTH], VALID_DAYS
    )
    der = certificate.public_bytes(Encoding.DER)
    try:
        _write(file, der)
    except OSError as err:
        raise CertificateFileError(f"{file}: {err.strerror}") from err
    log.warning("%s: made, thumbprint %s: have clients trust it", file, thumbprint(der))
    return OwnCertificate(certificate, key)


def uris_of(certificate: x509.Certificate) -> list[str]:
    """Return the URIs of applications that a certificate names."""
    try:
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except (x509.ExtensionNotFound, ValueError):
        return []
    return names.get_values_for_type(x509.UniformResourceIdentifier)


def trouble_of(certificate: x509.Certificate, now: datetime) -> str | None:
    """Check validity and key of a certificate; return the trouble in words, None without one."""
    key = certificate.public_key()
    if not isinstance(key, RSAPublicKey) or key.key_size not in RSA_BITS:
        return "has no RSA key of 2048 to 4096 bits"
    if not certificate.not_valid_before_utc <= now <= certificate.not_valid_after_utc:
        return (
            f"is valid from {certificate.not_valid_before_utc:%Y-%m-%d %H:%M}"
            f" to {certificate.not_valid_after_utc:%Y-%m-%d %H:%M} UTC"
        )
    return None


def is_trusted(folder: Path, der: bytes) -> bool:
    """True if the very certificate lies in `trusted`; files there are read anew, so no restart is needed."""
    with suppress(OSError):
        for path in sorted((folder / "trusted").iterdir())[:MAX_TRUSTED]:
            with suppress(OSError, ValueError):
                if _parsed(read_bounded(path, MAX_BYTES)).public_bytes(Encoding.DER) == der:
                    return True
    return False


def keep_rejected(folder: Path, der: bytes) -> Path:
    """Keep a certificate that was refused, so that an operator can move it to `trusted`; return its file."""
    rejected = folder / "rejected"
    path = rejected / f"{thumbprint(der)}.der"
    try:
        if not path.exists() and len(der) <= MAX_BYTES:
            kept = sorted(rejected.iterdir(), key=lambda each: each.stat().st_mtime)
            for oldest in kept[: max(0, len(kept) - MAX_REJECTED + 1)]:
                oldest.unlink()
            _write(path, der)
    except OSError as err:
        log.warning("%s: %s", path, err.strerror)
    return path


def _parsed(content: bytes) -> x509.Certificate:
    load = x509.load_pem_x509_certificate if content.startswith(b"-----") else x509.load_der_x509_certificate
    return load(content)


def _write(path: Path, content: bytes) -> None:
    unfinished = path.with_suffix(".new")
    unfinished.unlink(missing_ok=True)
    with os.fdopen(os.open(unfinished, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    unfinished.replace(path)


def now_utc() -> datetime:
    """Return the time by the host's clock."""
    return datetime.now(UTC)
