"""Remove by itself what the store need not keep any longer, in small steps, and know how long the disk suffices."""

import asyncio
import logging
import math
import os
import shutil
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TypeVar, TypeVarTuple

from service.base.errors import StoreError
from service.base.status import Checks
from service.recording.live_recording import RecordingState
from service.recording.recordings import Recordings
from service.store import Store
from service.store.checks import RetentionFacts, retention_checks, store_use
from service.store.particle_files import path_of
from service.store.retention import (
    STEP,
    Disk,
    RetentionLimits,
    consumers,
    files_going,
    is_older,
    mark_files,
    note_gone,
    remove_results,
)
from service.store.sweep import sweep

log = logging.getLogger(__name__)

T = TypeVar("T")
Arguments = TypeVarTuple("Arguments")

STEP_PAUSE_S, LOOK_S = 0.5, 30.0
"""Pause after a step that removed something, and after one that did not."""
SWEEP_S = 24 * 3600.0


class Retaining:
    """Removes files, results and recordings that are due: `run` is its task, `facts` says what health is to know."""

    def __init__(
        self,
        store: Store,
        recordings: Recordings,
        limits: RetentionLimits,
        *,
        is_clock_sure: Callable[[], bool] = lambda: True,
        disk_of: Callable[[Path], Disk] | None = None,
        now: Callable[[], datetime] = lambda: datetime.now(UTC),
    ) -> None:
        """Without a sure clock nothing is removed for its age."""
        self._store = store
        self._recordings = recordings
        self._limits = limits
        self._is_clock_sure = is_clock_sure
        self._disk_of = disk_of or _disk_of
        self._now = now
        self._is_ended = threading.Event()
        self.facts = RetentionFacts(warn_days=limits.warn_days)

    def use(self, limits: RetentionLimits) -> None:
        """Apply other limits from the next look on."""
        self._limits = limits
        self.facts = replace(self.facts, warn_days=limits.warn_days)

    def checks(self) -> Checks:
        return retention_checks(self.facts)

    async def run(self) -> None:
        """Remove what is due, whenever something is."""
        looked_s = swept_s = -math.inf
        with LowThread() as thread:
            try:
                while True:
                    is_more, trouble = False, None
                    try:
                        is_more = await self.step(thread)
                        if not is_more or time.monotonic() - looked_s >= LOOK_S:
                            looked_s = time.monotonic()
                            await self.look(thread)
                        if not is_more and time.monotonic() - swept_s >= SWEEP_S:
                            swept_s = time.monotonic()
                            await thread.run(sweep, self._store.dir, lambda: not self._is_ended.is_set())
                    except (StoreError, OSError) as err:
                        trouble = str(err)
                        log.error("retention: %s", err)
                    self.facts = replace(self.facts, trouble=trouble)
                    await asyncio.sleep(STEP_PAUSE_S if is_more else LOOK_S)
            finally:
                self._is_ended.set()

    async def step(self, thread: "LowThread") -> bool:
        """Remove a few of the results and files that are due; return whether there may be more."""
        store, now, limits = self._store, self._now(), self._sure_limits()
        if store.trouble is not None:  # the write would wait in the queue of results
            return False
        disk = await thread.run(self._disk_of, store.dir)
        n_marked = await store.write(mark_files, limits, disk, now)
        going = await store.read(files_going)
        for _, folder in going:
            await thread.run(_remove, path_of(store.particles_dir, folder))
        if going:
            await store.write(note_gone, [seq for seq, _ in going])
        n_results = await store.write(remove_results, limits, now)
        return STEP in (n_marked, len(going), n_results)

    async def look(self, thread: "LowThread") -> None:
        """Remove recordings that are due, and find out how long the disk suffices."""
        now, limits = self._now(), self._sure_limits()
        recordings_bytes = 0
        for recording in await self._recordings.all():
            is_due = is_older(recording.created_at, limits.recordings_days, now)
            if recording.state is RecordingState.COMPLETE and is_due:
                log.info("recording removed for its age recording=%s", recording.name)
                await self._recordings.delete(recording.name)
            else:
                recordings_bytes += recording.bytes
        disk = await thread.run(self._disk_of, self._store.dir)
        parked = await self._store.read(consumers)
        self.facts = replace(
            self.facts,
            use=await self._store.read(store_use, self._limits, disk, now),
            recordings_bytes=recordings_bytes,
            overrun=tuple(consumer.name for consumer in parked if consumer.is_overrun),
        )

    def _sure_limits(self) -> RetentionLimits:
        if self._is_clock_sure():
            return self._limits
        return replace(self._limits, files_days=0, results_days=0, recordings_days=0)


class LowThread(ThreadPoolExecutor):
    """A thread of a low priority for what the disk may take long to do; its end is not waited for."""

    def __init__(self) -> None:
        super().__init__(1, "retention", _lower_priority)

    def __exit__(self, *_: object) -> None:
        self.shutdown(wait=False, cancel_futures=True)

    async def run(self, work: Callable[[*Arguments], T], *args: *Arguments) -> T:
        """Return `work(*args)`."""
        return await asyncio.get_running_loop().run_in_executor(self, work, *args)


def _lower_priority() -> None:
    os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), 15)


def _remove(folder: Path) -> None:
    if folder.exists():
        shutil.rmtree(folder)


def _disk_of(folder: Path) -> Disk:
    usage = shutil.disk_usage(folder)
    return Disk(total_bytes=usage.total, free_bytes=usage.free)
