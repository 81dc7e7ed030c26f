"""The signature of a report: Ed25519 by the key of the instrument, in a last line of the PDF that readers skip.

The line is a comment of PDF: `%stonefall-signature`, what is said of the report as JSON, and the signature of every
byte before it. So the one file can be checked anywhere, without the instrument.
"""

import json
import re
import sqlite3
from collections.abc import Collection
from dataclasses import asdict, dataclass
from enum import StrEnum
from hashlib import sha256
from pathlib import Path
from typing import Any

from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    load_pem_private_key,
)
from pydantic import TypeAdapter, ValidationError

from drivers.files.bounded import read_bounded
from drivers.files.durable import replacing
from service.base.errors import StoreError
from service.base.schema import OptionalTime, request_body, served
from service.store import audit
from service.store.history import DATABASE
from service.store.schema import read

KEY_FILE, MAX_KEY_BYTES = "instrument-key.pem", 10_000
"""Private key of the instrument, beside the database; no backup has it."""
KEY_USED = "reports signed by a new key"
"""Action of the entries of the audit that keep the public keys of all reports."""
MAX_REPORT_BYTES = 10_000_000
MARK = b"\n%stonefall-signature "
LINE = re.compile(rb"(\{[^\r\n]*\}) ([0-9a-f]{128})\n")
PDF = b"%PDF-"


class SignatureState(StrEnum):
    """What a check of a signature found."""

    GENUINE = "genuine"
    """Not one byte was changed since the instrument, whose key is known, signed it."""
    UNKNOWN_KEY = "unknown_key"
    """Not one byte was changed since it was signed, but the key is not one that is known here."""
    CHANGED = "changed"
    """It was changed after it was signed."""
    NOT_SIGNED = "not_signed"
    """It has no signature, or has lost its end."""


@request_body
class Statement:
    """What is said of a report, and signed with it."""

    instrument: str | None
    """Serial of the instrument, as configured."""
    lot: str
    """Id of the lot."""
    revision: int
    """Revision of the lot."""
    signed_at: OptionalTime
    """When the report was made and signed, RFC 3339 UTC."""
    public_key: str
    """The key that proves the signature: 32 bytes as hexadecimal digits."""


@served
class ReportCheck:
    """What the check of a signed report found."""

    state: SignatureState
    """`genuine`, or why it is not to be relied on."""
    detail: str
    """The same in words."""
    fingerprint: str | None = None
    """Fingerprint of the key that signed; null if the file was changed or is not signed, as all that follows."""
    statement: Statement | None = None
    """What was signed with the report."""


@served
class KeyDocument:
    """The key of the instrument, by which its reports are checked."""

    public_key: str
    """Ed25519, 32 bytes as hexadecimal digits."""
    fingerprint: str
    """As reports print it: half of the SHA-256 of the key."""
    former: list[str]
    """Fingerprints of the keys that it had before, whose reports stay genuine."""


@dataclass(frozen=True, slots=True)
class InstrumentKey:
    """The key pair of the instrument."""

    private: Ed25519PrivateKey

    @property
    def public_key(self) -> str:
        """The public key, 64 hexadecimal digits."""
        return self.private.public_key().public_bytes_raw().hex()

    @property
    def fingerprint(self) -> str:
        return fingerprint_of(self.public_key)


def fingerprint_of(public_key: str) -> str:
    """Return half of the SHA-256 of a public key, in groups that people can compare."""
    return grouped(sha256(bytes.fromhex(public_key)).hexdigest()[:32])


def grouped(digits: str) -> str:
    """Return the digits of a fingerprint as reports print them."""
    return "-".join(digits[at : at + 4] for at in range(0, len(digits), 4))


def instrument_key(state_dir: Path) -> InstrumentKey:
    """Return the key of the instrument; it is made with the first call, readable by its owner alone; blocks.

    Raises `StoreError` for a damaged file: it is never replaced without being asked.
    """
    path = state_dir / KEY_FILE
    try:
        private = load_pem_private_key(read_bounded(path, MAX_KEY_BYTES), password=None)
    except FileNotFoundError:
        return _new_key(path)
    except OSError as err:
        raise StoreError(f"{path}: {err.strerror}") from err
    except (ValueError, TypeError, UnsupportedAlgorithm):
        private = None
    if not isinstance(private, Ed25519PrivateKey):
        raise StoreError(
            f"{path}: is no Ed25519 key: put the right file back, or remove it and restart for a new key"
        )
    return InstrumentKey(private)


