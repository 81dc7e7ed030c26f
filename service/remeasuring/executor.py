"""Open the cluster of `--executor dask://HOST:PORT`; dask.distributed is imported only when one is asked for."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from urllib.parse import urlsplit

from service.base.errors import UsageError
from service.processing.measure_job import WorkerContext
from service.processing.worker_pool import JobPool

SCHEME = "dask"
CONNECT = {"distributed.comm.timeouts.connect": "10s"}


def scheduler_address(executor: str) -> str:
    """Return the scheduler's address of `dask://HOST:PORT`; raise `UsageError` if it is none."""
    try:
        found = urlsplit(executor)
        host, port = found.hostname, found.port
    except ValueError:
        host = port = None
    if not host or port is None or executor != f"{SCHEME}://{found.netloc}" or "@" in found.netloc:
        raise UsageError(f"--executor {executor}: must be {SCHEME}://HOST:PORT, the scheduler's address")
    return f"tcp://{found.netloc}"


@asynccontextmanager
async def open_cluster(executor: str, context: WorkerContext) -> AsyncIterator[JobPool]:
    """Provide the pool of the cluster at `dask://HOST:PORT`, which has one worker at least.

    Raises `UsageError` without an address or the extra, `ClusterError` if no scheduler answers or no worker joins it.
    """
    address = scheduler_address(executor)
    try:
        import dask

        from service.remeasuring.cluster import connected_pool
    except ImportError as err:
        raise UsageError(
            f"--executor needs the extra [cluster], which is not installed ({err}):"
            " pip install --require-hashes -r deploy/requirements-cluster.lock"
        ) from None
    dask.config.set(CONNECT)
    async with connected_pool(address, context) as pool:
        yield pool
