"""Where commands measure: in processes of this machine, or on a cluster."""

from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager
from typing import Annotated

import typer

from service.base.errors import ServiceError
from service.processing.measure_job import WorkerContext, prepare
from service.processing.worker_pool import JobPool, WorkerPool
from service.remeasuring.executor import open_cluster

DEADLINE_S = 600.0
"""Only a worker that hangs is ended: no stone waits here."""
IN_FLIGHT = 4
"""Bundles in flight for each worker, however many there are."""

Executor = Annotated[
    str | None,
    typer.Option(help="dask://HOST:PORT: measure on the cluster with this scheduler, instead of here."),
]


@asynccontextmanager
async def measuring_pool(
    executor: str | None, workers: int, context: WorkerContext
) -> AsyncIterator[JobPool]:
    """Provide the cluster, if one is named, or else processes of this machine, started."""
    if executor is not None:
        async with open_cluster(executor, context) as cluster:
            yield cluster
        return
    async with WorkerPool(slots=workers, deadline_s=DEADLINE_S, prepare=prepare, context=context) as pool:
        yield pool


@contextmanager
def one_error() -> Iterator[None]:
    """Raise the first error of the service in a group by itself, for the one line that is printed."""
    try:
        yield
    except BaseExceptionGroup as group:
        error: BaseException | None = group.subgroup(ServiceError)
        while isinstance(error, BaseExceptionGroup):
            error = error.exceptions[0]
        if error is None:
            raise
        raise error from None
