"""What a shift sheet says, from the store: stones and their mass, lots, alarms, diary, ball, stops."""

import sqlite3
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import pairwise

from pydantic import TypeAdapter

from pipeline.frames import rfc3339
from pipeline.gradation.estimates import Estimate
from pipeline.gradation.influences import PAUSE_S
from pipeline.gradation.sieves import MeasuredRange
from pipeline.gradation.specification import Range, Verdict
from service.base.schema import Time, served
from service.base.status import AcquisitionState
from service.health.alarms.alarm import Alarm
from service.health.alarms.alarms import ALARM
from service.lots.lots import LotDocument, LotState, find_lot
from service.lots.outcome import LotVerdict
from service.lots.products import find_product
from service.lots.shifts import LotsSettings, Shift
from service.lots.stones import NO_LOT, ProductCount, counts_by_product, of_product, stretch, times_of
from service.lots.trends.control import product_control
from service.lots.trends.diary import DiaryEntry, entries
from service.lots.trends.trend import main_figures
from service.lots.yardsticks import Request, yardstick_of
from service.reports.report import EndedVerification, VerificationOutcome
from service.results.fields import Outcome
from service.store.events import EventType
from service.store.schema import rows_by_name

MAX_STONES = 20_000
"""Stones of a product whose size and shape are looked at; of more, every so many."""
MOST = 1000
"""Lots, alarms, entries, verifications and stops that are read."""
MM3_A_M3 = 1e9
FIGURES = TypeAdapter(dict[str, Estimate])


@served
class ShiftDocument:
    """A shift, by the host's local time."""

    shift: str
    """Name of the shift: when it begins, by the host's local time, such as `2026-03-02-0600`."""
    since: Time
    """Beginning, RFC 3339 UTC."""
    until: Time
    """End."""
    is_over: bool
    """False: it goes on, and what is said of it is of now."""


@served
class ControlledRange:
    """Limits of the control chart."""

    lower: float
    """Lower limit, in the unit of the figure."""
    upper: float
    """Upper limit."""


@served
class ShiftProduct:
    """What fell within a shift in lots of one version of a product, or in no lot."""

    product: str | None
    """Id of the product; null: in no lot."""
    version: int | None
    """Version of the product that the lots were opened with."""
    title: str | None
    """Name of the product for people."""
    measured: int
    """Stones with a body and its measures."""
    unmeasured: int
    """Stones without: rejected or lost. They are in no mass."""
    mass_kg: float | None
    """Mass of the measured stones, kg: their volume times the density; null without a density."""
    density_kg_m3: float | None
    """Density of the particles, EN 1097-6, kg/m³: the product's, or what the configuration says outside of lots."""
    d50_mm: Estimate
    """Size that half of the mass is smaller than, from the stones themselves, mm."""
    d50_limits: ControlledRange | None
    """Limits of the product's control chart as they were for its newest lot; null: none yet."""
    flakiness_percent: Estimate
    """Flakiness index FI, EN 933-3, %."""
    flakiness_limits: Range | None
    """Limits of the product's specification; null: none."""
    shape_percent: Estimate
    """Shape index SI, EN 933-4, %."""
    shape_limits: Range | None
    """Limits of the product's specification; null: none."""


@served
class ShiftLot:
    """A lot that was open within a shift, whole: not only what fell of it then."""

    lot: LotDocument
    """The lot as it is now; `completion` or `reached` has its verdict."""
    d50_mm: Estimate | None
    """D50 that it was completed with, mm; null before."""
    flakiness_percent: Estimate | None
    """Flakiness index that it was completed with, %; null before."""
    shape_percent: Estimate | None
    """Shape index that it was completed with, %; null before."""

    @property
    def is_final(self) -> bool:
        """True when its verdict stays, and its report is issued."""
        return self.lot.is_final and self.lot.state is LotState.CLOSED

    @property
    def said(self) -> LotVerdict | None:
        """Its final verdict, or the one that it has reached while it is open; None: there is none."""
        if self.lot.state is LotState.VOID:
            return None
        return self.lot.completion if self.lot.is_final else self.lot.reached

    @property
    def verdict(self) -> Verdict | None:
        return None if self.said is None else self.said.verdict


@served
class ShiftStop:
    """A time without a stone."""

    since: Time
    """The last stone before it fell, or the shift began; RFC 3339 UTC."""
    until: Time
    """The next stone fell, or the shift ended."""
    unarmed_s: float
    """For how much of it the instrument is known not to have measured, s: the crusher may have run then."""


