"""A shift sheet made by hand: as many lots and alarms as a bad night has."""

from datetime import UTC, datetime, timedelta
from typing import Any

from support.lot_figures import lot_document, measured

from pipeline.frames import rfc3339
from pipeline.gradation.specification import Range, Verdict
from service.health.alarms.alarm import Alarm, AlarmState
from service.health.alarms.rules import Priority
from service.lots.lots import LotState
from service.lots.outcome import LotCompletion
from service.lots.trends.diary import DiaryEntry, DiaryKind
from service.reports.report import EndedVerification, VerificationOutcome
from service.reports.shift_data import (
    ControlledRange,
    ShiftLot,
    ShiftProduct,
    ShiftSheet,
    ShiftStop,
)

BEGIN = datetime(2026, 3, 2, 5, tzinfo=UTC)


def after(minutes: float) -> str:
    return rfc3339(BEGIN + timedelta(minutes=minutes))


def shift_sheet(
    *, n_lots: int = 2, n_alarms: int = 2, n_stops: int = 1, long_text: str = "changed", **other: Any
) -> ShiftSheet:
    """The sheet of an early shift, its lots a quarter of an hour each."""
    verdicts = (Verdict.CONFORMS, Verdict.DOES_NOT_CONFORM)
    facts: dict[str, Any] = {
        "shift": "2026-03-02-0600",
        "since": after(0),
        "until": after(480),
        "is_over": True,
        "as_of": after(480),
        "triggers": 5321,
        "measured": 5200,
        "rejected": 100,
        "lost": 21,
        "void": 0,
        "products": [
            ShiftProduct(
                product="basalt-8-16",
                version=1,
                title="8/16 basalt",
                measured=5100,
                unmeasured=121,
                mass_kg=1234.5,
                density_kg_m3=2850.0,
                d50_mm=measured(11.4, 0.1),
                d50_limits=ControlledRange(lower=10.9, upper=12.1),
                flakiness_percent=measured(12.3),
                flakiness_limits=Range(0, 20),
                shape_percent=measured(9.5),
                shape_limits=None,
            ),
            ShiftProduct(
                product=None,
                version=None,
                title=None,
                measured=100,
                unmeasured=0,
                mass_kg=None,
                density_kg_m3=None,
                d50_mm=measured(14.4, 0.4),
                d50_limits=None,
                flakiness_percent=measured(15.0),
                flakiness_limits=None,
                shape_percent=measured(10.0),
                shape_limits=None,
            ),
        ],
        "lots": [
            ShiftLot(
                lot=lot_document(
                    lot=f"L-{1200 + n}",
                    product="basalt-8-16",
                    state=LotState.CLOSED,
                    opened_at=after(15 * n),
                    closed_at=after(15 * n + 14),
                    revision=1,
                    n_stones=170,
                    tonnage_t=40.0,
                    completion=LotCompletion(
                        verdict=verdicts[n % 5 == 4],
                        is_partial=False,
                        measured=170,
                        rejected=0,
                        lost=0,
                        revision=1,
                        at=after(15 * n + 15),
                        report="",
                        report_sha256="",
                    ),
                ),
                d50_mm=measured(11.4),
                flakiness_percent=measured(12.3),
                shape_percent=measured(9.5),
            )
            for n in range(n_lots)
        ],
        "alarms": [
            Alarm(
                id=n + 1,
                check=f"camera:c{n % 16 + 1:02d}",
                state=AlarmState.NORMAL,
                priority=Priority.MEDIUM,
                detail="lost",
                raised_at=after(11 * n + 1),
                changed_at=after(11 * n + 5),
                cleared_at=after(11 * n + 5) if n % 2 == 0 else None,
                acknowledged_at=after(11 * n + 2) if n % 3 == 0 else None,
                acknowledged_by="key wall" if n % 3 == 0 else None,
            )
            for n in range(n_alarms)
        ],
        "diary": [
            DiaryEntry(
                entry=1,
                at=after(60),
                kind=DiaryKind.GAP,
                text=long_text,
                value=25.0,
                who="key wall",
                noted_at=after(61),
            )
        ],
        "verifications": [
            EndedVerification(
                id="v-20260302",
                at=after(5),
                outcome=VerificationOutcome.PASSED,
                diameter_mm=14.3,
                error_mm=-0.001,
            )
        ],
        "stops": [
            ShiftStop(since=after(100 + 20 * n), until=after(112 + 20 * n), unarmed_s=120.0 * (n % 2))
            for n in range(n_stops)
        ],
        "stop_min": 5.0,
        "is_simulated": False,
        "is_replay": False,
    }
    return ShiftSheet(**facts | other)
