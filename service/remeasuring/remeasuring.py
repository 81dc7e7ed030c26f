"""Measure stones of the store again, one at a time, beside the measuring of those that fall.

A process of its own with the lowest priority does it; it is started when it is asked for and ends when nobody asks any
more. Frames come from the archive, the calibration is the one that the result names, algorithm and parameters are
today's, and so is the background: versions of it are not archived. What is measured with today's algorithm already is
not measured again, unless its refinement was left out in a rush: whoever asks for all stones of a lot may be killed and
ask again.
"""

import asyncio
import logging
import os
import shutil
from collections.abc import Callable, Sequence
from enum import StrEnum
from pathlib import Path
from typing import Protocol

from drivers.errors import RecordingError
from drivers.files.rig_file import read_rig
from drivers.interfaces import FrameLossReason
from pipeline.segmentation.silhouette import FoundBy
from pipeline.views.dropped import DropCause, DroppedView
from service.errors import ServiceError
from service.processing import measure_job
from service.processing.measure_job import (
    RESULT_FILES,
    MeasuredBundle,
    MeasureJob,
    RigFile,
    WorkerContext,
    measure,
)
from service.processing.worker_pool import JobLostError, WorkerPool, WorkerStartError
from service.processing.worker_process import WarmUp
from service.remeasuring.revising import revise
from service.results.fields import Outcome
from service.results.refinement import RUSH
from service.results.version import ALGORITHM_VERSION
from service.store import Record, Store
from service.store.particle_files import RAW, first_seq

log = logging.getLogger(__name__)

DEADLINE_S = 300.0
"""Longest time for one stone: it takes 0.1 s of an idle core, but none may be idle for long."""
NICER = 9
"""Added to the workers' 10: the least share of a core that something else wants."""
PROCESS_NAME = "stonefall-again"
"""Name of the process in `ps` and `top`."""
REST_S = 60.0
"""Time without a request after which the process ends; it holds as much memory as a worker."""


def prepare(context: WorkerContext) -> Sequence[WarmUp]:
    """Prepare this process as a worker, with the lowest priority."""
    os.nice(NICER)
    return measure_job.prepare(context)


def new_pool(context: WorkerContext) -> WorkerPool:
    """Return the pool of the one process, not started; its context is that of the workers."""
    return WorkerPool(slots=1, deadline_s=DEADLINE_S, prepare=prepare, context=context, name=PROCESS_NAME)


DAMAGED = str(DroppedView(DropCause.NO_FRAME, FrameLossReason.DAMAGED))
"""Why a view is missing whose page cannot be read."""


class Hindrance(StrEnum):
    """Why a stone cannot be measured again; a word of the REST contract."""

    NO_FRAMES = "not-kept"
    NO_CALIBRATION = "calibration-gone"
    NO_BACKGROUND = "no-background"
    FAILED = "not-measured"


class RemeasureError(ServiceError):
    """A stone is not measured again; its result stays as it is."""

    def __init__(self, why: Hindrance, detail: str) -> None:
        super().__init__(detail)
        self.why = why


class RigFiles(Protocol):
    """The calibrations, by the id that results name."""

    def rig_file_of(self, calibration_id: str | None) -> RigFile | None: ...


class Background(Protocol):
    """The processing of the stones that fall; it knows the background in use."""

    @property
    def background(self) -> Path | None: ...


class Pool(Protocol):
    """A pool of one process, not started."""

    async def start(self) -> None: ...

    async def run(
        self, function: Callable[[MeasureJob], MeasuredBundle], job: MeasureJob
    ) -> MeasuredBundle: ...

    def close(self) -> None: ...


