"""Tasks on a worker of the cluster: a bundle is measured by worker processes like the daemon's.

The process that dask starts measures nothing itself. A bundle that kills its process kills one of the pool, which is
replaced, and fails after the second time; everything else goes on. The reason why a bundle is not measured here is
returned, not raised, and told apart by its type.
"""

import asyncio
import multiprocessing
import pickle
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path
from uuid import uuid4

from distributed import Worker, WorkerPlugin, get_worker

from drivers.errors import RecordingError
from drivers.files.bundle_header import BundleHeader
from drivers.files.recording import read_header
from pipeline.frames import CameraId
from service.processing.compiled_code import isolate_numba_cache
from service.processing.measure_job import (
    RESULT_FILES,
    MeasuredBundle,
    MeasureJob,
    RigFile,
    WorkerContext,
    measure,
    prepare,
)
from service.processing.resting_pool import RestingPool
from service.processing.worker_pool import JobLostError, WorkerPool, WorkerStartError
from service.remeasuring.cluster.contents import Content, keep_content, kept_content
from service.results.fields import LossReason
from service.results.version import ALGORITHM_VERSION

DEADLINE_S = 600.0
"""Only a process that hangs is ended."""
CONTEXT = "context.pickle"
COMPUTES = ("numba", "numpy", "onnxruntime", "opencv-python-headless", "scipy", "stonefall")
"""Packages whose versions must be equal for equal bits."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ClusterJob:
    """One bundle to measure; what many bundles need is named by its digest."""

    header: BundleHeader  # as it is where the bundle is asked for, with the path of the file
    frames: bytes | None  # the file itself, where workers do not see it
    camera_ids: tuple[CameraId, ...]
    calibration_id: str
    save_silhouettes: bool
    context: str
    rig: str
    background: str | None
    versions: Mapping[str, str]

    @property
    def contents(self) -> set[str]:
        return {digest for digest in (self.context, self.rig, self.background) if digest is not None}


@dataclass(frozen=True, slots=True)
class MeasuredFiles:
    """A measured bundle, and its files by name."""

    measured: MeasuredBundle
    files: Mapping[str, bytes]


@dataclass(frozen=True, slots=True)
class Missing:
    """A worker lacks contents."""

    worker: str
    digests: frozenset[str]


@dataclass(frozen=True, slots=True)
class UnseenFileError:
    """A worker does not see the bundle's file, or sees another one under its name."""


@dataclass(frozen=True, slots=True)
class Failed:
    """The processes that measured the bundle died, failed or hung, twice."""

    reason: LossReason
    detail: str


@dataclass(frozen=True, slots=True)
class Unreadable:
    """The bundle's file is damaged."""

    problem: str


@dataclass(frozen=True, slots=True)
class Unfit:
    """A worker cannot measure at all, or not with the same results."""

    worker: str
    detail: str


Answer = MeasuredFiles | Missing | UnseenFileError | Failed | Unreadable | Unfit

_pools: dict[str, RestingPool] = {}
"""Pools of this worker, by the digest of their context."""


@cache
def installed_versions() -> Mapping[str, str]:
    """Return the versions of all that computes here."""
    return {"algorithm": ALGORITHM_VERSION, **{name: version(name) for name in COMPUTES}}


async def keep(content: Content, dask_worker: Worker) -> None:
    """Keep a content on the disk of this worker; `Client.run` names it."""
    await asyncio.to_thread(keep_content, _room(dask_worker), content)


async def measure_here(job: ClusterJob) -> Answer:
    """Measure one bundle on this worker."""
    worker = get_worker()
    if (trouble := _trouble(job.versions)) is not None:
        return Unfit(worker.address, trouble)
    room = _room(worker)
    kept = {digest: folder for digest in job.contents if (folder := kept_content(room, digest)) is not None}
    if missing := job.contents - kept.keys():
        return Missing(worker.address, frozenset(missing))
    folder = room.parent / f"bundle-{uuid4().hex}"
    try:
        path = await asyncio.to_thread(_bundle_path, job, folder)
        if path is None:
            return UnseenFileError()
        pool = await _pool(job.context, kept[job.context], worker)
        measured = await pool.run(measure, _measure_job(job, path, kept, folder / "out"))
        return MeasuredFiles(measured, await asyncio.to_thread(_files, folder / "out"))
    except RecordingError as err:
        return Unreadable(err.problem)
    except JobLostError as err:
        return Failed(err.reason, err.detail)
    except WorkerStartError as err:
        return Unfit(worker.address, str(err))
    finally:
        await asyncio.to_thread(shutil.rmtree, folder, ignore_errors=True)


def _room(worker: Worker) -> Path:
    """Return the folder of contents, which the worker removes when it ends."""
    return Path(worker.local_directory) / "stonefall" / "contents"


def _trouble(wanted: Mapping[str, str]) -> str | None:
    """Return the reason why results here would differ or fail, None if there is none."""
    if multiprocessing.current_process().daemon:
        return "it runs under dask's nanny, which lets it start no processes: start it with --no-nanny"
    here = installed_versions()
    if wrong := sorted(name for name in wanted if here.get(name) != wanted[name]):
        differing = ", ".join(f"{name} {here.get(name)} instead of {wanted[name]}" for name in wrong)
        return f"it would measure otherwise: it has {differing}"
    return None


class _Processes(WorkerPlugin):
    """The measuring processes of this worker, which end with it."""

    name = "stonefall"

    def teardown(self, worker: Worker) -> None:
        """End them: an interpreter that ends waits for its processes, and they ignore signals."""
        for pool in _pools.values():
            pool.close()
        _pools.clear()


async def _pool(digest: str, folder: Path, worker: Worker) -> RestingPool:
    """Return the pool for a context; made once, its processes start with the first bundle and end some time after."""
    if digest not in _pools:
        isolate_numba_cache()  # of the processes; this one computes nothing
        context: WorkerContext = pickle.loads((folder / CONTEXT).read_bytes())  # noqa: S301 - as every task of dask
        n_processes = worker.state.nthreads
        _pools[digest] = RestingPool(
            lambda: WorkerPool(slots=n_processes, deadline_s=DEADLINE_S, prepare=prepare, context=context)
        )
        if _Processes.name not in worker.plugins:
            await worker.plugin_add(_Processes(), _Processes.name)
    return _pools[digest]


def _bundle_path(job: ClusterJob, folder: Path) -> Path | None:
    """Return the bundle's file: the one that came along, or the very same one where it lies; None without either."""
    if job.frames is not None:
        folder.mkdir(parents=True)
        path = folder / "bundle.tiff"
        path.write_bytes(job.frames)
        return path
    try:
        seen = read_header(job.header.path)
    except RecordingError:
        return None
    return job.header.path if seen == job.header else None


def _measure_job(job: ClusterJob, path: Path, kept: Mapping[str, Path], out_dir: Path) -> MeasureJob:
    (rig_path,) = kept[job.rig].iterdir()
    return MeasureJob(
        bundle_path=path,
        camera_ids=job.camera_ids,
        rig_file=RigFile(rig_path, job.calibration_id),
        background_path=None if job.background is None else kept[job.background],
        out_dir=out_dir,
        save_silhouettes=job.save_silhouettes,
    )


def _files(folder: Path) -> Mapping[str, bytes]:
    return {name: path.read_bytes() for name in RESULT_FILES if (path := folder / name).exists()}
