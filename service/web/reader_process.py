"""What clients ask for and takes long is made in two processes, with a lower priority than the workers.

Meshes and pictures have one of their own, so that no figure or verdict waits for them. Both start with the daemon, as
their imports would compete with several stones. When one dies, a request is tried once more in a new one; the daemon,
its loop and its interpreter's lock have no part in it but to pass on the bytes.
"""

import asyncio
import logging
import os
from collections.abc import Callable, Sequence
from functools import partial
from http import HTTPStatus
from importlib import import_module
from typing import Protocol, TypeVar

from service.base.errors import ProblemError, ProblemKind
from service.processing.worker_pool import WorkerPool
from service.processing.worker_process import WarmUp
from service.processing.worker_slot import JobLostError, WorkerStartError

log = logging.getLogger(__name__)

T = TypeVar("T")

DEADLINE_S = 30.0
"""Longest time for one answer: a page of a thousand takes 0.3 s of an idle core, but none may be idle for long."""
MAX_WAITING = 64
"""Requests that wait for the process; more are told to come again."""
NICENESS = 19
"""The least priority that always gets on: an eighth of a core beside a worker.

Of the class SCHED_IDLE the process would get nothing on a machine that is busy for long, and clients no answer.
"""
READING, DRAWING = "stonefall-read", "stonefall-draw"
"""Names of the process for figures and documents, and of the one for pictures and meshes, in `ps` and `top`."""


class BusyError(ProblemError):
    """Too many requests wait for the process, or it cannot make this answer now; the same may be asked again."""

    kinds = (
        ProblemKind("busy", HTTPStatus.SERVICE_UNAVAILABLE, "More is asked for than can be made at a time"),
    )
    retry_after_s = 2


class Reading(Protocol):
    """A place where what blocks is done for a request."""

    async def run(self, function: Callable[..., T], *arguments: object) -> T:
        """Return `function(*arguments)`, all of which can be pickled; what it raises is raised here."""
        ...


def prepare(context: tuple[int, Sequence[str]]) -> tuple[WarmUp, ...]:
    """Give this process a lower priority, and let it import what makes the answers before the first request."""
    niceness, modules = context
    os.nice(niceness)
    return (partial(_import, modules),)


def _import(modules: Sequence[str]) -> bool:
    for module in modules:
        import_module(module)
    return False  # nothing is compiled


class ReaderProcess:
    """Runs one request at a time in a process of this name, which imports `modules` first; a `Reading`."""

    def __init__(self, modules: Sequence[str] = (), name: str = READING) -> None:
        self._pool = WorkerPool(
            slots=1, deadline_s=DEADLINE_S, prepare=prepare, context=(NICENESS, modules), name=name
        )
        self._turn = asyncio.Lock()
        self._n_waiting = 0

    async def start(self) -> None:
        """Start the process; one that fails to is tried again with the first request."""
        async with self._turn:
            try:
                await self._pool.start()
            except WorkerStartError as err:
                log.error("the process that answers requests did not start: %s", err)

    async def run(self, function: Callable[..., T], *arguments: object) -> T:
        """Return `function(*arguments)`.

        Raises `BusyError` when `MAX_WAITING` requests wait already, or the process died or took too long twice.
        """
        if self._n_waiting >= MAX_WAITING:
            raise BusyError("too many other requests are waiting: try again in 2 s")
        self._n_waiting += 1
        try:
            async with self._turn:
                return await self._pool.run(partial(function, *arguments))
        except (JobLostError, WorkerStartError) as err:
            log.error("a request was given up: %s", err)
            raise BusyError("this could not be made now: try again in 2 s") from err
        finally:
            self._n_waiting -= 1

    def close(self) -> None:
        """Kill the process."""
        self._pool.close()
