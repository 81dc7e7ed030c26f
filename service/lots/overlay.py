"""Curves of many lots at the same sieves, and a band to see them against: the specification, or the lots before."""

import sqlite3
from collections.abc import Collection, Iterator, Sequence
from enum import StrEnum

import numpy as np

from pipeline.gradation.estimates import Estimate
from service.base.status import Report
from service.lots.evaluation import passing_of
from service.lots.lots import LotChoice, LotState, find_lot, lots
from service.lots.products import find_product
from service.lots.stones import stones_of_lot
from service.lots.yardsticks import Request, Yardstick, yardstick_of

MAX_LOTS = 12
HISTORY = 30
"""Newest closed lots of a product that a band is made of."""
LEAST_HISTORY = 5
"""Fewer lots have no spread that is worth a band."""
REACH_SDS = 2.0


class ReferenceKind(StrEnum):
    """What the band of an overlay is."""

    SPECIFICATION = "specification"
    """Limits of the product's specification, or of the request's."""
    HISTORY = "history"
    """Median of the product's closed lots, two standard deviations to either side."""


class OverlaidStep(Report):
    """The gradation of a lot at one sieve."""

    sieve_mm: float
    """Aperture of the sieve, mm"""
    passing_percent: Estimate
    """By mass"""


class OverlaidLot(Report):
    """The curve of one lot."""

    lot: str
    """Id of the lot"""
    measured: int
    """Stones with a body and its measures"""
    curve: list[OverlaidStep]
    """By rising sieve"""


class ReferenceStep(Report):
    """The band at one sieve, percent passing by mass."""

    sieve_mm: float
    """Aperture of the sieve, mm"""
    low_percent: float
    """Lower end"""
    median_percent: float | None
    """Median of the lots; null of a specification"""
    high_percent: float
    """Upper end"""


class Reference(Report):
    """A band of passings, at the sieves that have one."""

    kind: ReferenceKind
    """Source of the band"""
    name: str
    """Name of the specification, or id of the product"""
    n_lots: int | None
    """Closed lots that it rests on; null of a specification"""
    steps: list[ReferenceStep]
    """By rising sieve"""


class Overlay(Report):
    """Curves of lots at the sieves of the first one's product, or at those of the request."""

    sieve_set: str
    """Sieves that were used"""
    lots: list[OverlaidLot]
    """In the order of the request"""
    reference: Reference | None
    """Null where none was asked for, the product has no limits, or fewer than five other closed lots"""


def overlay(
    connection: sqlite3.Connection, names: Sequence[str], kind: ReferenceKind | None, request: Request
) -> Overlay | None:
    """Return the curves of lots by the product of the first; None if one of them does not exist.

    Raises `UnknownYardstickError` as `yardstick_of` does.
    """
    records = [find_lot(connection, name) for name in names]
    if None in records or records[0] is None:
        return None
    first = records[0]
    yardstick = yardstick_of(find_product(connection, first.product, first.product_version), request)
    reference = None
    if kind is ReferenceKind.SPECIFICATION:
        reference = _limits(yardstick)
    elif kind is ReferenceKind.HISTORY:
        reference = _history(connection, first.product, names, yardstick)
    return Overlay(
        sieve_set=yardstick.sieves.name,
        lots=[_overlaid(connection, name, yardstick) for name in names],
        reference=reference,
    )


def _overlaid(connection: sqlite3.Connection, name: str, yardstick: Yardstick) -> OverlaidLot:
    stones = stones_of_lot(connection, name).lot
    passing = passing_of(stones, yardstick.apertures_mm, yardstick.measured)
    curve = [OverlaidStep(sieve_mm=sieve_mm, passing_percent=each) for sieve_mm, each in passing.items()]
    return OverlaidLot(lot=name, measured=stones.n_measured, curve=curve)


def _limits(yardstick: Yardstick) -> Reference | None:
    specification = yardstick.specification
    if specification is None or not specification.passing:
        return None
    steps = [
        ReferenceStep(
            sieve_mm=sieve_mm,
            low_percent=limits.min_percent,
            median_percent=None,
            high_percent=limits.max_percent,
        )
        for sieve_mm, limits in sorted(specification.passing.items())
    ]
    return Reference(kind=ReferenceKind.SPECIFICATION, name=specification.name, n_lots=None, steps=steps)


def _history(
    connection: sqlite3.Connection, product: str, shown: Collection[str], yardstick: Yardstick
) -> Reference | None:
    """Return the band of the closed lots but those that are shown; None with too few."""
    sieves_mm = [mm for mm in yardstick.apertures_mm if mm in yardstick.measured]
    closed = lots(connection, LotChoice(state=LotState.CLOSED, product=product), HISTORY + len(shown))
    others = [each.lot for each in closed if each.lot not in shown][:HISTORY]
    passing = np.array(list(_passing_of_lots(connection, others, sieves_mm)))
    if len(passing) < LEAST_HISTORY or not sieves_mm:
        return None
    medians, reaches = np.median(passing, axis=0), REACH_SDS * np.std(passing, axis=0, ddof=1)
    low, high = np.clip([medians - reaches, medians + reaches], 0, 100)
    steps = [
        ReferenceStep(sieve_mm=mm, low_percent=least, median_percent=median, high_percent=greatest)
        for mm, least, median, greatest in zip(
            sieves_mm, low.tolist(), medians.tolist(), high.tolist(), strict=True
        )
    ]
    return Reference(kind=ReferenceKind.HISTORY, name=product, n_lots=len(passing), steps=steps)


def _passing_of_lots(
    connection: sqlite3.Connection, names: Sequence[str], sieves_mm: Sequence[float]
) -> Iterator[list[float]]:
    """Yield the passing of each lot that has stones, percent; summed in the database, without their errors."""
    passing = ", ".join("100 * total(volume_mm3 * (sieve_size_mm <= ?)) / sum(volume_mm3)" for _ in sieves_mm)
    for name in names if sieves_mm else ():
        found = connection.execute(
            f"SELECT {passing} FROM stones WHERE lot = ? AND outcome = 'measured'",  # noqa: S608 - of this module
            (*sieves_mm, name),
        ).fetchone()
        if found[0] is not None:
            yield list(found)
