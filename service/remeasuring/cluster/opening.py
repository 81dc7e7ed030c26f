"""Open the cluster of an executor's address; dask.distributed is imported only then."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from service.processing.measure_job import WorkerContext
from service.processing.worker_pool import JobPool
from service.remeasuring.cluster.executor import require_distributed, scheduler_address


@asynccontextmanager
async def open_cluster(executor: str, context: WorkerContext) -> AsyncIterator[JobPool]:
    """Provide the pool of the cluster at `dask://HOST:PORT`, which has one worker at least.

    Raises
    ------
    UsageError
        That is no address, or the extra is not installed.
    ClusterError
        The scheduler does not answer, or no worker joins it.
    """
    address = scheduler_address(executor)
    require_distributed()
    from service.remeasuring.cluster.pool import connected_pool

    async with connected_pool(address, context) as pool:
        yield pool
