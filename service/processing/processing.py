"""Process bundles from the spool to the store: on any worker, committed strictly in the order of the triggers.

Every job names the version of the background that it needs (`backgrounds`), and the calibration in use when
its bundle's turn began, so a result does not depend on the number of workers. A bundle that an earlier session left is
measured with the newest background that its session had learnt.
Every trigger that leaves the spool gets exactly one outcome here.
"""

import asyncio
import logging
import shutil
import time
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Protocol

from drivers.errors import RecordingError
from pipeline.frames import BundleKind, CameraId
from service.processing.backgrounds import BackgroundVersions, KeptBackground, LearntBackground, complete
from service.processing.left_bundles import Quarantine, job_folder
from service.processing.measure_job import (
    RESULT_FILES,
    MeasuredBundle,
    MeasureJob,
    RigFile,
    learn_background,
    measure,
)
from service.processing.spool import LeftBundle, Loss, SpooledBundle
from service.processing.worker_pool import JobPool
from service.processing.worker_slot import JobLostError
from service.results.fields import LossReason, Result, Verified
from service.results.record import lost_record

log = logging.getLogger(__name__)

SHUTDOWN = Loss(reason=LossReason.SHUTDOWN, detail="the daemon was stopped before this bundle was measured")

RUSH_SHARE = 0.5
"""Bundles that wait, for each worker, beyond which the next body is not refined."""
MAX_TURNS = 1000
"""Most bundles that wait for their commit, more than slots; behind them, losses wait in the spool."""


class BundleSource(Protocol):
    """The output side of the spool."""

    async def take(self) -> SpooledBundle | None: ...

    async def release(self, bundle: SpooledBundle, seq: int | None = None) -> None: ...


KeepDrop = Callable[[Result], Awaitable[None]]
"""Stores the observation of a drop once its result is durable; raises `OSError` when it cannot be written."""


class CollectsDrops(Protocol):
    """An open calibration or verification that collects drops of balls or stones."""

    @property
    def kind(self) -> BundleKind: ...

    async def observe(self, pool: JobPool, job: MeasureJob) -> KeepDrop:
        """Observe the drop that the job has measured, in a worker; its files are in the job's folder."""
        ...


@dataclass(frozen=True, slots=True)
class CalibrationInUse:
    """The calibration that the next bundle is measured with, its last verdict, and the collector of drops, if any."""

    rig_file: RigFile
    collector: CollectsDrops | None = None
    verified: Verified | None = None


