"""The address of a cluster, and dask.distributed, which is imported only when a cluster is asked for."""

from urllib.parse import urlsplit

from service.base.errors import ServiceError, UsageError

SCHEME = "dask"
OUR_SETTINGS = {
    "distributed.admin.large-graph-warning-threshold": "1GB",  # frames go along with a task, where they must
    "distributed.comm.timeouts.connect": "10s",
}


class ClusterError(ServiceError):
    """The cluster cannot be used, or is gone."""


def scheduler_address(executor: str) -> str:
    """Return the scheduler's address of `dask://HOST:PORT`.

    Raises
    ------
    UsageError
        It is none.
    """
    try:
        found = urlsplit(executor)
        host, port = found.hostname, found.port
    except ValueError:
        host = port = None
    if not host or port is None or executor != f"{SCHEME}://{found.netloc}" or "@" in found.netloc:
        raise UsageError(f"--executor {executor}: must be {SCHEME}://HOST:PORT, the scheduler's address")
    return f"tcp://{found.netloc}"


def require_distributed() -> None:
    """Check that dask.distributed is installed, and set it up to warn of nothing that is meant.

    Raises
    ------
    UsageError
        It is not installed.
    """
    try:
        import dask
        import distributed  # noqa: F401 - only whether it is there
    except ImportError as err:
        raise UsageError(
            f"--executor needs the extra [cluster], which is not installed ({err}):"
            " pip install --require-hashes -r deploy/requirements-cluster.lock"
        ) from None
    dask.config.set(OUR_SETTINGS)
