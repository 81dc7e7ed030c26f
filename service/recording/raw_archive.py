"""Frames of the newest stones, compressed beside their results: afterwards, and with what time is left over.

A process of its own does it, nicer than workers, so that neither latency nor measuring pays. It compresses on cores
that nobody else wants; while others wait, or come in a rush, it only copies, which takes a fraction of the time. What
waits is bounded: while stones come faster than even that, the frames of some are not kept, and it says so.
"""

import asyncio
import logging
import os
import time
from collections import deque
from collections.abc import Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from drivers.errors import RecordingError
from drivers.files.bundle_file import Compression, read_bundle, read_header, write_bundle
from drivers.files.durable import copy_past_cache, replacing, sync
from pipeline.frames import CameraId, FrameBundle
from service.processing.worker_pool import JobLostError, WorkerPool
from service.processing.worker_process import WarmUp, worker_boundary

log = logging.getLogger(__name__)

DEADLINE_S = 300.0
"""0.2 s of an idle core, but there may be none for long."""
RUSH, RUSH_S = 6, 1.0
"""So many stones in so short a time are a rush: no core is idle for long enough to compress one before the next."""
RECENT_S = 60.0
"""So long health warns of frames that were not kept."""
NAME = "stonefall-keep"
"""What `ps` and `top` call the process."""


class RawFolder(Protocol):
    """The part of the store that says where frames belong."""

    def raw_path(self, seq: int) -> Path: ...

    async def drop_old_raw(self, seq: int) -> None: ...


@dataclass(frozen=True, slots=True)
class KeepJob:
    """A bundle's file, and where it goes."""

    bundle_path: Path
    camera_ids: tuple[CameraId, ...]
    out_path: Path
    compression: Compression


def lower_priority(context: None) -> tuple[WarmUp, ...]:
    """Yield to workers, which are less nice, and to the daemon."""
    os.nice(14)
    return ()


def _run_when_idle() -> None:
    """Give this thread a core when nobody else wants it."""
    os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))


def keep(job: KeepJob) -> str | None:
    """Write the bundle, durably; why not, if the disk does not take it.

    Raises
    ------
    RecordingError
        Nothing of the bundle can be read.
    WorkerFailure
        Anything else.
    """
    bundle = None
    if job.compression == "none":  # kept as it is: to look at pixels and checksums would take as long
        read_header(job.bundle_path)
    else:
        bundle = read_bundle(job.bundle_path, job.camera_ids, mapped=True)
    with worker_boundary():
        try:
            _write(job, bundle)
        except OSError as err:
            return str(err.strerror)
    return None


def _write(job: KeepJob, bundle: FrameBundle | None) -> None:
    """Compressed, or, without the bundle, as it is."""
    if not job.out_path.parent.exists():  # of a result without files of its own
        job.out_path.parent.mkdir()
        sync(job.out_path.parent.parent)
    if bundle is not None:
        with ThreadPoolExecutor(1, "compress", _run_when_idle) as thread:
            writing = thread.submit(
                write_bundle, job.out_path, bundle, job.camera_ids, compression=job.compression
            )
            writing.result()
    else:
        with replacing(job.out_path) as unfinished:
            copy_past_cache(job.bundle_path, unfinished)


class RawArchive:
    """`run` is its task; `take` says whether it takes a file, `on_done` is called with each one taken."""

    def __init__(
        self,
        folder: RawFolder,
        camera_ids: tuple[CameraId, ...],
        on_done: Callable[[Path], Awaitable[None]],
        *,
        max_waiting: int,
    ) -> None:
        """`max_waiting`: bundles on tmpfs, 21 MB each, beside those of the spool."""
        self._folder = folder
        self._camera_ids = camera_ids
        self._on_done = on_done
        self._max_waiting = max_waiting
        self._waiting: asyncio.Queue[tuple[Path, int] | None] = asyncio.Queue()
        self.left_out = 0
        """Results whose frames were not kept."""
        self._last_reason = ""
        self._last_left_out_s = -RECENT_S
        self._taken_s: deque[float] = deque(maxlen=RUSH)

    @property
    def trouble(self) -> str | None:
        """That frames were not kept within the last minute."""
        if time.monotonic() - self._last_left_out_s > RECENT_S:
            return None
        return f"frames of {self.left_out} stones were not kept so far: {self._last_reason}"

    def take(self, path: Path, seq: int) -> bool:
        """Take over the file of the bundle of a result, unless too many are waiting."""
        if self._waiting.qsize() < self._max_waiting:
            self._waiting.put_nowait((path, seq))
            self._taken_s.append(time.monotonic())
            return True
        self._leave_out(seq, "they come faster than frames are written")
        return False

    def finish(self) -> None:
        """Take no more: `run` returns after the last one."""
        self._waiting.put_nowait(None)

    async def run(self) -> None:
        """Write what is taken, one after the other."""
        pool = WorkerPool(slots=1, deadline_s=DEADLINE_S, prepare=lower_priority, context=None, name=NAME)
        try:
            while (item := await self._waiting.get()) is not None:
                path, seq = item
                if pool.pids == []:
                    await pool.start()
                try:
                    job = KeepJob(path, self._camera_ids, self._folder.raw_path(seq), self._compression())
                    if (refusal := await pool.run(keep, job)) is None:
                        await self._folder.drop_old_raw(seq)
                    else:
                        self._leave_out(seq, refusal)
                except (JobLostError, RecordingError) as err:
                    self._leave_out(seq, str(err))
                await self._on_done(path)
        finally:
            pool.close()

    def _compression(self) -> Compression:
        is_rush = len(self._taken_s) == RUSH and self._taken_s[-1] - self._taken_s[0] < RUSH_S
        return "zstd" if self._waiting.empty() and not is_rush else "none"

    def _leave_out(self, seq: int, reason: str) -> None:
        level = logging.DEBUG if self.trouble else logging.WARNING
        self.left_out += 1
        self._last_reason = reason
        self._last_left_out_s = time.monotonic()
        log.log(level, "frames not kept: %s seq=%d", reason, seq)
