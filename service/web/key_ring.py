"""All keys that are known now: those of the configuration, and those of the store, read anew when it has changed."""

import logging
import sqlite3
from collections.abc import Sequence

from service.base.errors import StoreError
from service.base.messages import Code, message
from service.base.status import Checks, trouble_check
from service.store import Store
from service.store.keys import AccessKey, known_keys, sha256_of
from service.web.settings import ApiKey

log = logging.getLogger(__name__)


class KeyRing:
    """The keys of the configuration and of the store; `refresh` before anything is asked."""

    def __init__(self, configured: Sequence[ApiKey], store: Store) -> None:
        self._store = store
        self._version: int | None = None  # of the store, when its keys were read
        self._stored: list[AccessKey] = []
        self._may_be_more = True
        self._trouble: str | None = None
        self.use(configured)

    @property
    def is_empty(self) -> bool:
        """Whether no key was ever made; after the last one was revoked, or while they cannot be read, it is not."""
        return not self._by_sha256 and not self._may_be_more

    def use(self, configured: Sequence[ApiKey]) -> None:
        """Replace the keys of the configuration."""
        self._configured = [AccessKey(key.sha256, key.name, key.scopes) for key in configured]
        self._by_sha256 = {key.sha256: key for key in (*self._stored, *self._configured)}

    def checks(self) -> Checks:
        self.refresh()
        trouble = self._trouble and message(Code.KEYS_UNREADABLE, reported=self._trouble)
        return {"keys": trouble_check(trouble)}

    def refresh(self) -> None:
        """Read the keys if the store has changed since; a look at that takes microseconds.

        While it cannot be read, those that were read before are accepted.
        """
        try:
            version = self._store.read_here(_version)
            if version == self._version:
                return
            stored = self._store.read_here(known_keys)
        except StoreError as err:
            if self._trouble != str(err):
                log.error("keys: %s", err)
            self._version, self._trouble = None, str(err)
            return
        self._version, self._trouble, self._may_be_more = version, None, False
        if stored != self._stored:
            log.info("keys read keys=%d", len(stored))
            self._stored = stored
            self._by_sha256 = {key.sha256: key for key in (*stored, *self._configured)}

    def find(self, token: str) -> AccessKey | None:
        """Return the key of a token, which may have been revoked or have expired; None if there is none."""
        return self.of_sha256(sha256_of(token))

    def of_sha256(self, sha256: str) -> AccessKey | None:
        """Return the key with a hash: what a lookup's time says of hashes gives no hint to a guess of tokens."""
        return self._by_sha256.get(sha256)


def _version(connection: sqlite3.Connection) -> int:
    """Return a number that another one replaces with each change by another connection."""
    return int(connection.execute("PRAGMA data_version").fetchone()[0])
