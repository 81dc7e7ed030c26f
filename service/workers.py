"""Worker processes: N slots of one process each; a crash or a deadline costs one job one retry.

A `ProcessPoolExecutor` of several workers breaks as a whole when one dies, so every slot has its own.
Processes are spawned, never forked (drivers have threads of their own), end with the daemon however
it ends, and leave Ctrl-C to it.
"""

import asyncio
import logging
import multiprocessing
import os
import re
import signal
import threading
import traceback
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing.connection import wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any, TypeVar

from service.errors import ServiceError, WorkerFailure
from service.process_memory import spare_collections

Job = TypeVar("Job")
Result = TypeVar("Result")
Initialize = Callable[[Any, int], bool]

log = logging.getLogger(__name__)

START_DEADLINE_S = 300.0
"""Compiling takes 20 s, on a machine that does nothing else."""
START_ATTEMPTS = 3
CLOSE_DEADLINE_S = 2.0
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


@contextmanager
def worker_boundary() -> Iterator[None]:
    """Turn whatever goes wrong within into a `WorkerFailure` with the traceback as text: it travels home as it is."""
    try:
        yield
    except Exception as err:  # noqa: BLE001 - the one place where everything is caught
        raise WorkerFailure("".join(traceback.format_exception(err))) from None


class WorkerPool:
    """Life cycle: `start`, any number of concurrent `run`, `close`; all on the event loop.

    `initialize(context, number)` runs once in each new process, the `number`th; it and the context must be
    picklable, like jobs and results. If it returns True, the process is replaced by another: it had to compile,
    and the compiler's memory stays. The processes are called `name` (15 bytes).
    """

    def __init__(
        self,
        *,
        slots: int,
        deadline_s: float,
        initialize: Initialize,
        context: object,
        name: str = WORKER_NAME,
    ) -> None:
        self._slots = [_Slot(name, initialize, (context, number)) for number in range(slots)]
        self._idle: asyncio.Queue[_Slot] = asyncio.Queue()
        self._deadline_s = deadline_s
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
        slot = await self._idle.get()
        try:
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
        finally:
            self._idle.put_nowait(slot)

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
    function: Callable[[Job], Result], job: Job, *, deadline_s: float, initialize: Initialize
) -> Result:
    """Return `function(job)`, computed in a process made for it: bundles do not wait for what takes long.

    Raises
    ------
    JobLostError
        It failed twice.
    WorkerStartError
        The process does not start.
    """
    pool = WorkerPool(slots=1, deadline_s=deadline_s, initialize=initialize, context=None)
    try:
        await pool.start()
        return await pool.run(function, job)
    finally:
        pool.close()


class _Slot:
    def __init__(self, name: str, initialize: Initialize, arguments: tuple[object, int]) -> None:
        self._name = name
        self._initialize = initialize
        self._arguments = arguments
        self._executor: ProcessPoolExecutor | None = None
        self.process: BaseProcess | None = None

    @property
    def pid(self) -> int | None:
        return None if self.process is None else self.process.pid

    async def start(self) -> None:
        """Spawn a process and initialize it."""
        is_second = False
        for attempt in range(1, START_ATTEMPTS + 1):
            executor = self._executor = ProcessPoolExecutor(
                max_workers=1,
                mp_context=multiprocessing.get_context("spawn"),
                initializer=_begin,
                initargs=(self._name, self._initialize),
            )
            others = set(multiprocessing.active_children())
            begun = executor.submit(os.getpid)  # starts the process
            (self.process,) = set(multiprocessing.active_children()) - others
            try:
                async with asyncio.timeout(START_DEADLINE_S):
                    await asyncio.wrap_future(begun)
                    is_spent = await asyncio.wrap_future(
                        executor.submit(_warm_up, self._initialize, self._arguments)
                    )
            except (BrokenProcessPool, TimeoutError, WorkerFailure) as err:
                self.kill()
                log.error("worker did not start: %s attempt=%d", str(err) or "deadline", attempt)
            else:
                if not is_spent or is_second:
                    return
                is_second = True
                self.kill()
        raise WorkerStartError(f"a worker process failed to start {START_ATTEMPTS} times in a row")

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


def _begin(name: str, initialize: Initialize) -> None:
    """First thing in a new worker process, which has by now imported what `initialize` needs."""
    Path("/proc/self/comm").write_text(name)
    for number in (signal.SIGINT, signal.SIGTERM):  # a terminal sends them to the whole process group
        signal.signal(number, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, name="end-with-parent", daemon=True).start()


def _warm_up(initialize: Initialize, arguments: tuple[object, int]) -> bool:
    with worker_boundary():
        is_spent = initialize(*arguments)
    spare_collections()
    return is_spent


def _end_with_parent() -> None:
    """Kill this process as soon as its parent is gone.

    The sentinel is a pipe whose other end only the parent holds. PR_SET_PDEATHSIG would not do: it
    fires when the parent's *thread* that spawned us ends (prctl(2)).
    """
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os.kill(os.getpid(), signal.SIGKILL)
