"""Damage of a database: its schema, its newest records and its pages are checked, in this order.

SQLite checks the structure of the pages and that documents are JSON, but not that texts are UTF-8, nor that a record is
one that this program can read. Whatever a damaged database makes of the check, it is damage, except for what a disk or
a lock does to a whole one.
"""

import json
import logging
import sqlite3
import uuid
from collections.abc import Callable
from pathlib import Path

from pipeline.frames import rfc3339
from service.store import indexed_fields, schema
from service.store.particle_files import is_folder
from service.store.trouble import TroubleCause, trouble_of

log = logging.getLogger(__name__)

N_NEWEST = 1000
"""Newest rows of each table that are parsed."""
ALL = -1
"""In the place of `N_NEWEST`: all rows."""
MAX_NUMBER = 2**53
"""Numbers of results and events are smaller, so that JSON holds them exactly."""
MAX_FORMAT = 2
"""Newest version of the file format, as its header tells it (bytes 18 and 19): 2 is WAL."""
DOCUMENTS = frozenset(
    {"after", "before", "data", "definition", "document", "headers", "info", "progress", "record"}
)
"""Columns that hold JSON objects, in whatever table."""
MAX_DETAIL = 200
"""Longest description of damage, in characters; SQLite and Python may quote a whole record."""


def find_damage(
    path: Path, go_on: Callable[[], bool] = lambda: True, *, n_newest: int = N_NEWEST
) -> str | None:
    """Return the damage found in a database, None if there is none as far as it may `go_on`.

    Raises `sqlite3.Error` or `OSError` if it cannot be read now.
    """
    if not path.is_file():
        return "it is no file"  # opened all the same, a pipe would wait for a writer
    try:
        with schema.connect_reader(path) as connection:
            connection.set_progress_handler(lambda: not go_on(), 10_000)
            damage = (
                _header_damage(path) or _schema_damage(connection) or _record_damage(connection, n_newest)
            )
            if damage is not None:
                return damage
            (found,) = connection.execute("PRAGMA quick_check(1)").fetchone()
            return None if found == "ok" else _short(str(found))
    except MemoryError:  # of this machine
        raise
    except Exception as err:  # whatever a damaged database makes of the check
        if getattr(err, "sqlite_errorcode", None) == sqlite3.SQLITE_INTERRUPT:
            log.info("only a part of the database was checked file=%s", path)
            return None
        trouble = trouble_of(err)
        if trouble is None:
            return _short(f"{type(err).__name__}: {err}")
        if trouble.cause is not TroubleCause.DAMAGED:
            raise
        return _short(trouble.detail)


def _header_damage(path: Path) -> str | None:
    """Return the damage of a header with which SQLite reads the file but never writes it."""
    with path.open("rb") as file:
        versions = file.read(20)[18:]
    return "the header is damaged" if any(version > MAX_FORMAT for version in versions) else None


def _schema_damage(connection: sqlite3.Connection) -> str | None:
    """Return the first object that a database of its version must have, or cannot have yet, and in which it differs."""
    (version,) = connection.execute("PRAGMA user_version").fetchone()
    if version > schema.newest_version():
        return None  # of a newer program, which is refused later
    if version < 0:
        return f"schema {version}"
    found = schema.objects(connection)
    expected = schema.expected_objects(version, indexed_fields.columns(connection))
    later = schema.expected_objects(schema.newest_version())
    for kind, name in sorted(later):
        if found.get((kind, name)) != expected.get((kind, name)):
            return f"{kind} {name} is not that of schema {version}"
    return None


def _record_damage(connection: sqlite3.Connection, n_newest: int) -> str | None:
    """Return the first table with a row that cannot be read; of each, the newest rows are parsed."""
    own = schema.expected_objects(schema.newest_version())
    tables = sorted(name for kind, name in own.keys() & schema.objects(connection).keys() if kind == "table")
    if "store" not in tables:
        return None  # before the first schema
    for table in tables:
        rows = connection.execute(f"SELECT * FROM {table} ORDER BY rowid DESC LIMIT ?", (n_newest,))  # noqa: S608 - our own names
        documents = [at for at, (name, *_) in enumerate(rows.description) if name in DOCUMENTS]
        for row in rows:
            if not all(row[at] is None or isinstance(json.loads(row[at]), dict) for at in documents):
                return f"a record of {table} is damaged"
    (newest,) = connection.execute("SELECT coalesce(max(seq), 0) FROM results").fetchone()
    row = connection.execute("SELECT instance_id, last_seq FROM store").fetchone()
    if row is None:  # a crash came after the migration, before the history had an identity
        return None if newest == 0 else "the identity of the history is gone"
    uuid.UUID(row[0])
    if not 0 <= newest <= row[1] < MAX_NUMBER:
        return f"the newest result has the number {newest}, the history ends at {row[1]}"
    if "files" in tables:
        folders = connection.execute("SELECT folder FROM files ORDER BY seq DESC LIMIT ?", (n_newest,))
        if not all(is_folder(folder) for (folder,) in folders):
            return "a folder of a particle would be elsewhere"
    if "lots" in tables and connection.execute("SELECT 1 FROM lots WHERE lot LIKE '%/%'").fetchone():
        return "files of a lot would be elsewhere"
    for (captured_at,) in connection.execute("SELECT captured_at FROM triggers WHERE state = 'open'"):
        rfc3339(captured_at)
    return None


def _short(detail: str) -> str:
    words = " ".join("".join(letter if letter.isprintable() else " " for letter in detail).split())
    return words if len(words) <= MAX_DETAIL else f"{words[:MAX_DETAIL]} ..."
