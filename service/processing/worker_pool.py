"""Pool of worker processes: N slots of one process each; a job that crashes or exceeds its deadline is retried once.

A `ProcessPoolExecutor` of several workers breaks as a whole when one dies, so every slot has its own.
Processes are forked from a server that does nothing else, never from the daemon, whose drivers have threads; if it is
killed, the next process starts another. They end when the daemon ends, however that happens, and leave Ctrl-C to it.
"""

import asyncio
import logging
import os
import time
from collections import defaultdict
from collections.abc import Callable, Mapping
from functools import partial
from multiprocessing.connection import wait
from typing import Protocol, Self, TypeVar

from service.base.errors import ServiceError
from service.base.messages import Code, joined, message
from service.base.status import Checks, HealthCheck, health_check
from service.processing.worker_process import Prepare
from service.processing.worker_slot import JobLostError, Slot, WorkerStartError

log = logging.getLogger(__name__)

RECENT_S = 60.0
"""Time for which a failure is reported as trouble."""
CLOSE_DEADLINE_S = 2.0
IDLE_S = 3.0
"""Time without a job after which the start of a new process is unlikely to delay a stone."""
REST_S = 60.0
"""Time without a job after which processes that rest end; they hold as much memory as the daemon's workers."""
WORKER_NAME = "stonefall-work"
"""Name of a measuring process in `ps` and `top`."""

Result = TypeVar("Result")


class JobPool(Protocol):
    """A pool of workers, of this machine or a cluster; `WorkerPool` says what its methods do and raise."""

    size: int
    n_waiting: int

    @property
    def threads_per_job(self) -> int: ...

    async def run(self, job: partial[Result]) -> Result: ...

    async def run_when_idle(self, make_job: Callable[[], partial[Result]]) -> Result: ...


