"""The table `indexed_fields`: the fields that results are searched, listed and counted by, copied from their records.

It has a row for each result, in its newest revision; that of a stone in a lot outlives the result. A field that is
`Indexed` in `service.results.fields` and has no column gets one at the next start, filled from the records. A column of
another release's list stays, and is filled as well: all columns that the table has are copied. So a change of the list
is no change of the schema, and a release with a shorter list opens the database as it is.
"""

import logging
import sqlite3
from types import UnionType
from typing import Union, get_args, get_origin

from service.results.fields import INDEXED_FIELDS, Result

log = logging.getLogger(__name__)

Columns = tuple[tuple[str, str], ...]
"""Names and types of the columns that are fields of the record."""

OWN_COLUMNS = frozenset({"seq", "id", "lot", "n_stones"})
"""Columns that are no field of the newest record as it is."""
SQL_TYPES = {float: "REAL", int: "INTEGER", bool: "INTEGER"}
"""Types of columns by that of the field; all others are text, lists in JSON."""
STEP = 50_000
"""Results whose added columns are filled in one transaction: 1 s."""


def columns(connection: sqlite3.Connection) -> Columns:
    """Return the columns of the database, none before it has the table.

    Raises `ValueError` if one is none that `add_columns` makes.
    """
    rows = connection.execute("SELECT name, type FROM pragma_table_info('indexed_fields')").fetchall()
    if not all(name.isidentifier() and kind in {"TEXT", *SQL_TYPES.values()} for name, kind in rows):
        raise ValueError("a column of indexed_fields is damaged")
    return tuple((name, kind) for name, kind in rows if name not in OWN_COLUMNS)


def missing_columns(connection: sqlite3.Connection) -> Columns:
    """Return the columns of today's fields that the database lacks."""
    present = dict(columns(connection))
    return tuple((name, _sql_type(name)) for name in INDEXED_FIELDS if name not in present)


def index_results(connection: sqlite3.Connection, condition: str, *values: int) -> None:
    """Add the rows of results, or replace them by what their newest revisions say, in the transaction of these."""
    names = [name for name, _ in columns(connection)]
    copied = ", ".join(f"record ->> '{name}'" for name in names)
    connection.execute(
        f"INSERT OR REPLACE INTO indexed_fields (seq, id, lot, n_stones, {', '.join(names)})"  # noqa: S608 - names are checked
        f" SELECT seq, id, lot, coalesce(record ->> 'n_stones', 1), {copied} FROM newest_records WHERE {condition}",
        values,
    )


def add_columns(connection: sqlite3.Connection, added: Columns) -> None:
    """Add columns within a transaction; further results have them filled, those of before get it by `fill_step`."""
    for name, kind in added:
        connection.execute(f"ALTER TABLE indexed_fields ADD COLUMN {name} {kind}")
        connection.execute("INSERT INTO unfilled_columns VALUES (?, 1)", (name,))


def fill_step(connection: sqlite3.Connection) -> bool:
    """Fill added columns for the next `STEP` results within a transaction; return False when none is left to fill."""
    unfilled = dict(connection.execute("SELECT name, from_seq FROM unfilled_columns").fetchall())
    if not unfilled:
        return False
    (last_seq,) = connection.execute("SELECT coalesce(max(seq), 0) FROM indexed_fields").fetchone()
    first = min(unfilled.values())
    last = min(first + STEP - 1, last_seq)
    changes = ", ".join(
        f"{name} = record ->> '{name}'" for name, _ in columns(connection) if name in unfilled
    )
    connection.execute(
        f"UPDATE indexed_fields SET {changes} FROM newest_records"  # noqa: S608 - as above
        " WHERE newest_records.seq = indexed_fields.seq AND indexed_fields.seq BETWEEN ? AND ?",
        (first, last),
    )
    connection.execute("UPDATE unfilled_columns SET from_seq = ?", (last + 1,))
    connection.execute("DELETE FROM unfilled_columns WHERE from_seq > ?", (last_seq,))
    log.info("the store indexes %s: up to result %d of %d", ", ".join(unfilled), last, last_seq)
    return True


def _sql_type(name: str) -> str:
    kind = Result.model_fields[name].annotation
    kinds = get_args(kind) if get_origin(kind) in (Union, UnionType) else (kind,)
    return next((SQL_TYPES[each] for each in kinds if each in SQL_TYPES), "TEXT")
