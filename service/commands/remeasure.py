"""`stonefall remeasure`: have a running daemon measure its stones again, each as a revision of its result.

The daemon alone writes its store, so this command asks it for one stone after the other; or, with `--executor`, has a
cluster measure many at a time: the daemon orders each stone, and takes the record. Killed half-way, it leaves nothing
but orders, which the daemon forgets; started again, it goes on: what is of today's algorithm already is not measured
again.
"""

import asyncio
import json
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import Progress

from drivers.errors import RecordingError
from service.base.errors import UsageError
from service.commands.daemon_client import DaemonClient, DaemonError, Key
from service.commands.options import Executor
from service.commands.results_folder import IN_FLIGHT
from service.configuration.settings import load_settings
from service.processing.measure_job import MeasureJob, measure
from service.processing.worker_pool import JobPool
from service.processing.worker_slot import JobLostError
from service.remeasuring.executor import open_cluster
from service.remeasuring.jobs import Hindrance
from service.remeasuring.orders import MAX_OPEN, read_context, read_order, write_record
from service.remeasuring.remeasuring import DEADLINE_S
from service.results.fields import Outcome

PAGE = 1000
NAMED = 10
"""Stones of a kind that are named for people; `--json` names all."""
TRIES = 3
"""Times that the daemon may need for one stone: another client may have it measure, too, and the process must start.

On a cluster orders for one stone: the background that one names may be replaced before it is read.
"""


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


def command(
    config: Annotated[Path, typer.Option(help="Configuration file of the running daemon.")],
    lot: Annotated[str | None, typer.Option(help="Only stones of this lot.")] = None,
    since: Annotated[str | None, typer.Option(help="Captured at or after, RFC 3339.")] = None,
    until: Annotated[str | None, typer.Option(help="Captured before, RFC 3339.")] = None,
    executor: Executor = None,
    key: Key = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the outcome of each stone as JSON.")] = False,
) -> None:
    """Measure stones again from their archived frames, with today's algorithm; the results become revisions.

    What each version of the algorithm changed in results: service/remeasuring/README.md.
    """
    settings = load_settings(config)
    daemon = DaemonClient(settings.api.local_url, key)
    query = {"kind": "particle", "lot": lot, "since": since, "until": until, "fields": "algorithm_version"}
    wanted = {name: value for name, value in query.items() if value is not None}
    summary = RemeasuredIds(
        without_frames=[stone["id"] for stone in _stones(daemon, wanted, has_frames=False)]
    )
    names = [stone["id"] for stone in _stones(daemon, wanted, has_frames=True)][::-1]  # the oldest first
    with Progress(console=Console(file=sys.stderr)) as progress:
        bar = progress.add_task("measuring again", total=len(names))
        if executor is None:
            for name in names:
                with noted_refusal(name, summary):
                    done = daemon.ask(f"/particles/{name}/revisions", {}, timeout_s=TRIES * DEADLINE_S)
                    (summary.revised if done["is_new"] else summary.unchanged).append(name)
                progress.advance(bar)
        else:
            ordering = OrderingDaemon(daemon, settings.spool.dir)
            asyncio.run(
                remeasure_on_cluster(ordering, executor, names, summary, lambda: progress.advance(bar))
            )
    if as_json:
        typer.echo(json.dumps(asdict(summary)))
    else:
        n_revised, n_same, gone = map(len, (summary.revised, summary.unchanged, summary.without_frames))
        typer.echo(f"{n_revised} stones measured again, {n_same} were of this algorithm")
        if gone:
            more = f" and {gone - NAMED} more" if gone > NAMED else ""
            typer.echo(f"{gone} have no frames any more: {', '.join(summary.without_frames[:NAMED])}{more}")
        for name, why in summary.failed.items():
            typer.echo(f"{name}: {why}", err=True)
    if summary.failed:
        raise typer.Exit(1)


def _stones(daemon: DaemonClient, wanted: dict[str, str], *, has_frames: bool) -> Iterator[dict[str, Any]]:
    """Return the stones that were looked at, newest first."""
    stones = daemon.pages("/particles", {**wanted, "has_frames": str(has_frames).lower(), "limit": PAGE})
    return (stone for stone in stones if stone["outcome"] != Outcome.LOST)


@dataclass(frozen=True, slots=True)
class OrderingDaemon:
    """A daemon on this host that runs as our own user."""

    daemon: DaemonClient
    spool_dir: Path

    async def order(self, name: str) -> tuple[str, MeasureJob] | None:
        """Return the name of an order for a stone, and the job; None if there is nothing to measure again.

        Raises `DaemonError` as `DaemonClient.ask` does, `UsageError` on another host, or as another user.
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
        order_name, job = ordered
        try:
            measured = await pool.run(partial(measure, job))
            await asyncio.to_thread(write_record, job, measured.record)
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
