"""Writes to the database: each function is one transaction on the writer's connection.

Invariants: every trigger ends in at most one result (`UNIQUE (trigger)`), and results are numbered without
a gap, because the number is taken in the transaction that makes the result durable.
"""

import json
import sqlite3
from collections.abc import Collection, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from drivers.files.times import is_of_unset_clock, utc_now
from pipeline.frames import BundleKind, GateCount, Trigger, rfc3339
from service.base.errors import StoreError
from service.results.fields import LossReason, Outcome
from service.results.record import lost_record
from service.store import indexed_fields
from service.store.particle_files import (
    drop_raw,
    drop_sources,
    keep_files,
    particle_folder,
    particle_id,
    path_of,
)
from service.store.schema import transaction

IS_REPLAY = (
    "coalesce(json_extract(info, '$.is_replay'), json_extract(info, '$.recording') IS NOT NULL"
    " OR coalesce(json_extract(info, '$.is_simulated'), 0))"
)
"""Whether a session's stones did not fall then; sessions from before it was noted tell by their rig."""
NOTE_EVERY = 100
"""Results between two notes in the database of how far raw frames were removed."""


def begin_session(connection: sqlite3.Connection, info: Mapping[str, Any]) -> int:
    """Record the start of a run of the daemon and return its number.

    Raises
    ------
    StoreError
        It is a replay and the store holds stones that fell, or the other way round.
    """
    with transaction(connection):
        session, is_replay = connection.execute(
            f"INSERT INTO sessions (started_at, info) VALUES (?, ?) RETURNING session, {IS_REPLAY}",  # noqa: S608 - a constant
            (utc_now(), json.dumps(info, allow_nan=False)),
        ).fetchone()
        others = connection.execute(
            f"SELECT 1 FROM sessions WHERE {IS_REPLAY} != ?"  # noqa: S608 - as above
            " AND EXISTS (SELECT 1 FROM triggers WHERE triggers.session = sessions.session)",
            (is_replay,),
        )
        if others.fetchone() is not None:
            held, wanted = ("stones that fell", "a replay") if is_replay else ("a replay", "a live rig")
            raise StoreError(f"the store holds the results of {held}: choose another store.dir for {wanted}")
    return int(session)


def note_calibration(connection: sqlite3.Connection, session: int, calibration_id: str) -> None:
    """Record in the `info` of a session which calibration it uses from now on."""
    with transaction(connection):
        connection.execute(
            "UPDATE sessions SET info = json_set(info, '$.calibration_id', ?) WHERE session = ?",
            (calibration_id, session),
        )


def first_with_frames(connection: sqlite3.Connection, keep_raw: int) -> int:
    """Return the first of the newest `keep_raw` results; revisions are none of them, as they have no frames."""
    row = connection.execute(
        "SELECT seq FROM listed ORDER BY seq DESC LIMIT 1 OFFSET ?", (keep_raw,)
    ).fetchone()
    return 1 if row is None else int(row[0]) + 1


def drop_old_raw(connection: sqlite3.Connection, particles_dir: Path, first: int, end: int) -> None:
    """Remove the raw frames of the results from `first` to before `end` but pinned ones, and note that at times."""
    rows = connection.execute(
        "SELECT folder FROM files WHERE seq >= ? AND seq < ? AND seq NOT IN (SELECT seq FROM pins)",
        (first, end),
    ).fetchall()
    for (folder,) in rows:
        drop_raw(path_of(particles_dir, folder))
    if end // NOTE_EVERY > first // NOTE_EVERY:
        with transaction(connection):
            connection.execute("UPDATE store SET first_raw = ?", (end,))


def record_triggers(
    connection: sqlite3.Connection,
    session: int,
    triggers: Mapping[str, Trigger],
    gate_count: GateCount | None,
) -> None:
    """Record triggers by the names of their bundles, without an outcome yet, and the gate's count at the last."""
    with transaction(connection):
        for bundle, trigger in triggers.items():
            _record(connection, session, bundle, trigger)
        if gate_count is not None:
            _note_gate_count(connection, session, asdict(gate_count))


def forget_gate_count(connection: sqlite3.Connection, session: int) -> None:
    """Record that nothing is missed of what the gate counts from now on."""
    with transaction(connection):
        _note_gate_count(connection, session, None)


def _note_gate_count(connection: sqlite3.Connection, session: int, count: Mapping[str, Any] | None) -> None:
    """Note the gate's count with the newest trigger, as `gate_count` in the `info` of the session."""
    (newest,) = connection.execute("SELECT max(trigger) FROM triggers").fetchone()
    connection.execute(
        "UPDATE sessions SET info = json_set(info, '$.gate_count', json(?)) WHERE session = ?",
        (json.dumps(count and {**count, "trigger": newest}), session),
    )


