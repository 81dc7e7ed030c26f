"""The stones of a stretch of time, quickly: their times from an index, their measures of every so many alone."""

import sqlite3
from dataclasses import dataclass

import numpy as np

from pipeline.arrays import Values
from pipeline.gradation.stones import Lot
from service.lots.stones import MEASURED_COLUMNS, lot_of_columns
from service.store.writes import IS_REPLAY

FELL = ("stones", "captured_at")
RECORDED = ("stones JOIN results USING (seq)", "json_extract(record, '$.recorded_at')")
"""Rows and their time: when a stone fell, or when its result came."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Stretch:
    """Stones that fell within a time."""

    n_stones: int
    n_timed: int  # of these, all but stones that were counted together: when each fell is not known
    n_measured: int
    lot: Lot  # in the order of time; of many stones every so many


def stretch(connection: sqlite3.Connection, since: str, until: str, max_stones: int) -> Stretch:
    """Return the stones from `since` to before `until`, with the measures of up to about `max_stones` of them.

    Of a replay, whose stones fell long ago: what had its result then.
    """
    rows, time = _rows_and_time(connection)
    within = f"FROM {rows} WHERE {time} >= ? AND {time} < ?"
    n_stones, n_timed, n_measured = connection.execute(
        "SELECT coalesce(sum(stones.n_stones), 0), coalesce(sum(stones.n_stones = 1), 0),"
        f" coalesce(sum(stones.outcome = 'measured'), 0) {within}",
        (since, until),
    ).fetchone()
    measures = connection.execute(
        f"SELECT {', '.join(f'stones.{column}' for column in MEASURED_COLUMNS)} {within}"
        f" AND stones.outcome = 'measured' AND stones.seq % ? = 0 ORDER BY {time}, stones.seq",
        (since, until, -(-n_measured // max_stones) or 1),
    ).fetchall()
    return Stretch(n_stones=n_stones, n_timed=n_timed, n_measured=n_measured, lot=lot_of_columns(measures))


def times_of(connection: sqlite3.Connection, since: str, until: str) -> Values:
    """Return the times of all stones from `since` to before `until`, of any outcome, in seconds since 1970, rising.

    To some tens of microseconds; of a replay when their results came. Stones that were counted together, at times that
    are not known, are left out.
    """
    rows, time = _rows_and_time(connection)
    found = connection.execute(
        f"SELECT (julianday({time}) - 2440587.5) * 86400 FROM {rows}"  # noqa: S608 - constants
        f" WHERE {time} >= ? AND {time} < ? AND stones.n_stones = 1 ORDER BY {time}",
        (since, until),
    )
    return np.fromiter((second for (second,) in found), float)


def _rows_and_time(connection: sqlite3.Connection) -> tuple[str, str]:
    """Return the table and the column of time to select from; a store holds either what fell or a replay."""
    newest = connection.execute(
        f"SELECT {IS_REPLAY} FROM sessions ORDER BY session DESC LIMIT 1"  # noqa: S608 - as above
    ).fetchone()
    return RECORDED if newest is not None and newest[0] else FELL
