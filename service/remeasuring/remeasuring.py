"""Measure stones of the store again, one at a time, beside the measuring of those that fall.

A process of its own with the lowest priority does it; it starts with the first request and ends a while after the last.
Frames come from the archive, the calibration is the one that the result names, algorithm and parameters are
today's, and so is the background: versions of it are not archived. What is measured with today's algorithm already is
not measured again, unless its refinement was left out in a rush: a client that asks for all stones of a lot may be
killed and ask again.
"""

import asyncio
import os
import shutil
from collections.abc import Sequence
from functools import partial

from drivers.errors import RecordingError
from service.processing import measure_job
from service.processing.measure_job import WorkerContext, measure
from service.processing.worker_pool import REST_S, WorkerPool
from service.processing.worker_process import WarmUp
from service.processing.worker_slot import JobLostError, WorkerStartError
from service.remeasuring.jobs import Hindrance, Jobs, RemeasureError, revise
from service.remeasuring.orders import Orders

DEADLINE_S = 300.0
"""Longest time for one stone: it takes 0.1 s of an idle core, but none may be idle for long."""
NICER = 9
"""Added to the workers' 10: the least share of a core that something else wants."""
PROCESS_NAME = "stonefall-again"
"""Name of the process in `ps` and `top`."""


def prepare(context: WorkerContext) -> Sequence[WarmUp]:
    """Prepare this process as a worker, with the lowest priority."""
    os.nice(NICER)
    return measure_job.prepare(context)


def new_pool(context: WorkerContext) -> WorkerPool:
    """Return the pool of the one process, not started; its context is that of the workers."""
    return WorkerPool(
        slots=1, deadline_s=DEADLINE_S, prepare=prepare, context=context, name=PROCESS_NAME, rest_s=REST_S
    )


class Remeasuring:
    """Measures stones again: `measure`, as often as wanted, then `close`; all on the event loop.

    `orders` are for stones that a cluster measures instead.
    """

    def __init__(self, jobs: Jobs, context: WorkerContext, pool: WorkerPool) -> None:
        self._jobs = jobs
        self.orders = Orders(jobs, context)
        self._turn = asyncio.Lock()
        self._pool = pool

    async def measure(self, name: str, who: str) -> bool:
        """Revise the stone with this id; return False if its newest result is all that today's algorithm can say.

        Raises `RemeasureError` if it cannot be measured again.
        """
        async with self._turn:
            record = await self._jobs.wanted(name)
            if record is None:
                return False
            out_dir = self._jobs.folder / "out"
            try:
                job = await self._jobs.job_for(record, out_dir)
                measured = await self._pool.run(partial(measure, job))
                return await revise(self._jobs.store, record, measured.record, out_dir, who)
            except RecordingError as err:
                raise RemeasureError(Hindrance.FAILED, f"{name}: {err.problem}") from err
            except (JobLostError, WorkerStartError) as err:
                raise RemeasureError(Hindrance.FAILED, f"{name}: {err}") from err
            except asyncio.CancelledError as err:
                if self._pool.is_closed:
                    raise RemeasureError(Hindrance.FAILED, "the daemon stops") from err
                # the request was given up: nothing of this may get among the next one's files
                self._pool.rest()
                raise
            finally:
                await asyncio.to_thread(shutil.rmtree, out_dir, ignore_errors=True)

    def close(self) -> None:
        """End the process, and what it measures; requests from now on are refused."""
        self._pool.close()
