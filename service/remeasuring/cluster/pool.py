"""A cluster in the place of the worker processes of this machine.

The cluster holds nothing but bundles in flight. When a worker dies, dask gives its bundles to others. A worker that
lacks a content says so at once, gets it, and the bundle is given out anew: what joins later, or comes back, needs
nothing in advance. Frames are read where they lie; once a worker does not see them they are sent along.
"""

import asyncio
import logging
import pickle
from collections import OrderedDict
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, cast
from uuid import uuid4

from distributed import CancelledError, Client, KilledWorker

from drivers.errors import RecordingError
from drivers.files.recording import read_header
from service.processing.measure_job import MeasuredBundle, MeasureJob, WorkerContext, prepare_to_learn
from service.processing.resting_pool import RestingPool
from service.processing.segmenters import CLASSICAL
from service.processing.worker_pool import Job, JobLostError, Result, WorkerPool
from service.remeasuring.cluster.contents import Content, content_of, read_content
from service.remeasuring.cluster.executor import ClusterError
from service.remeasuring.cluster.tasks import (
    CONTEXT,
    Answer,
    ClusterJob,
    Failed,
    MeasuredFiles,
    Missing,
    Unfit,
    Unreadable,
    UnseenFileError,
    installed_versions,
    keep,
    measure_here,
)
from service.results.fields import LossReason

log = logging.getLogger(__name__)

JOIN_S = 30.0
"""Longest wait for the first worker."""
LOOK_S = 5.0
"""Time between two looks at whether there is a worker."""
LEARN_DEADLINE_S = 600.0
N_CONTENTS = 4
"""Contents that are remembered by their path: the calibration and the latest backgrounds."""
SENT_AHEAD = 2
"""Bundles whose frames are sent while the workers measure others, 21 MB each at most."""


