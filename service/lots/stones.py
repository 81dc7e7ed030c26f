"""The stones of a lot, or of a time, as the gradation takes them, from the records of results.

Of a stretch of time quickly: their times from an index, their measures of every so many alone.
"""

import json
import sqlite3
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import sqrt
from operator import itemgetter
from typing import Any, TypeVar

import numpy as np

from pipeline.arrays import Values
from pipeline.frames import BundleKind
from pipeline.gradation.stones import MEASURES, OPTIONAL, REQUIRED, Fate, Lot, Stone, UnmeasuredStone, lot_of
from service.base.errors import InvalidRequestError
from service.base.schema import Time, served
from service.results.fields import INDEXED_FIELDS, why_not_refined
from service.store.schema import rows_by_name
from service.store.writes import IS_REPLAY

SURFACES = sqrt(2.0)
"""Standard deviation of a distance between two surfaces by that of one: their errors are taken for independent."""
MEASURED_COLUMNS = (*REQUIRED, *OPTIONAL, "volume_sd_percent", "surface_sd_mm")
"""Fields of a measured stone that a gradation needs, in the order of `lot_of_columns`."""
COLUMNS = ("id", "n_stones", *INDEXED_FIELDS)
REQUIRED_OF = itemgetter(*REQUIRED)
Number = TypeVar("Number", float, Values)

FELL = ("stones", "stones.captured_at")
RECORDED = ("stones JOIN results USING (seq)", "json_extract(record, '$.recorded_at')")
"""Rows and their time: when a stone fell, or when its result came."""
LotCondition = tuple[str, tuple[object, ...]]
"""SQL that chooses stones by their lot, and its values."""
ANY_LOT: LotCondition = ("1", ())
NO_LOT: LotCondition = ("stones.lot IS NULL", ())


def of_product(product: str, version: int) -> LotCondition:
    """Return the choice of the stones of all lots of a version of a product, void ones left out."""
    lots = "SELECT lot FROM lots WHERE product = ? AND version = ? AND state <> 'void'"
    return f"stones.lot IN ({lots})", (product, version)


class UnknownChoiceError(InvalidRequestError):
    """The lot has no such stones to leave out or to choose; names the field and what is not there."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Choice:
    """A choice of a lot's stones and revisions: by default all, each in its newest revision."""

    without: tuple[str, ...] = ()  # ids of stones that are left out
    algorithm_version: str | None = None  # of each stone the newest revision by this version


ALL_STONES = Choice()


@dataclass(frozen=True, slots=True, kw_only=True)
class Stones:
    """Stones with what is known of them together."""

    lot: Lot
    measured_ids: Sequence[str]  # of the measured ones, in their order; empty texts where records have none
    by_body: Mapping[str, int]  # how many of the measured ones, as far as it is known
    not_refined: Mapping[str, int]  # how many of the estimates among them, by `NotRefined`
    since: str | None  # captured, the first of them
    until: str | None  # the last
    calibration_ids: tuple[str, ...]
    algorithm_versions: tuple[str, ...]
    is_simulated: bool  # one of them at least
    is_replay: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Stretch:
    """Stones that fell within a time."""

    n_stones: int
    n_timed: int  # of these, all but stones that were counted together: when each fell is not known
    n_measured: int
    lot: Lot  # in the order of time; of many stones every so many


@dataclass(frozen=True, slots=True, kw_only=True)
class ProductCount:
    """Stones of one outcome that fell in lots of a version of a product, or in none."""

    product: str | None
    version: int | None
    is_void: bool  # their lots count no more
    outcome: str
    n_stones: int
    volume_mm3: float
    is_simulated: bool  # one of them at least
    is_replay: bool


@served
class StoneBehindStep:
    """A stone between two neighbouring sieves of the curve."""

    seq: int
    """`seq` of the result."""
    id: str
    """`id` of the result."""
    captured_at: Time
    """When the stone was exposed, RFC 3339 UTC."""
    quality: str
    """How far from the truth the result may be: `good`, `reduced` or `degraded`."""
    sieve_size_mm: float
    """Smallest square aperture the body passes (EN 933-2 square holes), mm."""
    volume_mm3: float
    """Corrected volume, mm³."""
    influence_percent: float
    """Its share of the lot's mass."""


def stones_of_lot(connection: sqlite3.Connection, lot: str, choice: Choice = ALL_STONES) -> Stones:
    """Return the stones of a lot, or a choice of them.

    Raises `UnknownChoiceError` if a stone to leave out is not in the lot, or none was measured by the version.
    """
    if choice.algorithm_version is None:
        records = _rows(connection, "lot = ?", lot)
    else:
        records = _by_version(connection, lot, choice.algorithm_version)
    return stones_in(_without(records, lot, choice.without))


