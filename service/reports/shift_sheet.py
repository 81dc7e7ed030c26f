"""Contents of a shift sheet, for one page of A4: as many lines of each list as there is room for, the rest counted."""

import sqlite3
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from typing import TypeVar

from drivers.files.times import utc_now
from pipeline.gradation.estimates import Estimate
from pipeline.gradation.specification import Range, Verdict
from service.base.language import Language
from service.base.messages import subject_words
from service.health.alarms.alarm import Alarm
from service.health.alarms.rules import load_rules
from service.lots.lots import LotState
from service.lots.plant import PlantSettings
from service.lots.shifts import LotsSettings, Shift
from service.lots.trends.diary import DiaryEntry
from service.reports.document import DASH, Column, Document, Note, Section, Table, facts
from service.reports.letterhead import letterhead
from service.reports.lot_reports import RigStanding, logo_svg
from service.reports.printed import html_of, pdf_of
from service.reports.report import EndedVerification, ReportFormat
from service.reports.shift_data import (
    ControlledRange,
    ShiftLot,
    ShiftProduct,
    ShiftRequest,
    ShiftSheet,
    ShiftStop,
    shift_sheet,
)
from service.reports.trend import entry_name
from service.reports.words import Words, abridged, words

T = TypeVar("T")

ROWS = 36
"""Lines of all lists together that a page of A4 has room for."""
LONGEST = 64
"""Characters of a text that fit into the line of a list."""
LONGEST_ID = 24
JUDGED = (Verdict.DOES_NOT_CONFORM, Verdict.UNDECIDED, Verdict.INSUFFICIENT, Verdict.CONFORMS)
"""Verdicts of lots, that of the sheet first."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SheetData:
    """All that a sheet prints; it can be pickled."""

    sheet: ShiftSheet
    created_at: str  # RFC 3339 UTC
    language: Language
    plant: PlantSettings = field(default_factory=PlantSettings)
    logo_svg: str | None = None


def sheet_html(data: SheetData) -> bytes:
    """Return a shift sheet as HTML."""
    return html_of(sheet_document(data))


def sheet_pdf(data: SheetData) -> bytes:
    """Return a shift sheet as PDF."""
    return pdf_of(sheet_document(data))


SHEETS: Mapping[ReportFormat, Callable[[SheetData], bytes]] = {
    ReportFormat.HTML: sheet_html,
    ReportFormat.PDF: sheet_pdf,
}
"""Functions from the data of a sheet to its file."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SheetRequest:
    """A request for a shift sheet as a file."""

    shift: Shift
    now: datetime
    lots: LotsSettings
    rig: RigStanding
    language: Language

    @property
    def figures(self) -> ShiftRequest:
        """The request for what it says."""
        return ShiftRequest(
            shift=self.shift, now=self.now, lots=self.lots, density_kg_m3=self.rig.density_kg_m3
        )


def sheet_file(connection: sqlite3.Connection, wanted: SheetRequest, report_format: ReportFormat) -> bytes:
    """Return the sheet of a shift as a file, in one of the formats of `SHEETS`."""
    return SHEETS[report_format](sheet_data(connection, wanted))


def sheet_data(connection: sqlite3.Connection, wanted: SheetRequest) -> SheetData:
    """Return all that the sheet of a shift prints."""
    plant = wanted.rig.plant
    return SheetData(
        sheet=shift_sheet(connection, wanted.figures),
        created_at=utc_now(),
        language=wanted.language,
        plant=plant,
        logo_svg=logo_svg(plant),
    )


