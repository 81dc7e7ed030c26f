"""Keys that `stonefall keys` creates and revokes: a file in the store's folder, which the daemon reads while it runs.

Of a token only the hash is kept; its 256 random bits cannot be guessed from that. A revoked key stays in the file, so
that its use is told from a wrong one and the audit can name who revoked it.
"""

import fcntl
import hashlib
import json
import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Literal

from pydantic import TypeAdapter, ValidationError

from drivers.files.bounded import read_bounded
from drivers.files.durable import replacing
from drivers.files.times import utc_now
from pipeline.frames import rfc3339
from service.base.errors import ServiceError
from service.web.settings import KEY_NAME, Scope

KEYS, LOCK = "keys.json", ".keys.lock"
PREFIX = "stonefall_"
"""Beginning of every token, which programs that search for secrets look for."""
TOKEN_BYTES = 32
MAX_KEYS = 1000
MAX_BYTES = 1_000_000


class KeyFileError(ServiceError):
    """The file of the keys cannot be read or written, or a key cannot be created or revoked."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredKey:
    """A key of the file; times are RFC 3339."""

    name: str
    sha256: str
    scopes: tuple[Scope, ...]
    created_at: str
    created_by: str
    expires_at: str | None = None
    revoked_at: str | None = None
    revoked_by: str | None = None

    def __post_init__(self) -> None:
        for time in (self.created_at, self.expires_at, self.revoked_at):
            if time is not None and rfc3339(datetime.fromisoformat(time)) != time:
                raise ValueError(
                    f"{time!r} is not a time as the daemon writes it, such as 2027-01-01T00:00:00.000Z"
                )

    def refusal(self, now: str) -> str | None:
        """Return the reason why the key is not accepted at a time, None if it is."""
        if self.revoked_at is not None:
            return f"key {self.name!r} was revoked at {self.revoked_at}"
        if self.expires_at is not None and now >= self.expires_at:
            return f"key {self.name!r} expired at {self.expires_at}"
        return None


@dataclass(frozen=True, slots=True, kw_only=True)
class KeyFile:
    """The content of the file, oldest key first."""

    format: Literal["stonefall-keys/1"] = "stonefall-keys/1"
    keys: tuple[StoredKey, ...] = ()


ADAPTER = TypeAdapter(KeyFile)


def read_keys(path: Path) -> tuple[StoredKey, ...]:
    """Return the keys of the file, none if there is no file; raise `KeyFileError` if it is damaged."""
    try:
        return ADAPTER.validate_json(read_bounded(path, MAX_BYTES)).keys
    except FileNotFoundError:
        return ()
    except OSError as err:
        raise KeyFileError(f"{path}: {err.strerror}") from err
    except ValidationError as err:
        error = err.errors(include_input=False)[0]
        field = ".".join(map(str, error["loc"]))
        raise KeyFileError(f"{path}: {field and f'{field}: '}{error['msg']}") from None


def create_key(
    folder: Path, name: str, scopes: tuple[Scope, ...], expires_at: str | None, by: str
) -> tuple[StoredKey, str]:
    """Add a key to the file of a store and return it with its token, which is nowhere else.

    Raises
    ------
    KeyFileError
        The name is no name, or that of a key that is accepted; or the file is damaged, or full.
    """
    if not KEY_NAME.fullmatch(name):
        raise KeyFileError(f"key {name!r}: a name has 1 to 64 letters, digits, '.', '-' and '_'")
    token = PREFIX + secrets.token_urlsafe(TOKEN_BYTES)
    now = utc_now()
    key = StoredKey(
        name=name,
        sha256=sha256_of(token),
        scopes=scopes,
        created_at=now,
        created_by=by,
        expires_at=expires_at,
    )
    with _locked(folder):
        keys = read_keys(folder / KEYS)
        if any(each.name == name and each.refusal(now) is None for each in keys):
            raise KeyFileError(f"there is a key {name!r}: revoke it first, or choose another name")
        if len(keys) >= MAX_KEYS:
            raise KeyFileError(f"{folder / KEYS}: has {MAX_KEYS} keys: remove old ones from the file")
        _write(folder, (*keys, key))
    return key, token


def revoke_key(folder: Path, name: str, by: str) -> None:
    """Revoke the key of this name.

    Raises
    ------
    KeyFileError
        There is none that is not revoked, or the file is damaged.
    """
    with _locked(folder):
        keys = read_keys(folder / KEYS)
        if not any(each.name == name and each.revoked_at is None for each in keys):
            raise KeyFileError(f"there is no key {name!r} to revoke in {folder / KEYS}")
        now = utc_now()
        _write(
            folder,
            tuple(
                replace(each, revoked_at=now, revoked_by=by)
                if each.name == name and each.revoked_at is None
                else each
                for each in keys
            ),
        )


def sha256_of(token: str) -> str:
    """Return the SHA-256 of a token, the only form in which it is stored."""
    return hashlib.sha256(token.encode()).hexdigest()


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Keep another command from writing the file at the same time."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o600)
    except OSError as err:
        raise KeyFileError(f"{folder}: {err.strerror}") from err
    try:
        _give_to_owner(descriptor, folder)
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def _write(folder: Path, keys: tuple[StoredKey, ...]) -> None:
    path = folder / KEYS
    try:
        with replacing(path, 0o600) as temporary, temporary.open("w", encoding="utf-8") as file:
            _give_to_owner(file.fileno(), folder)
            file.write(json.dumps(asdict(KeyFile(keys=keys)), indent=1) + "\n")
    except OSError as err:
        raise KeyFileError(f"{path}: {err.strerror}") from err


def _give_to_owner(descriptor: int, folder: Path) -> None:
    """Let the daemon read what root writes: a file belongs to the owner of the store's folder."""
    if os.geteuid() == 0:
        owner = folder.stat()
        os.fchown(descriptor, owner.st_uid, owner.st_gid)