def _new_key(path: Path) -> InstrumentKey:
    key = Ed25519PrivateKey.generate()
    try:
        with replacing(path, 0o600) as temporary:
            temporary.write_bytes(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    except OSError as err:
        raise StoreError(f"{path}: {err.strerror}") from err
    return InstrumentKey(key)


def note_key(connection: sqlite3.Connection, public_key: str) -> None:
    """Note in the audit the first use of a key: so backups have all public keys, and none a private one."""
    if public_key not in public_keys(connection):
        facts = {"public_key": public_key}
        audit.note(connection, "stonefall", KEY_USED, fingerprint_of(public_key), after=facts)


def public_keys(connection: sqlite3.Connection) -> list[str]:
    """Return the public keys that signed reports, the newest first."""
    rows = connection.execute("SELECT after FROM audit WHERE action = ? ORDER BY entry DESC", (KEY_USED,))
    return [json.loads(after)["public_key"] for (after,) in rows]


def key_document(connection: sqlite3.Connection, state_dir: Path) -> KeyDocument:
    """Return the public key of the instrument, and those it had before."""
    key = instrument_key(state_dir)
    former = [fingerprint_of(each) for each in public_keys(connection) if each != key.public_key]
    return KeyDocument(public_key=key.public_key, fingerprint=key.fingerprint, former=former)


def known_fingerprints(state_dir: Path) -> set[str]:
    """Return the fingerprints of all keys that the instrument of a store ever had; none if there is no store."""
    path = state_dir / DATABASE
    return {*map(fingerprint_of, read(path, public_keys))} if path.is_file() else set()


def signed(pdf: bytes, key: InstrumentKey, **said: Any) -> bytes:
    """Return a PDF with its signature; `said` are the other fields of the statement."""
    statement = Statement(public_key=key.public_key, **said)
    text = json.dumps(asdict(statement), ensure_ascii=False)
    content = pdf.rstrip(b"\n") + MARK + text.encode("utf-8", "replace")
    return content + b" " + key.private.sign(content).hex().encode() + b"\n"


def checked(content: bytes, known: Collection[str]) -> ReportCheck:
    """Check the signature of a report; `known` are the fingerprints of keys that are relied on."""
    pdf, mark, line = content.rpartition(MARK)
    if not pdf.startswith(PDF):
        kind = "carries no signature, or has lost its end" if content.startswith(PDF) else "is no PDF"
        return ReportCheck(state=SignatureState.NOT_SIGNED, detail=f"it {kind}")
    found = LINE.fullmatch(line)
    try:
        if found is None:
            raise ValueError
        public_key = json.loads(found[1])["public_key"]
        public = Ed25519PublicKey.from_public_bytes(bytes.fromhex(public_key))
        public.verify(bytes.fromhex(found[2].decode()), pdf + mark + found[1])
    except (ValueError, KeyError, TypeError, RecursionError, InvalidSignature):
        return ReportCheck(state=SignatureState.CHANGED, detail="it was changed after it was signed")
    fingerprint = fingerprint_of(public_key)
    is_known = fingerprint in known
    try:
        statement = TypeAdapter(Statement).validate_json(found[1])
        detail = _described(statement, fingerprint, is_known=is_known)
    except ValidationError:  # whole, as its signature shows
        statement = None
        detail = (
            f"it is unchanged since key {fingerprint} signed it; a later version wrote it: update stonefall"
        )
    return ReportCheck(
        state=SignatureState.GENUINE if is_known else SignatureState.UNKNOWN_KEY,
        detail=detail,
        fingerprint=fingerprint,
        statement=statement,
    )


def _described(statement: Statement, fingerprint: str, *, is_known: bool) -> str:
    instrument = "an instrument" if statement.instrument is None else f"instrument {statement.instrument}"
    of = f"report of lot {statement.lot}, revision {statement.revision}, {statement.signed_at}"
    if is_known:
        return f"genuine: {of}, signed by {instrument} with key {fingerprint}"
    return (
        f"intact, but the key is not known here: {of}, signed as {instrument} with key {fingerprint}: compare it with"
        " the instrument's"
    )
