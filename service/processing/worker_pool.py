"""Pool of worker processes: N slots of one process each; a job that crashes or exceeds its deadline is retried once.

A `ProcessPoolExecutor` of several workers breaks as a whole when one dies, so every slot has its own.
Processes are forked from a server that does nothing else, never from the daemon, whose drivers have threads; if it is
killed, the next process starts another. They end when the daemon ends, however that happens, and leave Ctrl-C to it.
"""

import asyncio
import logging
import multiprocessing
import os
import re
import signal
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from multiprocessing.connection import wait
from multiprocessing.process import BaseProcess
from typing import Protocol, Self, TypeVar

from service.base.errors import ServiceError, WorkerFailure
from service.base.status import Checks, HealthCheck, health_check
from service.processing.worker_process import (
    Prepare,
    begin_process,
    ensure_fork_server,
    freeze_gc,
    prepare_process,
    warm_up,
)
from service.results.fields import LossReason

log = logging.getLogger(__name__)

START_DEADLINE_S = 300.0
"""Longest start of a process; compiling alone takes 20 s on an idle machine."""
START_ATTEMPTS = 3
BACK_OFF_S = 0.2
"""Wait before a process is started again: what killed the last one, or its server, may not be over yet."""
RECENT_S = 60.0
"""Time for which a failure is reported as trouble."""
CLOSE_DEADLINE_S = 2.0
IDLE_S = 3.0
"""Time without a job after which the start of a new process is unlikely to delay a stone."""
WORKER_NAME = "stonefall-work"
"""Name of a measuring process in `ps` and `top`."""

_starting = threading.Lock()
"""Held while a process is started, so that it is told apart from those of others."""

Job = TypeVar("Job")
Result = TypeVar("Result")


class JobPool(Protocol):
    """A started pool of workers, of this machine or a cluster; `WorkerPool` says what its methods do and raise."""

    size: int
    n_waiting: int

    @property
    def threads_per_job(self) -> int: ...

    async def run(self, function: Callable[[Job], Result], job: Job) -> Result: ...

    async def run_when_idle(
        self, function: Callable[[Job], Result], make_job: Callable[[], Job]
    ) -> Result: ...


class WorkerStartError(ServiceError):
    """A worker process fails or hangs in its initialization; fatal for the daemon."""


class JobLostError(ServiceError):
    """A job failed twice, each time in a fresh process; `reason` is `WORKER_CRASH` or `DEADLINE`.

    `is_hosts`: the host had no descriptor or no room for it, whatever the job was.
    """

    def __init__(self, reason: LossReason, detail: str, is_hosts: bool = False) -> None:
        super().__init__(reason, detail, is_hosts)  # the arguments of this class: pickle calls it with them
        self.reason = reason
        self.detail = detail
        self.is_hosts = is_hosts

    def __str__(self) -> str:
        return f"{self.reason}: {self.detail}"


