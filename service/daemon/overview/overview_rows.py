"""What an overview takes from the store: counts, the newest stones, the open lot, and the figures; on a connection.

All but the figures take under a millisecond, as only what came since the last time is counted and read.
"""

import hashlib
import json
import sqlite3
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from datetime import datetime, timedelta

from pipeline.frames import BundleKind, rfc3339
from service.daemon.overview.overview_documents import (
    OverviewCounts,
    OverviewDecision,
    OverviewFigures,
    OverviewLot,
    OverviewStone,
)
from service.lots.evaluation import lot_figures, window_figures
from service.lots.figures import LotFigures
from service.lots.lots import LotState, lots
from service.lots.products import find_product
from service.lots.yardsticks import Request
from service.results.fields import Outcome
from service.store import ParticleFilter
from service.store.accounting import OutcomeCounts, outcome_counts
from service.store.reads import particles

RATE_OVER = timedelta(minutes=1)
WINDOW = timedelta(hours=1)
"""Time whose stones the figures are of while no lot is open."""
N_NEWEST = 12
MEDIAN_PERCENT = 50


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
        decisions=list(_decisions(found)),
        d50_mm=median.interpolated_mm,
        flakiness_percent=found.indices.flakiness_percent,
        shape_percent=found.indices.shape_percent,
        measured=found.measured,
        n_effective=found.n_effective,
        version=_version(found, lot),
    )


def _decisions(figures: LotFigures) -> Iterator[OverviewDecision]:
    for step in sorted(figures.curve, key=lambda step: -step.sieve_mm):
        if step.decision is not None:
            yield OverviewDecision(
                sieve_mm=step.sieve_mm, index=None, percent=step.passing_percent, decision=step.decision
            )
    if figures.flakiness_decision is not None:
        percent = figures.indices.flakiness_percent
        yield OverviewDecision(
            sieve_mm=None, index="FI", percent=percent, decision=figures.flakiness_decision
        )
    if figures.shape_decision is not None:
        percent = figures.indices.shape_percent
        yield OverviewDecision(sieve_mm=None, index="SI", percent=percent, decision=figures.shape_decision)


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
    return tuple(
        OverviewStone(
            seq=record["seq"],
            id=record["id"],
            outcome=record["outcome"],
            reason=record["reason"],
            quality=record.get("quality"),
            sieve_size_mm=record.get("sieve_size_mm"),
            zingg_class=record.get("zingg_class"),
            captured_at=record["captured_at"],
            has_mesh=record.get("mesh") is not None and record["files_removed"] is None,
        )
        for record in records
    )


def _open_lot(connection: sqlite3.Connection) -> OverviewLot | None:
    found = lots(connection, LotState.OPEN, None, None, 1)
    if not found:
        return None
    (lot,) = found
    product = find_product(connection, lot.product, lot.product_version)
    return OverviewLot(
        lot=lot.lot,
        product=lot.product,
        title=lot.product if product is None else product.definition.title,
        opened_at=lot.opened_at,
        n_stones=lot.n_stones,
    )


def _balance(by_outcome: Mapping[str, int], in_progress: int) -> OverviewCounts:
    measured, rejected, lost = (by_outcome.get(outcome, 0) for outcome in Outcome)
    return OverviewCounts(
        triggers=measured + rejected + lost + in_progress,
        measured=measured,
        rejected=rejected,
        lost=lost,
        in_progress=in_progress,
    )
