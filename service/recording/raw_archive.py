"""Keep the raw frames of the newest stones beside their results, after measuring and with spare processor time.

A process of its own with a lower priority than the workers does it, so that it costs no latency. It compresses on idle
cores; while other bundles wait, or stones come in a rush, it only copies, in a fraction of the time. The number
of waiting bundles is bounded: while stones come even faster, the frames of some are not kept, and health reports it.
"""

import asyncio
import logging
import os
import time
from collections import deque
from collections.abc import Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Protocol

from drivers.errors import RecordingError
from drivers.files.bundle_file import Compression, read_bundle, read_header, write_bundle
from drivers.files.durable import copy_past_cache, replacing, sync
from pipeline.frames import CameraId
from service.base.errors import StoreError
from service.base.messages import Code, message
from service.base.status import Checks, trouble_check
from service.processing.worker_pool import WorkerPool
from service.processing.worker_process import lower_priority, worker_boundary
from service.processing.worker_slot import JobLostError

log = logging.getLogger(__name__)

DEADLINE_S = 300.0
"""Longest time for one bundle: it takes 0.2 s of an idle core, but none may be idle for long."""
RUSH, RUSH_S = 6, 1.0
"""This many stones within this time are a rush, in which a core is never idle for long enough to compress a bundle."""
RECENT_S = 60.0
"""Time for which health warns of frames that were not kept."""
PROCESS_NAME = "stonefall-keep"
"""Name of the process in `ps` and `top`."""
NICENESS = 14
"""Above that of the workers."""


class RawFolder(Protocol):
    """The place of raw frames in the store."""

    async def raw_path(self, seq: int) -> Path: ...

    async def drop_old_raw(self, seq: int) -> None: ...


def keep_frames(
    bundle_path: Path, camera_ids: tuple[CameraId, ...], out_path: Path, compression: Compression
) -> str | None:
    """Write the bundle of a file durably to another; return the problem of the disk if it cannot be written.

    Raises `RecordingError` when nothing of the bundle can be read, else `WorkerFailure`.
    """
    bundle = None
    if compression == "none":  # copied as it is: verifying pixels by their checksums would take as long
        read_header(bundle_path)
    else:
        bundle = read_bundle(bundle_path, camera_ids, mapped=True)
    with worker_boundary():
        try:
            if not out_path.parent.exists():  # the result has no other files
                out_path.parent.mkdir(parents=True)
                sync(out_path.parent.parent)
            if bundle is None:
                with replacing(out_path) as unfinished:
                    copy_past_cache(bundle_path, unfinished)
            else:
                compressing = partial(write_bundle, compression=compression)
                only_when_idle = partial(os.sched_setscheduler, 0, os.SCHED_IDLE, os.sched_param(0))
                with ThreadPoolExecutor(1, "compress", only_when_idle) as thread:
                    thread.submit(compressing, out_path, bundle, camera_ids).result()
        except OSError as err:
            return str(err.strerror)
    return None


class RawArchive:
    """Keeps raw frames in the store: `take` hands it a file, `run` is its task, `on_done` is called for each file."""

    def __init__(
        self,
        folder: RawFolder,
        camera_ids: tuple[CameraId, ...],
        on_done: Callable[[Path], Awaitable[None]],
        *,
        max_waiting: int,
    ) -> None:
        """`max_waiting`: most bundles waiting on tmpfs, 21 MB each, in addition to those of the spool."""
        self._folder = folder
        self._camera_ids = camera_ids
        self._on_done = on_done
        self._max_waiting = max_waiting
        self._waiting: asyncio.Queue[tuple[Path, int] | None] = asyncio.Queue()
        self.left_out = 0
        """Number of results whose frames were not kept."""
        self._last_reason = ""
        self._last_left_out_s = -RECENT_S
        self._taken_s: deque[float] = deque(maxlen=RUSH)

    @property
    def trouble(self) -> str | None:
        """Why frames were not kept within the last `RECENT_S`, None if all were."""
        if time.monotonic() - self._last_left_out_s > RECENT_S:
            return None
        return message(Code.ARCHIVE_LEFT_OUT, stones=self.left_out, reported=str(self._last_reason))

    def checks(self) -> Checks:
        return {"archive": trouble_check(self.trouble, self.left_out, "left out")}

    def take(self, path: Path, seq: int) -> bool:
        """Take over the file of a result's bundle; return False if too many are waiting."""
        if self._waiting.qsize() < self._max_waiting:
            self._waiting.put_nowait((path, seq))
            self._taken_s.append(time.monotonic())
            return True
        self._leave_out(seq, "stones come faster than frames are written")
        return False

    def finish(self) -> None:
        """Declare the end of all files: `run` returns after the last one."""
        self._waiting.put_nowait(None)

    async def run(self) -> None:
        """Write the files that were taken, one after the other."""
        pool = WorkerPool(
            slots=1, deadline_s=DEADLINE_S, prepare=lower_priority, context=NICENESS, name=PROCESS_NAME
        )
        try:
            while (item := await self._waiting.get()) is not None:
                path, seq = item
                is_rush = len(self._taken_s) == RUSH and self._taken_s[-1] - self._taken_s[0] < RUSH_S
                try:
                    out_path = await self._folder.raw_path(seq)
                    compression: Compression = "zstd" if self._waiting.empty() and not is_rush else "none"
                    keeping = partial(keep_frames, path, self._camera_ids, out_path, compression)
                    if (problem := await pool.run(keeping)) is None:
                        await self._folder.drop_old_raw(seq)
                    else:
                        self._leave_out(seq, problem)
                except (JobLostError, RecordingError, StoreError) as err:
                    self._leave_out(seq, str(err))
                await self._on_done(path)
        finally:
            pool.close()

    def _leave_out(self, seq: int, reason: str) -> None:
        level = logging.DEBUG if self.trouble else logging.WARNING
        self.left_out += 1
        self._last_reason = reason
        self._last_left_out_s = time.monotonic()
        log.log(level, "frames not kept: %s seq=%d", reason, seq)
