"""Writes to the database: each function is one transaction on the writer's connection.

Invariants: every trigger ends in at most one result (`UNIQUE (trigger)`), and results are numbered without
a gap, because the number is taken in the transaction that makes the result durable.
"""

import json
import sqlite3
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from drivers.files.times import utc_now
from pipeline.frames import BundleKind, Trigger, rfc3339
from service.errors import StoreError
from service.results.fields import LossReason
from service.results.record import lost_record
from service.store.particle_files import drop_sources, keep_files, particle_id
from service.store.schema import transaction


def begin_session(connection: sqlite3.Connection, info: Mapping[str, Any]) -> int:
    """Record the start of a run of the daemon and return its number."""
    with transaction(connection):
        (session,) = connection.execute(
            "INSERT INTO sessions (started_at, info) VALUES (?, ?) RETURNING session",
            (utc_now(), json.dumps(info, allow_nan=False)),
        ).fetchone()
    return int(session)


def note_calibration(connection: sqlite3.Connection, session: int, calibration_id: str) -> None:
    """Record in the `info` of a session which calibration it uses from now on."""
    with transaction(connection):
        connection.execute(
            "UPDATE sessions SET info = json_set(info, '$.calibration_id', ?) WHERE session = ?",
            (calibration_id, session),
        )


def note_first_raw(connection: sqlite3.Connection, seq: int) -> None:
    """Record that results before `seq` have no raw frames."""
    with transaction(connection):
        connection.execute("UPDATE store SET first_raw = ?", (seq,))


def record_triggers(connection: sqlite3.Connection, session: int, triggers: Mapping[str, Trigger]) -> None:
    """Record triggers by the names of their bundles, without an outcome yet."""
    with transaction(connection):
        connection.executemany(
            "INSERT INTO triggers (session, bundle, sequence, kind, captured_at, state)"
            " VALUES (?, ?, ?, ?, ?, ?)",
            [
                (
                    session,
                    bundle,
                    trigger.sequence,
                    trigger.kind,
                    rfc3339(trigger.utc),
                    "background" if trigger.kind is BundleKind.BACKGROUND else "open",
                )
                for bundle, trigger in triggers.items()
            ],
        )


def finish(
    connection: sqlite3.Connection,
    particles_dir: Path,
    session: int,
    bundle: str,
    record: Mapping[str, Any],
    files: Mapping[str, Path],
) -> int:
    """End a trigger with `record` and return its `seq`; a trigger that has a result keeps that, and its `seq`."""
    with transaction(connection):
        row = connection.execute(
            "SELECT trigger, state, seq FROM triggers LEFT JOIN results USING (trigger)"
            " WHERE triggers.session = ? AND bundle = ?",
            (session, bundle),
        ).fetchone()
        if row is None:
            raise StoreError(f"session {session}, bundle {bundle}: no such trigger was recorded")
        trigger, state, seq = row
        if state == "background":
            raise StoreError(f"session {session}, bundle {bundle}: a background has no outcome")
        if seq is not None:
            return int(seq)
        seq = _end(connection, particles_dir, trigger, record, files)
    drop_sources(files)
    return seq


def lose_open(
    connection: sqlite3.Connection,
    particles_dir: Path,
    live_session: int | None,
    reason: LossReason,
    detail: str,
) -> int:
    """End as `lost` all open triggers of sessions other than `live_session`; return how many these were."""
    with transaction(connection):
        rows = connection.execute(
            "SELECT trigger, bundle, info FROM triggers JOIN sessions USING (session)"
            " WHERE state = 'open' AND session IS NOT ? ORDER BY trigger",
            (live_session,),
        ).fetchall()
        for trigger, bundle, info_text in rows:
            info = json.loads(info_text)
            record = lost_record(
                None,
                bundle=bundle,
                reason=reason,
                detail=detail,
                calibration_id=info.get("calibration_id"),
                is_simulated=info.get("is_simulated"),
            )
            _end(connection, particles_dir, trigger, record, {})
    return len(rows)


def _end(
    connection: sqlite3.Connection,
    particles_dir: Path,
    trigger: int,
    record: Mapping[str, Any],
    files: Mapping[str, Path],
) -> int:
    session, bundle, sequence, kind, captured_at = connection.execute(
        "SELECT session, bundle, sequence, kind, captured_at FROM triggers WHERE trigger = ?", (trigger,)
    ).fetchone()
    seq, instance_id = connection.execute(
        "UPDATE store SET last_seq = last_seq + 1 RETURNING last_seq, instance_id"
    ).fetchone()
    name = particle_id(instance_id, seq)
    keep_files(particles_dir / name, files)
    identity = {
        "seq": seq,
        "id": name,
        "session": session,
        "bundle": bundle,
        "sequence": sequence,
        "kind": kind,
        "captured_at": captured_at,
        "recorded_at": utc_now(),
        # relative to the state directory, and likewise to the base path of the REST interface
        "mesh": f"particles/{name}/mesh.ply" if "mesh.ply" in files else None,
    }
    stored = identity | dict(record) | identity  # first for the order of the keys, last for the values
    connection.execute(
        "INSERT INTO results (seq, id, trigger, session, record) VALUES (?, ?, ?, ?, ?)",
        (seq, name, trigger, session, json.dumps(stored, allow_nan=False)),
    )
    connection.execute("UPDATE triggers SET state = ? WHERE trigger = ?", (record["outcome"], trigger))
    return int(seq)