def finish(
    connection: sqlite3.Connection,
    particles_dir: Path,
    session: int,
    bundle: str,
    record: Mapping[str, Any],
    files: Mapping[str, Path],
) -> int:
    """End a trigger with `record` and return its `seq`; a trigger that has a result keeps that, and its `seq`.

    A trigger that was not recorded, because the store was held when it came, is recorded now.
    """
    with transaction(connection):
        row = connection.execute(
            "SELECT trigger, state, seq FROM triggers LEFT JOIN results USING (trigger)"
            " WHERE triggers.session = ? AND bundle = ?",
            (session, bundle),
        ).fetchone()
        trigger, state, seq = row or (_record_late(connection, session, bundle, record), "open", None)
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
    but: Collection[tuple[int, str]],
    most: int,
) -> int:
    """End as `lost` the first `most` open triggers of sessions other than `live_session`; return of how many stones.

    `but` are left open, by session and bundle: they are measured yet.
    """
    with transaction(connection):
        rows = connection.execute(
            "SELECT trigger, session, bundle, info, sequence, kind, captured_at, n"
            " FROM triggers JOIN sessions USING (session)"
            " WHERE state = 'open' AND session IS NOT ? ORDER BY trigger LIMIT ?",
            (live_session, most + len(but)),
        ).fetchall()
        lost = [row for row in rows if row[1:3] not in but][:most]
        for trigger, _, bundle, info_text, sequence, kind, captured_at, n_stones in lost:
            info = json.loads(info_text)
            record = lost_record(
                _trigger(sequence, BundleKind(kind), captured_at, n_stones),
                bundle=bundle,
                reason=reason,
                detail=detail,
                calibration_id=info.get("calibration_id"),
                is_simulated=info.get("is_simulated"),
            )
            _end(connection, particles_dir, trigger, record, {})
    return sum(n_stones for *_, n_stones in lost)


def _record_late(connection: sqlite3.Connection, session: int, bundle: str, record: Mapping[str, Any]) -> int:
    if record.get("captured_at") is None:
        raise StoreError(f"session {session}, bundle {bundle}: no such trigger was recorded")
    kind, n_stones = BundleKind(record["kind"]), record.get("n_stones", 1)
    return _record(
        connection, session, bundle, _trigger(record["sequence"], kind, record["captured_at"], n_stones)
    )


def _trigger(sequence: int, kind: BundleKind, utc: str, n_stones: int) -> Trigger:
    """Return a trigger as far as the database knows it."""
    return Trigger(sequence=sequence, received_ns=0, device_ns=0, utc=utc, kind=kind, n_stones=n_stones)


def _record(connection: sqlite3.Connection, session: int, bundle: str, trigger: Trigger) -> int:
    """Insert a trigger without an outcome and return its number."""
    state = "background" if trigger.kind is BundleKind.BACKGROUND else "open"
    (number,) = connection.execute(
        "INSERT INTO triggers (session, bundle, sequence, kind, captured_at, state, n, lot)"
        " VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7,"
        " iif(?4 = 'particle', (SELECT lot FROM lots WHERE state = 'open'), NULL)) RETURNING trigger",
        (session, bundle, trigger.sequence, trigger.kind, rfc3339(trigger.utc), state, trigger.n_stones),
    ).fetchone()
    return int(number)


def _end(
    connection: sqlite3.Connection,
    particles_dir: Path,
    trigger: int,
    record: Mapping[str, Any],
    files: Mapping[str, Path],
) -> int:
    session, bundle, sequence, kind, captured_at, n_stones, is_replay = connection.execute(
        f"SELECT session, bundle, sequence, kind, captured_at, n, {IS_REPLAY}"  # noqa: S608 - a constant
        " FROM triggers JOIN sessions USING (session) WHERE trigger = ?",
        (trigger,),
    ).fetchone()
    seq, instance_id = connection.execute(
        "UPDATE store SET last_seq = last_seq + 1 RETURNING last_seq, instance_id"
    ).fetchone()
    name = particle_id(instance_id, seq)
    recorded_at = utc_now()
    folder = particle_folder(name, recorded_at)
    kept = keep_files(particles_dir / folder, files)
    identity = {
        "seq": seq,
        "id": name,
        "revision": 1,
        "revises": None,
        "session": session,
        "bundle": bundle,
        "sequence": sequence,
        "kind": kind,
        "n_stones": n_stones,
        "captured_at": captured_at,
        "recorded_at": recorded_at,
        "time_is_doubtful": is_of_unset_clock(min(captured_at, recorded_at)),
        # relative to the base path of the REST interface, which makes PLY of a compact one
        "mesh": f"particles/{name}/mesh.ply" if any(file.startswith("mesh.") for file in kept) else None,
        "is_replay": bool(is_replay),
    }
    stored = identity | dict(record) | identity  # first for the order of the keys, last for the values
    connection.execute(
        "INSERT INTO results (seq, id, trigger, session, record) VALUES (?, ?, ?, ?, ?)",
        (seq, name, trigger, session, json.dumps(stored, allow_nan=False)),
    )
    indexed_fields.add_row(connection, seq)
    if record["outcome"] != Outcome.LOST:
        connection.execute(
            "INSERT INTO files (seq, folder, bytes) VALUES (?, ?, ?)", (seq, folder, sum(kept.values()))
        )
    connection.execute("UPDATE triggers SET state = ? WHERE trigger = ?", (record["outcome"], trigger))
    return int(seq)
