"""Sessions, triggers, results and revisions are written: each call is a transaction of `Store.write`, or a part of one.

Invariants: every trigger ends in at most one result (`UNIQUE (trigger)`), and results are numbered without
a gap, because the number is taken in the transaction that makes the result durable.

A revision is a later item of the feed that describes the same stone anew; the first one stays as it is. It has the
stone's `id`, a `seq` of its own, and its files within the stone's folder, so that whatever holds, moves or removes that
folder takes them along. The raw frames stay where they are, and the accounting knows first results only.
"""

import json
import sqlite3
from collections.abc import Collection, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from drivers.files.times import is_of_unset_clock, utc_now
from pipeline.body_measurement import mass_g
from pipeline.frames import BundleKind, GateCount, Trigger, rfc3339
from service.base.errors import StoreError
from service.results.fields import DensitySource, LossReason, Outcome, Result
from service.results.record import document_of, lost_record
from service.store import indexed_fields
from service.store.particle_files import (
    drop_raw,
    keep_files,
    particle_folder,
    particle_id,
    path_of,
    revision_folder,
)
from service.store.reads import particle
from service.store.schema import rows_by_name, transaction

IS_REPLAY = (
    "coalesce(json_extract(info, '$.is_replay'), json_extract(info, '$.recording') IS NOT NULL"
    " OR coalesce(json_extract(info, '$.is_simulated'), 0))"
)
"""Whether a session's stones did not fall then; sessions from before it was noted tell by their rig."""
KEPT = (
    "id", "session", "bundle", "sequence", "kind", "captured_at", "is_simulated", "is_replay", "verification"
)  # fmt: skip
"""Fields of the stone and its fall, which measuring again does not change."""
MAX_LOST = 1000
"""Triggers that are ended as lost in one transaction: results wait for it a tenth of a second at most."""
NOTE_EVERY = 100
"""Results between two notes in the database of how far raw frames were removed."""


def begin_session(connection: sqlite3.Connection, info: Mapping[str, Any]) -> int:
    """Record the start of a run of the daemon and return its number.

    Raises `StoreError` if it is a replay and the store holds stones that fell, or the other way round.
    """
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
    for bundle, trigger in triggers.items():
        _record(connection, session, bundle, trigger, trigger.utc)
    if gate_count is not None:
        note_gate_count(connection, session, gate_count)


def note_gate_count(connection: sqlite3.Connection, session: int, count: GateCount | None) -> None:
    """Note the gate's count with the newest trigger, as `gate_count` in the `info` of the session.

    None: nothing is missed of what the gate counts from now on.
    """
    (newest,) = connection.execute("SELECT max(trigger) FROM triggers").fetchone()
    noted = None
    if count is not None:
        noted = {**asdict(count), "trigger": newest}
        del noted["at"]  # it is that of the trigger
    connection.execute(
        "UPDATE sessions SET info = json_set(info, '$.gate_count', json(?)) WHERE session = ?",
        (json.dumps(noted), session),
    )


def finish(
    connection: sqlite3.Connection,
    particles_dir: Path,
    session: int,
    bundle: str,
    record: Result,
    files: Mapping[str, Path],
) -> tuple[int, bool]:
    """End a trigger with `record`; return its `seq`, and False if it has a result already, which it keeps.

    A trigger that was not recorded, because the store was held when it came, is recorded now. Then
    `drop_sources(files)` is for after the commit.
    """
    row = connection.execute(
        "SELECT trigger, state, seq FROM triggers LEFT JOIN results USING (trigger)"
        " WHERE triggers.session = ? AND bundle = ?",
        (session, bundle),
    ).fetchone()
    if row is None:
        if not record.captured_at:
            raise StoreError(f"session {session}, bundle {bundle}: no such trigger was recorded")
        row = (_record(connection, session, bundle, record, record.captured_at), "open", None)
    trigger, state, seq = row
    if state == "background":
        raise StoreError(f"session {session}, bundle {bundle}: a background has no outcome")
    if seq is not None:
        return seq, False
    return _end(connection, particles_dir, trigger, record, files), True


def lose_open(
    connection: sqlite3.Connection,
    particles_dir: Path,
    live_session: int | None,
    reason: LossReason,
    detail: str,
    but: Collection[tuple[int, str]] = frozenset(),
    most: int = MAX_LOST,
) -> int:
    """End as `lost` the first `most` open triggers of sessions other than `live_session`; return of how many stones.

    Nothing is left when it returns 0. `but` are left open, by session and bundle: they are measured yet.
    """
    rows = connection.execute(
        "SELECT trigger, session, bundle, info, sequence, kind, captured_at, n"
        " FROM triggers JOIN sessions USING (session)"
        " WHERE state = 'open' AND session IS NOT ? ORDER BY trigger LIMIT ?",
        (live_session, most + len(but)),
    ).fetchall()
    lost = [row for row in rows if row[1:3] not in but][:most]
    for number, _, bundle, info_text, sequence, kind, utc, n in lost:
        info = json.loads(info_text)
        record = lost_record(
            Trigger(
                sequence=sequence, received_ns=0, device_ns=0, utc=utc, kind=BundleKind(kind), n_stones=n
            ),
            bundle=bundle,
            reason=reason,
            detail=detail,
            calibration_id=info.get("calibration_id"),
            is_simulated=info.get("is_simulated"),
        )
        _end(connection, particles_dir, number, record, {})
    return sum(n_stones for *_, n_stones in lost)


