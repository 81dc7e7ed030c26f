"""All keys that are known now: those of the configuration, and those of the file, read anew whenever it changes."""

import hmac
import logging
import os
import sqlite3
from collections.abc import Sequence
from pathlib import Path

from service.base.status import Checks, trouble_check
from service.store import audit
from service.store.schema import transaction
from service.web.key_file import KEYS, KeyFileError, StoredKey, read_keys, sha256_of
from service.web.settings import ApiKey

log = logging.getLogger(__name__)

Version = tuple[int, int, int, int]


class KeyRing:
    """The keys of the configuration and of the store's folder; `refresh` before anything is asked."""

    def __init__(self, configured: Sequence[ApiKey], folder: Path) -> None:
        self._configured = tuple(configured)
        self._path = folder / KEYS
        self._version: Version | str | None = None  # of the file that was read, or why it could not be
        self.stored: tuple[StoredKey, ...] = ()
        """The keys of the file, those that were revoked or have expired among them."""
        self.trouble: str | None = None
        """Why no key of the file is accepted, None if they are."""
        self.is_noted = True
        """Whether the audit has the changes by `stonefall keys`; set by the caller that notes them."""

    @property
    def is_empty(self) -> bool:
        """Whether no key was ever made; after the last one was revoked, or when the file is damaged, it is not."""
        return not self._configured and not self.stored and self.trouble is None

    def use(self, configured: Sequence[ApiKey]) -> None:
        """Replace the keys of the configuration."""
        self._configured = tuple(configured)

    def checks(self) -> Checks:
        self.refresh()
        return {"keys": trouble_check(self.trouble)}

    def refresh(self) -> None:
        """Read the file if it is another one than at the last time; a look at the file takes microseconds."""
        try:
            version: Version | str | None = _version_of(self._path.stat())
        except FileNotFoundError:
            version = None
        except OSError as err:
            version = str(err.strerror)
        if version == self._version:
            return
        self._version = version
        self.stored, self.trouble = (), None
        try:
            if isinstance(version, str):
                raise KeyFileError(f"{self._path}: {version}")
            if version is not None:
                self.stored = read_keys(self._path)
        except KeyFileError as err:
            self.trouble = f"{err}: its keys are not accepted; mend it, or remove it and create them anew"
            log.error("keys: %s", self.trouble)
        else:
            log.info("keys read file=%s keys=%d", self._path, len(self.stored))
        self.is_noted = not self.stored

    def find(self, token: str) -> ApiKey | StoredKey | None:
        """Return the key of a token; compared in constant time, so that timing gives no hint to a guess."""
        digest = sha256_of(token)
        known: list[ApiKey | StoredKey] = [*self._configured, *self.stored]
        matching = [key for key in known if hmac.compare_digest(digest, key.sha256)]
        return matching[0] if matching else None

    def named(self, name: str) -> list[ApiKey | StoredKey]:
        """Return all keys of a name, those that were revoked or have expired among them."""
        known: list[ApiKey | StoredKey] = [*self._configured, *self.stored]
        return [key for key in known if key.name == name]


def note_keys(connection: sqlite3.Connection, keys: Sequence[StoredKey]) -> None:
    """Note in the audit which keys were created and revoked since this was noted last."""
    with transaction(connection):
        for key in keys:
            noted = dict(
                connection.execute(
                    "SELECT action, entry FROM audit WHERE subject = ? AND after ->> 'created_at' = ?",
                    (key.name, key.created_at),
                )
            )
            created = {"scopes": key.scopes, "created_at": key.created_at, "expires_at": key.expires_at}
            if "key created" not in noted:
                audit.note(connection, _command_of(key.created_by), "key created", key.name, after=created)
            if key.revoked_at is not None and "key revoked" not in noted:
                revoked = {**created, "revoked_at": key.revoked_at}
                audit.note(
                    connection,
                    _command_of(key.revoked_by or "?"),
                    "key revoked",
                    key.name,
                    before=created,
                    after=revoked,
                )


def _command_of(user: str) -> str:
    return f"stonefall keys of {user}"


def _version_of(status: os.stat_result) -> Version:
    """Identify a version of the file by times, size and inode; the change time also shows another owner or mode."""
    return (status.st_mtime_ns, status.st_ctime_ns, status.st_size, status.st_ino)
