"""One transaction a revision: the item of the feed, the lot that the stone is in, the entry of the audit."""

import logging
import sqlite3
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from drivers.interfaces import FrameLossReason
from pipeline.views.dropped import DropCause, DroppedView
from service.lots.lots import note_revised
from service.processing.measure_job import RESULT_FILES
from service.remeasuring.jobs import Hindrance, RemeasureError
from service.results.fields import Result
from service.store import Record, Store, audit
from service.store.particle_files import drop_sources
from service.store.reads import particle
from service.store.writes import add_revision

log = logging.getLogger(__name__)

DAMAGED = str(DroppedView(DropCause.NO_FRAME, FrameLossReason.DAMAGED))
"""Why a view is missing whose page cannot be read."""
NOTED = (
    "seq", "revision", "outcome", "reason", "quality", "volume_mm3", "sieve_size_mm", "calibration_id",
    "algorithm_version",
)  # fmt: skip
"""Fields of a result that the audit has before and after."""


async def revise(store: Store, before: Record, record: Result, folder: Path, who: str) -> bool:
    """Revise a stone by what was measured into a folder; return False if it was revised since `before`.

    Raises `RemeasureError` if frames of it were damaged since, or its files were just removed.
    """
    damaged = [
        camera for camera, why in record.dropped_views.items() if why == DAMAGED and camera in before["views"]
    ]
    if damaged:  # a result must not become worse for that
        raise RemeasureError(Hindrance.FAILED, f"{before['id']}: frames of {', '.join(damaged)} are damaged")
    files = {name: path for name in RESULT_FILES if (path := folder / name).is_file()}
    seq = await store.write(_revise, store.particles_dir, before, record, files, who)
    if seq is not None:
        drop_sources(files)
        log.info("measured again id=%s seq=%d by=%s", before["id"], seq, who)
    return seq is not None


def _revise(
    connection: sqlite3.Connection,
    particles_dir: Path,
    before: Record,
    record: Result,
    files: Mapping[str, Path],
    who: str,
) -> int | None:
    """Add a revision and return its `seq`; None if `before` is not the stone's newest result any more."""

    def noted(record: Record) -> dict[str, Any]:
        return {field: record.get(field) for field in NOTED}

    name = before["id"]
    newest = particle(connection, name)
    if newest is not None and newest["seq"] != before["seq"]:
        return None
    seq = add_revision(connection, particles_dir, name, record, files)
    after = None if seq is None else particle(connection, seq)
    if after is None:
        raise RemeasureError(Hindrance.NO_FRAMES, f"the files of {name} were just removed")
    if after["lot"] is not None:
        note_revised(connection, after["lot"])
    audit.note(connection, who, "particle remeasured", name, before=noted(before), after=noted(after))
    return seq
