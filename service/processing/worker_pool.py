"""Worker processes: N slots of one process each; a crash or a deadline costs one job one retry.

A `ProcessPoolExecutor` of several workers breaks as a whole when one dies, so every slot has its own.
Processes are never forked from this one (drivers have threads of their own) but from a server that does nothing else,
end with the daemon however it ends, and leave Ctrl-C to it.
"""

import asyncio
import logging
import multiprocessing
import os
import re
import sys
from collections import defaultdict
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import forkserver
from multiprocessing.connection import wait
from multiprocessing.process import BaseProcess
from typing import TypeVar

from service.errors import ServiceError, WorkerFailure
from service.processing.process_memory import freeze_gc
from service.processing.worker_process import Prepare, begin, prepare_process, warm_up

Job = TypeVar("Job")
Result = TypeVar("Result")

log = logging.getLogger(__name__)

START_DEADLINE_S = 300.0
"""Compiling takes 20 s, on a machine that does nothing else."""
START_ATTEMPTS = 3
CLOSE_DEADLINE_S = 2.0
CALM_S = 3.0
"""Without a job for so long, the next stone is hardly the one that a new process makes late."""
WORKER_NAME = "stonefall-work"
"""What `ps` and `top` call a process that measures."""


class WorkerStartError(ServiceError):
    """A worker process does not get through its initialization; fatal for the daemon."""


class JobLostError(ServiceError):
    """A job failed twice, each time in a fresh process; `reason` is `worker_crash` or `deadline`."""

    def __init__(self, reason: str, detail: str) -> None:
        super().__init__(f"{reason}: {detail}")
        self.reason = reason
        self.detail = detail


def import_for_workers(module: str) -> None:
    """Start the server that workers are forked from: it imports the module while this process does something else."""
    multiprocessing.set_forkserver_preload([module])
    before = dict(os.environ)
    os.environ |= {
        "PYTHONSAFEPATH": "1",  # it would look into the working directory first
        "PYTHONPATH": os.pathsep.join(sys.path),
        "OPENBLAS_NUM_THREADS": "1",  # or it has a thread, and who has threads is not forked well
    }
    try:
        forkserver.ensure_running()
    finally:
        os.environ.clear()
        os.environ.update(before)


