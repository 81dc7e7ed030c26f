"""Stones of the store measured again by a cluster, for the command that drives it on the daemon's host.

The daemon never talks to a cluster, whose connections carry code; it decides what is measured with what, and writes
the store. An order is a folder of its own on tmpfs, with the job in it; the command lays what was measured into it, and
asks to have it delivered. Only the user of the service can write there, who may write the store as well: a client of
REST cannot make up a result. Orders of a command that was killed are removed when others come, and with the session.
"""

import asyncio
import json
import pickle
import shutil
from pathlib import Path
from typing import TypeVar

from drivers.files.durable import replacing
from service.processing.measure_job import MeasureJob, WorkerContext
from service.remeasuring.jobs import Hindrance, Jobs, RemeasureError, revise
from service.results.fields import Result
from service.results.record import document_of, result_of
from service.results.version import ALGORITHM_VERSION
from service.store import Record

Content = TypeVar("Content")

MAX_OPEN = 1024
"""Orders that are open at a time; the oldest give way to others."""
ORDER, CONTEXT, RECORD = "order.pickle", "context.pickle", "record.json"


def read_order(folder: Path) -> MeasureJob:
    """Return the job that was ordered in a folder, which must be trusted; like all readers for the cluster's side."""
    return _unpickled(folder / ORDER, MeasureJob)


def read_context(job: MeasureJob) -> WorkerContext:
    """Return the context of the daemon's workers, which all orders of a daemon share."""
    return _unpickled(job.out_dir.parents[1] / CONTEXT, WorkerContext)


def write_record(job: MeasureJob, record: Result) -> None:
    """Write the record of what was measured beside its files."""
    with replacing(job.out_dir / RECORD) as temporary:
        temporary.write_text(json.dumps(document_of(record)))


class Orders:
    """Open orders, by name: `order`, then `deliver`; all on the event loop."""

    def __init__(self, jobs: Jobs, context: WorkerContext) -> None:
        self._jobs = jobs
        self._context = context
        self._folder = jobs.folder / "orders"
        self._open: dict[str, str] = {}  # the stone's id, by the name of the folder
        self._n_orders = 0

    async def order(self, name: str) -> Path | None:
        """Return the folder of an order for the stone with this id; None if there is nothing to measure again.

        Raises `RemeasureError` if it cannot be measured again.
        """
        record = await self._jobs.wanted(name)
        if record is None:
            return None
        self._n_orders += 1
        folder = self._folder / f"{self._n_orders}"
        job = await self._jobs.job_for(record, folder / "out")
        self._open[folder.name] = name
        await asyncio.to_thread(_write, folder, job, self._context)
        while len(self._open) > MAX_OPEN:
            await self._remove(next(iter(self._open)))
        return folder

    async def deliver(self, name: str, order: str, who: str) -> bool:
        """Revise the stone by what lies in the folder of its order; return False if it was revised meanwhile.

        Raises `RemeasureError` if there is no such order, or it has no sound result.
        """
        if self._open.get(order) != name:
            raise RemeasureError(Hindrance.NO_ORDER, f"{order} is no open order for {name}")
        del self._open[order]
        try:
            before = await self._jobs.wanted(name)
            if before is None:
                return False
            out = self._folder / order / "out"
            record = await asyncio.to_thread(_read_record, out / RECORD, before)
            return await revise(self._jobs.store, before, record, out, who)
        finally:
            await self._remove(order)

    async def _remove(self, order: str) -> None:
        self._open.pop(order, None)
        await asyncio.to_thread(shutil.rmtree, self._folder / order, ignore_errors=True)


def _write(folder: Path, job: MeasureJob, context: WorkerContext) -> None:
    folder.mkdir(parents=True)
    if not (shared := folder.parent / CONTEXT).exists():
        with replacing(shared) as temporary:
            temporary.write_bytes(pickle.dumps(context))
    (folder / ORDER).write_bytes(pickle.dumps(job))


def _read_record(path: Path, before: Record) -> Result:
    """Return the record of what was measured; raise `RemeasureError` unless it is one of this stone."""
    try:
        record = result_of(json.loads(path.read_text()))
    except (OSError, ValueError, TypeError) as err:
        raise RemeasureError(
            Hindrance.FAILED, f"{before['id']}: nothing measured lies in its order: {err}"
        ) from None
    wanted = {
        "bundle": before["bundle"],
        "calibration_id": before["calibration_id"],
        "algorithm_version": ALGORITHM_VERSION,
    }
    for field, value in wanted.items():
        if (found := getattr(record, field)) != value:
            raise RemeasureError(Hindrance.FAILED, f"{before['id']}: {field} is {found!r}, not {value!r}")
    return record


def _unpickled(path: Path, kind: type[Content]) -> Content:
    found = pickle.loads(path.read_bytes())  # noqa: S301 - of our own user, see `service.commands.remeasure`
    if not isinstance(found, kind):
        raise TypeError(f"{path} holds no {kind.__name__}")
    return found