Finish = Callable[[int, str, Result, Mapping[str, Path]], Awaitable[int]]
"""Makes an outcome durable, by session and bundle, with its files; returns its number."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ProcessingContext:
    """Parameters that all bundles of a session share."""

    session: int
    camera_ids: tuple[CameraId, ...]
    is_simulated: bool
    save_silhouettes: bool
    folder: Path  # exists; for the workers' files until the store has them
    checked: bool = True  # whether pixels are compared with their checksums, a pass over all of them
    can_rush: bool = False  # whether bodies are not refined while other bundles wait
    kept_background: KeptBackground | None = None  # of the last session, for the next one; None: none is kept


@dataclass(frozen=True, slots=True, kw_only=True)
class ProcessingObserver:
    """Functions that are called as bundles are processed."""

    on_progress: Callable[[], None]  # after every commit and at no other time
    on_empty_rig: Callable[[Mapping[str, Any]], None] = lambda optics: None  # optics of each exposure of it
    on_result: Callable[[Result], None] = lambda record: None  # each one, in their order, once it is durable
    on_measured: Callable[[MeasuredBundle], None] = lambda measured: None  # each measured or rejected one
    on_outcome: Callable[[float], None] = lambda delay_s: None  # from each trigger to its durable outcome
    on_stored: Callable[[float], None] = lambda took_s: None  # time that it took to make a result durable


@dataclass(frozen=True, slots=True)
class _Measured:
    bundle: MeasuredBundle
    folder: Path
    keep_drop: KeepDrop | None


_Outcome = _Measured | LearntBackground | Loss


@dataclass(frozen=True, slots=True)
class _Turn:
    """A bundle, with calibration, collector and background in use when its turn began."""

    bundle: SpooledBundle
    session: int
    rig_file: RigFile
    collector: CollectsDrops | None
    background: Path | None
    retired: tuple[Path, ...]  # versions of the background that neither this job nor a later one uses


class Processing:
    """Processes the bundles of a spool: `run` is its task, `abandon` ends it early."""

    def __init__(
        self,
        context: ProcessingContext,
        *,
        spool: BundleSource,
        pool: JobPool,
        finish: Finish,
        calibration: Callable[[], CalibrationInUse],
        observer: ProcessingObserver,
        quarantine: Quarantine | None = None,
    ) -> None:
        self._context = context
        self._spool = spool
        self._pool = pool
        self._finish = finish
        self._calibration = calibration
        self._observer = observer
        self._jobs: set[asyncio.Task[_Outcome]] = set()
        self._is_abandoned = False
        self._quarantine = quarantine
        self._backgrounds = BackgroundVersions(context.folder, context.kept_background)
        self._last_loss: Loss | None = None

    @property
    def background(self) -> Path | None:
        """The folder of the version that the next stone is measured with; it is removed some time after another."""
        return self._backgrounds.in_use

    async def run(self) -> None:
        """Process and commit every bundle of the spool; return when it is finished."""
        await self._backgrounds.restore()
        turns: asyncio.Queue[tuple[_Turn, asyncio.Task[_Outcome]] | None] = asyncio.Queue(MAX_TURNS)
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._commit_all(turns, tasks))
            while (bundle := await self._spool.take()) is not None:
                turn = await self._turn(bundle)
                job = tasks.create_task(self._process(turn))
                self._jobs.add(job)
                job.add_done_callback(self._jobs.discard)
                await turns.put((turn, job))
                if self._is_abandoned:
                    job.cancel()
                if bundle.is_background:
                    await self._backgrounds.learn(job)
            await turns.put(None)

    async def _turn(self, bundle: SpooledBundle) -> _Turn:
        """Begin the turn of a bundle; it waits for the background that it needs."""
        await self._backgrounds.restore_if_gone()
        if isinstance(bundle, LeftBundle):
            background = bundle.background or self._backgrounds.in_use
            return _Turn(bundle, bundle.session, self._calibration().rig_file, None, background, ())
        retired = await self._backgrounds.advance(bundle.is_background)
        calibration = self._calibration()
        collector = calibration.collector
        if collector is not None and collector.kind is not bundle.trigger.kind:
            collector = None
        session, background = self._context.session, self._backgrounds.in_use
        return _Turn(bundle, session, calibration.rig_file, collector, background, retired)

    def abandon(self) -> None:
        """Stop measuring: bundles without a result are lost, reason `shutdown`, and `run` returns soon."""
        self._is_abandoned = True
        for job in self._jobs:
            job.cancel()

    async def _commit_all(
        self, turns: "asyncio.Queue[tuple[_Turn, asyncio.Task[_Outcome]] | None]", tasks: asyncio.TaskGroup
    ) -> None:
        while (committed := await turns.get()) is not None:
            turn, job = committed
            bundle = turn.bundle
            await asyncio.wait([job])
            if turn.retired:  # no unfinished job was given it
                tasks.create_task(self._backgrounds.remove(turn.retired))
            if job.cancelled():
                outcome: _Outcome = bundle.content if isinstance(bundle.content, Loss) else SHUTDOWN
            else:
                outcome = job.result()
            seq = await self._commit(turn, outcome, tasks)
            if not isinstance(bundle, LeftBundle) and not bundle.is_background:
                self._observer.on_outcome((time.monotonic_ns() - bundle.trigger.received_ns) / 1e9)
            await self._spool.release(bundle, seq)
            self._observer.on_progress()

    async def _commit(self, turn: _Turn, outcome: _Outcome, tasks: asyncio.TaskGroup) -> int | None:
        """Make the outcome durable; return the number of a result that was measured or rejected, else None."""
        bundle = turn.bundle
        match outcome:
            case LearntBackground(path, optics):
                self._observer.on_empty_rig(optics)
                await self._backgrounds.keep(path, tasks)
            case Loss() if bundle.is_background:
                log.warning("background lost: %s (%s) bundle=%s", outcome.reason, outcome.detail, bundle.name)
            case Loss():
                # a repeated cause is logged once; every trigger has its record
                level = logging.DEBUG if outcome == self._last_loss else logging.WARNING
                named = f"session={turn.session} bundle={bundle.name}"
                log.log(level, "trigger lost: %s (%s) %s", outcome.reason, outcome.detail, named)
                self._last_loss = outcome
                record = lost_record(
                    bundle.trigger,
                    bundle=bundle.name,
                    reason=outcome.reason,
                    detail=outcome.detail,
                    calibration_id=turn.rig_file.calibration_id,
                    is_simulated=self._context.is_simulated,
                )
                await self._stored(turn, record, {})
                self._observer.on_result(record)
            case _Measured(measured, folder, keep_drop):
                files = {path.name: path for name in RESULT_FILES if (path := folder / name).exists()}
                self._last_loss = None
                record = measured.record
                if (verified := self._calibration().verified) is not None:
                    record = record.model_copy(update={"verification": verified})
                seq = await self._stored(turn, record, files)
                self._observer.on_result(record)
                self._observer.on_measured(measured)
                if keep_drop is not None:
                    try:
                        await keep_drop(record)
                    except OSError as err:  # the drop has its outcome; only the calibration lacks it
                        log.error("drop not kept for the calibration: %s bundle=%s", err, bundle.name)
                await asyncio.to_thread(shutil.rmtree, folder, ignore_errors=True)
                return seq
        return None

    async def _stored(self, turn: _Turn, record: Result, files: Mapping[str, Path]) -> int:
        """Make a record durable and return its number."""
        begun_s = time.monotonic()
        seq = await self._finish(turn.session, turn.bundle.name, record, files)
        self._observer.on_stored(time.monotonic() - begun_s)
        return seq

    async def _process(self, turn: _Turn) -> _Outcome:
        bundle, path = turn.bundle, turn.bundle.content
        if isinstance(path, Loss):
            return path
        is_background = bundle.is_background
        folder = self._backgrounds.new_folder() if is_background else self._context.folder / job_folder(path)
        try:
            return await (self._learn if is_background else self._measure)(path, turn, folder)
        except JobLostError as err:
            loss = Loss(reason=err.reason, detail=err.detail)
            if self._quarantine is not None and not is_background and not err.is_hosts:
                await asyncio.to_thread(self._quarantine.keep, path, turn.session, bundle.name)
        except RecordingError as err:
            loss = Loss(reason=LossReason.UNREADABLE, detail=err.problem)
        except FileNotFoundError:
            if not is_background:
                raise
            loss = Loss(reason=LossReason.UNREADABLE, detail="the spool was deleted")
        # files of failed jobs would fill the tmpfs
        await asyncio.to_thread(shutil.rmtree, folder, ignore_errors=True)
        return loss

    async def _learn(self, path: Path, turn: _Turn, folder: Path) -> LearntBackground:
        job = partial(
            learn_background,
            bundle_path=path,
            camera_ids=self._context.camera_ids,
            previous_path=turn.background,
            out_path=folder,
            threads=self._pool.threads_per_job,
        )
        optics = await self._pool.run(job)
        return LearntBackground(complete(folder), optics)

    async def _measure(self, path: Path, turn: _Turn, folder: Path) -> _Measured:
        job = MeasureJob(
            bundle_path=path,
            camera_ids=self._context.camera_ids,
            rig_file=turn.rig_file,
            background_path=turn.background,
            out_dir=folder,
            save_silhouettes=self._context.save_silhouettes,
            checked=self._context.checked,
            threads=self._pool.threads_per_job,
        )
        measured = await self._pool.run_when_idle(
            lambda: partial(measure, replace(job, is_rushed=self._is_rush()))
        )
        keep_drop = None if turn.collector is None else await turn.collector.observe(self._pool, job)
        return _Measured(measured, folder, keep_drop)

    def _is_rush(self) -> bool:
        """True when so many bundles wait that the next body is not refined."""
        return self._context.can_rush and self._pool.n_waiting > RUSH_SHARE * self._pool.size
