"""From the spool to the store: measured on any worker, committed strictly in the order of the triggers.

Every job names the version of the background that it needs (`background_versions`), and the calibration in use when
its bundle's turn began, so a result does not depend on the number of workers.
Every trigger that comes out of the spool ends here in exactly one outcome.
"""

import asyncio
import logging
import shutil
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from drivers.errors import RecordingError
from pipeline.frames import BundleKind, CameraId
from service.processing.background_keeping import KeptBackground
from service.processing.background_versions import BackgroundVersions, Learnt
from service.processing.measure_job import (
    MESH,
    SILHOUETTES,
    LearnJob,
    MeasureJob,
    RigFile,
    learn_background,
    measure,
)
from service.processing.spool import Loss, SpooledBundle
from service.processing.worker_pool import JobLostError, WorkerPool
from service.results.record import lost_record

log = logging.getLogger(__name__)

SHUTDOWN = Loss(reason="shutdown", detail="the daemon was stopped before this bundle was measured")


class BundleSource(Protocol):
    """The far side of the spool."""

    async def take(self) -> SpooledBundle | None: ...

    async def release(self, bundle: SpooledBundle, seq: int | None = None) -> None: ...


Record = Mapping[str, Any]
KeepDrop = Callable[[Record], Awaitable[None]]
"""Keeps what was observed of a drop, once its result is durable; `OSError` when that cannot be written."""


class DropCollector(Protocol):
    """A calibration or verification that waits for balls or stones."""

    @property
    def kind(self) -> BundleKind: ...

    async def observe(self, pool: WorkerPool, job: MeasureJob) -> KeepDrop:
        """Have a worker observe the drop that the job has measured; files may be left in the job's folder."""
        ...


class CalibrationInUse(Protocol):
    """Says what the next bundle is measured with, and who wants its outlines."""

    @property
    def rig_file(self) -> RigFile: ...

    @property
    def collector(self) -> DropCollector | None: ...


@dataclass(frozen=True, slots=True)
class FixedCalibration:
    """One calibration for all bundles."""

    rig_file: RigFile
    collector: DropCollector | None = None


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
    is_simulated: bool
    save_silhouettes: bool
    folder: Path  # exists; for the workers' files until the store has them
    checked: bool = (
        True  # whether pixels are compared with their checksums, which takes a pass over all of them
    )


@dataclass(frozen=True, slots=True)
class _Measured:
    record: dict[str, Any]
    folder: Path
    keep_drop: KeepDrop | None


KEPT = (MESH, SILHOUETTES)
"""What the store wants of a worker's folder; a worker that crashed may have left more."""


@dataclass(frozen=True, slots=True)
class JobInputs:
    """What was in use when a bundle's turn began."""

    rig_file: RigFile
    collector: DropCollector | None
    background: Path | None


@dataclass(frozen=True, slots=True)
class _Turn:
    bundle: SpooledBundle
    inputs: JobInputs
    retired: tuple[Path, ...]  # versions of the background that neither this job nor a later one uses
    job: asyncio.Task[_Measured | Learnt | Loss]

    @property
    def outcome(self) -> _Measured | Learnt | Loss:
        """Of the job, which is done."""
        if not self.job.cancelled():
            return self.job.result()
        return self.bundle.content if isinstance(self.bundle.content, Loss) else SHUTDOWN