@served
class ShiftSheet(ShiftDocument):
    """All that a shift sheet says."""

    as_of: Time
    """Moment that it is of: until then stones are counted, of a shift that is over all of them; RFC 3339 UTC."""
    triggers: int
    """Stones that fell, whatever became of them."""
    measured: int
    """Stones with a body and its measures."""
    rejected: int
    """Stones whose views were found unfit."""
    lost: int
    """Stones whose views were never looked at."""
    void: int
    """Stones of lots that are void, among all these: they are in no product, and in no mass."""
    products: list[ShiftProduct]
    """By product, and what fell in no lot; empty where nothing fell."""
    lots: list[ShiftLot]
    """Oldest first."""
    alarms: list[Alarm]
    """Alarms that were not ended when it began and those raised since, oldest first, as they are now."""
    diary: list[DiaryEntry]
    """Entries of the crusher's diary, oldest first."""
    verifications: list[EndedVerification]
    """Verifications with a ball that have a verdict, oldest first, as far as events are kept."""
    stops: list[ShiftStop]
    """Times without a stone, oldest first."""
    stop_min: float
    """A shorter time without a stone is no stop, minutes."""
    is_simulated: bool
    """True when a stone at least is of a simulated rig."""
    is_replay: bool
    """True when a stone at least is of a recording."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ShiftRequest:
    """A request for a shift's sheet."""

    shift: Shift
    now: datetime
    lots: LotsSettings
    density_kg_m3: float | None = None  # outside of lots


def shift_document(shift: Shift, now: datetime) -> ShiftDocument:
    """Return a shift as REST lists it."""
    return ShiftDocument(
        shift=shift.name,
        since=rfc3339(shift.since),
        until=rfc3339(shift.until),
        is_over=shift.until <= now,
    )


def shift_sheet(connection: sqlite3.Connection, wanted: ShiftRequest) -> ShiftSheet:
    """Return all that the sheet of a shift says."""
    shift = shift_document(wanted.shift, wanted.now)
    since, until = shift.since, rfc3339(min(wanted.shift.until, wanted.now))
    counts = counts_by_product(connection, since, until)
    by_outcome = {each: sum(count.n_stones for count in counts if count.outcome == each) for each in Outcome}
    stop_min = wanted.lots.no_stones_min or PAUSE_S / 60
    return ShiftSheet(
        shift=shift.shift,
        since=since,
        until=shift.until,
        is_over=shift.is_over,
        as_of=until,
        triggers=sum(by_outcome.values()),
        measured=by_outcome[Outcome.MEASURED],
        rejected=by_outcome[Outcome.REJECTED],
        lost=by_outcome[Outcome.LOST],
        void=sum(count.n_stones for count in counts if count.is_void),
        products=list(_products(connection, counts, until, wanted)),
        lots=_lots(connection, since, until),
        alarms=_alarms(connection, since, until),
        diary=entries(connection, since, until, MOST)[::-1],
        verifications=_verifications(connection, since, until),
        stops=list(_stops(connection, since, until, stop_min)),
        stop_min=stop_min,
        is_simulated=any(count.is_simulated for count in counts),
        is_replay=any(count.is_replay for count in counts),
    )


def _products(
    connection: sqlite3.Connection, counts: Sequence[ProductCount], until: str, wanted: ShiftRequest
) -> Iterator[ShiftProduct]:
    since = rfc3339(wanted.shift.since)
    valid = [each for each in counts if not each.is_void]
    for key in dict.fromkeys((each.product, each.version) for each in valid):
        of_it = [each for each in valid if (each.product, each.version) == key]
        name, version = key
        product = None if name is None else find_product(connection, name, version)
        choice = NO_LOT if name is None or version is None else of_product(name, version)
        stones = stretch(connection, since, until, MAX_STONES, choice)
        n_measured = sum(each.n_stones for each in of_it if each.outcome == Outcome.MEASURED)
        density = wanted.density_kg_m3 if product is None else product.density_kg_m3
        volume_mm3 = sum(each.volume_mm3 for each in of_it)
        request = Request(measured=wanted.lots.measured)
        specification = None if product is None else yardstick_of(product, request).specification
        yield ShiftProduct(
            product=name,
            version=version,
            title=None if product is None else product.title,
            measured=n_measured,
            unmeasured=sum(each.n_stones for each in of_it) - n_measured,
            mass_kg=None if density is None else volume_mm3 / MM3_A_M3 * density,
            density_kg_m3=density,
            **main_figures(stones.lot, wanted.lots.measured),
            d50_limits=None if name is None else _d50_limits(connection, name, wanted.lots.measured),
            flakiness_limits=None if specification is None else specification.flakiness,
            shape_limits=None if specification is None else specification.shape,
        )


def _d50_limits(
    connection: sqlite3.Connection, product: str, measured: MeasuredRange
) -> ControlledRange | None:
    found = product_control(connection, product, measured, 1)
    for chart in () if found is None else found.charts:
        for point in chart.points:
            if chart.figure == "d50_mm" and point.lower is not None and point.upper is not None:
                return ControlledRange(lower=point.lower, upper=point.upper)
    return None


