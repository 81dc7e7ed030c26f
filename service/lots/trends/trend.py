"""Trend of rate, size and shape of the stones over the last hours."""

import sqlite3
from collections.abc import Collection, Mapping, Sequence
from datetime import UTC, datetime, timedelta
from enum import StrEnum
from itertools import pairwise

from pydantic import Field

from pipeline.frames import rfc3339
from pipeline.gradation.curve import Inverse, exact_mm, passing_percent, quantile
from pipeline.gradation.estimates import NOT_MEASURED, Estimate
from pipeline.gradation.estimators import sample_of, share_percent
from pipeline.gradation.sieves import MeasuredRange
from pipeline.gradation.specification import nearest_mm
from pipeline.gradation.stones import Lot
from pipeline.uncertainty.evidence import LENGTH_SD_PERCENT
from service.base.schema import OptionalTime, Time
from service.base.status import Report
from service.lots.figures import SHARES
from service.lots.lots import LotState
from service.lots.products import ProductDefinition
from service.lots.stones import stretch
from service.lots.trends.diary import DiaryEntry, entries
from service.store.schema import rows_by_name

BUCKETS_S = (60, 120, 300, 600, 900, 1800, 3600, 7200, 10_800, 21_600, 43_200, 86_400)
"""Lengths of a bucket, s: of each the next is a multiple or nearly so, and all part a day."""
MAX_BUCKETS = 48
MAX_STONES = 2000
"""Stones of a bucket that are looked at; of more, every so many."""
MAX_MARKS = 500
"""Entries of the diary, and lots, that a trend names, the newest."""


class PassingEnd(StrEnum):
    """End of a product's range of sizes whose sieve is followed."""

    LOWER = "lower"
    """d"""
    UPPER = "upper"
    """D"""


def ends_mm(definition: ProductDefinition, apertures_mm: Sequence[float]) -> dict[PassingEnd, float]:
    """Return the sieves of d and D of a product among these, as far as it has them, mm."""
    ends = {PassingEnd.LOWER: definition.lower_mm, PassingEnd.UPPER: definition.upper_mm}
    return {end: nearest_mm(each, apertures_mm) for end, each in ends.items() if each is not None}


class TrendBucket(Report):
    """What fell within a part of the time."""

    since: Time = Field(description="Beginning, RFC 3339 UTC")
    until: Time = Field(description="End; of the last one it is now")
    n_stones: int = Field(description="Stones that fell, whatever became of them")
    measured: int = Field(description="Stones with a body and its measures")
    stones_per_min: float = Field(
        description="Stones that fell, over the whole time of the bucket, 1/min; those of which only the light gate's"
        " counter knows, many in one result, are left out: when each of them fell is not known"
    )
    d50_mm: Estimate = Field(
        description="Size that half of the mass is smaller than, from the stones themselves, mm"
    )
    flakiness_percent: Estimate = Field(description="Flakiness index FI, EN 933-3, %")
    shape_percent: Estimate = Field(description="Shape index SI, EN 933-4, %")
    passing_percent: Mapping[float, Estimate] = Field(
        description="Passing by mass at the sieves of d and D of the product that was asked for, by aperture in mm"
    )


class TrendLot(Report):
    """A lot that was open within the time."""

    lot: str = Field(description="Id of the lot")
    product: str = Field(description="Id of its product")
    state: LotState = Field(description="`open`, `closed` or `void`")
    opened_at: Time = Field(description="When it was opened, RFC 3339 UTC")
    closed_at: OptionalTime = Field(description="When it was closed or voided, RFC 3339 UTC; null while open")


class Trend(Report):
    """Rate, size and shape over some hours, with what was done to the crusher and which lots were open."""

    since: Time = Field(description="Beginning of the first bucket, RFC 3339 UTC")
    until: Time = Field(description="Now, as the host sees it")
    bucket_s: int = Field(description="Length of a bucket, s; the last one is not over yet")
    buckets: list[TrendBucket] = Field(description="Oldest first, also those in which nothing fell")
    diary: list[DiaryEntry] = Field(description="Entries within the time, oldest first, the newest 500")
    lots: list[TrendLot] = Field(
        description="Lots that were open within the time, oldest first, the newest 500"
    )


def bucket_s_of(hours: float) -> int:
    """Return the length of the buckets that some hours are parted into, s."""
    return next((each for each in BUCKETS_S if hours * 3600 / each <= MAX_BUCKETS), BUCKETS_S[-1])


def trend(
    connection: sqlite3.Connection,
    now: str,
    hours: float,
    measured: MeasuredRange,
    sieves_mm: Collection[float] = (),
) -> Trend:
    """Return the trend of rate, size and shape over the last hours; buckets begin at multiples of their length, UTC."""
    bucket_s = bucket_s_of(hours)
    end = datetime.fromisoformat(now)
    begin_s = (end - timedelta(hours=hours)).timestamp() // bucket_s * bucket_s
    edges = [
        rfc3339(datetime.fromtimestamp(begin_s + each * bucket_s, UTC))
        for each in range(int(-(-(end.timestamp() - begin_s) // bucket_s)))
    ] + [now]
    return Trend(
        since=edges[0],
        until=now,
        bucket_s=bucket_s,
        buckets=[_bucket(connection, *ends, measured, sieves_mm) for ends in pairwise(edges)],
        diary=entries(connection, edges[0], now, MAX_MARKS)[::-1],
        lots=_lots(connection, edges[0], now),
    )


def _bucket(
    connection: sqlite3.Connection,
    since: str,
    until: str,
    measured: MeasuredRange,
    sieves_mm: Collection[float],
) -> TrendBucket:
    found = stretch(connection, since, until, MAX_STONES)
    lasted = datetime.fromisoformat(until) - datetime.fromisoformat(since)
    return TrendBucket(
        since=since,
        until=until,
        n_stones=found.n_stones,
        measured=found.n_measured,
        stones_per_min=found.n_timed / (lasted / timedelta(minutes=1)),
        passing_percent={
            each: passing_percent(sample_of(found.lot, LENGTH_SD_PERCENT / 100), each)
            if each in measured
            else NOT_MEASURED
            for each in sieves_mm
        },
        **main_figures(found.lot, measured),
    )


def main_figures(lot: Lot, measured: MeasuredRange) -> dict[str, Estimate]:
    """Return `d50_mm`, from the stones themselves, `flakiness_percent` and `shape_percent`."""
    sample = sample_of(lot, LENGTH_SD_PERCENT / 100)
    d50 = quantile(sample, 50, Inverse(size_mm=lambda share: exact_mm(sample.lot, share)), measured)
    shares = {name: share_percent(sample, property_of(measured)) for name, property_of in SHARES.items()}
    return {"d50_mm": NOT_MEASURED if d50 is None else d50.size_mm, **shares}


def _lots(connection: sqlite3.Connection, since: str, until: str) -> list[TrendLot]:
    rows = connection.execute(
        "SELECT lot, product, state, opened_at, closed_at FROM lots"
        " WHERE opened_at < ? AND coalesce(closed_at, '9') >= ? ORDER BY opened_at DESC LIMIT ?",
        (until, since, MAX_MARKS),
    )
    return [TrendLot(**row) for row in rows_by_name(rows)][::-1]
