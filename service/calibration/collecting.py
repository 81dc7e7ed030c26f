"""From a measured bundle to a drop of the open calibration or verification."""

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from pathlib import Path

from drivers.errors import RecordingError
from pipeline.frames import BundleKind
from service.calibration.drop_files import ObservedDrop
from service.calibration.drop_jobs import ObserveJob, observe
from service.processing.measure_job import MeasureJob
from service.processing.processing import KeepDrop
from service.processing.worker_pool import JobLostError, JobPool
from service.results.fields import Result


@dataclass(frozen=True, slots=True, kw_only=True)
class DropCollector:
    """Observes the drops of one kind and passes each on as soon as its result is durable."""

    kind: BundleKind
    diameters_mm: tuple[float, ...]
    """Diameters of the balls that may fall; empty for stones."""
    add: Callable[[ObservedDrop, Result, Path | None], Awaitable[None]]
    """Called with a drop, its result record, and the file of its outlines, None when nothing was observed."""

    async def observe(self, pool: JobPool, job: MeasureJob) -> KeepDrop:
        """Find the outlines of a drop in a worker. Return the awaitable that keeps them once its result is durable.

        A drop that cannot be observed is passed on with the problem.
        """
        observing = ObserveJob(job, self.kind, self.diameters_mm)
        problem: str | None = None
        try:
            drop = await pool.run(observe, observing)
        except RecordingError as err:
            problem = err.problem
        except JobLostError as err:
            problem = str(err)

        async def keep(record: Result) -> None:
            if problem is None:
                await self.add(drop, record, observing.outlines)
            else:
                await self.add(ObservedDrop(bundle=record.bundle, problem=problem), record, None)

        return keep
