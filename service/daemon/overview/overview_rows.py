"""What an overview takes from the store: counts, the newest stones, the open lot, and the figures; on a connection.

All but the figures take under a millisecond, as only what came since the last time is counted and read.
"""

import hashlib
import json
import sqlite3
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from datetime import datetime, timedelta
from typing import Literal

from pipeline.frames import BundleKind, rfc3339
from pipeline.gradation.estimates import Estimate
from pipeline.gradation.specification import Decision
from service.daemon.overview.overview_documents import (
    OverviewCounts,
    OverviewDecision,
    OverviewFigures,
    OverviewLot,
    OverviewPassing,
    OverviewStone,
)
from service.lots.evaluation import lot_figures, window_figures
from service.lots.figures import LotFigures
from service.lots.lots import ClosedLot, LotChoice, LotState, find_lot, lots, newest_closed
from service.lots.products import find_product
from service.lots.trends.trend import ends_mm
from service.lots.yardsticks import MEDIAN_PERCENT, Request
from service.results.fields import Outcome
from service.store import ParticleFilter
from service.store.accounting import OutcomeCounts, outcome_counts
from service.store.reads import particles

RATE_OVER = timedelta(minutes=1)
WINDOW = timedelta(hours=1)
"""Time whose stones the figures are of while no lot is open."""
N_NEWEST = 12


@dataclass(frozen=True, slots=True, kw_only=True)
class TodaysCounts:
    """Results by outcome of those captured since midnight, up to a number."""

    midnight: str
    up_to_seq: int = 0
    n: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Rows:
    """Rows of the store at one moment."""

    counts: OutcomeCounts = field(default_factory=OutcomeCounts)
    today: TodaysCounts | None = None
    stones_per_min: int = 0
    newest: tuple[OverviewStone, ...] = ()
    lot: OverviewLot | None = None
    last_lot: ClosedLot | None = None
    is_simulated: bool = False
    is_replay: bool = False

    @property
    def accounting(self) -> OverviewCounts:
        """Return the balance of the whole history."""
        by_outcome: Counter[str] = Counter()
        for (outcome, _, _), n in self.counts.n.items():
            by_outcome[outcome] += n
        return _balance(by_outcome, self.counts.in_progress)

    @property
    def accounting_today(self) -> OverviewCounts:
        """Return the balance since midnight; what is in progress fell just now."""
        return _balance({} if self.today is None else self.today.n, self.counts.in_progress)


def overview_rows(
    connection: sqlite3.Connection, session: int | None, now: datetime, is_another_stone: bool, known: Rows
) -> Rows:
    """Return the rows now; `known` are the last ones, or none.

    `now` is in the host's local time. Only if `is_another_stone` are the newest read anew.
    """
    counts = outcome_counts(connection, known.counts)
    midnight = rfc3339(now.replace(hour=0, minute=0, second=0, microsecond=0))
    (n_minute,) = connection.execute(
        # by the time of the result: a replay's stones fell long ago; many that are one result fell at no known time
        "SELECT count(*) FROM results JOIN listed USING (seq)"
        " WHERE json_extract(record, '$.recorded_at') >= ? AND listed.kind = ?",
        (rfc3339(now - RATE_OVER), BundleKind.PARTICLE),
    ).fetchone()
    (info,) = connection.execute(
        "SELECT info FROM sessions WHERE session = ?1 UNION ALL SELECT '{}'", (session,)
    ).fetchone()
    run = json.loads(info)
    return Rows(
        counts=counts,
        today=_todays_counts(connection, midnight, known.today),
        stones_per_min=n_minute,
        newest=_newest(connection) if is_another_stone else known.newest,
        lot=_open_lot(connection),
        last_lot=newest_closed(connection),
        is_simulated=bool(run.get("is_simulated")),
        is_replay=bool(run.get("is_replay")),
    )


