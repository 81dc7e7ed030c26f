"""Shifts and their sheets: one page a shift, as figures, HTML and PDF."""

from datetime import UTC, datetime
from typing import Annotated, Literal

from fastapi import APIRouter, Depends, Path, Query, Response

from service.base.language import Language
from service.base.schema import served
from service.lots.shifts import LotsSettings, Shift, shift_named, shifts_before
from service.reports.lot_reports import RigStanding
from service.reports.report import MEDIA_TYPES, ReportFormat
from service.reports.routes.lot_reports import REPORT_POLICY, ReportLanguage
from service.reports.shift_data import ShiftDocument, ShiftRequest, ShiftSheet, shift_document, shift_sheet
from service.reports.shift_sheet import SheetRequest, sheet_file
from service.web.auth import READABLE
from service.web.context import Context
from service.web.etags import Responses
from service.web.problems import existing, problem_responses

router = APIRouter(prefix="/shifts", tags=["shifts"], dependencies=READABLE)

SheetFormat = Literal[ReportFormat.HTML, ReportFormat.PDF]
SHEETS: Responses = {
    200: {
        "content": {MEDIA_TYPES[each].partition(";")[0]: {} for each in (ReportFormat.HTML, ReportFormat.PDF)}
    }
}


@served
class Shifts:
    """Shifts, by the host's local time."""

    items: list[ShiftDocument]
    """Newest first; the first one goes on."""


async def shift_of(
    context: Context,
    shift: Annotated[
        str,
        Path(
            max_length=64,
            description="When it begins, by the host's local time, such as `2026-03-02-0600`; the newest 1000 days",
        ),
    ],
) -> Shift:
    """Return the shift of a name; raise the problem 404 if there is none."""
    now = datetime.now(UTC).astimezone()
    return existing(shift_named(shift, now, context.part(LotsSettings).shift_starts), "shift", shift)


NamedShift = Annotated[Shift, Depends(shift_of)]


@router.get("")
async def list_shifts(
    context: Context, limit: Annotated[int, Query(ge=1, le=1000, description="Shifts, at most")] = 30
) -> Shifts:
    """List the present shift and those before it; `[lots] shift_starts` says when they begin."""
    now = datetime.now(UTC).astimezone()
    found = shifts_before(now, context.part(LotsSettings).shift_starts, limit)
    return Shifts(items=[shift_document(each, now) for each in found])


@router.get("/{shift}", responses=problem_responses(404))
async def get_shift(context: Context, shift: NamedShift) -> ShiftSheet:
    """Get all that the sheet of a shift says: mass and stones, lots, alarms, diary, ball, times without a stone."""
    wanted = ShiftRequest(
        shift=shift,
        now=datetime.now(UTC),
        lots=context.part(LotsSettings),
        density_kg_m3=context.part(RigStanding).density_kg_m3,
    )
    return await context.read_beside(shift_sheet, wanted)


@router.get(
    "/{shift}/sheet.{sheet_format}",
    response_class=Response,
    responses={**SHEETS, **problem_responses(404)},
)
async def shift_sheet_file(
    context: Context,
    shift: NamedShift,
    sheet_format: Annotated[SheetFormat, Path(description="Format of the file")],
    language: ReportLanguage = Language.ENGLISH,
) -> Response:
    """Download the sheet of a shift: one page of A4."""
    wanted = SheetRequest(
        shift=shift,
        now=datetime.now(UTC),
        lots=context.part(LotsSettings),
        rig=context.part(RigStanding),
        language=language,
    )
    content = await context.read_beside(sheet_file, wanted, sheet_format)
    headers = {
        "Content-Disposition": f'inline; filename="shift-{shift.name}.{sheet_format}"',
        "Content-Security-Policy": REPORT_POLICY,
    }
    return Response(content, media_type=MEDIA_TYPES[sheet_format], headers=headers)