def sheet_document(data: SheetData) -> Document:
    """Return a shift sheet as HTML and PDF print it."""
    say, sheet = words(data.language, data.plant.zone), data.sheet
    clock = Clock(sheet.since, say)
    lists = {
        "lots": [lot_row(each, clock, say) for each in sheet.lots],
        "alarms": [alarm_row(each, clock, say) for each in reversed(sheet.alarms)],
        "stops": [stop_row(each, clock, say) for each in _longest_first(sheet.stops)],
        "diary": [diary_row(each, clock, say) for each in sheet.diary],
        "balls": [ball_row(each, clock, say) for each in reversed(sheet.verifications)],
    }
    room = room_of(
        {"products": len(sheet.products), **{name: len(rows) for name, rows in lists.items()}}, ROWS
    )
    named = {name: say(f"shift.{name}", n=say.number(len(rows), 0)) for name, rows in lists.items()}
    title = say(
        "shift.title",
        day=clock.day(sheet.since),
        begin=clock.time(sheet.since),
        end=clock.time(sheet.until),
    )
    verdict = next((each for each in JUDGED if any(lot.verdict is each for lot in sheet.lots)), None)
    banners = [
        *([say("banner.simulated")] if sheet.is_simulated else []),
        *([say("banner.replay")] if sheet.is_replay else []),
        *([] if sheet.is_over else [say("shift.goes_on", at=say.time(sheet.as_of))]),
    ]
    return Document(
        language=data.language,
        letterhead=letterhead(data.plant, data.logo_svg, f"/shifts/{sheet.shift}/sheet.html", say),
        title=title,
        subtitle=say("shift.subtitle"),
        banners=banners,
        verdict=verdict,
        verdict_title=_headline(sheet, say),
        verdict_lines=(),
        sections=(
            _stones(sheet, say),
            _products(sheet.products, room["products"], say),
            *(
                _listed(named[name], name, rows, room[name], say, stop_min=say.size(sheet.stop_min))
                for name, rows in lists.items()
            ),
        ),
        footer=say("report.footer", name=title, at=say.time(data.created_at)),
        page=say("report.page"),
        created_at=data.created_at,
        is_sheet=True,
    )


def room_of(wanted: Mapping[str, int], n_rows: int) -> dict[str, int]:
    """Share lines out among lists: one after the other gets one more, until all have theirs or none is left."""
    room = dict.fromkeys(wanted, 0)
    while n_rows and (waiting := [name for name in wanted if room[name] < wanted[name]]):
        for name in waiting[:n_rows]:
            room[name] += 1
        n_rows -= min(n_rows, len(waiting))
    return room


@dataclass(frozen=True, slots=True)
class Clock:
    """Times as a sheet writes them: without the day, where that is the one on which its shift began."""

    since: str
    say: Words

    def _local(self, utc: str) -> datetime:
        return datetime.fromisoformat(utc).astimezone(self.say.zone)

    def day(self, utc: str) -> str:
        """Return the day of a moment."""
        return f"{self._local(utc):{self.say('number.date_format')}}"

    def time(self, utc: str | None) -> str:
        """Return the time of a moment; a dash for None."""
        if utc is None:
            return DASH
        day = "" if self.day(utc) == self.day(self.since) else f"{self._local(utc):{self.say('trend.day')}} "
        return f"{day}{self._local(utc):%H:%M}"


def _headline(sheet: ShiftSheet, say: Words) -> str:
    """Return mass and stones, and how many lots have which verdict."""
    mass_kg = sum(each.mass_kg or 0.0 for each in sheet.products)
    is_known = any(each.mass_kg is not None for each in sheet.products)
    parts = [
        say("lot.tonnes", value=say.number(mass_kg / 1000, 3)) if is_known else say("shift.no_mass"),
        say.counted("shift.n_stones", sheet.triggers),
        say.counted("shift.n_lots", len(sheet.lots)),
    ]
    counted = Counter(each.verdict for each in sheet.lots if each.is_final)
    parts += [f"{n} × {say.known('verdict', each)}" for each in JUDGED if (n := counted[each])]
    return " · ".join(parts)


