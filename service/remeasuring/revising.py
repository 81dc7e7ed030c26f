"""One transaction a revision: the item of the feed, the lot that the stone is in, the entry of the audit."""

import logging
import sqlite3
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from service.lots.lots import note_revised
from service.processing.measure_job import RESULT_FILES
from service.remeasuring.hindrance import Hindrance, RemeasureError, require_sound
from service.results.fields import Result
from service.store import Record, Store, audit
from service.store.particle_files import drop_sources
from service.store.reads import particle
from service.store.writes import add_revision

log = logging.getLogger(__name__)

NOTED = (
    "seq", "revision", "outcome", "reason", "quality", "volume_mm3", "sieve_size_mm", "calibration_id",
    "algorithm_version",
)  # fmt: skip
"""Fields of a result that the audit has before and after."""


async def revise(store: Store, before: Record, record: Result, folder: Path, who: str) -> bool:
    """Revise a stone by what was measured into a folder; return False if it was revised since `before`.

    Raises
    ------
    RemeasureError
        Frames of it were damaged since, or its files were just removed.
    """
    require_sound(before, record)
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
    audit.note(connection, who, "particle remeasured", name, before=_noted(before), after=_noted(after))
    return seq


def _noted(record: Record) -> dict[str, Any]:
    return {field: record.get(field) for field in NOTED}