def add_revision(
    connection: sqlite3.Connection, particles_dir: Path, name: str, record: Result, files: Mapping[str, Path]
) -> int | None:
    """Add a revision of the stone with this id, and return its `seq`; None if it or its files were removed meanwhile.

    `drop_sources(files)` is for after the commit.
    """
    before = particle(connection, name)
    found = connection.execute(
        "SELECT trigger, seq, folder FROM results JOIN files USING (seq) WHERE id = ? AND removed IS NULL",
        (name,),
    ).fetchone()
    if before is None or found is None:
        return None
    (trigger, first, folder), revision = found, before.get("revision", 1) + 1
    (seq,) = connection.execute("UPDATE store SET last_seq = last_seq + 1 RETURNING last_seq").fetchone()
    kept = keep_files(path_of(particles_dir, revision_folder(folder, revision)), files)
    density = _density_of_product(connection, trigger)
    identity = {"seq": seq, "revision": revision, "revises": before["seq"]}
    identity |= {field: before.get(field) for field in KEPT} | {"recorded_at": utc_now()}
    connection.execute(
        "INSERT INTO revisions (seq, first, revision, record) VALUES (?, ?, ?, ?)",
        (seq, first, revision, _durable(record, identity, kept, seq, density)),
    )
    indexed_fields.index_results(connection, "seq = ?", first)
    connection.execute("UPDATE files SET bytes = bytes + ? WHERE seq = ?", (sum(kept.values()), first))
    return int(seq)


def _record(
    connection: sqlite3.Connection, session: int, bundle: str, fall: Trigger | Result, at: str
) -> int:
    """Insert a trigger without an outcome and return its number."""
    state = "background" if fall.kind == BundleKind.BACKGROUND else "open"
    (number,) = connection.execute(
        "INSERT INTO triggers (session, bundle, sequence, kind, captured_at, state, n, lot)"
        " VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7,"
        " iif(?4 = 'particle', (SELECT lot FROM lots WHERE state = 'open'), NULL)) RETURNING trigger",
        (session, bundle, fall.sequence, fall.kind, rfc3339(at), state, fall.n_stones),
    ).fetchone()
    return int(number)


def _end(
    connection: sqlite3.Connection,
    particles_dir: Path,
    trigger: int,
    record: Result,
    files: Mapping[str, Path],
) -> int:
    rows = connection.execute(
        "SELECT session, bundle, sequence, kind, n AS n_stones, captured_at,"  # noqa: S608 - a constant
        f" {IS_REPLAY} AS is_replay FROM triggers JOIN sessions USING (session) WHERE trigger = ?",
        (trigger,),
    )
    (fall,) = rows_by_name(rows)
    seq, instance_id = connection.execute(
        "UPDATE store SET last_seq = last_seq + 1 RETURNING last_seq, instance_id"
    ).fetchone()
    name = particle_id(instance_id, seq)
    recorded_at = utc_now()
    folder = particle_folder(name, recorded_at)
    kept = keep_files(particles_dir / folder, files)
    is_replay = bool(fall.pop("is_replay"))
    identity = {"seq": seq, "id": name, "revision": 1, "revises": None, **fall}
    identity |= {"recorded_at": recorded_at, "is_replay": is_replay}
    density = _density_of_product(connection, trigger)
    connection.execute(
        "INSERT INTO results (seq, id, trigger, session, record) VALUES (?, ?, ?, ?, ?)",
        (seq, name, trigger, fall["session"], _durable(record, identity, kept, name, density)),
    )
    indexed_fields.index_results(connection, "seq = ?", seq)
    if record.outcome != Outcome.LOST:
        connection.execute(
            "INSERT INTO files (seq, folder, bytes) VALUES (?, ?, ?)", (seq, folder, sum(kept.values()))
        )
    connection.execute("UPDATE triggers SET state = ? WHERE trigger = ?", (record.outcome, trigger))
    return int(seq)


def _density_of_product(connection: sqlite3.Connection, trigger: int) -> float | None:
    """Return the density of the product of a stone's lot, kg/m³; None for a stone outside of lots."""
    found = connection.execute(
        "SELECT definition ->> 'density_kg_m3' FROM products WHERE (product, version) ="
        " (SELECT product, version FROM lots WHERE lot = (SELECT lot FROM triggers WHERE trigger = ?))",
        (trigger,),
    ).fetchone()
    return None if found is None else found[0]


def _durable(
    record: Result, identity: Mapping[str, Any], kept: Collection[str], key: str | int, density: float | None
) -> str:
    """Return a record as it is stored: with its identity, its mass, and the address of its mesh if that was kept."""
    given = {
        **identity,
        "time_is_doubtful": is_of_unset_clock(min(identity["captured_at"], identity["recorded_at"])),
        # relative to the base path of the REST interface, which makes PLY of a compact one
        "mesh": f"particles/{key}/mesh.ply" if any(file.startswith("mesh.") for file in kept) else None,
    }
    # first for the order of the keys, last for the values
    stored = given | document_of(record) | given
    if density is not None and record.volume_mm3 is not None:
        stored |= {"mass_g": mass_g(density, record.volume_mm3), "density_kg_m3": density}
        stored["density_source"] = DensitySource.PRODUCT
    return json.dumps(stored, allow_nan=False)