def overview_figures(
    connection: sqlite3.Connection, lot: str | None, now: datetime, request: Request
) -> OverviewFigures | None:
    """Return the main figures of a lot, or of the last hour; None without a measured stone."""
    if lot is None:
        found = window_figures(connection, rfc3339(now - WINDOW), rfc3339(now), request, None)
    else:
        found = lot_figures(connection, lot, request)
    if found is None or found.measured == 0:
        return None
    (median,) = (each for each in found.quantiles if each.percent == MEDIAN_PERCENT)
    return OverviewFigures(
        lot=lot,
        verdict=found.verdict,
        is_partial=found.is_partial,
        countdown=found.countdown,
        passing=[] if lot is None else _passing(connection, lot, found),
        decisions=_decisions(found),
        d50_mm=median.exact_mm,
        flakiness_percent=found.indices.flakiness_percent,
        shape_percent=found.indices.shape_percent,
        measured=found.measured,
        n_effective=found.n_effective,
        version=_version(found, lot),
    )


def _passing(connection: sqlite3.Connection, lot: str, figures: LotFigures) -> list[OverviewPassing]:
    known = find_lot(connection, lot)
    product = None if known is None else find_product(connection, known.product, known.product_version)
    if product is None:
        return []
    percents = {step.sieve_mm: step.passing_percent for step in figures.curve}
    ends = ends_mm(product.definition, list(percents))
    return [OverviewPassing(end=end, sieve_mm=each, percent=percents[each]) for end, each in ends.items()]


def _decisions(figures: LotFigures) -> list[OverviewDecision]:
    indices = figures.indices
    steps = sorted(figures.curve, key=lambda step: -step.sieve_mm)
    judged: list[tuple[float | None, Literal["FI", "SI"] | None, Estimate, Decision | None]] = [
        *((step.sieve_mm, None, step.passing_percent, step.decision) for step in steps),
        (None, "FI", indices.flakiness_percent, figures.flakiness_decision),
        (None, "SI", indices.shape_percent, figures.shape_decision),
    ]
    return [
        OverviewDecision(sieve_mm=sieve_mm, index=index, percent=percent, decision=decision)
        for sieve_mm, index, percent, decision in judged
        if decision is not None
    ]


def _version(figures: LotFigures, lot: str | None) -> str:
    """Hash all that the drawing of the curve depends on: not the seconds that a decision still takes."""
    steps = [
        (
            step.sieve_mm,
            asdict(step.passing_percent),
            None if step.decision is None else step.decision.verdict,
        )
        for step in figures.curve
    ]
    drawn = json.dumps([lot, figures.verdict, figures.specification, steps])
    return hashlib.sha256(drawn.encode()).hexdigest()[:16]


def _todays_counts(connection: sqlite3.Connection, midnight: str, known: TodaysCounts | None) -> TodaysCounts:
    if known is None or known.midnight != midnight:
        known = TodaysCounts(midnight=midnight)
    (last_seq,) = connection.execute("SELECT last_seq FROM store").fetchone()
    if known.up_to_seq == last_seq:
        return known
    # at first by the index of the times, which a range of numbers would keep SQLite from; then by the few new numbers
    place = "seq > ?" if known.up_to_seq else "+seq > ?"
    n = dict(known.n)
    for outcome, count in connection.execute(
        f"SELECT outcome, sum(n) FROM listed WHERE captured_at >= ? AND {place} GROUP BY outcome",  # noqa: S608 - one of two above
        (midnight, known.up_to_seq),
    ):
        n[outcome] = n.get(outcome, 0) + count
    return TodaysCounts(midnight=midnight, up_to_seq=last_seq, n=n)


def _newest(connection: sqlite3.Connection) -> tuple[OverviewStone, ...]:
    records = particles(connection, ParticleFilter(kind="particle"), None, N_NEWEST)
    for record in records:
        record["has_mesh"] = record.get("mesh") is not None and record["files_removed"] is None
    return tuple(
        OverviewStone.model_validate({name: record.get(name) for name in OverviewStone.model_fields})
        for record in records
    )


def _open_lot(connection: sqlite3.Connection) -> OverviewLot | None:
    found = lots(connection, LotChoice(state=LotState.OPEN), 1)
    if not found:
        return None
    (lot,) = found
    product = find_product(connection, lot.product, lot.product_version)
    return OverviewLot(title=lot.product if product is None else product.definition.title, **dict(lot))


def _balance(by_outcome: Mapping[str, int], in_progress: int) -> OverviewCounts:
    counts = {outcome.value: by_outcome.get(outcome, 0) for outcome in Outcome}
    return OverviewCounts(triggers=sum(counts.values()) + in_progress, in_progress=in_progress, **counts)
