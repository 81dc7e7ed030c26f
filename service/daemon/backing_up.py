"""Back the store up by itself, every hour or as configured, and know why the last backup failed."""

import asyncio
import logging
import time

from service.base.errors import StoreError
from service.base.messages import Code, message
from service.base.status import Checks, trouble_check
from service.configuration.settings import StoreSettings
from service.store import Store
from service.store.history import backups_in

log = logging.getLogger(__name__)

RETRY_S = 300.0
"""Pause after a backup that failed."""


class BackingUp:
    """Makes backups: `run` is its task."""

    def __init__(self, store: Store, settings: StoreSettings) -> None:
        self._store = store
        self._settings = settings
        self._is_changed = asyncio.Event()
        self.trouble: str | None = None
        """Why the last backup failed, None if it did not."""

    def use(self, settings: StoreSettings) -> None:
        """Take another interval and number at once."""
        self._settings = settings
        self._is_changed.set()

    def checks(self) -> Checks:
        return {"backup": trouble_check(self.trouble)}

    async def run(self) -> None:
        """Make a backup whenever the newest one is too old."""
        pause_s = await asyncio.to_thread(self._due_in_s)
        while True:
            try:
                async with asyncio.timeout(pause_s if self._every_s > 0 else None):
                    await self._is_changed.wait()
                self._is_changed.clear()
                pause_s = await asyncio.to_thread(self._due_in_s)
            except TimeoutError:
                await self._back_up()
                pause_s = self._every_s if self.trouble is None else min(RETRY_S, self._every_s)

    @property
    def _every_s(self) -> float:
        return 3600 * self._settings.backup_every_h

    def _due_in_s(self) -> float:
        try:
            newest = max(backups_in(self._store.dir), default=None)
            age_s = self._every_s if newest is None else time.time() - newest.stat().st_mtime
        except OSError:
            return 0.0
        return max(self._every_s - max(age_s, 0.0), 0.0)

    async def _back_up(self) -> None:
        try:
            path = await self._store.back_up(self._settings.keep_backups)
        except (StoreError, OSError) as err:
            self.trouble = message(Code.BACKUP_FAILED, reported=str(err))
            log.error("%s", err)
        else:
            self.trouble = None
            log.info("store backed up file=%s", path)
