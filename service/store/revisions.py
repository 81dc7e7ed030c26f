"""Revise a result: a later item of the feed describes the same stone anew, and the first one stays as it is.

A revision has the stone's `id`, a `seq` of its own, and its files within the stone's folder, so that whatever holds,
moves or removes that folder takes them along. The raw frames stay where they are, and the accounting knows first
results only.
"""

import json
import sqlite3
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from drivers.files.times import is_of_unset_clock, utc_now
from service.store import indexed_fields
from service.store.particle_files import keep_files, path_of, revision_folder
from service.store.reads import particle

KEPT = (
    "id",
    "session",
    "bundle",
    "sequence",
    "kind",
    "captured_at",
    "is_simulated",
    "is_replay",
    "verification",
)
"""Fields of the stone and its fall, which measuring again does not change."""


def add_revision(
    connection: sqlite3.Connection,
    particles_dir: Path,
    name: str,
    record: Mapping[str, Any],
    files: Mapping[str, Path],
) -> int | None:
    """Add a revision of the stone with this id within a transaction, and return its `seq`.

    None if the stone or its files were removed meanwhile. `drop_sources(files)` is for after the commit.
    """
    before = particle(connection, name)
    found = connection.execute(
        "SELECT seq, folder FROM results JOIN files USING (seq) WHERE id = ? AND removed IS NULL", (name,)
    ).fetchone()
    if before is None or found is None:
        return None
    first, folder = found
    (seq,) = connection.execute("UPDATE store SET last_seq = last_seq + 1 RETURNING last_seq").fetchone()
    revision = before.get("revision", 1) + 1
    kept = keep_files(path_of(particles_dir, revision_folder(folder, revision)), files)
    recorded_at = utc_now()
    identity = {
        "seq": seq,
        "revision": revision,
        "revises": before["seq"],
        **{field: before.get(field) for field in KEPT},
        "recorded_at": recorded_at,
        "time_is_doubtful": is_of_unset_clock(min(before["captured_at"], recorded_at)),
        "mesh": f"particles/{seq}/mesh.ply" if any(file.startswith("mesh.") for file in kept) else None,
    }
    stored = identity | dict(record) | identity  # first for the order of the keys, last for the values
    connection.execute(
        "INSERT INTO revisions (seq, first, revision, record) VALUES (?, ?, ?, ?)",
        (seq, first, revision, json.dumps(stored, allow_nan=False)),
    )
    indexed_fields.update_row(connection, first)
    connection.execute("UPDATE files SET bytes = bytes + ? WHERE seq = ?", (sum(kept.values()), first))
    return int(seq)