def versions_of_lot(connection: sqlite3.Connection, lot: str) -> dict[str, int]:
    """Return the number of stones of a lot by each algorithm version that measured them, as far as results are kept."""
    rows = connection.execute(
        "SELECT version, count(DISTINCT first) FROM ("
        "SELECT seq AS first, algorithm_version AS version FROM stones WHERE lot = ?1 UNION ALL "
        "SELECT stones.seq, results.record ->> 'algorithm_version' FROM stones JOIN revised ON first = stones.seq"
        " JOIN results ON results.seq = stones.seq WHERE lot = ?1 UNION ALL "
        "SELECT stones.seq, revisions.record ->> 'algorithm_version' FROM stones JOIN revisions ON first = stones.seq"
        " WHERE lot = ?1) WHERE version IS NOT NULL GROUP BY version ORDER BY version",
        (lot,),
    )
    return dict(rows.fetchall())


def stones_between(connection: sqlite3.Connection, since: str, until: str) -> Stones:
    """Return the stones that fell from `since` to before `until`, of any lot; of a replay, what had its result then."""
    rows, time = _rows_and_time(connection)
    return stones_in(_rows(connection, f"{time} >= ? AND {time} < ?", since, until, rows=rows))


def stones_behind(
    connection: sqlite3.Connection, lot: str, above_mm: float, up_to_mm: float, limit: int
) -> list[StoneBehindStep]:
    """Return the stones of a lot that pass one sieve and not the next smaller one, the heaviest first."""
    (total_mm3,) = connection.execute(
        "SELECT total(volume_mm3) FROM stones WHERE lot = ? AND outcome = 'measured'", (lot,)
    ).fetchone()
    rows = connection.execute(
        "SELECT seq, id, captured_at, quality, sieve_size_mm, volume_mm3 FROM stones WHERE lot = ?"
        " AND outcome = 'measured' AND sieve_size_mm > ? AND sieve_size_mm <= ?"
        " ORDER BY volume_mm3 DESC, seq LIMIT ?",
        (lot, above_mm, up_to_mm, limit),
    )
    return [
        StoneBehindStep(**row, influence_percent=100 * row["volume_mm3"] / total_mm3)
        for row in rows_by_name(rows)
    ]


def _rows(
    connection: sqlite3.Connection, condition: str, *values: str, rows: str = "stones"
) -> list[dict[str, Any]]:
    columns = ", ".join(f"stones.{column}" for column in COLUMNS)
    query = f"SELECT {columns} FROM {rows} WHERE {condition} ORDER BY stones.seq"  # noqa: S608 - of this module
    return rows_by_name(connection.execute(query, values))


def _by_version(connection: sqlite3.Connection, lot: str, version: str) -> list[dict[str, Any]]:
    """Return the rows of the stones that a version has measured; only the records of the others are looked into."""
    earlier = connection.execute(
        "SELECT record FROM ("
        "SELECT stones.seq AS first, 1 AS revision, results.record FROM stones"
        " JOIN revised ON first = stones.seq JOIN results ON results.seq = stones.seq"
        " WHERE lot = ?1 AND stones.algorithm_version IS NOT ?2 UNION ALL "
        "SELECT stones.seq, revision, revisions.record FROM stones JOIN revisions ON first = stones.seq"
        " WHERE lot = ?1 AND stones.algorithm_version IS NOT ?2)"
        " WHERE record ->> 'algorithm_version' = ?2 ORDER BY first, revision",
        (lot, version),
    )
    newest: dict[str, dict[str, Any]] = {}
    for (text,) in earlier:
        record = json.loads(text)
        newest[record["id"]] = {name: record.get(name) for name in COLUMNS}
    records = [*_rows(connection, "lot = ? AND algorithm_version = ?", lot, version), *newest.values()]
    if not records:
        known = ", ".join(versions_of_lot(connection, lot)) or "none"
        raise UnknownChoiceError(
            f"algorithm_version: no stone of lot {lot} was measured by {version!r}; there are {known}"
        )
    return records


def _without(records: list[dict[str, Any]], lot: str, left_out: Sequence[str]) -> list[dict[str, Any]]:
    missing = set(left_out) - {record["id"] for record in records}
    if missing:
        raise UnknownChoiceError(f"without: lot {lot} has no stone {', '.join(sorted(missing))}")
    return [record for record in records if record["id"] not in left_out]