class WorkerPool:
    """Life cycle: `start`, any number of concurrent `run`, `close`; all on the event loop.

    `prepare` and the context must be picklable, like jobs and results. Processes that start together share what there
    is to compile: none begins a warm-up that another is at. `renew` replaces those that had to compile, when there is
    nothing to measure: the compiler's memory stays. The processes are called `name` (15 bytes).
    """

    def __init__(
        self,
        *,
        slots: int,
        deadline_s: float,
        prepare: Prepare,
        context: object,
        name: str = WORKER_NAME,
    ) -> None:
        warming: Mapping[int, asyncio.Lock] = defaultdict(asyncio.Lock)
        self._slots = [_Slot(name, prepare, context, warming) for _ in range(slots)]
        self._idle: asyncio.Queue[_Slot] = asyncio.Queue()
        self._deadline_s = deadline_s
        self._n_jobs = 0
        self.restarts = 0

    @property
    def size(self) -> int:
        return len(self._slots)

    @property
    def share(self) -> int:
        """How many processors there are for the next job, beside those that are busy."""
        n_busy = self.size - self._idle.qsize()
        return max(1, len(os.sched_getaffinity(0)) // (n_busy + 1))

    @property
    def pids(self) -> list[int]:
        return [slot.pid for slot in self._slots if slot.pid is not None]

    async def start(self) -> None:
        """Return when every worker is warm.

        Raises
        ------
        WorkerStartError
        """
        await asyncio.gather(*(slot.start() for slot in self._slots))
        for slot in self._slots:
            self._idle.put_nowait(slot)

    async def run(self, function: Callable[[Job], Result], job: Job) -> Result:
        """Return `function(job)`, computed in the first idle slot; a `WorkerFailure` counts as a crash.

        Raises
        ------
        JobLostError
            It failed twice.
        WorkerStartError
            The slot could not be rebuilt.
        """
        self._n_jobs += 1
        slot = await self._idle.get()
        try:
            async with slot.at_work:
                return await self._run_in(slot, function, job)
        finally:
            self._idle.put_nowait(slot)

    async def renew(self, calm_s: float = CALM_S) -> None:
        """Replace the processes that had to compile, each after so long without a job; one that cannot be stays."""
        for slot in self._slots:
            if slot.is_spent:
                await self._calm(calm_s)
                try:
                    await slot.renew()
                except WorkerStartError as err:
                    log.warning("a worker keeps its compiler's memory: %s", err)

    async def _calm(self, calm_s: float) -> None:
        """Return when there was no job for so long."""
        n_before = -1
        while n_before != self._n_jobs or self._idle.qsize() < self.size:
            n_before = self._n_jobs
            await asyncio.sleep(calm_s)

    async def _run_in(self, slot: "_Slot", function: Callable[[Job], Result], job: Job) -> Result:
        try:
            return await slot.run(function, job, self._deadline_s)
        except JobLostError as err:
            log.warning("%s; retrying in a fresh worker", err)
        await self._rebuild(slot)
        try:
            return await slot.run(function, job, self._deadline_s)
        except JobLostError:
            await self._rebuild(slot)
            raise

    async def _rebuild(self, slot: "_Slot") -> None:
        self.restarts += 1
        slot.kill()
        await slot.start()

    def close(self) -> None:
        """End all processes now; whatever still runs in them is lost."""
        processes = [process for slot in self._slots if (process := slot.process) is not None]
        for slot in self._slots:
            slot.kill()
        for process in processes:  # their folder is about to be removed
            wait([process.sentinel], timeout=CLOSE_DEADLINE_S)


async def run_apart(
    function: Callable[[Job], Result], job: Job, *, deadline_s: float, prepare: Prepare
) -> Result:
    """Return `function(job)`, computed in a process made for it: bundles do not wait for what takes long.

    Raises
    ------
    JobLostError
        It failed twice.
    WorkerStartError
        The process does not start.
    """
    pool = WorkerPool(slots=1, deadline_s=deadline_s, prepare=prepare, context=None)
    try:
        await pool.start()
        return await pool.run(function, job)
    finally:
        pool.close()


class _Slot:
    def __init__(
        self, name: str, prepare: Prepare, context: object, warming: Mapping[int, asyncio.Lock]
    ) -> None:
        """`warming`: held by the slot that is at the warm-up of this number."""
        self._name = name
        self._prepare = prepare
        self._context = context
        self._warming = warming
        self._executor: ProcessPoolExecutor | None = None
        self.process: BaseProcess | None = None
        self.is_spent = False
        self.at_work = asyncio.Lock()

    @property
    def pid(self) -> int | None:
        return None if self.process is None else self.process.pid

    async def start(self) -> None:
        """Spawn a process and have it ready for jobs."""
        for attempt in range(1, START_ATTEMPTS + 1):
            executor = self._executor = ProcessPoolExecutor(
                max_workers=1,
                mp_context=multiprocessing.get_context("forkserver"),
                initializer=begin,
                initargs=(self._name, self._prepare),
            )
            others = set(multiprocessing.active_children())
            begun = executor.submit(os.getpid)  # starts the process
            (self.process,) = set(multiprocessing.active_children()) - others
            try:
                async with asyncio.timeout(START_DEADLINE_S):
                    await asyncio.wrap_future(begun)
                    self.is_spent = await self._warm_up(executor)
                return
            except (BrokenProcessPool, TimeoutError, WorkerFailure) as err:
                self.kill()
                log.error("worker did not start: %s attempt=%d", str(err) or "deadline", attempt)
        raise WorkerStartError(f"a worker process failed to start {START_ATTEMPTS} times in a row")

    async def _warm_up(self, executor: ProcessPoolExecutor) -> bool:
        """Whether it took a compiler."""
        left = list(
            range(await asyncio.wrap_future(executor.submit(prepare_process, self._prepare, self._context)))
        )
        has_compiled = False
        while left:
            number = next((number for number in left if not self._warming[number].locked()), left[0])
            left.remove(number)
            async with self._warming[number]:
                has_compiled |= await asyncio.wrap_future(executor.submit(warm_up, number))
        await asyncio.wrap_future(executor.submit(freeze_gc))
        return has_compiled

    async def renew(self) -> None:
        """Replace the process by another, ready for jobs, between two jobs."""
        successor = _Slot(self._name, self._prepare, self._context, self._warming)
        try:
            await successor.start()
            async with self.at_work:
                self.kill()
                self.process, successor.process = successor.process, None
                self._executor, successor._executor = successor._executor, None
                self.is_spent = False
        finally:
            successor.kill()

    async def run(self, function: Callable[[Job], Result], job: Job, deadline_s: float) -> Result:
        if self._executor is None:
            raise WorkerStartError("the worker pool is not running")
        try:
            async with asyncio.timeout(deadline_s):
                return await asyncio.wrap_future(self._executor.submit(function, job))
        except TimeoutError:
            raise JobLostError("deadline", f"not finished within {deadline_s:g} s") from None
        except BrokenProcessPool as err:
            raise JobLostError("worker_crash", f"worker process {self.pid} died") from err
        except WorkerFailure as err:
            log.error("a job failed in worker process %s:\n%s", self.pid, err)
            raise JobLostError("worker_crash", _last_line(str(err))) from err

    def kill(self) -> None:
        if self.process is not None:
            self.process.kill()
        if self._executor is not None:
            self._executor.shutdown(wait=False, cancel_futures=True)
        self.process = self._executor = None


def _last_line(traceback: str) -> str:
    """Type and message of the exception, without the folders of paths: clients get to read it."""
    return re.sub(r"(?<![\w.])/\S*/", "", traceback.strip().rpartition("\n")[2])
