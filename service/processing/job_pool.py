"""Pools that run the jobs of bundles: worker processes of this machine, or a cluster."""

from collections.abc import Callable
from typing import Protocol, TypeVar

Job = TypeVar("Job")
Result = TypeVar("Result")


class JobPool(Protocol):
    """A started pool; `WorkerPool` says what its methods do and raise."""

    @property
    def size(self) -> int: ...

    @property
    def n_waiting(self) -> int: ...

    @property
    def threads_per_job(self) -> int: ...

    async def run(self, function: Callable[[Job], Result], job: Job) -> Result: ...

    async def run_when_idle(
        self, function: Callable[[Job], Result], make_job: Callable[[], Job]
    ) -> Result: ...
