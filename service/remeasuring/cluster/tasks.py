"""Tasks on a worker of the cluster: a bundle is measured by worker processes like the daemon's.

The process that dask starts measures nothing itself. A bundle that kills its process kills one of the pool, which is
replaced, and fails after the second time; everything else goes on. Files are read where the machine that asks has
them: a worker that sees another file under that path, or none, is refused, and the path named.
"""

import asyncio
import hashlib
import multiprocessing
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from uuid import uuid4

from distributed import Worker, WorkerPlugin, get_worker

from drivers.errors import RecordingError
from drivers.files.bundle_header import BundleHeader
from drivers.files.recording import read_header
from service.base.errors import ClusterError
from service.processing.compiled_code import isolate_numba_cache
from service.processing.measure_job import (
    RESULT_FILES,
    MeasuredBundle,
    MeasureJob,
    WorkerContext,
    measure,
    prepare,
)
from service.processing.resting_pool import RestingPool
from service.processing.worker_pool import JobLostError, WorkerPool, WorkerStartError
from service.results.fields import LossReason
from service.results.version import ALGORITHM_VERSION

DEADLINE_S = 600.0
"""Only a process that hangs is ended."""
N_DIGESTS = 4
"""Digests that a worker remembers by path: a background is 84 MB or more."""
COMPUTES = ("numba", "numpy", "onnxruntime", "opencv-python-headless", "scipy", "stonefall")
"""Packages whose versions must be equal for equal bits."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ClusterJob:
    """One bundle to measure, and its files as they are where it is asked for."""

    job: MeasureJob
    header: BundleHeader  # with the checksums of all pixels
    digests: Mapping[Path, str]  # of calibration and background


@dataclass(frozen=True, slots=True)
class MeasuredFiles:
    """A measured bundle, and its files by name."""

    measured: MeasuredBundle
    files: dict[str, bytes]


@dataclass(frozen=True, slots=True)
class Failed:
    """The processes that measured the bundle died, failed or hung, twice."""

    reason: LossReason
    detail: str


Answer = MeasuredFiles | Failed


def installed_versions() -> Mapping[str, str]:
    """Return the versions of all that computes here."""
    return {"algorithm": ALGORITHM_VERSION, **{name: version(name) for name in COMPUTES}}


def digest_of(path: Path) -> str:
    """Return the SHA-256 of a file, or of the files in a folder by their names."""
    digest = hashlib.sha256()
    for each in sorted(path.iterdir()) if path.is_dir() else [path]:
        with each.open("rb") as file:
            digest.update(f"{each.name} {hashlib.file_digest(file, 'sha256').hexdigest()} ".encode())
    return digest.hexdigest()


class Processes(WorkerPlugin):
    """The measuring processes of a worker, for one command; dask starts and ends them with command and worker."""

    def __init__(self, context: WorkerContext) -> None:
        self.name = f"stonefall-{uuid4().hex}"
        self._context = context
        self._versions = installed_versions()

    def setup(self, worker: Worker) -> None:
        """Make the pool; its processes start with the first bundle and end some time after."""
        isolate_numba_cache()  # of the processes; this one computes nothing
        self._pool = RestingPool(
            lambda: WorkerPool(
                slots=worker.state.nthreads, deadline_s=DEADLINE_S, prepare=prepare, context=self._context
            )
        )
        self._digest_of = lru_cache(N_DIGESTS)(digest_of)
        self._folder = Path(worker.local_directory) / "stonefall"  # which the worker removes when it ends

    def teardown(self, worker: Worker) -> None:
        """End them: an interpreter that ends waits for its processes, and they ignore signals."""
        self._pool.close()

    async def measure(self, task: ClusterJob) -> Answer:
        """Measure a bundle; raise `ClusterError` if this worker cannot, or not with the same results."""
        trouble = _trouble(self._versions)
        if trouble := trouble or await asyncio.to_thread(_unshared, task, self._digest_of):
            raise ClusterError(trouble)
        folder = self._folder / f"bundle-{uuid4().hex}"
        try:
            measured = await self._pool.run(measure, replace(task.job, out_dir=folder / "out"))
            return MeasuredFiles(measured, await asyncio.to_thread(_files, folder / "out"))
        except JobLostError as err:
            return Failed(err.reason, err.detail)
        except WorkerStartError as err:
            raise ClusterError(str(err)) from None
        finally:
            await asyncio.to_thread(shutil.rmtree, folder, ignore_errors=True)


def _trouble(wanted: Mapping[str, str]) -> str | None:
    """Return the reason why results here would differ or fail, None if there is none."""
    if multiprocessing.current_process().daemon:
        return "it runs under dask's nanny, which lets it start no processes: start it with --no-nanny"
    here = installed_versions()
    if wrong := sorted(name for name in wanted if here.get(name) != wanted[name]):
        differing = ", ".join(f"{name} {here.get(name)} instead of {wanted[name]}" for name in wrong)
        return f"it would measure otherwise: it has {differing}"
    return None


def _unshared(task: ClusterJob, digest_of: Callable[[Path], str]) -> str | None:
    """Return the reason why a file of the job is not the one that the asking machine has, None if all are."""
    for path in (task.header.path, *task.digests):
        try:
            wanted = task.digests.get(path, task.header)
            is_same = wanted == (digest_of(path) if path in task.digests else read_header(path))
        except (RecordingError, OSError):
            is_same = False
        if not is_same:
            return f"{path} is missing there, or another file: share its folder with all machines, under this path"
    return None


async def measure_here(processes: str, task: ClusterJob) -> Answer:
    """Measure one bundle on this worker, by its processes of this name."""
    worker = get_worker()
    plugin = worker.plugins[processes]
    assert isinstance(plugin, Processes)  # noqa: S101 - the pool has registered it
    try:
        return await plugin.measure(task)
    except ClusterError as err:
        raise ClusterError(f"worker {worker.address} cannot measure: {err}") from None


def _files(folder: Path) -> dict[str, bytes]:
    return {name: path.read_bytes() for name in RESULT_FILES if (path := folder / name).exists()}
