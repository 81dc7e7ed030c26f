"""Keys of the REST interface: a table that `stonefall keys` changes beside a running daemon, with the audit.

Of a token only the hash is kept; its 256 random bits cannot be guessed from that. A revoked key stays, so that its use
is told from a wrong one.
"""

import hashlib
import logging
import os
import re
import secrets
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass, replace
from http import HTTPStatus
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from drivers.files.bounded import read_bounded
from drivers.files.times import utc_now
from service.base.errors import ProblemError, ProblemKind, StoreError
from service.base.schema import GivenTime
from service.store import audit
from service.store.history import DATABASE, HAS_KEYS
from service.store.schema import connect, newest_version, read, transaction
from service.store.store import open_store

log = logging.getLogger(__name__)


class KeyConflictError(ProblemError, StoreError):
    """The key cannot be added: its name is none or is taken, or there are too many."""

    kinds = (ProblemKind("key-conflict", HTTPStatus.CONFLICT, "The key cannot be made"),)


NAME = re.compile(r"[A-Za-z0-9_.-]{1,64}")
PREFIX = "stonefall_"
"""Beginning of every token, which programs that search for secrets look for."""
TOKEN_BYTES = 32
MAX_KEYS = 1000
"""Beyond, those that were revoked or expired first are forgotten."""
BUSY_MS = 10_000
"""Longest wait for the daemon's own writes."""
FIRST_SCHEMA = 16
"""Schema that first has keys."""
FILE, MAX_BYTES = "keys.json", 1_000_000
"""Where earlier releases kept them."""


@dataclass(frozen=True, slots=True)
class AccessKey:
    """A key of the store, column by column, or of the configuration, which knows no times; these are RFC 3339."""

    sha256: str
    name: str
    scopes: tuple[str, ...]
    created_at: GivenTime | None = None
    created_by: str | None = None
    expires_at: GivenTime | None = None
    revoked_at: GivenTime | None = None
    revoked_by: str | None = None
    is_display: bool = False
    """True for the key of a wall screen: it only reads, and stays signed in until it is revoked."""

    def refusal(self, now: str) -> str | None:
        """Return the reason why the key is not accepted at a time, None if it is."""
        if self.revoked_at is not None:
            return f"key {self.name!r} was revoked at {self.revoked_at}"
        if self.expires_at is not None and now >= self.expires_at:
            return f"key {self.name!r} expired at {self.expires_at}"
        return None

    @property
    def facts(self) -> dict[str, Any]:
        """What the audit says of its creation."""
        names = ("scopes", "is_display", "created_at", "expires_at")
        return {name: getattr(self, name) for name in names}


def sha256_of(token: str) -> str:
    """Return the SHA-256 of a token, the only form in which it is stored."""
    return hashlib.sha256(token.encode()).hexdigest()


def known_keys(connection: sqlite3.Connection) -> list[AccessKey]:
    """Return all keys, the oldest first; raise `StoreError` if there are none because they were lost."""
    keys = _all_keys(connection)
    (is_lost,) = connection.execute("SELECT keys_lost FROM store").fetchone()
    if is_lost and not keys:
        raise StoreError("a damaged database may have had keys: restore a backup, or create them anew")
    return keys


def stored_keys(state_dir: Path) -> list[AccessKey]:
    """Return the keys of a store, which need not exist; raise `StoreError` if they cannot be read."""
    path = state_dir / DATABASE
    has_keys = path.is_file() and read(path, _version) >= FIRST_SCHEMA
    return [*(read(path, known_keys) if has_keys else ()), *keys_of_file(state_dir / FILE)]


def new_token() -> str:
    """Return a token that no one has guessed."""
    return PREFIX + secrets.token_urlsafe(TOKEN_BYTES)


def create_key(
    state_dir: Path,
    name: str,
    scopes: tuple[str, ...],
    expires_at: str | None,
    by: str,
    *,
    is_display: bool = False,
) -> tuple[AccessKey, str]:
    """Add a key to a store and return it with its token, which is nowhere else.

    Raises `StoreError` for no name or that of an accepted key, or if the store cannot be written, or is full of keys.
    """
    token = new_token()
    key = AccessKey(sha256_of(token), name, scopes, utc_now(), by, expires_at, is_display=is_display)
    with writing(state_dir) as connection:
        insert_key(connection, state_dir, key)
        audit.note(connection, f"stonefall keys of {by}", "key created", name, after=key.facts)
    return key, token


def insert_key(connection: sqlite3.Connection, state_dir: Path, key: AccessKey) -> None:
    """Add a key within a transaction; raise `KeyConflictError` if it cannot be added."""
    if not NAME.fullmatch(key.name):
        raise KeyConflictError(f"key {key.name!r}: a name has 1 to 64 letters, digits, '.', '-' and '_'")
    keys, now = _all_keys(connection), utc_now()
    if any(each.name == key.name and each.refusal(now) is None for each in keys):
        raise KeyConflictError(f"there is a key {key.name!r}: revoke it first, or choose another name")
    if len(keys) >= MAX_KEYS:
        dead = next((each for each in keys if each.refusal(now) is not None), None)
        if dead is None:
            raise KeyConflictError(f"{state_dir}: has {MAX_KEYS} keys: revoke old ones")
        connection.execute("DELETE FROM keys WHERE sha256 = ?", (dead.sha256,))
    (state_dir / HAS_KEYS).touch()
    _insert(connection, key)