class WorkerPool:
    """Runs jobs in worker processes: any number of concurrent `run`, then `close`; all on the event loop.

    A process starts with its first job, or with all others by `start`; in `async with` the pool is started and closed.
    A job is a call. `prepare` and the context must be picklable, like jobs and results.
    Processes that start together share the compiling: none begins a warm-up that another one is running. `renew`
    replaces processes that had to compile, when there is nothing to measure, because they never free the compiler's
    memory. The processes are called `name` (15 bytes).
    """

    def __init__(
        self,
        *,
        slots: int,
        deadline_s: float,
        prepare: Prepare,
        context: object,
        name: str = WORKER_NAME,
        retry_s: float | None = None,
        rest_s: float | None = None,
    ) -> None:
        """`retry_s`: pause before another attempt where a process cannot be replaced; None: there is none.

        `rest_s`: time without a job after which the processes end, to be started again with the next; None: they stay.
        """
        warm_up_locks: Mapping[int, asyncio.Lock] = defaultdict(asyncio.Lock)
        self._slots = [Slot(name, prepare, context, warm_up_locks) for _ in range(slots)]
        self.size = slots
        self._idle: asyncio.Queue[Slot] = asyncio.Queue()
        for slot in self._slots:
            self._idle.put_nowait(slot)
        self._deadline_s = deadline_s
        self._retry_s = retry_s
        self._rest_s = rest_s
        self._resting: asyncio.TimerHandle | None = None
        self.is_closed = False
        self._n_jobs = 0
        self.n_waiting = 0  # jobs for which no slot is idle
        self.restarts = 0
        self._last_failure = ""
        self._last_failure_s = -RECENT_S

    @property
    def threads_per_job(self) -> int:
        """Number of processors that the next job may use: all, divided by the busy workers and its own."""
        n_busy = self.size - self._idle.qsize()
        return max(1, len(os.sched_getaffinity(0)) // (n_busy + 1))

    @property
    def trouble(self) -> str | None:
        """The latest failure of a process within the last `RECENT_S`, None if there was none."""
        return self._last_failure if time.monotonic() - self._last_failure_s < RECENT_S else None

    @property
    def pids(self) -> list[int]:
        processes = [slot.process for slot in self._slots if slot.process is not None]
        return [process.pid for process in processes if process.pid is not None]

    def checks(self) -> Checks:
        return {"workers": workers_check(len(self.pids), self.size, self.restarts, self.trouble)}

    async def __aenter__(self) -> Self:
        await self.start()
        return self

    async def __aexit__(self, *error: object) -> None:
        self.close()

    async def start(self) -> None:
        """Return when every worker is warm; raise `WorkerStartError` when one cannot be, and none is left then."""
        try:
            await asyncio.gather(*(slot.start() for slot in self._slots))
        except BaseException:
            self.rest()
            raise

    async def run(self, job: partial[Result]) -> Result:
        """Return the job's result, computed in the first idle slot; raise what `run_when_idle` raises."""
        return await self.run_when_idle(lambda: job)

    async def run_when_idle(self, make_job: Callable[[], partial[Result]]) -> Result:
        """Return the result of a job that is made once a slot is idle; a `WorkerFailure` counts as a crash.

        Raises `JobLostError` when it failed twice, `WorkerStartError` when the slot could not be started or rebuilt,
        `CancelledError` when the pool is closed, also meanwhile.
        """
        if self._resting is not None:
            self._resting.cancel()
        self._n_jobs += 1
        self.n_waiting += 1
        try:
            slot = await self._idle.get()
        finally:
            self.n_waiting -= 1
        try:
            async with slot.busy:
                await self._ensure_ready(slot)
                return await self._run_in(slot, make_job())
        finally:
            self._idle.put_nowait(slot)
            if self._rest_s is not None and self.n_waiting == 0 and self._idle.qsize() == self.size:
                self._resting = asyncio.get_running_loop().call_later(self._rest_s, self.rest)

    async def renew(self, idle_s: float = IDLE_S) -> None:
        """Replace the processes that had to compile, each after `idle_s` without a job; if that fails it stays."""
        for slot in self._slots:
            if not slot.has_compiled:
                continue
            n_before = -1
            while n_before != self._n_jobs or self._idle.qsize() < self.size:
                n_before = self._n_jobs
                await asyncio.sleep(idle_s)
            try:
                await slot.renew()
            except WorkerStartError as err:
                log.warning("a worker keeps its compiler's memory: %s", err)

    async def _ensure_ready(self, slot: Slot) -> None:
        if not slot.is_ready and not self.is_closed:
            slot.kill()  # what a start that was given up has left
            await slot.start()
        if self.is_closed:  # maybe while it started
            slot.kill()
            raise asyncio.CancelledError

    async def _run_in(self, slot: Slot, job: partial[Result]) -> Result:
        try:
            return await slot.run(job, self._deadline_s)
        except JobLostError as err:
            if self.is_closed:
                raise asyncio.CancelledError from None
            log.warning("%s; retrying in a fresh worker", err)
            await self._rebuild(slot, err)
        try:
            return await slot.run(job, self._deadline_s)
        except JobLostError as err:
            await self._rebuild(slot, err)
            raise

    async def _rebuild(self, slot: Slot, failure: JobLostError) -> None:
        self.restarts += 1
        self._note(failure)
        slot.kill()
        while True:
            try:
                return await slot.start()
            except WorkerStartError as err:
                if self._retry_s is None:
                    raise
                log.error("%s: again in %g s", err, self._retry_s)
                self._note(err)
                await asyncio.sleep(self._retry_s)

    def _note(self, failure: ServiceError) -> None:
        self._last_failure, self._last_failure_s = str(failure), time.monotonic()

    def close(self) -> None:
        """Kill all processes for good."""
        self.is_closed = True
        self.rest()

    def rest(self) -> None:
        """Kill all processes until the next job; jobs that still run in them are lost."""
        if self._resting is not None:
            self._resting.cancel()
        sentinels = [slot.process.sentinel for slot in self._slots if slot.process is not None]
        for slot in self._slots:
            slot.kill()
        for sentinel in sentinels:  # their folder is about to be removed
            wait([sentinel], timeout=CLOSE_DEADLINE_S)


def workers_check(n_up: int, n_slots: int, restarts: int, trouble: str | None) -> HealthCheck:
    """Check that all processes run, and that none failed lately."""
    details = [message(Code.WORKERS_UP, processes=n_up, most=n_slots, restarts=restarts)]
    if trouble:
        details.append(message(Code.WORKER_FAILED, reported=trouble))
    detail = joined(details)
    return health_check(detail, n_up, "processes", warn=n_up < n_slots or trouble is not None, fail=n_up == 0)
