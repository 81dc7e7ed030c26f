"""Bundles measured on a dask.distributed cluster, in the place of the worker processes of this machine.

The cluster holds nothing but bundles in flight. When a worker dies, dask gives its bundles to others, and what joins
later, or comes back, is given the same processes. Files are read where the machine that asks has them: a worker that
sees another file under that path, or none, is refused, and the path named.

The process that dask starts measures nothing itself: worker processes like the daemon's do. A bundle that kills its
process kills one of the pool, which is replaced, and fails after the second time; everything else goes on.
"""

import asyncio
import hashlib
import logging
import multiprocessing
import shutil
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from importlib.metadata import version
from pathlib import Path
from typing import cast
from uuid import uuid4

from distributed import CancelledError, Client, KilledWorker, Worker, WorkerPlugin, get_worker

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
    prepare_to_learn,
)
from service.processing.segmenters import CLASSICAL
from service.processing.worker_pool import REST_S, Result, WorkerPool
from service.processing.worker_slot import JobLostError, WorkerStartError
from service.results.fields import LossReason
from service.results.version import ALGORITHM_VERSION

log = logging.getLogger(__name__)

DEADLINE_S = 600.0
"""Only a process that hangs is ended."""
N_DIGESTS = 4
"""Digests that are remembered by path, of calibration and backgrounds: one of these is 84 MB or more."""
COMPUTES = ("numba", "numpy", "onnxruntime", "opencv-python-headless", "scipy", "stonefall")
"""Packages whose versions must be equal for equal bits."""
JOIN_S = 30.0
"""Longest wait for the first worker."""
LOOK_S = 5.0
"""Time between two looks at whether there is a worker."""


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
        self._pool = WorkerPool(
            slots=worker.state.nthreads,
            deadline_s=DEADLINE_S,
            prepare=prepare,
            context=self._context,
            rest_s=REST_S,
        )
        self._digest_of = lru_cache(N_DIGESTS)(digest_of)
        self._folder = Path(worker.local_directory) / "stonefall"  # which the worker removes when it ends

    def teardown(self, worker: Worker) -> None:
        """End them: an interpreter that ends waits for its processes, and they ignore signals."""
        self._pool.close()

    async def measure(self, task: ClusterJob) -> MeasuredFiles:
        """Measure a bundle; raise `ClusterError` if this worker cannot, or not with the same results."""
        trouble = _trouble(self._versions)
        if trouble := trouble or await asyncio.to_thread(_unshared, task, self._digest_of):
            raise ClusterError(trouble)
        folder = self._folder / f"bundle-{uuid4().hex}"
        try:
            measured = await self._pool.run(partial(measure, replace(task.job, out_dir=folder / "out")))
            return MeasuredFiles(measured, await asyncio.to_thread(_files, folder / "out"))
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


async def measure_here(processes: str, task: ClusterJob) -> MeasuredFiles:
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


@asynccontextmanager
async def connected_pool(address: str, context: WorkerContext) -> AsyncIterator["ClusterPool"]:
    """Provide the pool of the cluster whose scheduler has this address."""
    try:
        client = await Client(address, asynchronous=True, name="stonefall")
    except (OSError, TimeoutError) as err:
        raise ClusterError(f"no scheduler answers at {address}: {err}") from None
    processes = Processes(context)
    try:
        try:
            await client.wait_for_workers(1, timeout=JOIN_S)
        except TimeoutError:
            raise ClusterError(f"no worker has joined the scheduler at {address}") from None
        await client.register_plugin(processes)  # with each worker, also with those that join later
        pool = ClusterPool(client, processes.name, context, size=sum((await client.nthreads()).values()))
        watching = asyncio.create_task(_watch(client))
        try:
            yield pool
        finally:
            watching.cancel()
            pool.close()
            with suppress(TimeoutError, OSError):
                await client.unregister_worker_plugin(processes.name)
    finally:
        with suppress(TimeoutError, OSError):
            await client.close()


async def _watch(client: Client) -> None:
    """Log when no worker is left: everything waits for one."""
    had_some = True
    while True:
        await asyncio.sleep(LOOK_S)
        with suppress(OSError):
            has_some = bool(await client.nthreads())
            if had_some and not has_some:
                log.warning("no worker is left: waiting for one to join")
            had_some = has_some


class ClusterPool:
    """Measures bundles on a cluster; backgrounds are learnt here. All on the event loop."""

    def __init__(self, client: Client, processes: str, context: WorkerContext, *, size: int) -> None:
        """`size`: of bundles that the workers measure at a time."""
        self._client = client
        self._processes = processes
        self.size = size
        self.n_waiting = 0  # bundles of an archive wait for as long as it takes
        self.threads_per_job = 1
        learning = replace(context, segmentation=CLASSICAL)
        self._here = WorkerPool(
            slots=1, deadline_s=DEADLINE_S, prepare=prepare_to_learn, context=learning, rest_s=REST_S
        )
        self._digest_of = lru_cache(N_DIGESTS)(digest_of)  # none is rewritten under its name

    async def run(self, job: partial[Result]) -> Result:
        """Return the job's result, computed on the cluster if a bundle is to be measured.

        Raises `JobLostError` as `WorkerPool` does, `ClusterError` if the cluster is gone or a worker cannot measure.
        """
        if job.func is measure:
            return cast(Result, await self._measure(*job.args))
        return await self._here.run(job)

    async def run_when_idle(self, make_job: Callable[[], partial[Result]]) -> Result:
        return await self.run(make_job())

    def close(self) -> None:
        """Stop the local process that learns backgrounds."""
        self._here.close()

    async def _measure(self, job: MeasureJob) -> MeasuredBundle:
        task = await asyncio.to_thread(self._task, job)
        try:
            found = await self._submitted(task)
        except ClusterError:
            for path in (task.header.path, *task.digests):
                await asyncio.to_thread(path.stat)  # it went meanwhile: `FileNotFoundError`
            raise
        await asyncio.to_thread(_write, job.out_dir, found.files)
        return found.measured

    def _task(self, job: MeasureJob) -> ClusterJob:
        rig_path, background = job.rig_file.path.absolute(), job.background_path
        job = replace(
            job,
            bundle_path=job.bundle_path.absolute(),
            rig_file=replace(job.rig_file, path=rig_path),
            background_path=None if background is None else background.absolute(),
        )
        needed = [rig_path] if job.background_path is None else [rig_path, job.background_path]
        digests = {path: self._digest_of(path) for path in needed}
        return ClusterJob(job=job, header=read_header(job.bundle_path), digests=digests)

    async def _submitted(self, task: ClusterJob) -> MeasuredFiles:
        key = f"stonefall-{task.header.name}-{uuid4().hex}"
        future = self._client.submit(measure_here, self._processes, task, key=key, pure=False)
        try:
            return cast(MeasuredFiles, await future)
        except (ClusterError, JobLostError, RecordingError):
            raise
        except KilledWorker as err:
            detail = f"{err.allowed_failures + 1} workers of the cluster died over it"
            raise JobLostError(LossReason.WORKER_CRASH, detail) from None
        except CancelledError as err:
            raise ClusterError(f"the scheduler is gone, or has given a bundle up: {err}") from None
        except Exception as err:  # whatever a worker raised, such as another version's error
            raise ClusterError(f"a worker cannot measure: {type(err).__name__}: {err}") from err
        finally:
            future.release()


def _write(folder: Path, files: dict[str, bytes]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        (folder / name).write_bytes(content)