def revoke_key(state_dir: Path, name: str, by: str) -> None:
    """Revoke the key of this name; raise `StoreError` if there is none that is not revoked."""
    with writing(state_dir) as connection:
        revoked = connection.execute(
            "UPDATE keys SET revoked_at = ?, revoked_by = ? WHERE name = ? AND revoked_at IS NULL RETURNING *",
            (utc_now(), by, name),
        ).fetchall()
        if not revoked:
            raise StoreError(f"there is no key {name!r} to revoke in {state_dir}")
        for key in map(_of_row, revoked):
            after = {**key.facts, "revoked_at": key.revoked_at}
            audit.note(
                connection, f"stonefall keys of {by}", "key revoked", name, before=key.facts, after=after
            )


def take_over(connection: sqlite3.Connection, state_dir: Path) -> str | None:
    """Add the keys of the file of earlier releases, or note that they are lost with it; return its name from then on.

    Call `rename_file` once that is durable.
    """
    path = state_dir / FILE
    if not path.exists():
        return None
    (state_dir / HAS_KEYS).touch()
    try:
        new = [asdict(key) for key in keys_of_file(path) if _insert(connection, key)]
        if new:
            facts = [{name: value for name, value in key.items() if name != "sha256"} for key in new]
            audit.note(connection, "stonefall", "keys taken over", FILE, after={"keys": facts})
    except (StoreError, sqlite3.IntegrityError) as err:
        log.error("keys: %s", err)
        connection.execute("UPDATE store SET keys_lost = 1")
        return f"{FILE}.damaged"
    return f"{FILE}.taken-over"


def rename_file(state_dir: Path, name: str | None) -> None:
    """Rename the file of earlier releases that was taken over, and remove the secret of their sessions."""
    if name is not None:
        (state_dir / FILE).rename(state_dir / name)
    (state_dir / "sessions.json").unlink(missing_ok=True)


def keys_of_file(path: Path) -> list[AccessKey]:
    """Return the keys of a file that no store has taken over yet; raise `StoreError` if it is damaged."""
    try:
        document = TypeAdapter(dict[str, Any]).validate_json(read_bounded(path, MAX_BYTES))
        return TypeAdapter(list[AccessKey]).validate_python(document.get("keys"))
    except FileNotFoundError:
        return []
    except OSError as err:
        raise StoreError(f"{path}: {err.strerror}") from err
    except ValidationError as err:
        error = err.errors(include_input=False)[0]
        field = ".".join(map(str, error["loc"]))
        raise StoreError(f"{path}: {field and f'{field}: '}{error['msg']}") from None


@contextmanager
def writing(state_dir: Path) -> Iterator[sqlite3.Connection]:
    """Run a transaction on a store, beside a daemon that may have it open.

    One that is missing or of an earlier release is opened as the daemon does first, which needs the lock.
    """
    path = state_dir / DATABASE
    try:
        state_dir.mkdir(parents=True, exist_ok=True)
        if os.geteuid() == 0:  # what root writes belongs to the owner of the folder, which the daemon is
            owner = state_dir.stat()
            os.setegid(owner.st_gid)
            os.seteuid(owner.st_uid)
        if not path.is_file() or read(path, _version) != newest_version():
            open_store(state_dir).close()
        with closing(connect(path)) as connection:
            connection.execute(f"PRAGMA busy_timeout = {BUSY_MS}")
            with transaction(connection):
                new_name = take_over(connection, state_dir)
            rename_file(state_dir, new_name)
            with transaction(connection):
                yield connection
            audit.keep_digests(connection, state_dir, len(audit.kept_digests(state_dir)))
    except (sqlite3.Error, OSError) as err:
        raise StoreError(f"{path}: {err}") from err


def _version(connection: sqlite3.Connection) -> int:
    return int(connection.execute("PRAGMA user_version").fetchone()[0])


def _all_keys(connection: sqlite3.Connection) -> list[AccessKey]:
    return [_of_row(row) for row in connection.execute("SELECT * FROM keys ORDER BY rowid")]


def _of_row(row: tuple[Any, ...]) -> AccessKey:
    sha256, name, scopes, *times, is_display = row
    return replace(AccessKey(sha256, name, tuple(scopes.split()), *times), is_display=bool(is_display))


def _insert(connection: sqlite3.Connection, key: AccessKey) -> bool:
    """Add a key, unless it is there already; return whether it was added."""
    row = {**asdict(key), "scopes": " ".join(key.scopes)}
    inserted = connection.execute(
        "INSERT INTO keys VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?) ON CONFLICT (sha256) DO NOTHING",
        tuple(row.values()),
    )
    return inserted.rowcount == 1
