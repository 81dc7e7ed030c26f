"""From the spool to the store: measured on any worker, committed strictly in the order of the triggers.

An exposure of the empty rig becomes a new version of the background before any later bundle is started,
and every job names the version it needs, so a result does not depend on the number of workers.
Every trigger that comes out of the spool ends here in exactly one outcome.
"""

import asyncio
import logging
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from drivers.errors import RecordingError
from pipeline.frames import CameraId
from service.kept_background import KeptBackground
from service.record import lost_record
from service.spool import Loss, SpooledBundle
from service.worker_job import LearnJob, MeasureJob, learn_background, measure
from service.workers import JobLostError, WorkerPool

log = logging.getLogger(__name__)

SHUTDOWN = Loss(reason="shutdown", detail="the daemon was stopped before this bundle was measured")


class BundleSource(Protocol):
    """The far side of the spool."""

    async def take(self) -> SpooledBundle | None: ...

    async def release(self, bundle: SpooledBundle) -> None: ...


class ResultSink(Protocol):
    """The part of the store that takes outcomes."""

    async def finish(
        self, session: int, bundle: str, record: Mapping[str, Any], files: Mapping[str, Path] | None = None
    ) -> int: ...


@dataclass(frozen=True, slots=True, kw_only=True)
class ProcessingContext:
    """What all bundles of a session have in common."""

    session: int
    camera_ids: tuple[CameraId, ...]
    calibration_id: str
    is_simulated: bool
    archive_raw: bool
    save_silhouettes: bool
    folder: Path  # exists; for the workers' files until the store has them


@dataclass(frozen=True, slots=True)
class _Measured:
    record: dict[str, Any]
    folder: Path


KEPT = ("mesh.ply", "silhouettes", "bundle.tiff")
"""What the store wants of a worker's folder; a worker that crashed may have left more."""


@dataclass(frozen=True, slots=True)
class _Learnt:
    path: Path
    retired: Path | None  # the version that no later job uses


class Processing:
    """The consumer of a spool: `run` is its task, `abandon` ends it early.

    `on_progress` is called after every commit and by nothing else.
    """

    def __init__(
        self,
        context: ProcessingContext,
        *,
        spool: BundleSource,
        pool: WorkerPool,
        results: ResultSink,
        kept: KeptBackground | None = None,
        on_progress: Callable[[], None],
    ) -> None:
        self._context = context
        self._spool = spool
        self._pool = pool
        self._results = results
        self._on_progress = on_progress
        self._jobs: set[asyncio.Task[_Measured | _Learnt | Loss]] = set()
        self._is_abandoned = False
        self._kept = kept
        self._background: Path | None = None
        self._started = 0
        self._last_loss = ("", "")

    @property
    def has_background(self) -> bool:
        return self._background is not None

    async def run(self) -> None:
        """Return when the spool is finished and everything from it is committed."""
        if self._kept is not None:
            restored = self._context.folder / "00000000.npz"
            self._background = await asyncio.to_thread(self._kept.restore, restored)
        turns: asyncio.Queue[_Turn | None] = asyncio.Queue()
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._commit_all(turns))
            while (bundle := await self._spool.take()) is not None:
                job = tasks.create_task(self._process(bundle))
                self._jobs.add(job)
                job.add_done_callback(self._jobs.discard)
                turns.put_nowait((bundle, job))
                if self._is_abandoned:
                    job.cancel()
                if bundle.is_background:
                    await asyncio.wait([job])
            turns.put_nowait(None)

    def abandon(self) -> None:
        """Measure nothing more: what has no result yet becomes lost `shutdown`, and `run` returns soon."""
        self._is_abandoned = True
        for job in self._jobs:
            job.cancel()

    async def _commit_all(self, turns: "asyncio.Queue[_Turn | None]") -> None:
        while (turn := await turns.get()) is not None:
            bundle, job = turn
            await asyncio.wait([job])
            abandoned = bundle.content if isinstance(bundle.content, Loss) else SHUTDOWN
            await self._commit(bundle, abandoned if job.cancelled() else job.result())
            await self._spool.release(bundle)
            self._on_progress()

    async def _commit(self, bundle: SpooledBundle, outcome: _Measured | _Learnt | Loss) -> None:
        match outcome:
            case _Learnt(path, retired):
                if self._kept is not None:
                    await asyncio.to_thread(self._kept.keep, path)
                # its turn has come, so all jobs that were given the old version are through
                if retired is not None:
                    await asyncio.to_thread(retired.unlink)
            case Loss() if bundle.is_background:
                log.warning("background lost: %s (%s) bundle=%s", outcome.reason, outcome.detail, bundle.name)
            case Loss(reason=reason, detail=detail):
                # a cause that lasts is logged once; every trigger has its record
                level = logging.DEBUG if (reason, detail) == self._last_loss else logging.WARNING
                log.log(level, "trigger lost: %s (%s) bundle=%s", reason, detail, bundle.name)
                self._last_loss = (reason, detail)
                record = lost_record(
                    bundle.trigger,
                    bundle=bundle.name,
                    reason=reason,
                    detail=detail,
                    calibration_id=self._context.calibration_id,
                    is_simulated=self._context.is_simulated,
                )
                await self._results.finish(self._context.session, bundle.name, record)
            case _Measured(record, folder):
                files = {path.name: path for name in KEPT if (path := folder / name).exists()}
                self._last_loss = ("", "")
                seq = await self._results.finish(self._context.session, bundle.name, record, files)
                await asyncio.to_thread(shutil.rmtree, folder)
                log.debug("%s seq=%d bundle=%s", record["outcome"], seq, bundle.name)

    async def _process(self, bundle: SpooledBundle) -> _Measured | _Learnt | Loss:
        if isinstance(bundle.content, Loss):
            return bundle.content
        self._started += 1
        folder = self._context.folder / f"{self._started:08d}"
        try:
            if bundle.is_background:
                return await self._learn(bundle.content, folder.with_suffix(".npz"))
            return await self._measure(bundle.content, folder)
        except JobLostError as err:
            return Loss(reason=err.reason, detail=err.detail)
        except RecordingError as err:
            return Loss(reason="unreadable", detail=err.problem)

    async def _learn(self, path: Path, out_path: Path) -> _Learnt:
        job = LearnJob(
            bundle_path=path,
            camera_ids=self._context.camera_ids,
            previous_path=self._background,
            out_path=out_path,
        )
        await self._pool.run(learn_background, job)
        retired, self._background = self._background, out_path
        return _Learnt(out_path, retired)

    async def _measure(self, path: Path, folder: Path) -> _Measured:
        job = MeasureJob(
            bundle_path=path,
            camera_ids=self._context.camera_ids,
            background_path=self._background,
            out_dir=folder,
            archive=self._context.archive_raw,
            save_silhouettes=self._context.save_silhouettes,
        )
        return _Measured(await self._pool.run(measure, job), folder)


_Turn = tuple[SpooledBundle, asyncio.Task[_Measured | _Learnt | Loss]]