class Remeasuring:
    """Measures stones again: `measure`, as often as wanted, then `close`; all on the event loop."""

    def __init__(
        self,
        store: Store,
        calibrations: RigFiles,
        processing: Background,
        *,
        make_pool: Callable[[], Pool],
        folder: Path,
        save_silhouettes: bool,
    ) -> None:
        """`folder`: on tmpfs, for the files of the stone in work and a version of the background."""
        self._store = store
        self._calibrations = calibrations
        self._processing = processing
        self._make_pool = make_pool
        self._folder = folder / "again"
        self._save_silhouettes = save_silhouettes
        self._turn = asyncio.Lock()
        self._pool: Pool | None = None
        self._resting: asyncio.TimerHandle | None = None
        self._job: asyncio.Task[MeasuredBundle] | None = None
        self._linked: tuple[Path, Path] | None = None  # a version of the background, and its links
        self._n_linked = 0
        self._is_closed = False

    async def measure(self, name: str, who: str) -> bool:
        """Revise the stone with this id; return False if its newest result is all that today's algorithm can say.

        Raises
        ------
        RemeasureError
            It cannot be measured again.
        """
        async with self._turn:
            record = await self._store.particle(name)
            if record is None or record["outcome"] == Outcome.LOST:
                raise RemeasureError(Hindrance.NO_FRAMES, f"{name} never had frames")
            was_rushed = record.get("refinement_fallback") == RUSH
            if record.get("algorithm_version") == ALGORITHM_VERSION and not was_rushed:
                return False
            try:
                job = await self._job_for(record)
                measured = await self._measured(job)
                _require_sound(record, measured.record)
                files = {path.name: path for each in RESULT_FILES if (path := job.out_dir / each).exists()}
                seq = await self._store.write(
                    revise, self._store.particles_dir, name, measured.record, files, who
                )
            except RecordingError as err:
                raise RemeasureError(Hindrance.FAILED, f"{name}: {err.problem}") from err
            except (JobLostError, WorkerStartError) as err:
                raise RemeasureError(Hindrance.FAILED, f"{name}: {err}") from err
            finally:
                await asyncio.to_thread(shutil.rmtree, self._out_dir, ignore_errors=True)
                self._rest_later()
            if seq is None:
                raise RemeasureError(Hindrance.NO_FRAMES, f"the files of {name} were just removed")
            log.info("measured again id=%s seq=%d by=%s", name, seq, who)
            return True

    def close(self) -> None:
        """End the process, and what it measures; requests from now on are refused."""
        self._is_closed = True
        if self._job is not None:
            self._job.cancel()
        self._rest()

    @property
    def _out_dir(self) -> Path:
        return self._folder / "out"

    async def _job_for(self, record: Record) -> MeasureJob:
        """Return how the stone is to be measured; raise `RemeasureError` when something for it is gone."""
        name, calibration_id = record["id"], record.get("calibration_id")
        frames = await self._store.folder(first_seq(name)) / RAW
        if record["files_removed"] is not None or not await asyncio.to_thread(frames.is_file):
            raise RemeasureError(Hindrance.NO_FRAMES, f"the frames of {name} are not kept any more")
        rig_file = self._calibrations.rig_file_of(calibration_id)
        if rig_file is None:
            raise RemeasureError(
                Hindrance.NO_CALIBRATION, f"{name}: calibration {calibration_id} is not kept"
            )
        try:
            rig = await asyncio.to_thread(read_rig, rig_file.path)
        except RecordingError as err:
            raise RemeasureError(Hindrance.NO_CALIBRATION, f"{name}: {err}") from err
        background = await asyncio.to_thread(self._held_background)
        if background is None and FoundBy.BACKGROUND in record.get("segmenters", {}).values():
            raise RemeasureError(
                Hindrance.NO_BACKGROUND, "the empty rig was not exposed yet: arm the rig, or wait a moment"
            )
        return MeasureJob(
            bundle_path=frames,
            camera_ids=tuple(camera.id for camera in rig.cameras),
            rig_file=rig_file,
            background_path=background,
            out_dir=self._out_dir,
            save_silhouettes=self._save_silhouettes,
        )

    def _held_background(self) -> Path | None:
        """Return the background in use as links of our own, for the version may be removed meanwhile; blocks."""
        while (in_use := self._processing.background) is not None:
            if self._linked is not None and self._linked[0] == in_use:
                return self._linked[1]
            shutil.rmtree(self._folder, ignore_errors=True)
            self._n_linked += 1
            links = self._folder / f"background-{self._n_linked}"
            try:
                shutil.copytree(in_use, links, copy_function=os.link)
            except OSError:
                if self._processing.background == in_use:
                    raise
            if self._processing.background == in_use:  # or it may have been half removed already
                self._linked = in_use, links
        return None

    async def _measured(self, job: MeasureJob) -> MeasuredBundle:
        """Return what the process has measured; it is started if it rests."""
        if self._resting is not None:
            self._resting.cancel()
        self._job = asyncio.create_task(self._run(job))
        try:
            await asyncio.wait([self._job])
            if self._job.cancelled():
                raise RemeasureError(Hindrance.FAILED, "the daemon stops")
            return self._job.result()
        finally:
            if (
                not self._job.done()
            ):  # whoever asked was given up: nothing of this may get among the next one's files
                self._job.cancel()
                self._rest()
            self._job = None

    async def _run(self, job: MeasureJob) -> MeasuredBundle:
        if self._is_closed:
            raise asyncio.CancelledError
        if self._pool is None:
            pool = self._make_pool()
            try:
                await pool.start()
            except BaseException:
                pool.close()
                raise
            self._pool = pool
        return await self._pool.run(measure, job)

    def _rest_later(self) -> None:
        if self._resting is not None:
            self._resting.cancel()
        if not self._is_closed:
            self._resting = asyncio.get_running_loop().call_later(REST_S, self._rest)

    def _rest(self) -> None:
        """End the process; it is started again when it is needed."""
        if self._resting is not None:
            self._resting.cancel()
            self._resting = None
        if self._pool is not None:
            self._pool.close()
            self._pool = None


def _require_sound(before: Record, after: Record) -> None:
    """Raise `RemeasureError` if a page of the archive was damaged since: a result must not become worse for that."""
    damaged = [
        camera
        for camera, why in after["dropped_views"].items()
        if why == DAMAGED and camera in before["views"]
    ]
    if damaged:
        raise RemeasureError(Hindrance.FAILED, f"{before['id']}: frames of {', '.join(damaged)} are damaged")