def _lots(connection: sqlite3.Connection, since: str, until: str) -> list[ShiftLot]:
    rows = connection.execute(
        "SELECT lot, figures FROM lots WHERE opened_at < ? AND coalesce(closed_at, '9') >= ?"
        " ORDER BY opened_at DESC LIMIT ?",
        (until, since, MOST),
    ).fetchall()
    found = ((find_lot(connection, lot), figures) for lot, figures in reversed(rows))
    return [_lot(lot, figures) for lot, figures in found if lot is not None]


def _lot(lot: LotDocument, figures: str | None) -> ShiftLot:
    completed = FIGURES.validate_json(figures) if figures is not None and lot.is_final else {}
    return ShiftLot(
        lot=lot,
        d50_mm=completed.get("d50_mm"),
        flakiness_percent=completed.get("flakiness_percent"),
        shape_percent=completed.get("shape_percent"),
    )


def _alarms(connection: sqlite3.Connection, since: str, until: str) -> list[Alarm]:
    rows = connection.execute(
        "SELECT document FROM alarms WHERE document ->> 'raised_at' < ? AND coalesce(ended_at, '9') >= ?"
        " ORDER BY document ->> 'raised_at' DESC LIMIT ?",
        (until, since, MOST),
    ).fetchall()
    return [ALARM.validate_json(document) for (document,) in reversed(rows)]


def _verifications(connection: sqlite3.Connection, since: str, until: str) -> list[EndedVerification]:
    rows = connection.execute(
        "SELECT subject AS id, at, data ->> 'outcome' AS outcome, data ->> 'diameter_mm' AS diameter_mm,"
        " data ->> 'error_mm' AS error_mm FROM events WHERE type = ? AND at >= ? AND at < ?"
        " AND data ->> 'outcome' IN (?, ?) ORDER BY seq DESC LIMIT ?",
        (EventType.VERIFICATION_ENDED, since, until, *VerificationOutcome, MOST),
    )
    return [
        EndedVerification(**row | {"outcome": VerificationOutcome(row["outcome"])})
        for row in rows_by_name(rows)
    ][::-1]


def _stops(connection: sqlite3.Connection, since: str, until: str, stop_min: float) -> Iterator[ShiftStop]:
    """Yield the newest `MOST` times without a stone."""
    begin_s, end_s = (datetime.fromisoformat(each).timestamp() for each in (since, until))
    times_s = [begin_s, *times_of(connection, since, until), end_s]
    long = [(before, after) for before, after in pairwise(times_s) if after - before > 60 * stop_min]
    unarmed = _unarmed(connection, since, until)
    for before_s, after_s in long[-MOST:]:
        overlaps = (min(after_s, ended_s) - max(before_s, began_s) for began_s, ended_s in unarmed)
        unarmed_s = sum(max(each, 0.0) for each in overlaps)
        ends = (rfc3339(datetime.fromtimestamp(round(each, 3), UTC)) for each in (before_s, after_s))
        yield ShiftStop(since=next(ends), until=next(ends), unarmed_s=round(unarmed_s, 1))


def _unarmed(connection: sqlite3.Connection, since: str, until: str) -> list[tuple[float, float]]:
    """Return the times in which the rig was not armed, as far as events tell, in seconds since 1970.

    No rig was armed before the first session, nor is one when a session starts.
    """
    rows = connection.execute(
        "SELECT at, data ->> 'state' FROM events WHERE type = ?1 AND at < ?3 AND seq >= coalesce((SELECT max(seq)"
        " FROM events WHERE type = ?1 AND at <= ?2), 0) UNION ALL"
        " SELECT started_at, ?4 FROM sessions WHERE started_at > ?2 AND started_at < ?3 UNION ALL"
        " SELECT ?2, ?4 WHERE NOT EXISTS (SELECT 1 FROM sessions WHERE started_at <= ?2) ORDER BY 1",
        (EventType.ACQUISITION_CHANGED, since, until, AcquisitionState.DISARMED),
    ).fetchall()
    states = [(datetime.fromisoformat(at).timestamp(), state) for at, state in (*rows, (until, None))]
    return [
        (at_s, end_s) for (at_s, state), (end_s, _) in pairwise(states) if state != AcquisitionState.ARMED
    ]


def is_complete(connection: sqlite3.Connection, until: str) -> bool:
    """Return True when all stones that fell before a time have outcomes."""
    (n_open,) = connection.execute(
        "SELECT count(*) FROM triggers WHERE state = 'open' AND captured_at < ?", (until,)
    ).fetchone()
    return not n_open
