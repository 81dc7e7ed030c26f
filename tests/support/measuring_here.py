"""`stonefall measure` without processes of its own: what a command does with results, not where they are made."""

from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from functools import partial

from service.processing.measure_job import WorkerContext, begin
from service.processing.worker_pool import JobPool, Result


@dataclass(frozen=True)
class PoolOfThisProcess:
    """A started `JobPool` that runs each job at once, in this process."""

    size: int
    n_waiting: int = 0
    threads_per_job: int = 1

    async def run(self, job: partial[Result]) -> Result:
        return job()

    async def run_when_idle(self, make_job: Callable[[], partial[Result]]) -> Result:
        return make_job()()


@asynccontextmanager
async def measuring_here(
    executor: str | None, workers: int, context: WorkerContext
) -> AsyncIterator[JobPool]:
    """Provide this process in the place of `service.commands.measure.measuring_pool`."""
    assert executor is None
    begin(context)
    yield PoolOfThisProcess(workers)