class Processing:
    """The consumer of a spool: `run` is its task, `abandon` ends it early.

    `on_empty` is told what each exposure of the empty rig says about the cameras; `on_progress` is called
    after every commit and by nothing else.
    """

    def __init__(
        self,
        context: ProcessingContext,
        *,
        spool: BundleSource,
        pool: WorkerPool,
        results: ResultSink,
        calibration: CalibrationInUse,
        kept: KeptBackground | None = None,
        on_empty: Callable[[Mapping[str, Any]], None] = lambda optics: None,
        on_progress: Callable[[], None],
    ) -> None:
        self._context = context
        self._spool = spool
        self._pool = pool
        self._results = results
        self._calibration = calibration
        self._on_empty = on_empty
        self._on_progress = on_progress
        self._jobs: set[asyncio.Task[_Measured | Learnt | Loss]] = set()
        self._is_abandoned = False
        self._kept = kept
        self._keeping: asyncio.Task[None] | None = None
        self._backgrounds = BackgroundVersions()
        self._started = 0
        self._last_loss = ("", "")

    @property
    def has_background(self) -> bool:
        return self._backgrounds.in_use is not None

    async def run(self) -> None:
        """Return when the spool is finished and everything from it is committed."""
        if self._kept is not None:
            restored = self._context.folder / "00000000"
            self._backgrounds = BackgroundVersions(await asyncio.to_thread(self._kept.restore, restored))
        turns: asyncio.Queue[_Turn | None] = asyncio.Queue()
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._commit_all(turns, tasks))
            while (bundle := await self._spool.take()) is not None:
                retired = await self._backgrounds.turn_of(bundle.is_background)
                collector = self._calibration.collector
                if collector is not None and collector.kind is not bundle.trigger.kind:
                    collector = None
                inputs = JobInputs(self._calibration.rig_file, collector, self._backgrounds.in_use)
                job = tasks.create_task(self._process(bundle, inputs))
                self._jobs.add(job)
                job.add_done_callback(self._jobs.discard)
                turns.put_nowait(_Turn(bundle, inputs, retired, job))
                if self._is_abandoned:
                    job.cancel()
                if bundle.is_background:
                    await self._backgrounds.learn(job)
            turns.put_nowait(None)

    def abandon(self) -> None:
        """Measure nothing more: what has no result yet becomes lost `shutdown`, and `run` returns soon."""
        self._is_abandoned = True
        for job in self._jobs:
            job.cancel()

    async def _commit_all(self, turns: "asyncio.Queue[_Turn | None]", tasks: asyncio.TaskGroup) -> None:
        while (turn := await turns.get()) is not None:
            await asyncio.wait([turn.job])
            for path in turn.retired:  # all jobs that were given it are through
                tasks.create_task(self._remove(path, self._keeping))
            seq = await self._commit(turn, tasks)
            await self._spool.release(turn.bundle, seq)
            self._on_progress()

    async def _commit(self, turn: _Turn, tasks: asyncio.TaskGroup) -> int | None:
        """Make the outcome durable; returns the number of a result that was measured or rejected."""
        bundle = turn.bundle
        match outcome := turn.outcome:
            case Learnt(path, optics):
                self._on_empty(optics)
                if self._keeping is not None:
                    await self._keeping
                if self._kept is not None:  # no stone waits for the disk
                    self._keeping = tasks.create_task(asyncio.to_thread(self._kept.keep, path))
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
                    calibration_id=turn.inputs.rig_file.calibration_id,
                    is_simulated=self._context.is_simulated,
                )
                await self._results.finish(self._context.session, bundle.name, record)
            case _Measured(record, folder, keep_drop):
                files = {path.name: path for name in KEPT if (path := folder / name).exists()}
                self._last_loss = ("", "")
                seq = await self._results.finish(self._context.session, bundle.name, record, files)
                if keep_drop is not None:
                    try:
                        await keep_drop(record)
                    except OSError as err:  # the ball has its outcome; a calibration lacks it
                        log.error("ball not kept for the calibration: %s bundle=%s", err, bundle.name)
                await asyncio.to_thread(shutil.rmtree, folder)
                log.debug("%s seq=%d bundle=%s", record["outcome"], seq, bundle.name)
                return seq
        return None

    async def _remove(self, path: Path, keeping: "asyncio.Task[None] | None") -> None:
        """Remove a version of the background, which may just be read to be kept."""
        if keeping is not None:
            await asyncio.wait([keeping])
        await asyncio.to_thread(shutil.rmtree, path)

    async def _process(self, bundle: SpooledBundle, inputs: JobInputs) -> _Measured | Learnt | Loss:
        if isinstance(bundle.content, Loss):
            return bundle.content
        self._started += 1
        folder = self._context.folder / f"{self._started:08d}"
        try:
            if bundle.is_background:
                return await self._learn(bundle.content, inputs.background, folder)
            return await self._measure(bundle.content, inputs, folder)
        except JobLostError as err:
            loss = Loss(reason=err.reason, detail=err.detail)
        except RecordingError as err:
            loss = Loss(reason="unreadable", detail=err.problem)
        # what a job had written by then would fill the tmpfs
        await asyncio.to_thread(shutil.rmtree, folder, ignore_errors=True)
        return loss

    async def _learn(self, path: Path, background: Path | None, out_path: Path) -> Learnt:
        job = LearnJob(
            bundle_path=path,
            camera_ids=self._context.camera_ids,
            previous_path=background,
            out_path=out_path,
            threads=self._pool.share,
        )
        return Learnt(out_path, await self._pool.run(learn_background, job))

    async def _measure(self, path: Path, inputs: JobInputs, folder: Path) -> _Measured:
        job = MeasureJob(
            bundle_path=path,
            camera_ids=self._context.camera_ids,
            rig_file=inputs.rig_file,
            background_path=inputs.background,
            out_dir=folder,
            save_silhouettes=self._context.save_silhouettes,
            checked=self._context.checked,
            threads=self._pool.share,
        )
        record = await self._pool.run(measure, job)
        collector = inputs.collector
        keep_drop = None if collector is None else await collector.observe(self._pool, job)
        return _Measured(record, folder, keep_drop)
