"""Measure a daemon's stones again on a cluster: the daemon orders each, and takes the record.

Four bundles for each process of the cluster are under way at most, whatever the size of the archive. Killed at any
moment, this leaves nothing but orders, which the daemon forgets.
"""

import asyncio
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Any

from drivers.errors import RecordingError
from service.base.errors import UsageError
from service.commands.daemon_client import DaemonClient, DaemonError
from service.commands.measuring_pool import IN_FLIGHT
from service.processing.measure_job import measure
from service.processing.worker_pool import JobLostError, JobPool
from service.remeasuring.executor import open_cluster
from service.remeasuring.jobs import Hindrance
from service.remeasuring.orders import MAX_OPEN, Order, read_context, read_order, write_record

TRIES = 3
"""Orders for one stone: the background that one names may be replaced before it is read."""


@dataclass(slots=True)
class RemeasuredIds:
    """The ids of the stones of `stonefall remeasure`, by outcome."""

    revised: list[str] = field(default_factory=list)
    unchanged: list[str] = field(default_factory=list)
    without_frames: list[str] = field(default_factory=list)
    failed: dict[str, str] = field(default_factory=dict)  # with the reason


@contextmanager
def noted_refusal(name: str, summary: RemeasuredIds) -> Iterator[None]:
    """Note why a daemon refuses to measure a stone again; what is about no stone is raised on."""
    try:
        yield
    except DaemonError as err:
        if err.kind == Hindrance.NO_FRAMES:
            summary.without_frames.append(name)
        elif err.kind in (Hindrance.NO_CALIBRATION, Hindrance.FAILED):
            summary.failed[name] = str(err)
        else:  # the daemon stops, the key is wrong, the rig was never empty
            raise


@dataclass(frozen=True, slots=True)
class OrderingDaemon:
    """A daemon on this host that runs as our own user."""

    daemon: DaemonClient
    spool_dir: Path

    async def order(self, name: str) -> tuple[str, Order] | None:
        """Return the name of an order for a stone, and the order; None if there is nothing to measure again.

        Raises
        ------
        DaemonError
            It does not answer, or refuses.
        UsageError
            We are on another host, or another user.
        """
        ordered = await self._post(f"/particles/{name}/revisions/orders")
        if not ordered["is_needed"]:
            return None
        folder = Path(ordered["folder"])
        await asyncio.to_thread(self._require_own, folder)
        return ordered["order"], await asyncio.to_thread(read_order, folder)

    async def deliver(self, name: str, order: str) -> bool:
        """Request a revision from the record; return False if the stone was revised meanwhile."""
        done = await self._post(f"/particles/{name}/revisions", {"order": order})
        return bool(done["is_new"])

    async def _post(self, path: str, body: dict[str, str] | None = None) -> dict[str, Any]:
        return await asyncio.to_thread(self.daemon.ask, path, body or {})

    def _require_own(self, folder: Path) -> None:
        """Raise `UsageError` unless the folder is of our user and in the spool: what lies in it is trusted."""
        try:
            is_own = folder.stat().st_uid == os.geteuid()
        except OSError as err:
            raise UsageError(f"--executor: {err}: run this on the daemon's host, as its user") from None
        if not is_own or not folder.resolve().is_relative_to(self.spool_dir.resolve()):
            raise UsageError(
                f"--executor: {folder} is not a folder of this user in {self.spool_dir}: run this as the daemon's user"
            )


async def remeasure_on_cluster(
    daemon: OrderingDaemon,
    executor: str,
    names: Sequence[str],
    summary: RemeasuredIds,
    on_progress: Callable[[], object],
) -> None:
    """Measure these stones on the cluster, and note the outcome of each.

    Raises as `OrderingDaemon.order`, `open_cluster` and `ClusterPool.run` do.
    """
    left = iter(names)
    for name in left:
        with noted_refusal(name, summary):
            if (ordered := await daemon.order(name)) is not None:
                context = await asyncio.to_thread(read_context, ordered[1])
                break
            summary.unchanged.append(name)
        on_progress()
    else:
        return
    async with open_cluster(executor, context) as pool, asyncio.TaskGroup() as tasks:
        names_left = chain([name], left)

        async def remeasure_all() -> None:
            for name in names_left:  # that no other task has taken
                with noted_refusal(name, summary):
                    await _remeasure(name, daemon, pool, summary)
                on_progress()

        for _ in range(min(IN_FLIGHT * pool.size, MAX_OPEN // 2)):  # there may be another command
            tasks.create_task(remeasure_all())


async def _remeasure(name: str, daemon: OrderingDaemon, pool: JobPool, summary: RemeasuredIds) -> None:
    for attempt in range(1, TRIES + 1):
        if (ordered := await daemon.order(name)) is None:
            summary.unchanged.append(name)
            return
        order_name, order = ordered
        try:
            measured = await pool.run(measure, order.job)
            await asyncio.to_thread(write_record, order, measured.record)
        except FileNotFoundError as err:
            if attempt == TRIES:
                summary.failed[name] = str(err)
        except RecordingError as err:
            summary.failed[name] = err.problem
            return
        except JobLostError as err:
            summary.failed[name] = str(err)
            return
        else:
            is_new = await daemon.deliver(name, order_name)
            (summary.revised if is_new else summary.unchanged).append(name)
            return
