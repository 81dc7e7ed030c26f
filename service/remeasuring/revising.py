"""One transaction a revision: the item of the feed, the lot that the stone is in, the entry of the audit."""

import sqlite3
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from service.lots.lots import note_revised
from service.store import audit
from service.store.particle_files import drop_sources
from service.store.reads import particle
from service.store.revisions import add_revision
from service.store.schema import transaction

NOTED = (
    "seq", "revision", "outcome", "reason", "quality", "volume_mm3", "sieve_size_mm", "calibration_id",
    "algorithm_version",
)  # fmt: skip
"""Fields of a result that the audit has before and after."""


def revise(
    connection: sqlite3.Connection,
    particles_dir: Path,
    name: str,
    record: Mapping[str, Any],
    files: Mapping[str, Path],
    who: str,
) -> int | None:
    """Add a revision of the stone with this id and return its `seq`; None if its files were removed meanwhile."""
    with transaction(connection):
        before = particle(connection, name)
        seq = add_revision(connection, particles_dir, name, record, files)
        after = None if seq is None else particle(connection, seq)
        if before is None or after is None:
            return None
        if after["lot"] is not None:
            note_revised(connection, after["lot"])
        audit.note(connection, who, "particle remeasured", name, before=_noted(before), after=_noted(after))
    drop_sources(files)
    return seq


def _noted(record: Mapping[str, Any]) -> dict[str, Any]:
    return {field: record.get(field) for field in NOTED}
