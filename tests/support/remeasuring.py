"""Measuring again without pixels: a pool that returns a made-up record, and stones with frames."""

import asyncio
import sqlite3
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from support.outcomes import add, measured
from support.rest import particle_files

from pipeline.particle import PipelineParameters
from pipeline.preview import encode_png
from service.processing.measure_job import MESH, THUMBNAIL, MeasuredBundle, MeasureJob, WorkerContext
from service.remeasuring.jobs import Jobs
from service.remeasuring.remeasuring import Remeasuring
from service.results.version import ALGORITHM_VERSION
from service.store import Store
from service.store.reads import particle

OLD = "0"
"""The algorithm's version of the stones that are to be measured again."""


@dataclass
class AgainPool:
    """Stands in for the process that measures again; writes a mesh of other size and a picture of 8 pixels."""

    fields: dict[str, Any] = field(default_factory=dict)  # of the next records
    error: Exception | None = None  # raised instead
    jobs: list[MeasureJob] = field(default_factory=list)
    n_rests: int = 0
    is_closed: bool = False
    closing: asyncio.Event = field(default_factory=asyncio.Event)

    async def run(self, call: partial[MeasuredBundle]) -> MeasuredBundle:
        if self.is_closed:
            raise asyncio.CancelledError
        (job,) = call.args
        self.jobs.append(job)
        if self.error is not None:
            raise self.error
        job.out_dir.mkdir(parents=True)
        trimesh.creation.box((1.0, 2.0, 3.0)).export(job.out_dir / MESH)
        (job.out_dir / THUMBNAIL).write_bytes(encode_png(np.zeros((8, 8), np.uint8)))
        made = {"calibration_id": job.rig_file.calibration_id, "algorithm_version": ALGORITHM_VERSION}
        record = measured(**made, **self.fields)
        return MeasuredBundle(record)

    def rest(self) -> None:
        self.n_rests += 1

    def close(self) -> None:
        self.is_closed = True
        self.closing.set()


def remeasuring_of(
    store: Store,
    calibrations: Any,
    pool: AgainPool,
    folder: Path,
    background: Callable[[], Path | None] = lambda: None,
) -> Remeasuring:
    """Return what measures stones of the store again, in that pool."""
    again = folder / "again"
    jobs = Jobs(store, calibrations.rig_file_of, background, folder=again, save_silhouettes=False)
    context = WorkerContext(parameters=PipelineParameters(), is_simulated=True)
    return Remeasuring(jobs, context, pool)


async def add_old(
    store: Store, session: int, sequence: int, folder: Path, calibration_id: str, **fields: Any
) -> str:
    """Store a stone with frames that an older algorithm measured; return its id."""
    record = measured(calibration_id=calibration_id, algorithm_version=OLD, **fields)
    seq = await add(store, session, sequence, record, particle_files(folder / "out"))
    found = await store.read(particle, seq)
    assert found is not None
    return str(found["id"])


def make_old(state: Path) -> None:
    """Have an older algorithm measured all stones of the store in this folder, whose daemon has ended."""
    with closing(sqlite3.connect(state / "results.sqlite")) as database, database:
        for table in ("results", "revisions"):
            query = f"UPDATE {table} SET record = json_set(record, '$.algorithm_version', ?)"  # noqa: S608 - two names
            database.execute(query, (OLD,))
        database.execute("UPDATE indexed_fields SET algorithm_version = ?", (OLD,))
