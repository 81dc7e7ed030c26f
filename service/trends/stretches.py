"""The stones of a stretch of time, quickly: their times from an index, their measures of every so many alone."""

import sqlite3
from dataclasses import dataclass

import numpy as np

from pipeline.arrays import Values
from pipeline.gradation.stones import Lot
from service.lots.stones import MEASURED_COLUMNS, lot_of_columns

SECONDS = "(julianday(captured_at) - 2440587.5) * 86400"
"""A time in seconds since 1970, to some tens of microseconds."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Stretch:
    """What fell within a time."""

    n_stones: int
    n_measured: int
    lot: Lot  # in the order of time; of many stones every so many


def stretch(connection: sqlite3.Connection, since: str, until: str, max_stones: int) -> Stretch:
    """Return what fell from `since` to before `until`, with the measures of up to about `max_stones` of them."""
    within = "captured_at >= ? AND captured_at < ?"
    n_stones, n_measured = connection.execute(
        f"SELECT count(*), coalesce(sum(outcome = 'measured'), 0) FROM stones WHERE {within}",  # noqa: S608 - a constant
        (since, until),
    ).fetchone()
    rows = connection.execute(
        f"SELECT {', '.join(MEASURED_COLUMNS)} FROM stones"  # noqa: S608 - as above
        f" WHERE {within} AND outcome = 'measured' AND seq % ? = 0 ORDER BY captured_at, seq",
        (since, until, -(-n_measured // max_stones) or 1),
    ).fetchall()
    return Stretch(n_stones=n_stones, n_measured=n_measured, lot=lot_of_columns(rows))


def times_of(connection: sqlite3.Connection, since: str, until: str) -> Values:
    """Return when stones fell from `since` to before `until`, whatever became of them, in seconds, rising."""
    rows = connection.execute(
        f"SELECT {SECONDS} FROM stones WHERE captured_at >= ? AND captured_at < ? ORDER BY captured_at",  # noqa: S608 - as above
        (since, until),
    )
    return np.fromiter((second for (second,) in rows), float)
