"""A place for one worker process, which is started, given jobs, and replaced when it dies or takes too long."""

import asyncio
import logging
import multiprocessing
import os
import re
import signal
import threading
from collections.abc import Mapping
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from functools import partial
from multiprocessing.process import BaseProcess
from typing import TypeVar

from service.base.errors import ServiceError, WorkerFailure
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

_starting = threading.Lock()
"""Held while a process is started, so that it is told apart from those of others."""

Result = TypeVar("Result")


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


class Slot:
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
        self.is_ready = False
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
                self.is_ready = True
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
        successor = Slot(self._name, self._prepare, self._context, self._warm_up_locks)
        try:
            await successor.start()
            async with self.busy:
                self.kill()
                self.process, successor.process = successor.process, None
                self._pidfd, successor._pidfd = successor._pidfd, -1
                self._executor, successor._executor = successor._executor, None
                self.is_ready, self.has_compiled = True, False
        finally:
            successor.kill()

    async def run(self, job: partial[Result], deadline_s: float) -> Result:
        if self._executor is None or self.process is None:
            raise WorkerStartError("the worker pool is not running")
        pid = self.process.pid
        try:
            async with asyncio.timeout(deadline_s):
                return await asyncio.wrap_future(self._executor.submit(job))
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
        self.is_ready = False
        if self._pidfd >= 0:
            # not Process.kill: it takes a process for dead whose fork server was killed
            with suppress(ProcessLookupError):
                signal.pidfd_send_signal(self._pidfd, signal.SIGKILL)
            os.close(self._pidfd)
            self._pidfd = -1
        if self._executor is not None:
            self._executor.shutdown(wait=False, cancel_futures=True)
        self.process = self._executor = None
