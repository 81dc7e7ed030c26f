"""The reports of lots."""

from typing import Annotated

from fastapi import APIRouter, Path, Query, Response
from fastapi import Request as HttpRequest

from service.base.language import Language
from service.lots.routes.lot_figures import Measuring
from service.lots.routes.lots import LotName
from service.lots.yardsticks import Request
from service.reports.lot_reports import ReportRequest, RigStanding, lot_report
from service.reports.report import ReportFormat
from service.web.auth import READABLE
from service.web.context import ApiContext, Context
from service.web.etags import Responses
from service.web.negotiation import negotiated
from service.web.problems import existing, problem_responses

router = APIRouter(prefix="/lots", tags=["lots"], dependencies=READABLE)

OFFERS = {each: each.media_type.partition(";")[0] for each in ReportFormat}
REPORTS: Responses = {200: {"content": {media_type: {} for media_type in OFFERS.values()}}}
REPORT_POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"
"""What a browser lets the HTML do: it has no scripts and loads nothing."""
ReportLanguage = Annotated[Language, Query(description="Language of the report")]


@router.get("/{lot}/report", response_class=Response, responses={**REPORTS, **problem_responses(406)})
async def report(
    context: Context,
    asked: HttpRequest,
    lot: LotName,
    measuring: Measuring,
    language: ReportLanguage = Language.ENGLISH,
) -> Response:
    """Get the report of a lot: in the format that `Accept` prefers, HTML, PDF, CSV or XLSX."""
    return await _report(context, lot, negotiated(asked, OFFERS, "a report"), language, measuring)


@router.get("/{lot}/report.{report_format}", response_class=Response, responses=REPORTS)
async def report_file(
    context: Context,
    lot: LotName,
    report_format: Annotated[ReportFormat, Path(description="Format of the file")],
    measuring: Measuring,
    language: ReportLanguage = Language.ENGLISH,
) -> Response:
    """Download the report of a lot as a file of this format."""
    return await _report(context, lot, report_format, language, measuring)


async def _report(
    context: ApiContext, lot: str, report_format: ReportFormat, language: Language, measuring: Request
) -> Response:
    wanted = ReportRequest(figures=measuring, language=language, rig=context.part(RigStanding))
    content = await context.read_beside(lot_report, context.store.particles_dir, lot, wanted, report_format)
    name = f'inline; filename="{lot}.{report_format}"'
    headers = {"Content-Disposition": name, "Vary": "Accept", "Content-Security-Policy": REPORT_POLICY}
    return Response(existing(content, "lot", lot), media_type=report_format.media_type, headers=headers)