def _stones(sheet: ShiftSheet, say: Words) -> Section:
    """Return the section on time, stones and mass, with what the mass is based on."""
    based = [
        say(
            "shift.based" if each.density_kg_m3 is not None else "shift.no_density",
            product=_title(each, say),
            density=say.number(each.density_kg_m3, 0),
        )
        for each in sheet.products
    ]
    unmeasured = sum(each.unmeasured for each in sheet.products)
    given = [each.lot.tonnage_t for each in sheet.lots if each.lot.tonnage_t is not None and each.is_final]
    counts = {name: say.number(getattr(sheet, name), 0) for name in ("measured", "rejected", "lost", "void")}
    block = facts(
        say,
        "shift",
        time=f"{say.time(sheet.since)} – {say.time(sheet.until)}",
        stones=say("shift.counts", **counts),
        mass=say("shift.mass_is", of=abridged("; ".join(based), 200), n=say.number(unmeasured, 0))
        if based
        else None,
        tonnage=say.counted("shift.given", len(given), value=say.number(sum(given), 1)) if given else None,
    )
    return Section(say("shift.measured"), (block,))


def _title(product: ShiftProduct, say: Words) -> str:
    return abridged(product.title or product.product or say("shift.no_lot"), LONGEST_ID)


def _products(products: Sequence[ShiftProduct], n_shown: int, say: Words) -> Section:
    """Return the table of products: size and shape, with their limits."""
    if not products:
        return Section(say("shift.products"), (Note(say("shift.no_stones")),))
    names = ("d50_mm", "flakiness_percent", "shape_percent")
    columns = [
        Column(say("shift.product"), is_number=False, width=1.8),
        Column(say("shift.n"), width=0.9),
        Column(say("shift.mass_t"), width=1.1),
    ]
    for name in names:
        columns += [Column(say(f"shift.{name}"), width=2.4), Column(say("shift.limits"), width=1.5)]
    rows = [
        [
            _title(each, say),
            say.number(each.measured, 0),
            DASH if each.mass_kg is None else say.number(each.mass_kg / 1000, 3),
            *(
                cell
                for name, limits in zip(
                    names, (each.d50_limits, each.flakiness_limits, each.shape_limits), strict=True
                )
                for cell in (_with_interval(getattr(each, name), say), _limits(limits, say))
            ),
        ]
        for each in products[:n_shown]
    ]
    more = [say("shift.more", n=say.number(n, 0)) + "."] if (n := len(products) - n_shown) else []
    note = Note(" ".join([*more, say("shift.limits_are")]))
    return Section(say("shift.products"), (Table(columns, rows), note))


def _with_interval(figure: Estimate, say: Words) -> str:
    interval = say.interval(figure, 1)
    return say.number(figure.value, 1) + ("" if interval == DASH else f" ({interval})")


def _limits(limits: Range | ControlledRange | None, say: Words) -> str:
    if limits is None:
        return DASH
    low, high = (
        (limits.lower, limits.upper)
        if isinstance(limits, ControlledRange)
        else (limits.min_percent, limits.greatest_percent)
    )
    return f"≤ {say.size(high)}" if low == 0 else f"{say.number(low, 1)} – {say.number(high, 1)}"


COLUMNS: Mapping[str, Sequence[tuple[str, bool, float]]] = {
    "lots": (
        ("lot", False, 2.4),
        ("product", False, 2.0),
        ("from", False, 1.0),
        ("to", False, 1.0),
        ("n", True, 0.9),
        ("d50_mm", True, 0.9),
        ("flakiness_percent", True, 0.8),
        ("shape_percent", True, 0.8),
        ("verdict", False, 2.2),
    ),
    "alarms": (
        ("raised", False, 1.0),
        ("cleared", False, 1.0),
        ("priority", False, 1.2),
        ("alarm", False, 5.8),
        ("noted_by", False, 2.6),
    ),
    "stops": (("from", False, 1.0), ("to", False, 1.0), ("minutes", True, 1.0), ("unarmed", False, 8.0)),
    "diary": (("at", False, 1.0), ("kind", False, 2.4), ("text", False, 5.6), ("by", False, 2.0)),
    "balls": (
        ("at", False, 1.0),
        ("ball_mm", True, 1.2),
        ("error_mm", True, 1.6),
        ("verdict", False, 2.0),
        ("verification", False, 4.0),
    ),
}
"""Columns of each list: the word of the head, whether it has numbers, its width."""


