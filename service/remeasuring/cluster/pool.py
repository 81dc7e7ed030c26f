"""A cluster in the place of the worker processes of this machine.

The cluster holds nothing but bundles in flight. When a worker dies, dask gives its bundles to others, and what joins
later, or comes back, is given the same processes: all of it finds its files below the same shared paths.
"""

import asyncio
import logging
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import cast
from uuid import uuid4

from distributed import CancelledError, Client, KilledWorker

from drivers.errors import RecordingError
from drivers.files.recording import read_header
from service.base.errors import ClusterError
from service.processing.measure_job import MeasuredBundle, MeasureJob, WorkerContext, prepare_to_learn
from service.processing.resting_pool import RestingPool
from service.processing.segmenters import CLASSICAL
from service.processing.worker_pool import Job, JobLostError, Result, WorkerPool
from service.remeasuring.cluster.tasks import Answer, ClusterJob, Failed, Processes, digest_of, measure_here
from service.results.fields import LossReason

log = logging.getLogger(__name__)

JOIN_S = 30.0
"""Longest wait for the first worker."""
LOOK_S = 5.0
"""Time between two looks at whether there is a worker."""
LEARN_DEADLINE_S = 600.0
N_DIGESTS = 4
"""Digests that are remembered by path: of the calibration and the latest backgrounds."""


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
        self._here = RestingPool(
            lambda: WorkerPool(
                slots=1, deadline_s=LEARN_DEADLINE_S, prepare=prepare_to_learn, context=learning
            )
        )
        self._digest_of = lru_cache(N_DIGESTS)(digest_of)  # none is rewritten under its name

    async def run(self, function: Callable[[Job], Result], job: Job) -> Result:
        """Return `function(job)`, computed on the cluster if a bundle is to be measured.

        Raises `JobLostError` as `WorkerPool` does, `ClusterError` if the cluster is gone or a worker cannot measure.
        """
        if isinstance(job, MeasureJob):
            return cast(Result, await self._measure(job))
        return await self._here.run(function, job)

    async def run_when_idle(self, function: Callable[[Job], Result], make_job: Callable[[], Job]) -> Result:
        return await self.run(function, make_job())

    def close(self) -> None:
        """Stop the local process that learns backgrounds."""
        self._here.close()

    async def _measure(self, job: MeasureJob) -> MeasuredBundle:
        task = await asyncio.to_thread(self._task, job)
        try:
            answer = await self._answer(task)
        except ClusterError:
            for path in (task.header.path, *task.digests):
                path.stat()  # it went meanwhile: `FileNotFoundError`
            raise
        if isinstance(answer, Failed):
            raise JobLostError(answer.reason, answer.detail)
        await asyncio.to_thread(_write, job.out_dir, answer.files)
        return answer.measured

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

    async def _answer(self, task: ClusterJob) -> Answer:
        key = f"stonefall-{task.header.name}-{uuid4().hex}"
        future = self._client.submit(measure_here, self._processes, task, key=key, pure=False)
        try:
            return cast(Answer, await future)
        except (ClusterError, RecordingError):
            raise
        except KilledWorker as err:
            n_died = err.allowed_failures + 1
            return Failed(LossReason.WORKER_CRASH, f"{n_died} workers of the cluster died over it")
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