@asynccontextmanager
async def connected_pool(address: str, context: WorkerContext) -> AsyncIterator["ClusterPool"]:
    """Provide the pool of the cluster whose scheduler has this address."""
    try:
        client = await Client(address, asynchronous=True, name="stonefall")
    except (OSError, TimeoutError) as err:
        raise ClusterError(f"no scheduler answers at {address}: {err}") from None
    try:
        try:
            await client.wait_for_workers(1, timeout=JOIN_S)
        except TimeoutError:
            raise ClusterError(f"no worker has joined the scheduler at {address}") from None
        pool = ClusterPool(client, context, size=sum((await client.nthreads()).values()))
        watching = asyncio.create_task(_watch(client))
        try:
            yield pool
        finally:
            watching.cancel()
            pool.close()
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

    def __init__(self, client: Client, context: WorkerContext, *, size: int) -> None:
        """`size`: of bundles that the workers measure at a time."""
        self._client = client
        self._context = content_of({CONTEXT: pickle.dumps(context)})
        self.size = size
        self.n_waiting = 0  # bundles of an archive wait for as long as it takes
        learning = replace(context, segmentation=CLASSICAL)
        self._here = RestingPool(
            lambda: WorkerPool(
                slots=1, deadline_s=LEARN_DEADLINE_S, prepare=prepare_to_learn, context=learning
            )
        )
        self._contents: OrderedDict[Path, Content] = OrderedDict()
        self._reading = asyncio.Lock()
        self._sends: dict[tuple[str, str], asyncio.Task[None]] = {}
        self._frames_are_seen = True
        self._room_for_frames = asyncio.Semaphore(size + SENT_AHEAD)

    @property
    def threads_per_job(self) -> int:
        return 1

    async def run(self, function: Callable[[Job], Result], job: Job) -> Result:
        """Return `function(job)`, computed on the cluster if a bundle is to be measured; raises as `WorkerPool` does.

        Raises
        ------
        JobLostError
            The bundle failed twice, or one worker of the cluster after the other died over it.
        ClusterError
            The cluster is gone, or a worker of it cannot measure.
        """
        if isinstance(job, MeasureJob):
            return cast(Result, await self._measure(job))
        return await self._here.run(function, job)

    async def run_when_idle(self, function: Callable[[Job], Result], make_job: Callable[[], Job]) -> Result:
        return await self.run(function, make_job())

    def close(self) -> None:
        """End what learns."""
        self._here.close()

    async def _measure(self, job: MeasureJob) -> MeasuredBundle:
        background = None if job.background_path is None else await self._content(job.background_path)
        rig = await self._content(job.rig_file.path)
        contents = {each.digest: each for each in (self._context, rig, background) if each is not None}
        task = ClusterJob(
            header=await asyncio.to_thread(read_header, job.bundle_path.absolute()),
            frames=None,
            camera_ids=job.camera_ids,
            calibration_id=job.rig_file.calibration_id,
            save_silhouettes=job.save_silhouettes,
            context=self._context.digest,
            rig=rig.digest,
            background=None if background is None else background.digest,
            versions=installed_versions(),
        )
        answer = await self._answer(task, contents) if self._frames_are_seen else UnseenFileError()
        if isinstance(answer, UnseenFileError):
            self._frames_are_seen = False
            async with self._room_for_frames:
                frames = await asyncio.to_thread(job.bundle_path.read_bytes)
                answer = await self._answer(replace(task, frames=frames), contents)
        match answer:
            case MeasuredFiles(measured, files):
                await asyncio.to_thread(_write, job.out_dir, files)
                return measured
            case Failed(reason, detail):
                raise JobLostError(reason, detail)
            case Unreadable(problem):
                raise RecordingError(job.bundle_path, problem)
            case Unfit(worker, detail):
                raise ClusterError(f"worker {worker} cannot measure: {detail}")
        raise ClusterError("frames that were sent did not arrive")

    async def _content(self, path: Path) -> Content:
        """Return the content of a path, which is never rewritten under its name."""
        async with self._reading:
            if path not in self._contents:
                self._contents[path] = await asyncio.to_thread(read_content, path)
                if len(self._contents) > N_CONTENTS:
                    self._contents.popitem(last=False)
            self._contents.move_to_end(path)
            return self._contents[path]

    async def _answer(self, task: ClusterJob, contents: Mapping[str, Content]) -> Answer:
        """Return a worker's answer to a task; contents that the worker lacks are sent, and the task submitted again."""
        while isinstance(answer := await self._submitted(task), Missing):
            for digest in answer.digests:
                await self._send(answer.worker, contents[digest])
        return answer

    async def _submitted(self, task: ClusterJob) -> Answer:
        key = f"stonefall-{task.header.name}-{uuid4().hex}"
        future = self._client.submit(measure_here, task, key=key, pure=False)
        try:
            return cast(Answer, await future)
        except KilledWorker as err:
            n_died = err.allowed_failures + 1
            raise JobLostError(
                LossReason.WORKER_CRASH, f"{n_died} workers of the cluster died over it"
            ) from None
        except CancelledError as err:
            raise ClusterError(f"the scheduler is gone, or has given a bundle up: {err}") from None
        except Exception as err:  # whatever a worker raised, such as another version's error
            raise ClusterError(f"a worker cannot measure: {type(err).__name__}: {err}") from err
        finally:
            future.release()

    async def _send(self, worker: str, content: Content) -> None:
        """Send a content to a worker, once for all bundles that need it there."""
        key = worker, content.digest
        if (sending := self._sends.get(key)) is None:
            sending = self._sends[key] = asyncio.create_task(self._keep(worker, content))
            sending.add_done_callback(lambda _: self._sends.pop(key))
        await asyncio.shield(sending)

    async def _keep(self, worker: str, content: Content) -> None:
        answers: Any = await self._client.run(keep, content, workers=[worker], on_error="return")
        error = answers.get(worker)
        if isinstance(error, Exception) and worker in await self._client.nthreads():
            raise ClusterError(f"worker {worker} cannot keep what it was sent: {error}")


def _write(folder: Path, files: Mapping[str, bytes]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        (folder / name).write_bytes(content)
