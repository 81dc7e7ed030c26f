"""A worker pool that is started with its first job, and ends a while after its last."""

import asyncio
from collections.abc import Callable

from service.processing.worker_pool import Job, Result, WorkerPool

REST_S = 60.0
"""Time without a job after which the processes end; they hold as much memory as the daemon's workers."""


class RestingPool:
    """Runs jobs in a pool that it makes with the first of them: `run`, as often as wanted, then `close`."""

    def __init__(self, make_pool: Callable[[], WorkerPool]) -> None:
        self._make_pool = make_pool
        self._pool: WorkerPool | None = None
        self._starting = asyncio.Lock()
        self._n_jobs = 0
        self._resting: asyncio.TimerHandle | None = None
        self._is_closed = False

    async def run(self, function: Callable[[Job], Result], job: Job) -> Result:
        """Run a job in the pool, which is started if it rests; raise `CancelledError` if it is closed."""
        if self._resting is not None:
            self._resting.cancel()
        self._n_jobs += 1
        try:
            return await (await self._started()).run(function, job)
        finally:
            self._n_jobs -= 1
            if self._n_jobs == 0 and not self._is_closed:
                self._resting = asyncio.get_running_loop().call_later(REST_S, self.rest)

    async def _started(self) -> WorkerPool:
        async with self._starting:
            if self._pool is None and not self._is_closed:
                pool = self._make_pool()
                await pool.start()
                self._pool = pool
            if self._is_closed:  # maybe while it started
                self.rest()
            if self._pool is None:
                raise asyncio.CancelledError
            return self._pool

    def rest(self) -> None:
        """End the processes, and what runs in them; they are started again when they are needed."""
        if self._resting is not None:
            self._resting.cancel()
        if self._pool is not None:
            self._pool.close()
            self._pool = None

    def close(self) -> None:
        """End the processes for good."""
        self._is_closed = True
        self.rest()