def stones_in(records: Sequence[Mapping[str, Any]]) -> Stones:
    """Return the stones of records, or of rows with the same names; balls are none."""
    records = [record for record in records if record.get("kind") != BundleKind.BALL]
    times = [record["captured_at"] for record in records if record["captured_at"] is not None]
    incomplete = UnmeasuredStone(fate=Fate.REJECTED, reason="incomplete")  # of a version that measured less
    stones = [
        incomplete if record["outcome"] == Fate.MEASURED and None in REQUIRED_OF(record) else stone_of(record)
        for record in records
    ]
    measured = [record for record, stone in zip(records, stones, strict=True) if isinstance(stone, Stone)]
    by_body = Counter(record["body"] for record in measured if record["body"] is not None)
    estimates = [record for record in measured if record["body"] == "estimate"]
    fallbacks = [each for record in estimates if (each := record["refinement_fallback"]) is not None]
    return Stones(
        lot=lot_of(stones),
        measured_ids=[record.get("id", "") for record in measured],
        by_body=dict(by_body.most_common()),
        not_refined=dict(Counter(map(why_not_refined, fallbacks)).most_common()),
        since=min(times, default=None),
        until=max(times, default=None),
        calibration_ids=_different(records, "calibration_id"),
        algorithm_versions=_different(records, "algorithm_version"),
        is_simulated=any(record["is_simulated"] for record in records),
        is_replay=any(record.get("is_replay") for record in records),
    )


def _different(records: Iterable[Mapping[str, Any]], field: str) -> tuple[str, ...]:
    return tuple(sorted({record[field] for record in records if record[field] is not None}))


def stone_of(record: Mapping[str, Any]) -> Stone | UnmeasuredStone:
    """Return the stone of a record; whether a replay counts is for the caller: in a store of replays it does."""
    fate = Fate(record["outcome"])
    if fate is not Fate.MEASURED:
        return UnmeasuredStone(fate=fate, reason=record["reason"], n_stones=record.get("n_stones") or 1)
    known = {name: record[name] for name in (*REQUIRED, *OPTIONAL) if record.get(name) is not None}
    deviations = _deviations(record["volume_sd_percent"] or 0.0, record["surface_sd_mm"] or 0.0)
    return Stone(**known, **deviations, quality=record["quality"])


def _deviations(volume_sd_percent: Number, surface_sd_mm: Number) -> dict[str, Number]:
    size_sd_mm = SURFACES * surface_sd_mm
    return {"volume_sd": volume_sd_percent / 100, "sieve_size_sd_mm": size_sd_mm, "feret_sd_mm": size_sd_mm}


def lot_of_columns(rows: Sequence[Sequence[float | None]]) -> Lot:
    """Return the lot of many measured stones, each a row of `MEASURED_COLUMNS`, in their order.

    Stones that lack a required measure, as those of a version that measured less, are left out.
    """
    columns = np.array(rows, float).reshape(-1, len(MEASURED_COLUMNS)).T
    columns = columns[:, np.all(columns[: len(REQUIRED)] > 0, axis=0)]
    measures = dict(zip(MEASURED_COLUMNS, columns, strict=True)) | _deviations(*np.nan_to_num(columns[-2:]))
    return Lot(measures=np.array([measures[name] for name in MEASURES]))


def stretch(
    connection: sqlite3.Connection, since: str, until: str, max_stones: int, choice: LotCondition = ANY_LOT
) -> Stretch:
    """Return the stones from `since` to before `until`, with the measures of up to about `max_stones` of them.

    Of a replay, whose stones fell long ago: what had its result then.
    """
    rows, time = _rows_and_time(connection)
    condition, values = choice
    within = f"FROM {rows} WHERE {time} >= ? AND {time} < ? AND {condition}"
    n_stones, n_timed, n_measured = connection.execute(
        "SELECT coalesce(sum(stones.n_stones), 0), coalesce(sum(stones.n_stones = 1), 0),"
        f" coalesce(sum(stones.outcome = 'measured'), 0) {within}",
        (since, until, *values),
    ).fetchone()
    measures = connection.execute(
        f"SELECT {', '.join(f'stones.{column}' for column in MEASURED_COLUMNS)} {within}"
        f" AND stones.outcome = 'measured' AND stones.seq % ? = 0 ORDER BY {time}, stones.seq",
        (since, until, *values, -(-n_measured // max_stones) or 1),
    ).fetchall()
    return Stretch(n_stones=n_stones, n_timed=n_timed, n_measured=n_measured, lot=lot_of_columns(measures))


def counts_by_product(connection: sqlite3.Connection, since: str, until: str) -> list[ProductCount]:
    """Count the stones of a time by product and outcome; those of a replay by the time of their result."""
    rows, time = _rows_and_time(connection)
    found = connection.execute(
        "SELECT lots.product, lots.version, coalesce(lots.state = 'void', 0) AS is_void, stones.outcome,"  # noqa: S608 - constants
        " sum(stones.n_stones) AS n_stones, total(stones.volume_mm3) AS volume_mm3, max(stones.is_simulated) AS"
        f" is_simulated, max(stones.is_replay) AS is_replay FROM {rows} LEFT JOIN lots ON lots.lot = stones.lot"
        f" WHERE {time} >= ? AND {time} < ? GROUP BY 1, 2, 3, 4 ORDER BY 1, 2",
        (since, until),
    )
    return [
        ProductCount(**row | {name: bool(row[name]) for name in ("is_void", "is_simulated", "is_replay")})
        for row in rows_by_name(found)
    ]


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
