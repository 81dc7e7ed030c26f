"""Lock the folder of a store, open its database file, and migrate an older one to today's schema.

The lock is on the folder itself, because a file in it can be deleted while a daemon runs. Migrations are the numbered
SQL files beside this module; `PRAGMA user_version` is the number of the last one applied. A database with a newer
schema is refused.
"""

import fcntl
import os
import sqlite3
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, Concatenate, ParamSpec, TypeVar

from service.base.errors import StoreError
from service.store import audit, indexed_fields

BUSY_S = 0.5
"""Longest wait for another connection that has the database locked, before that is reported."""
STEPS: Mapping[str, Callable[[sqlite3.Connection], None]] = {
    "013_audit_urls.sql": audit.redact_configurations,
    "015_indexed_fields.sql": lambda connection: indexed_fields.index_results(
        connection, "seq IN (SELECT seq FROM listed WHERE kind = 'ball')"
    ),
}
"""What a migration does after its script, in the same transaction: the table of 014 had no balls."""
P = ParamSpec("P")
T = TypeVar("T")


def lock_store(state_dir: Path) -> int:
    """Lock the folder for this process and return the descriptor to close at the end; raise `StoreError` if it is."""
    descriptor = os.open(state_dir, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as err:
        os.close(descriptor)
        raise StoreError(
            f"{state_dir}: another process has the store open: stop it, or choose another store.dir"
        ) from err
    return descriptor


def is_locked(state_dir: Path) -> bool:
    """True while a process has the store open; False when there is no such folder."""
    try:
        os.close(lock_store(state_dir))
    except StoreError:
        return True
    except OSError:
        pass
    return False


def prepare(path: Path) -> None:
    """Create the database, or bring an older one to today's schema; raise `StoreError` if it is of a newer one."""
    with closing(sqlite3.connect(path, isolation_level=None, timeout=BUSY_S)) as connection:
        connection.execute("PRAGMA journal_mode = WAL")
        (version,) = connection.execute("PRAGMA user_version").fetchone()
        if version > newest_version():
            raise StoreError(
                f"schema {version} was written by a newer stonefall; this one knows schemas up to {newest_version()}:"
                " start the newer one, or choose another store.dir"
            )
        _apply(connection, version, newest_version())
        with transaction(connection):
            indexed_fields.add_columns(connection, indexed_fields.missing_columns(connection))
        is_left = True
        while is_left:
            with transaction(connection):
                is_left = indexed_fields.fill_step(connection)
        connection.execute("INSERT OR IGNORE INTO store (one, instance_id) VALUES (1, ?)", (new_instance(),))


def new_instance() -> str:
    """Return the identity of a new history of results."""
    return str(uuid.uuid4())


def connect(path: Path) -> sqlite3.Connection:
    """Open an existing database for writing."""
    uri = f"{path.absolute().as_uri()}?mode=rw"
    connection = sqlite3.connect(uri, uri=True, isolation_level=None, timeout=BUSY_S)
    try:
        # a commit returns when it is on the disk: 0.18 ms measured, negligible at four stones a second
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute("PRAGMA synchronous = FULL")
        connection.execute("PRAGMA foreign_keys = ON")
    except BaseException:
        connection.close()
        raise
    return connection


@contextmanager
def connect_reader(path: Path) -> Iterator[sqlite3.Connection]:
    """Open a read-only connection whose queries all see the same state of the database."""
    with closing(reader_of(path)) as connection:
        connection.execute("BEGIN")
        yield connection


def reader_of(path: Path) -> sqlite3.Connection:
    """Open a read-only connection, for one thread at a time."""
    uri = f"{path.absolute().as_uri()}?mode=ro"
    return sqlite3.connect(uri, uri=True, isolation_level=None, check_same_thread=False)


def read(
    path: Path, query: Callable[Concatenate[sqlite3.Connection, P], T], *args: P.args, **kwargs: P.kwargs
) -> T:
    """Return `query(connection, ...)` on a read-only connection of its own; blocks, in any process.

    Raises `StoreError` if the database cannot be read, or is damaged.
    """
    try:
        with connect_reader(path) as connection:
            return query(connection, *args, **kwargs)
    except (sqlite3.Error, ValueError) as err:  # or of a damaged record
        raise StoreError(f"{path}: {err}") from err
    except StopIteration as err:  # a fault; as such it would never arrive, and the asker wait for ever
        raise RuntimeError(f"{query}: nothing was left to take") from err


def rows_by_name(rows: sqlite3.Cursor) -> list[dict[str, Any]]:
    """Return rows by the names of their columns."""
    names = [column for column, *_ in rows.description]
    return [dict(zip(names, row, strict=True)) for row in rows]


@contextmanager
def transaction(connection: sqlite3.Connection) -> Iterator[None]:
    """Run a transaction that is committed at the end of the block, and rolled back if the block is left early.

    Within one that `Store.write` has begun, the block is a part of that.
    """
    is_part = connection.in_transaction
    if is_part:
        yield
        return
    connection.execute("BEGIN IMMEDIATE")
    try:
        yield
        connection.execute("COMMIT")
    finally:
        if connection.in_transaction:
            connection.execute("ROLLBACK")


def newest_version() -> int:
    """Return the number of today's schema."""
    return len(_scripts())


Objects = Mapping[tuple[str, str], tuple[str, str | None]]
"""Table and statement of each object of a schema, by its kind and name: a trigger may have the name of a table."""


def objects(connection: sqlite3.Connection) -> Objects:
    """Return the objects of a database."""
    return {
        (kind, name): (table, statement)
        for kind, name, table, statement in connection.execute(
            "SELECT type, name, tbl_name, sql FROM sqlite_schema"
        )
    }


@cache
def expected_objects(version: int, columns: indexed_fields.Columns = ()) -> Objects:
    """Return the objects of a new database of this schema, with these columns of fields, which a release has chosen."""
    with closing(sqlite3.connect(":memory:", isolation_level=None)) as connection:
        _apply(connection, 0, version)
        if present := indexed_fields.columns(connection):
            added = tuple(each for each in columns if each not in present)
            indexed_fields.add_columns(connection, added)
        return objects(connection)


def _apply(connection: sqlite3.Connection, version: int, target: int) -> None:
    """Bring a database from one version of the schema to a later one."""
    for number, (name, script) in enumerate(_scripts()[version:target], start=version + 1):
        connection.executescript(f"BEGIN IMMEDIATE; {script}")
        if (step := STEPS.get(name)) is not None:
            step(connection)
        connection.execute(f"PRAGMA user_version = {number}")
        connection.execute("COMMIT")


@cache
def _scripts() -> Sequence[tuple[str, str]]:
    entries = (entry for entry in files("service.store").iterdir() if entry.name.endswith(".sql"))
    return sorted((entry.name, entry.read_text(encoding="utf-8")) for entry in entries)