def _listed(
    title: str, name: str, rows: Sequence[Sequence[str]], n_shown: int, say: Words, **facts: str
) -> Section:
    """Return a list with as many rows as there is room for, the others counted."""
    if not rows:
        return Section(title, (Note(say(f"shift.no_{name}", **facts)),))
    columns = [Column(say(f"shift.{head}"), is_number, width) for head, is_number, width in COLUMNS[name]]
    table = Table(columns, rows[:n_shown])
    more = len(rows) - n_shown
    return Section(title, (table, Note(say("shift.more", n=say.number(more, 0)))) if more else (table,))


def lot_row(shown: ShiftLot, clock: Clock, say: Words) -> list[str]:
    """Return the line of a lot."""
    lot, said = shown.lot, shown.said
    figures = (shown.d50_mm, shown.flakiness_percent, shown.shape_percent)
    verdict = DASH if shown.verdict is None else say.known("verdict", shown.verdict)
    if lot.state is LotState.VOID:
        verdict = say("shift.is_void")
    elif not shown.is_final:
        verdict = say("shift.so_far", verdict=verdict)
    elif said is not None and said.is_partial:
        verdict = say("shift.partial", verdict=verdict)
    return [
        abridged(lot.lot, LONGEST_ID),
        abridged(lot.product, LONGEST_ID),
        clock.time(lot.opened_at),
        clock.time(lot.closed_at),
        say.number(lot.n_stones, 0),
        *(DASH if each is None else say.number(each.value, 1) for each in figures),
        verdict,
    ]


def alarm_row(alarm: Alarm, clock: Clock, say: Words) -> list[str]:
    """Return the line of an alarm: raised, cleared, what it is, and who took note."""
    rule = load_rules().of(alarm.check)
    cause = alarm.detail or "" if rule is None else rule.cause[say.language]
    noted = alarm.acknowledged_by and f"{clock.time(alarm.acknowledged_at)} {alarm.acknowledged_by}"
    return [
        clock.time(alarm.raised_at),
        clock.time(alarm.cleared_at or alarm.ended_at),
        say.known("priority", alarm.priority),
        abridged(f"{subject_words(alarm.check, say.language)}: {cause}", LONGEST),
        abridged(noted or say("shift.nobody"), LONGEST_ID),
    ]


def _longest_first(stops: Sequence[ShiftStop]) -> list[ShiftStop]:
    return sorted(stops, key=lambda each: -_minutes(each))


def _minutes(stop: ShiftStop) -> float:
    since, until = (datetime.fromisoformat(each) for each in (stop.since, stop.until))
    return (until - since).total_seconds() / 60


def stop_row(stop: ShiftStop, clock: Clock, say: Words) -> list[str]:
    """Return the line of a time without a stone."""
    unarmed = say("shift.unarmed_for", minutes=say.number(stop.unarmed_s / 60, 0))
    return [
        clock.time(stop.since),
        clock.time(stop.until),
        say.number(_minutes(stop), 0),
        unarmed if stop.unarmed_s else "",
    ]


def diary_row(entry: DiaryEntry, clock: Clock, say: Words) -> list[str]:
    """Return the line of an entry of the diary."""
    return [
        clock.time(entry.at),
        entry_name(entry, say),
        abridged(entry.text or DASH, LONGEST),
        abridged(entry.who, LONGEST_ID),
    ]


def ball_row(ball: EndedVerification, clock: Clock, say: Words) -> list[str]:
    """Return the line of a verification with a ball."""
    sign = "+" if (ball.error_mm or 0) > 0 else ""
    return [
        clock.time(ball.at),
        say.number(ball.diameter_mm, 2),
        sign + say.number(ball.error_mm, 3),
        say.known("verification", ball.outcome),
        abridged(ball.id, LONGEST),
    ]