class WorkerPool:
    """Runs jobs in worker processes: `start`, any number of concurrent `run`, `close`; all on the event loop.

    In `async with` it is started and closed. `prepare` and the context must be picklable, like jobs and results.
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
    ) -> None:
        """`retry_s`: pause before another attempt where a process cannot be replaced; None: there is none."""
        warm_up_locks: Mapping[int, asyncio.Lock] = defaultdict(asyncio.Lock)
        self._slots = [_Slot(name, prepare, context, warm_up_locks) for _ in range(slots)]
        self.size = slots
        self._idle: asyncio.Queue[_Slot] = asyncio.Queue()
        self._deadline_s = deadline_s
        self._retry_s = retry_s
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
            self.close()
            raise
        for slot in self._slots:
            self._idle.put_nowait(slot)

    async def run(self, function: Callable[[Job], Result], job: Job) -> Result:
        """Return `function(job)`, computed in the first idle slot; raise what `run_when_idle` raises."""
        return await self.run_when_idle(function, lambda: job)

    async def run_when_idle(self, function: Callable[[Job], Result], make_job: Callable[[], Job]) -> Result:
        """Return `function(make_job())`, the job made once a slot is idle; a `WorkerFailure` counts as a crash.

        Raises `JobLostError` when it failed twice, `WorkerStartError` when the slot could not be rebuilt.
        """
        self._n_jobs += 1
        self.n_waiting += 1
        try:
            slot = await self._idle.get()
        finally:
            self.n_waiting -= 1
        try:
            async with slot.busy:
                return await self._run_in(slot, function, make_job())
        finally:
            self._idle.put_nowait(slot)

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

    async def _run_in(self, slot: "_Slot", function: Callable[[Job], Result], job: Job) -> Result:
        try:
            return await slot.run(function, job, self._deadline_s)
        except JobLostError as err:
            log.warning("%s; retrying in a fresh worker", err)
            await self._rebuild(slot, err)
        try:
            return await slot.run(function, job, self._deadline_s)
        except JobLostError as err:
            await self._rebuild(slot, err)
            raise

    async def _rebuild(self, slot: "_Slot", failure: JobLostError) -> None:
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
        """Kill all processes; jobs that still run in them are lost."""
        sentinels = [slot.process.sentinel for slot in self._slots if slot.process is not None]
        for slot in self._slots:
            slot.kill()
        for sentinel in sentinels:  # their folder is about to be removed
            wait([sentinel], timeout=CLOSE_DEADLINE_S)


class _Slot:
    """A place for one worker process, which is replaced when it dies."""

    def __init__(
        self, name: str, prepare: Prepare, context: object, warm_up_locks: Mapping[int, asyncio.Lock]
    ) -> None:
        """`warm_up_locks`: by the number of a warm-up, the lock of the slot that runs it."""
        self._name = name
        self._prepare = prepare
        self._context = context
        self._warm_up_locks = warm_up_locks
        self._executor: ProcessPoolExecutor | None = None
        self.process: BaseProcess | None = None
        self._pidfd = -1
        self.has_compiled = False
        self.busy = asyncio.Lock()

    async def start(self) -> None:
        """Start a process and warm it up for jobs."""
        for attempt in range(1, START_ATTEMPTS + 1):
            executor = self._executor = ProcessPoolExecutor(
                max_workers=1,
                mp_context=multiprocessing.get_context("forkserver"),
                initializer=begin_process,
                initargs=(self._name, self._prepare),
            )
            try:
                # on a thread: a fork server that was killed takes a second to import everything again
                begun = await asyncio.to_thread(self._begin, executor)
                async with asyncio.timeout(START_DEADLINE_S):
                    await asyncio.wrap_future(begun)
                    self.has_compiled = await self._warm_up(executor)
                return
            # the last two are what a fork server raises that is killed at this moment
            except (BrokenProcessPool, TimeoutError, WorkerFailure, OSError, EOFError) as err:
                self.kill()
                log.error("worker did not start: %s attempt=%d", str(err) or type(err).__name__, attempt)
                await asyncio.sleep(BACK_OFF_S)
        raise WorkerStartError(f"a worker process failed to start {START_ATTEMPTS} times in a row")

    def _begin(self, executor: ProcessPoolExecutor) -> Future[int]:
        """Start the executor's process and return its first job; blocks."""
        with _starting:
            ensure_fork_server()
            others = set(multiprocessing.active_children())
            begun = executor.submit(os.getpid)  # starts the process
            started = set(multiprocessing.active_children()) - others
        if not started:
            raise BrokenProcessPool("the process ended at once")
        (self.process,) = started
        self._pidfd = os.pidfd_open(self.process.pid or 0)
        return begun

    async def _warm_up(self, executor: ProcessPoolExecutor) -> bool:
        """Run all warm-ups, first those that no other slot is running; return whether something was compiled."""
        n_warm_ups = await asyncio.wrap_future(executor.submit(prepare_process, self._prepare, self._context))
        left = list(range(n_warm_ups))
        has_compiled = False
        while left:
            number = next((number for number in left if not self._warm_up_locks[number].locked()), left[0])
            left.remove(number)
            async with self._warm_up_locks[number]:
                has_compiled |= await asyncio.wrap_future(executor.submit(warm_up, number))
        await asyncio.wrap_future(executor.submit(freeze_gc))
        return has_compiled

    async def renew(self) -> None:
        """Start another process and replace this one by it between two jobs."""
        successor = _Slot(self._name, self._prepare, self._context, self._warm_up_locks)
        try:
            await successor.start()
            async with self.busy:
                self.kill()
                self.process, successor.process = successor.process, None
                self._pidfd, successor._pidfd = successor._pidfd, -1
                self._executor, successor._executor = successor._executor, None
                self.has_compiled = False
        finally:
            successor.kill()

    async def run(self, function: Callable[[Job], Result], job: Job, deadline_s: float) -> Result:
        if self._executor is None or self.process is None:
            raise WorkerStartError("the worker pool is not running")
        pid = self.process.pid
        try:
            async with asyncio.timeout(deadline_s):
                return await asyncio.wrap_future(self._executor.submit(function, job))
        except TimeoutError:
            raise JobLostError(LossReason.DEADLINE, f"not finished within {deadline_s:g} s") from None
        except BrokenProcessPool as err:
            raise JobLostError(LossReason.WORKER_CRASH, f"worker process {pid} died") from err
        except WorkerFailure as err:
            log.error("a job failed in worker process %s:\n%s", pid, err)
            # type and message of the exception, without the folders of paths because clients can read it
            detail = re.sub(r"(?<![\w.])/\S*/", "", str(err).strip().rpartition("\n")[2])
            raise JobLostError(LossReason.WORKER_CRASH, detail, is_hosts=err.is_hosts) from err

    def kill(self) -> None:
        if self._pidfd >= 0:
            # not Process.kill: it takes a process for dead whose fork server was killed
            with suppress(ProcessLookupError):
                signal.pidfd_send_signal(self._pidfd, signal.SIGKILL)
            os.close(self._pidfd)
            self._pidfd = -1
        if self._executor is not None:
            self._executor.shutdown(wait=False, cancel_futures=True)
        self.process = self._executor = None


def workers_check(n_up: int, n_slots: int, restarts: int, trouble: str | None) -> HealthCheck:
    """Check that all processes run, and that none failed lately."""
    detail = f"{n_up} of {n_slots} up, {restarts} restarts"
    if trouble:
        detail += f"; within the last minute: {trouble}"
    return health_check(detail, n_up, "processes", warn=n_up < n_slots or trouble is not None, fail=n_up == 0)
